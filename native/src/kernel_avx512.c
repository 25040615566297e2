#define LANES 16
#define SHORT 16
#define ROWS 11
#include "kernel.inc.h"
#include "isa.h"

const isa isa_avx512 = {"avx512", LANES, SHORT, predict};
