/* The proof that a texture file carries: golden windows and steps, which have to come out as they did in training. */
#include <math.h>

#include "constants.h"
#include "loop.h"

enum { GOLDEN_STEPS = 64, MOST_GOLDEN = 4096 };

/* Of n golden windows or steps, how many are replayed: all, but to a fuzzer, whose time is short, two are as good as many. */
static size_t replayed(size_t n) {
#ifdef FOTEN_FUZZING
    return n < 2 ? n : 2;
#else
    return n;
#endif
}

/* Whether n numbers are near enough to those in the file; a reason in the file where they are not. */
static int proven(texture_file *file, const char *what, const double *ours, const double *expected, size_t n, double tolerance) {
    double worst = 0;
    for (size_t i = 0; i < n; i++) {
        double size = fabs(expected[i]) > 1 ? fabs(expected[i]) : 1, error = fabs(ours[i] - expected[i]) / size;
        if (error > worst || isnan(error)) worst = error; /* than which nothing is larger */
    }
#ifdef FOTEN_FUZZING
    tolerance = INFINITY; /* what a hostile file makes of the loop is to be reached */
    worst = 0;
#endif
    if (worst <= tolerance) return 1;
    file_refuse(file, FOTEN_NO_PROOF, "the texture file fails its own proof: %s differs by %.2g scaled from what was trained, expected at most %g; is the file damaged?",
                what, worst, tolerance);
    return 0;
}

foten_status model_prove(foten_model *m, texture_file *file) {
    arena memory = {0};
    size_t shape[4], length = (size_t)m->history;
    foten_status status = FOTEN_BAD_FILE;
    if (file_shape(file, "golden.one_step", shape) != 1 || shape[0] < FOTEN_LEAST_GOLDEN || shape[0] > MOST_GOLDEN) {
        file_refuse(file, FOTEN_BAD_FILE, "the file holds no golden windows, or not from %d to %d of them, which prove it", FOTEN_LEAST_GOLDEN, MOST_GOLDEN);
        return FOTEN_BAD_FILE;
    }
    size_t n = shape[0];
    const double *windows = file_take(file, "golden.windows", (size_t[]){n, length, 3, 0}, &memory);
    const double *one_step = windows ? file_take(file, "golden.one_step", (size_t[]){n, 0, 0, 0}, &memory) : NULL;
    const double *conditions = one_step ? file_take(file, "golden.condition", (size_t[]){GOLDEN_STEPS, 2, 0, 0}, &memory) : NULL;
    const double *closed = conditions ? file_take(file, "golden.closed_loop", (size_t[]){GOLDEN_STEPS, 0, 0, 0}, &memory) : NULL;
    const double *warm = closed ? file_take(file, "warm_start", (size_t[]){length, 3, 0, 0}, &memory) : NULL;
    const double *sigma = warm && m->excited ? file_take(file, "golden.sigma", (size_t[]){n, 0, 0, 0}, &memory) : NULL;
    if (memory.failed) status = FOTEN_NO_MEMORY;
    if (!warm || (m->excited && !sigma) || !file_all_taken(file, m->name)) goto done;

    block size = {0};
    loop_place(m, &size);
    block kept = {arena_take(&m->memory, size.used, 1), 0}, tried = {arena_take(&memory, size.used, 1), 0};
    double *ours = arena_take(&memory, n > GOLDEN_STEPS ? n : GOLDEN_STEPS, sizeof *ours);
    if (!kept.base || !tried.base || !ours) {
        status = file_refuse(file, FOTEN_NO_MEMORY, "no memory");
        goto done;
    }
    m->begin = loop_place(m, &kept);
    loop *l = loop_place(m, &tried);
    for (size_t i = 0; i < replayed(n); i++) {
        foten_prediction prediction;
        m->kind->start(m, l, windows + i * length * 3, m->history, 1);
        m->kind->predict(m, l, FOTEN_PREDICT_MODEL, &prediction);
        ours[i] = prediction.sample;
    }
    status = FOTEN_NO_PROOF;
    if (!proven(file, "one step", ours, one_step, n, FOTEN_ONE_STEP_TOLERANCE)) goto done;
    for (size_t i = 0; m->excited && i < replayed(n); i++) {
        m->kind->start(m, l, windows + i * length * 3, m->history, 0);
        ours[i] = m->kind->scale(m, l);
    }
    if (m->excited && !proven(file, "the excitation", ours, sigma, n, FOTEN_ONE_STEP_TOLERANCE)) goto done;
    m->kind->start(m, m->begin, warm, m->history, 0);
    loop_copy(m, l, m->begin);
    for (size_t i = 0; i < replayed(GOLDEN_STEPS); i++) {
        int cut;
        condition c = condition_of(&m->lattice.level, conditions + 2 * i);
        double noise = noise_at(0, 0, i);
        ours[i] = m->kind->step(m, l, &c, model_is_random(m) ? &noise : NULL, INFINITY, &cut);
    }
    if (proven(file, "64 closed-loop steps", ours, closed, GOLDEN_STEPS, FOTEN_CLOSED_LOOP_TOLERANCE)) status = FOTEN_OK;
done:
    arena_free(&memory);
    return status;
}
