/* The instruction sets in this library, and the one that is used. */
#ifndef FOTEN_ISA_H
#define FOTEN_ISA_H
#include "network.h"

extern const isa isa_portable, isa_avx2, isa_avx512, isa_neon, isa_simd128;

/* The best that this processor has, or the one that FOTEN_ISA names if the processor has it. Looked up once. */
const isa *isa_here(void);
#endif
