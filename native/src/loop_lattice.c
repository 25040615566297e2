/* The loop of foten-plus: an excited lattice, with tones of the path or with the network's correction of the next innovation. */
#include <math.h>

#include "loop.h"

/* Of the lattice that predicts a recording and the one that is excited; they take turns in a stream's memory. */
static int longer_order(const foten_model *m) { return m->lattice.order > m->excited_lattice->order ? m->lattice.order : m->excited_lattice->order; }

static void place(const foten_model *m, loop *l, block *from) {
    lattice_place(&l->lattice, longer_order(m), from);
    l->tones.coefficients = block_take(from, 2 * (size_t)m->tones.n, sizeof *l->tones.coefficients);
    predictor_place(&m->predictor, &l->predictor, from);
}

/* Make ready, at the phase that there is, for the sample after one under a condition. */
static void set_condition(const foten_model *m, loop *l, const condition *c, int first) {
    int moved = first || loop_moved(l, c), moved_path = moved || c->path_speed != l->condition.path_speed;
    l->condition = *c;
    if (moved) {
        lattice_set_condition(m->excited_lattice, &l->lattice, c->scaled);
        excitation_set_condition(&m->excitation, &l->excitation, c->scaled);
    }
    if (m->tones.n) tones_set_condition(&m->tones, &m->lattice.level, &l->tones, c, moved_path);
}

/* Take in a recorded sample of the vibration, whose lattice is made ready for it. */
static void analyse(const foten_model *m, loop *l, const double *sample) {
    double e = lattice_analyse(&l->lattice, m->lattice.order, sample[0] / gain_after(&m->lattice, &l->lattice));
    predictor_push(&m->predictor, &l->predictor, sample[0] / l->lattice.level, sample + 1, e / gain_before(&m->lattice, &l->lattice));
}

static void start_with_tones(const foten_model *m, loop *l, const double *windows, int n) {
    const lattice *of = m->excited_lattice;
    const scale *level = &m->lattice.level;
    condition last = condition_of(level, windows + 3 * n - 2);
    tones_fit(&m->tones, level, &l->tones, windows, n);
    for (int t = 1; t < n; t++) {
        condition before = condition_of(level, windows + 3 * t - 2);
        double tone = tones_follow(&m->tones, level, &l->tones, &before);
        lattice_set_condition(of, &l->lattice, before.scaled);
        lattice_analyse(&l->lattice, of->order, (windows[3 * t] - tone) / gain_after(of, &l->lattice));
    }
    tones_begin_path(&m->tones, &l->tones, &last);
    set_condition(m, l, &last, 1);
}

static void start(const foten_model *m, loop *l, const double *windows, int n, int as_prediction) {
    predictor_clear(&m->predictor, &l->predictor);
    l->excitation.volatility = 0;
    lattice_clear(&l->lattice, longer_order(m));
    if (m->tones.n && !as_prediction) {
        start_with_tones(m, l, windows, n);
        return;
    }
    for (int t = 1; t < n; t++) {
        lattice_set_condition(&m->lattice, &l->lattice, windows + 3 * t - 2);
        analyse(m, l, windows + 3 * t);
    }
    condition last = condition_of(&m->lattice.level, windows + 3 * n - 2);
    if (m->tones.n) lattice_set_condition(&m->lattice, &l->lattice, last.scaled);
    else set_condition(m, l, &last, 1);
}

/* What the network adds, in units of the innovation. */
static double correction(const foten_model *m, loop *l) {
    return m->correction_limit * tanh(predictor_predict(&m->predictor, &l->predictor) / m->correction_limit);
}

/* The lattice of the vibration and the network predict, with tones as well: the phase of a recording is not known. The scale is
 * that of a rendering, and so known only where that predicts the same. */
static void predict(const foten_model *m, loop *l, foten_prediction_part part, foten_prediction *out) {
    int with_network = part == FOTEN_PREDICT_MODEL || (part == FOTEN_PREDICT_RENDERING && m->network_in_loop);
    double unit = l->lattice.all_cosines * l->lattice.level;
    *out = (foten_prediction){lattice_predict(&l->lattice, m->lattice.order) * gain_after(&m->lattice, &l->lattice), 0, 0};
    if (with_network) out->sample += unit * correction(m, l);
    if (m->tones.n) return;
    if (with_network == m->network_in_loop) out->scale = unit * l->excitation.sigma;
    out->tail = l->excitation.tail;
}

static void push(const foten_model *m, loop *l, const double *sample) {
    analyse(m, l, sample);
    condition now = condition_of(&m->lattice.level, sample + 1);
    if (m->tones.n) lattice_set_condition(&m->lattice, &l->lattice, now.scaled);
    else set_condition(m, l, &now, 0);
}

static double scale_of_noise(const foten_model *m, const loop *l) {
    return l->lattice.all_cosines * l->lattice.level * excitation_factor(&m->excitation, &l->excitation) * l->excitation.sigma;
}

static double step(const foten_model *m, loop *l, const condition *c, const double *noise, double limit) {
    const lattice *of = m->excited_lattice;
    double e = m->network_in_loop ? correction(m, l) : 0;
    if (noise) e += excitation_next(&m->excitation, &l->excitation, *noise, l->lattice.all_cosines * l->lattice.level);
    double sample = gain_after(of, &l->lattice) * lattice_synthesise(&l->lattice, of->order, gain_before(of, &l->lattice) * e);
    if (m->tones.n) {
        sample += l->tones.tone;
        tones_push(&m->tones, &l->tones, e, c);
    } else {
        predictor_push(&m->predictor, &l->predictor, sample / l->lattice.level, c->scaled, e);
    }
    set_condition(m, l, c, 0);
    return loop_cut(l, sample, limit);
}

/* Draw the states, the volatility, and the phase of tones; run the network, where it is in the loop, for the length of its window. */
static void begin(const foten_model *m, loop *l, const condition *c, noise_source noise) {
    const lattice *of = m->excited_lattice;
    set_condition(m, l, c, 1);
    /* The mean square of z exp(h z^2 / 2) is (1 - 2h)^(-3/2). */
    double size = gain_before(of, &l->lattice) * l->excitation.sigma * excitation_rms(&l->excitation);
    for (int i = 0; i < of->order; i++) l->lattice.states[i] = size * noise_next(&noise);
    excitation_draw(&m->excitation, &l->excitation, noise_next(&noise));
    if (m->tones.n) {
        double sine = noise_next(&noise), cosine = noise_next(&noise);
        tones_draw(&l->tones, sine, cosine);
        set_condition(m, l, c, 1);
        return;
    }
    predictor_fill(&m->predictor, &l->predictor, c->scaled);
    if (m->network_in_loop) loop_run(m, l, c, &noise, m->predictor.window, INFINITY);
}

static void quiet(const foten_model *m, loop *l) {
    lattice_quiet(&l->lattice, m->excited_lattice->order);
    predictor_quiet(&m->predictor, &l->predictor);
}

const loop_kind lattice_loop = {place, start, begin, predict, push, scale_of_noise, step, quiet};
