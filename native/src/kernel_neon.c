#define LANES 4
#define ROWS 8
#include "kernel.inc.h"

const isa isa_neon = {"neon", LANES, predict};
