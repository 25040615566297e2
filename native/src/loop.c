#include "loop.h"

#include <string.h>

/* What must survive a sample, first in a loop's memory. */
static loop *place_state(const foten_model *m, block *from) {
    loop measured, *l = block_take(from, 1, sizeof *l);
    m->kind->place(m, l ? l : &measured, from);
    return l;
}

loop *loop_place(const foten_model *m, block *from) {
    loop *l = place_state(m, from);
    predictor_place_scratch(&m->predictor, l ? &l->predictor : NULL, from);
    return l;
}

void loop_copy(const foten_model *m, loop *to, const loop *from) {
    block size = {NULL, 0}, own = {(unsigned char *)to, 0};
    float *scratch = to->predictor.scratch;
    place_state(m, &size);
    memcpy(to, from, size.used);
    place_state(m, &own); /* which sets the pointers anew, and nothing else */
    to->predictor.scratch = scratch;
}
