/* The loop of models that are given the last samples alone: networks and graphs, with a random part or without, and models of noise. */
#include <math.h>

#include "loop.h"

static void place(const foten_model *m, loop *l, block *from) {
    predictor_place(&m->predictor, &l->predictor, from);
    innovation_place(&m->rendering_network, &l->innovation, from);
}

/* Make ready for the sample after one under a condition. */
static void set_condition(const foten_model *m, loop *l, const condition *c, int first) {
    if (m->excited && (first || loop_moved(l, c))) {
        excitation_set_condition(&m->excitation, &l->excitation, c->scaled);
        if (m->network_in_loop) l->lattice.level = scale_at(&m->lattice.level, c->scaled, l->lattice.logs);
    }
    l->condition = *c;
}

/* Go on from a sample, what was predicted of it without innovation, and what an innovation was worth. */
static void follow(const foten_model *m, loop *l, double sample, double predicted, double unit, const condition *c) {
    predictor_push(&m->predictor, &l->predictor, sample, c->scaled);
    set_condition(m, l, c, 0);
    if (m->network_in_loop)
        innovation_push(m->network_in_loop, &l->innovation, (sample - predicted) / unit, asinh(sample / unit), l->lattice.logs, 0);
}

static void push(const foten_model *m, loop *l, const double *sample) {
    condition now = condition_of(&m->lattice.level, sample + 1);
    l->predictor.n_pending = 0; /* a hop goes on from its own samples */
    double predicted = m->network_in_loop ? predictor_predict(&m->predictor, &l->predictor) : 0;
    follow(m, l, sample[0], predicted, l->lattice.level, &now);
}

static void start(const foten_model *m, loop *l, const double *windows, int n, int as_prediction) {
    (void)as_prediction;
    condition last = condition_of(&m->lattice.level, windows + 3 * n - 2);
    predictor_clear(&m->predictor, &l->predictor);
    l->excitation.volatility = 0;
    for (int t = 0; t < n; t++) predictor_push(&m->predictor, &l->predictor, windows[3 * t], windows + 3 * t + 1);
    set_condition(m, l, &last, 1);
    if (m->network_in_loop) innovation_clear(m->network_in_loop, &l->innovation, l->lattice.logs, 0);
}

/* A network of innovations adds what it expects. */
static void predict(const foten_model *m, loop *l, foten_prediction_part part, double recorded, foten_prediction *out) {
    (void)part;
    double predicted = predictor_predict(&m->predictor, &l->predictor), unit = l->lattice.level;
    *out = (foten_prediction){.sample = predicted};
    if (m->network_in_loop) {
        out->sample += unit * innovation_mixture(m->network_in_loop, &l->innovation);
        loop_score(m->network_in_loop, &l->innovation, recorded - predicted, unit, out);
    } else if (m->excited) excitation_score(&l->excitation, recorded - predicted, l->excitation.sigma, out);
}

static double scale_of_noise(const foten_model *m, const loop *l) {
    if (m->network_in_loop) return l->lattice.level * l->excitation.sigma;
    return m->excited ? excitation_factor(&m->excitation, &l->excitation) * l->excitation.sigma : 0;
}

/* Nothing bounds a network on its own output, so it goes on from the cut sample. */
static double step(const foten_model *m, loop *l, const condition *c, const double *noise, double limit) {
    double predicted = predictor_predict(&m->predictor, &l->predictor), sample = predicted, unit = scale_of_noise(m, l);
    if (m->network_in_loop) sample += unit * loop_drawn(m, l, noise, unit);
    else if (noise && m->excited) sample += excitation_next(&m->excitation, &l->excitation, *noise, 1);
    double played = loop_cut(l, sample, limit);
    double fed_back = !m->of_noise ? played : noise ? *noise : 0;
    follow(m, l, fed_back, predicted, unit, c);
    return played * c->fade;
}

void loop_take_noise(const foten_model *m, loop *l, const noise_source *noise) {
    noise_source from = noise ? *noise : (noise_source){0};
    for (int i = 0; i < m->predictor.window; i++) l->predictor.window[i * m->predictor.n_inputs] = noise ? (float)noise_next(&from) : 0;
}

/* With an excitation run for a window's length. */
static void begin(const foten_model *m, loop *l, const condition *c, noise_source noise) {
    if (m->of_noise) {
        predictor_fill(&m->predictor, &l->predictor, c->scaled);
        loop_take_noise(m, l, &noise);
    }
    if (!m->excited) return;
    set_condition(m, l, c, 1);
    predictor_set_condition(&m->predictor, &l->predictor, c->scaled);
    excitation_draw(&m->excitation, &l->excitation, noise_next(&noise));
    if (m->network_in_loop) innovation_clear(m->network_in_loop, &l->innovation, l->lattice.logs, 0);
    loop_run(m, l, c, &noise, m->predictor.window, FOTEN_LOUDEST_BEGINNING);
}

static void quiet(const foten_model *m, loop *l) { predictor_quiet(&m->predictor, &l->predictor); }

const loop_kind window_loop = {place, start, begin, predict, push, scale_of_noise, step, quiet};
