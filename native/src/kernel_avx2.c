#define LANES 8
#define SHORT 8
#define ROWS 5
#include "kernel.inc.h"
#include "isa.h"

const isa isa_avx2 = {"avx2", LANES, SHORT, predict};
