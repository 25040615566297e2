#define LANES 4
#define SHORT 4
#define ROWS 8
#include "kernel.inc.h"
#include "isa.h"

const isa isa_neon = {"neon", LANES, SHORT, predict};
