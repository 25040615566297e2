#define LANES 8
#define ROWS 5
#include "kernel.inc.h"

const isa isa_avx2 = {"avx2", LANES, predict};
