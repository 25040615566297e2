/* The loop of piecewise AR: a lattice whose coefficients are mixed from local models, excited by white noise, through
 * zeros where there are any. */
#include <math.h>
#include <string.h>

#include "loop.h"

static const double MIN_SCALE = 1e-9; /* scaled; what varies by nothing at all has no likelihood */

static void place(const foten_model *m, loop *l, block *from) {
    size_t n = (size_t)m->piecewise_ar->ma;
    lattice_place(&l->lattice, m->piecewise_ar->order, from);
    l->mixture.zeros = block_take(from, n, sizeof *l->mixture.zeros);
    l->innovations = block_take(from, n, sizeof *l->innovations);
}

/* Mix the local models for the sample after one under a condition. */
static void set_condition(const foten_model *m, loop *l, const condition *c, int first) {
    int moved = first || loop_moved(l, c);
    l->condition = *c;
    if (!moved) return;
    piecewise_ar_at(m->piecewise_ar, c->scaled, &l->mixture, l->lattice.reflections);
    lattice_turn(&l->lattice, m->piecewise_ar->order);
}

static void remember(const foten_model *m, loop *l, double innovation) {
    int n = m->piecewise_ar->ma;
    if (!n) return;
    memmove(l->innovations + 1, l->innovations, (size_t)(n - 1) * sizeof *l->innovations);
    l->innovations[0] = innovation;
}

/* What past innovations add to the next one, through the zeros. */
static double coloured(const foten_model *m, const loop *l) {
    double sum = 0;
    for (int k = 0; k < m->piecewise_ar->ma; k++) sum += l->mixture.zeros[k] * l->innovations[k];
    return sum;
}

static double scale_of_noise(const foten_model *m, const loop *l) {
    (void)m;
    return l->mixture.gain * l->lattice.all_cosines;
}

static double expected(const foten_model *m, const loop *l) {
    return lattice_predict(&l->lattice, m->piecewise_ar->order) + scale_of_noise(m, l) * coloured(m, l);
}

/* Take in a recorded sample, and its innovation where all samples before are known. */
static void infer(const foten_model *m, loop *l, const double *sample, int known) {
    condition now = condition_of(&m->lattice.level, sample + 1);
    double scale = scale_of_noise(m, l), innovation = 0;
    if (known && scale > 0) innovation = clip((sample[0] - expected(m, l)) / scale, FOTEN_MAX_INNOVATION);
    lattice_analyse(&l->lattice, m->piecewise_ar->order, sample[0]);
    remember(m, l, innovation);
    set_condition(m, l, &now, 0);
}

static void push(const foten_model *m, loop *l, const double *sample) { infer(m, l, sample, 1); }

static void start(const foten_model *m, loop *l, const double *windows, int n, int as_prediction) {
    (void)as_prediction;
    condition first = condition_of(&m->lattice.level, windows + 1);
    lattice_clear(&l->lattice, m->piecewise_ar->order);
    for (int k = 0; k < m->piecewise_ar->ma; k++) l->innovations[k] = 0;
    l->mixture.triangle = 0;
    set_condition(m, l, &first, 1);
    for (int t = 1; t < n; t++) infer(m, l, windows + 3 * t, t > m->piecewise_ar->order);
}

static void predict(const foten_model *m, loop *l, foten_prediction_part part, double recorded, foten_prediction *out) {
    (void)part;
    double scale = scale_of_noise(m, l);
    *out = (foten_prediction){.sample = expected(m, l)};
    excitation_score(recorded - out->sample, scale < MIN_SCALE ? MIN_SCALE : scale, out);
}

static double step(const foten_model *m, loop *l, const condition *c, const double *noise, double limit) {
    double e = noise ? *noise : 0;
    double sample = lattice_synthesise(&l->lattice, m->piecewise_ar->order, l->mixture.gain * (e + coloured(m, l)));
    remember(m, l, e);
    set_condition(m, l, c, 0);
    return loop_cut(l, sample * c->fade, limit);
}

/* Draw states and innovations; with zeros, which colour what enters the lattice, run until it has settled. */
static void begin(const foten_model *m, loop *l, const condition *c, noise_source noise) {
    int n_zeros = m->piecewise_ar->ma;
    double power = 1;
    set_condition(m, l, c, 1);
    for (int k = 0; k < n_zeros; k++) power += l->mixture.zeros[k] * l->mixture.zeros[k];
    double size = l->mixture.gain * sqrt(power);
    for (int i = 0; i < m->piecewise_ar->order; i++) l->lattice.states[i] = size * noise_next(&noise);
    for (int k = 0; k < n_zeros; k++) l->innovations[k] = noise_next(&noise);
    if (n_zeros) loop_run(m, l, c, &noise, FOTEN_SETTLING_SAMPLES, INFINITY);
}

static void quiet(const foten_model *m, loop *l) { lattice_quiet(&l->lattice, m->piecewise_ar->order); }

const loop_kind piecewise_ar_loop = {place, start, begin, predict, push, scale_of_noise, step, quiet, NULL};
