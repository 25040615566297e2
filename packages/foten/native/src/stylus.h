/* What api.c needs of a stylus: see foten.h. */
#pragma once
#include "foten.h"

/* Speed [mm/s] and force [N] of the next sample of the texture's own rate. */
void stylus_block(foten_stylus *stylus);
void stylus_next(foten_stylus *stylus, double out[2]);
