#define LANES 16
#define ROWS 11
#include "kernel.inc.h"

const isa isa_avx512 = {"avx512", LANES, predict};
