/* The loop of models that predict from the last samples: networks and graphs, with an excitation or without. */
#include <math.h>

#include "loop.h"

static void place(const foten_model *m, loop *l, block *from) { predictor_place(&m->predictor, &l->predictor, from); }

/* Make ready for the sample after one under a condition. */
static void set_condition(const foten_model *m, loop *l, const condition *c, int first) {
    if (m->excited && (first || loop_moved(l, c))) l->sigma = excitation_sigma(&m->excitation, c->scaled);
    l->condition = *c;
}

static void push(const foten_model *m, loop *l, const double *sample) {
    condition now = condition_of(&m->lattice.level, sample + 1);
    predictor_push(&m->predictor, &l->predictor, sample[0], now.scaled, 0);
    set_condition(m, l, &now, 0);
}

static void start(const foten_model *m, loop *l, const double *windows, int n, int as_prediction) {
    (void)as_prediction;
    condition last = condition_of(&m->lattice.level, windows + 3 * n - 2);
    predictor_clear(&m->predictor, &l->predictor);
    for (int t = 0; t < n; t++) predictor_push(&m->predictor, &l->predictor, windows[3 * t], windows + 3 * t + 1, 0);
    set_condition(m, l, &last, 1);
}

static void predict(const foten_model *m, loop *l, foten_prediction_part part, double recorded, foten_prediction *out) {
    (void)part;
    *out = (foten_prediction){.sample = predictor_predict(&m->predictor, &l->predictor)};
    if (m->excited) excitation_score(recorded - out->sample, l->sigma, out);
}

static double scale_of_noise(const foten_model *m, const loop *l) { return m->excited ? l->sigma : 0; }

/* Nothing bounds a network in its closed loop, so it goes on from the cut sample. */
static double step(const foten_model *m, loop *l, const condition *c, const double *noise, double limit) {
    double sample = predictor_predict(&m->predictor, &l->predictor);
    if (noise && m->excited) sample += l->sigma * excitation_limited(&m->excitation, *noise, l->sigma);
    double played = loop_cut(l, sample, limit);
    predictor_push(&m->predictor, &l->predictor, played, c->scaled, noise ? *noise : 0);
    set_condition(m, l, c, 0);
    return played * c->fade;
}

/* With an excitation run for a window's length. */
static void begin(const foten_model *m, loop *l, const condition *c, noise_source noise) {
    if (!m->excited) {
        predictor_take_noise(&m->predictor, &l->predictor, &noise);
        return;
    }
    set_condition(m, l, c, 1);
    predictor_set_condition(&m->predictor, &l->predictor, c->scaled);
    loop_run(m, l, c, &noise, m->predictor.window, FOTEN_MAX_INITIAL);
}

static void quiet(const foten_model *m, loop *l) { predictor_quiet(&m->predictor, &l->predictor); }

static double replace_last(const foten_model *m, loop *l, double sample) {
    return predictor_replace_last(&m->predictor, &l->predictor, sample);
}

const loop_kind window_loop = {place, start, begin, predict, push, scale_of_noise, step, quiet, replace_last};
