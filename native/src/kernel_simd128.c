#define LANES 4
#define ROWS 5
#include "kernel.inc.h"

const isa isa_simd128 = {"simd128", LANES, predict};
