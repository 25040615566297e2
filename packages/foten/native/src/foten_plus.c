/* The loop of foten-plus: a lattice with innovations of an excitation or of the recording, and tones of the path. */
#include <math.h>

#include "loop.h"

/* Of the lattice that predicts a recording and the one that is excited; they take turns in a stream's memory. */
static int longer_order(const foten_model *m) {
    return m->lattice.order > m->excited_lattice->order ? m->lattice.order : m->excited_lattice->order;
}

static void place(const foten_model *m, loop *l, block *from) {
    lattice_place(&l->lattice, longer_order(m), from);
    l->tones.coefficients = block_take(from, 2 * (size_t)m->tones.n, sizeof *l->tones.coefficients);
    innovation_place(&m->network, &l->innovation, from);
}

/* Make ready, at the phase that there is, for the sample after one under a condition. */
static void set_condition(const foten_model *m, loop *l, const condition *c, int first) {
    int moved = first || loop_moved(l, c), moved_path = moved || c->path_speed != l->condition.path_speed;
    l->condition = *c;
    if ((m->equaliser.used || m->recorded.used) && (first || moved))
        scale_physical(&m->lattice.level, c->scaled, l->physical);
    if (first) equaliser_settle(&l->equaliser, l->physical[0]);
    if (moved) {
        lattice_set_condition(m->excited_lattice, &l->lattice, c->scaled);
        l->sigma = excitation_sigma(&m->excitation, c->scaled);
    }
    if (m->tones.n) tones_set_condition(&m->tones, &m->lattice.level, &l->tones, c, moved_path);
}

/* Take in a recorded sample of what a lattice is of, which is made ready for it, and its condition; a network, or NULL
 * for none, takes in its innovation. */
static void analyse(loop *l, const lattice *of, const innovation_network *network, double sample, const condition *c) {
    double e =
        lattice_analyse(&l->lattice, of->order, sample / gain_after(of, &l->lattice)) / gain_before(of, &l->lattice);
    double x = sample / l->lattice.level;
    lattice_set_condition(of, &l->lattice, c->scaled);
    if (network) innovation_push(network, &l->innovation, e, x, l->lattice.logs);
}

static void start(const foten_model *m, loop *l, const double *windows, int n, int as_prediction) {
    const lattice *of = as_prediction ? &m->lattice : m->excited_lattice;
    const scale *level = &m->lattice.level;
    int with_tones = m->tones.n && !as_prediction;
    condition last = condition_of(level, windows + 3 * n - 2);
    lattice_clear(&l->lattice, longer_order(m));
    lattice_set_condition(of, &l->lattice, windows + 1);
    innovation_clear(&m->network, &l->innovation);
    if (with_tones) tones_fit(&m->tones, level, &l->tones, windows, n);
    for (int t = 1; t < n; t++) {
        condition before = condition_of(level, windows + 3 * t - 2), now = condition_of(level, windows + 3 * t + 1);
        double tone = with_tones ? tones_follow(&m->tones, level, &l->tones, &before) : 0;
        int warming_up = as_prediction && t >= n - m->warm_up;
        analyse(l, of, warming_up ? &m->network : NULL, windows[3 * t] - tone, &now);
    }
    if (as_prediction) {
        l->sigma = excitation_sigma(&m->excitation, last.scaled);
        return;
    }
    if (with_tones) tones_begin_path(&m->tones, &l->tones, &last);
    set_condition(m, l, &last, 1);
    if (m->recorded.used) recorded_begin(&m->recorded, &l->recorded, l->physical, NULL);
}

/* The lattice of the vibration and its network predict, with tones as well: the phase of a recording is not known. How
 * likely a sample is, is said by the lattice and the excitation; not where a rendering has tones. */
static void predict(const foten_model *m, loop *l, foten_prediction_part part, double recorded, foten_prediction *out) {
    double gain = l->lattice.all_cosines * l->lattice.level;
    double linear = lattice_predict(&l->lattice, m->lattice.order) * gain_after(&m->lattice, &l->lattice);
    *out = (foten_prediction){.sample = linear};
    if (part == FOTEN_PREDICT_MODEL) out->sample += gain * innovation_expected(&m->network, &l->innovation);
    else if (!m->tones.n) excitation_score(recorded - linear, gain * l->sigma, out);
}

static void push(const foten_model *m, loop *l, const double *sample) {
    condition now = condition_of(&m->lattice.level, sample + 1);
    analyse(l, &m->lattice, &m->network, sample[0], &now);
    l->sigma = excitation_sigma(&m->excitation, now.scaled);
}

static double scale_of_noise(const foten_model *m, const loop *l) {
    (void)m;
    return l->lattice.all_cosines * l->lattice.level * l->sigma;
}

/* With the gain before the filter near rest what enters fades, and what rang before rings out, as a tool does; else
 * what leaves. */
static double step(const foten_model *m, loop *l, const condition *c, const double *noise, double limit) {
    const lattice *of = m->excited_lattice;
    double entering = of->gain_before_filter ? c->fade : 1, leaving = of->gain_before_filter ? 1 : c->fade;
    double e = 0;
    if (noise) {
        double innovation = m->recorded.used ? l->recorded.next : *noise;
        e = l->sigma * excitation_limited(&m->excitation, innovation, scale_of_noise(m, l)) * entering;
    }
    double residual =
        gain_after(of, &l->lattice) * lattice_synthesise(&l->lattice, of->order, gain_before(of, &l->lattice) * e);
    double sample = residual * leaving;
    if (m->tones.n) {
        sample += l->tones.tone * c->fade;
        tones_push(&m->tones, &l->tones, e, c);
    }
    set_condition(m, l, c, 0);
    if (m->recorded.used) recorded_advance(&m->recorded, &l->recorded, l->physical, noise);
    if (m->equaliser.used) sample = equaliser_step(&m->equaliser, &l->equaliser, sample, l->physical);
    return loop_cut(l, sample, limit);
}

/* Draw the states, the phase of tones, and where the recording begins. */
static void begin(const foten_model *m, loop *l, const condition *c, noise_source noise) {
    const lattice *of = m->excited_lattice;
    set_condition(m, l, c, 1);
    double size = gain_before(of, &l->lattice) * l->sigma;
    if (of->gain_before_filter) size *= c->fade;
    for (int i = 0; i < of->order; i++) l->lattice.states[i] = size * noise_next(&noise);
    if (m->tones.n) {
        double sine = noise_next(&noise), cosine = noise_next(&noise);
        tones_draw(&l->tones, sine, cosine);
        set_condition(m, l, c, 1);
    }
    if (m->recorded.used) {
        double z = noise_next(&noise);
        recorded_begin(&m->recorded, &l->recorded, l->physical, &z);
    }
}

static void quiet(const foten_model *m, loop *l) {
    lattice_quiet(&l->lattice, m->excited_lattice->order);
    equaliser_quiet(&l->equaliser);
}

const loop_kind lattice_loop = {place, start, begin, predict, push, scale_of_noise, step, quiet, NULL};
