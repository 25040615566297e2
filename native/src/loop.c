#include "loop.h"
#include "noise.h"

#include <math.h>
#include <string.h>

static const double PI = 3.14159265358979323846;
static const double LEAK = 0.9997;          /* of a state in a sample; as foten.dsp.lattice says */
static const double HEAVIEST_TAIL = 0.25;
static const double LARGEST_SHOCK = 4, LARGEST_SWELL = 3, LARGEST_STRAY = 3;
static const double MEAN_SIZE = 0.79788456080286541, SIZE_SD = 0.60281027498907660; /* of |z| */
static const double LOUDEST_BEGUN = 50;       /* standard deviations, of a sample that a stream begins with, where nothing else bounds it */
static const double LARGEST_INNOVATION = 100; /* standard deviations, of those found in a recorded window */
static const double LEAST_SCALE = 1e-9;       /* scaled; what varies by nothing at all has no likelihood */
enum { CANDIDATES = 32, SETTLED_AFTER = 256 };
static const uint64_t TO_BEGIN = (uint64_t)1 << 63; /* the first of the noise numbers that streams begin with */

static double within(double x, double limit) { return x > limit ? limit : x < -limit ? -limit : x; }
static const lattice *heard(const foten_model *m) { return m->n_tones ? &m->residual : &m->whole; }

/* States of what is heard; numbers that the network sees, speed and force of the last sample included. */
static int order_of(const foten_model *m) { return m->local ? m->local->order : m->plus ? heard(m)->order : 0; }
static int window_of(const foten_model *m) { return m->network ? m->network->window : m->predictor ? m->history : 0; }
static size_t numbers_seen(const foten_model *m) { return (size_t)window_of(m) * (size_t)m->n_inputs + (window_of(m) ? 2 : 0); }

loop *loop_place(const foten_model *m, block *from) {
    loop *l = block_take(from, 1, sizeof *l);
    size_t order = 0;
    if (m->plus) order = (size_t)(m->whole.order > m->residual.order ? m->whole.order : m->residual.order);
    if (m->local) order = (size_t)m->local->order;
    size_t zeros = m->local ? (size_t)m->local->ma : 0, seen_numbers = numbers_seen(m);
    double *states = block_take(from, order, sizeof *states), *reflections = block_take(from, order, sizeof *reflections);
    double *cosines = block_take(from, order, sizeof *cosines), *coefficients = block_take(from, 2 * (size_t)m->n_tones, sizeof *coefficients);
    double *coming = block_take(from, zeros, sizeof *coming), *past = block_take(from, zeros, sizeof *past);
    float *seen = block_take(from, seen_numbers, sizeof *seen);
    float *scratch = block_take(from, m->network ? m->network->scratch : 0, sizeof *scratch);
    float *ahead = block_take(from, m->predictor ? (size_t)m->hop : 0, sizeof *ahead);
    if (!from->base) return NULL;
    *l = (loop){.states = states, .reflections = reflections, .cosines = cosines, .coefficients = coefficients, .seen = seen, .scratch = scratch,
                .past = past, .coming = ahead};
    l->local = (local_mixture){.reflections = reflections, .zeros = coming};
    return l;
}

void loop_copy(const foten_model *m, loop *to, const loop *from) {
    loop kept = *to;
    size_t order = (size_t)order_of(m);
    *to = *from;
    to->states = kept.states;
    to->reflections = kept.reflections;
    to->cosines = kept.cosines;
    to->coefficients = kept.coefficients;
    to->seen = kept.seen;
    to->scratch = kept.scratch;
    to->coming = kept.coming;
    to->past = kept.past;
    to->local.reflections = kept.local.reflections;
    to->local.zeros = kept.local.zeros;
    if (order) {
        memcpy(to->states, from->states, order * sizeof *to->states);
        memcpy(to->reflections, from->reflections, order * sizeof *to->states);
        memcpy(to->cosines, from->cosines, order * sizeof *to->states);
    }
    if (m->n_tones) memcpy(to->coefficients, from->coefficients, 2 * (size_t)m->n_tones * sizeof *to->coefficients);
    if (m->local && m->local->ma) {
        memcpy(to->past, from->past, (size_t)m->local->ma * sizeof *to->past);
        memcpy(to->local.zeros, from->local.zeros, (size_t)m->local->ma * sizeof *to->past);
    }
    if (window_of(m)) memcpy(to->seen, from->seen, numbers_seen(m) * sizeof *to->seen);
    if (from->n_coming) memcpy(to->coming, from->coming, (size_t)m->hop * sizeof *to->coming);
}

hand hand_of(const foten_model *m, const double condition[2]) {
    double physical[2] = {0, 0};
    if (m->plus) physical_of(&m->whole.level, condition, physical);
    return (hand){{condition[0], condition[1]}, physical[0]};
}

/* What goes with reflections: their cosines, and the product of these. */
static void reflect(loop *l, int order) {
    for (int i = 0; i < order; i++) l->cosines[i] = sqrt(1 - l->reflections[i] * l->reflections[i]);
    l->gain = 1;
    for (int i = 0; i < order; i++) l->gain *= l->cosines[i];
}

/* The level and the reflections of a lattice for the sample after one under a hand. */
static void follow(const lattice *from, const hand *hand, loop *l) {
    double logs[2], physical[2];
    l->level = scale_at(&from->level, hand->condition, logs);
    physical_of(&from->level, hand->condition, physical);
    plane_at(&from->reflections, physical[0], physical[1], l->reflections);
    reflect(l, from->order);
}

/* Tones of coefficients c_1, s_1, c_2, ... at a phase. */
static double tone_of(const double *coefficients, int n, double phase) {
    double sum = 0;
    for (int k = 0; k < n; k++) sum += coefficients[2 * k] * cos(phase * (k + 1)) + coefficients[2 * k + 1] * sin(phase * (k + 1));
    return sum;
}

/* The tones' coefficients, scaled, for the sample after one under a hand by which the path turns the phase. */
static void tones_at(const foten_model *m, const hand *hand, double turned, double *out) {
    double logs[2], physical[2], level = scale_at(&m->whole.level, hand->condition, logs);
    physical_of(&m->whole.level, hand->condition, physical);
    plane_at(&m->tones, physical[0], physical[1], out);
    for (int k = 0; k < m->n_tones; k++) {
        double audible = 10 - 10 * (k + 1) * turned / PI;
        audible = audible > 1 ? 1 : audible < 0 ? 0 : audible;
        out[2 * k] *= level * audible;
        out[2 * k + 1] *= level * audible;
    }
}

static double turned_by(const foten_model *m, const hand *hand) { return m->turn * hand->path; }

/* Make ready, at the phase that there is, for the sample after one under a hand. */
static void heed(const foten_model *m, loop *l, const hand *hand, int first) {
    int moved = first || hand->condition[0] != l->heeded.condition[0] || hand->condition[1] != l->heeded.condition[1];
    int turned = moved || hand->path != l->heeded.path;
    l->heeded = *hand;
    if (moved && m->excited) {
        double logs[2], powers[5], tail = m->tail_bias;
        if (m->plus) follow(heard(m), hand, l);
        l->sigma = scale_at(&m->sigma, hand->condition, logs);
        powers_of(logs, powers);
        for (int k = 0; k < 5; k++) tail += m->tail[k] * powers[k];
        l->tail = HEAVIEST_TAIL / (1 + exp(-tail));
    }
    if (m->n_tones) {
        l->turned = turned_by(m, hand);
        if (turned) tones_at(m, hand, l->turned, l->coefficients);
        l->tone = tone_of(l->coefficients, m->n_tones, l->phase);
    }
}

/* A recorded sample (over what its level scales) through the lattice from output to innovation, which is returned. */
static double analyse(int order, loop *l, double x) {
    double f = x, before = x;
    for (int i = 0; i < order; i++) {
        double k = l->reflections[i], c = l->cosines[i], b = LEAK * l->states[i];
        double backward = (b + k * f) / c;
        f = (f + k * b) / c;
        l->states[i] = before;
        before = backward;
    }
    return f;
}

/* What the lattice will give without innovation. */
static double foreseen(int order, const loop *l) {
    double f = 0;
    for (int i = order - 1; i >= 0; i--) f = l->cosines[i] * f - l->reflections[i] * (LEAK * l->states[i]);
    return f;
}

/* An innovation through the lattice, which moves on by a sample and gives it. */
static double synthesise(int p, loop *l, double e) {
    double f = e;
    for (int i = p - 1; i >= 0; i--) {
        double k = l->reflections[i], c = l->cosines[i], b = LEAK * l->states[i];
        if (i + 1 < p) l->states[i + 1] = k * f + c * b;
        f = c * f - k * b;
    }
    l->states[0] = f;
    return f;
}

/* What of the level scales the innovation, and what scales that which leaves the lattice. */
static double drive(const lattice *of, const loop *l) { return of->gain_before_filter ? l->level : 1; }
static double behind(const lattice *of, const loop *l) { return of->gain_before_filter ? 1 : l->level; }

/* Append a sample to what the network sees. */
static void see(const foten_model *m, loop *l, double x, const double condition[2], double e) {
    int n = m->n_inputs, window = window_of(m);
    memmove(l->seen, l->seen + n, (size_t)(window - 1) * (size_t)n * sizeof *l->seen);
    float *last = l->seen + (window - 1) * n;
    last[0] = (float)x;
    if (n > 2) {
        last[1] = (float)condition[0];
        last[2] = (float)condition[1];
    }
    if (n == 2 || n == 4) last[n - 1] = (float)e;
    l->seen[window * n] = (float)condition[0];
    l->seen[window * n + 1] = (float)condition[1];
}

static void start_lattice(const foten_model *m, const lattice *of, loop *l, const double *windows, int n) {
    memset(l->states, 0, (size_t)of->order * sizeof *l->states);
    for (int t = 1; t < n; t++) {
        const double *sample = windows + 3 * t;
        hand before = hand_of(m, sample - 2);
        follow(of, &before, l);
        double e = analyse(of->order, l, sample[0] / behind(of, l));
        see(m, l, sample[0] / l->level, sample + 1, e / drive(of, l));
    }
}

/* The phase at which the tones are nearest a window, and the window without them. */
static void start_tones(const foten_model *m, loop *l, const double *windows, int n) {
    double best = INFINITY, chosen = 0, missed[CANDIDATES] = {0}, travelled = 0;
    for (int t = 1; t < n; t++) {
        hand before = hand_of(m, windows + 3 * t - 2);
        double turned = turned_by(m, &before), logs[2], level = scale_at(&m->whole.level, before.condition, logs);
        travelled += turned;
        tones_at(m, &before, turned, l->coefficients);
        for (int k = 0; k < CANDIDATES; k++) {
            double off = (windows[3 * t] - tone_of(l->coefficients, m->n_tones, travelled + 2 * PI * k / CANDIDATES)) / level;
            missed[k] += off * off;
        }
    }
    for (int k = 0; k < CANDIDATES; k++)
        if (missed[k] < best) {
            best = missed[k];
            chosen = 2 * PI * k / CANDIDATES;
        }
    memset(l->states, 0, (size_t)m->residual.order * sizeof *l->states);
    travelled = 0;
    for (int t = 1; t < n; t++) {
        hand before = hand_of(m, windows + 3 * t - 2);
        double turned = turned_by(m, &before);
        travelled += turned;
        tones_at(m, &before, turned, l->coefficients);
        follow(&m->residual, &before, l);
        analyse(m->residual.order, l, (windows[3 * t] - tone_of(l->coefficients, m->n_tones, travelled + chosen)) / behind(&m->residual, l));
    }
    hand last = hand_of(m, windows + 3 * n - 2);
    /* The way to the first sample belongs to the recording, of which nothing is to be left: the path begins here, and the phase
       within half a turn of it. */
    l->phase = travelled + chosen + turned_by(m, &last);
    l->phase -= 2 * PI * floor((l->phase + PI) / (2 * PI));
    l->path = l->rate = 0;
}

/* Mix the local models for the sample after one under a hand. */
static void heed_local(const foten_model *m, loop *l, const hand *hand, int first) {
    int moved = first || hand->condition[0] != l->heeded.condition[0] || hand->condition[1] != l->heeded.condition[1];
    l->heeded = *hand;
    if (!moved) return;
    local_at(m->local, hand->condition, &l->local);
    reflect(l, m->local->order);
}

static void remember(const foten_model *m, loop *l, double innovation) {
    int q = m->local->ma;
    if (!q) return;
    memmove(l->past + 1, l->past, (size_t)(q - 1) * sizeof *l->past);
    l->past[0] = innovation;
}

/* What past innovations add to the next one, through the zeros. */
static double coloured(const foten_model *m, const loop *l) {
    double sum = 0;
    for (int k = 0; k < m->local->ma; k++) sum += l->local.zeros[k] * l->past[k];
    return sum;
}

static void start_local(const foten_model *m, loop *l, const double *windows, int n) {
    int p = m->local->order;
    memset(l->states, 0, (size_t)p * sizeof *l->states);
    if (m->local->ma) memset(l->past, 0, (size_t)m->local->ma * sizeof *l->past);
    l->local.triangle = 0;
    for (int t = 0; t < n; t++) {
        hand hand = hand_of(m, windows + 3 * t + 1);
        if (t > 0) {
            double scale, found = 0, missed = windows[3 * t] - loop_forecast(m, l, &scale, 0);
            if (t > p && scale > 0) found = within(missed / scale, LARGEST_INNOVATION);
            analyse(p, l, windows[3 * t]);
            remember(m, l, found);
        }
        heed_local(m, l, &hand, t == 0);
    }
}

static double step_local(const foten_model *m, loop *l, const hand *hand, const double *noise) {
    double e = noise ? *noise : 0;
    double sample = synthesise(m->local->order, l, l->local.drive * (e + coloured(m, l)));
    remember(m, l, e);
    heed_local(m, l, hand, 0);
    return sample;
}

/* Draw states and innovations; with zeros, which colour what drives the lattice, play until it has settled. */
static void begin_local(const foten_model *m, loop *l, const hand *hand, uint64_t seed, uint64_t stream) {
    uint64_t n = TO_BEGIN;
    int p = m->local->order, q = m->local->ma;
    double power = 1;
    heed_local(m, l, hand, 1);
    for (int k = 0; k < q; k++) power += l->local.zeros[k] * l->local.zeros[k];
    double size = l->local.drive * sqrt(power);
    for (int i = 0; i < p; i++) l->states[i] = size * noise_at(seed, stream, n++);
    for (int k = 0; k < q; k++) l->past[k] = noise_at(seed, stream, n++);
    for (int i = 0; q && i < SETTLED_AFTER; i++) {
        double noise = noise_at(seed, stream, n++);
        step_local(m, l, hand, &noise);
    }
}

void loop_start(const foten_model *m, loop *l, const double *windows, int n, int as_prediction) {
    if (m->local) {
        start_local(m, l, windows, n);
        return;
    }
    hand last = hand_of(m, windows + 3 * n - 2);
    memset(l->seen, 0, numbers_seen(m) * sizeof *l->seen);
    l->swell = 0;
    l->n_coming = 0;
    if (!m->plus) {
        for (int t = 0; t < n; t++) see(m, l, windows[3 * t], windows + 3 * t + 1, 0);
        heed(m, l, &last, 1);
        return;
    }
    if (m->n_tones && !as_prediction) {
        start_tones(m, l, windows, n);
        heed(m, l, &last, 1);
    } else {
        start_lattice(m, &m->whole, l, windows, n);
        follow(&m->whole, &last, l);
        if (!m->n_tones) heed(m, l, &last, 1);
    }
}

/* What a network makes of what it sees; nothing, where somebody else's makes no number of it. */
static double answer(const foten_model *m, loop *l) {
    if (m->network) return m->isa->predict(m->network, l->seen, l->scratch);
    if (!l->n_coming) {
        m->predictor(m->predictor_user, l->seen, l->coming, m->hop);
        l->n_coming = m->hop;
    }
    double found = l->coming[m->hop - l->n_coming];
    if (isfinite(found)) return found;
    l->n_coming = 1;
    return 0;
}

/* What the network adds, in units of the innovation. */
static double correction(const foten_model *m, loop *l) {
    double found = answer(m, l);
    return m->correction_limit * tanh(found / m->correction_limit);
}

static double swelling(const foten_model *m, const loop *l) { return exp(l->swell - m->swell_sd * m->swell_sd); }

double loop_forecast(const foten_model *m, loop *l, double *scale, int with_network) {
    *scale = 0;
    if (m->local) {
        *scale = l->local.drive * l->gain;
        return foreseen(m->local->order, l) + *scale * coloured(m, l);
    }
    if (!m->plus) {
        if (m->excited) *scale = swelling(m, l) * l->sigma;
        return answer(m, l);
    }
    const lattice *of = with_network ? &m->whole : heard(m);
    double sample = foreseen(of->order, l) * behind(of, l), unit = l->gain * l->level;
    if (with_network || m->network_in_loop) sample += unit * correction(m, l);
    if (m->n_tones && !with_network) sample += l->tone;
    *scale = unit * swelling(m, l) * l->sigma;
    return sample;
}

void loop_predict(const foten_model *m, loop *l, foten_prediction_part part, foten_prediction *out) {
    int with_network = part == FOTEN_PREDICT_MODEL || (part == FOTEN_PREDICT_RENDERING && m->network_in_loop);
    *out = (foten_prediction){0, 0, m->excited && !m->local ? l->tail : 0};
    if (m->plus) {
        double unit = l->gain * l->level;
        out->sample = foreseen(m->whole.order, l) * behind(&m->whole, l) + (with_network ? unit * correction(m, l) : 0);
        if (!m->n_tones && with_network == m->network_in_loop) out->scale = unit * l->sigma;
    } else {
        out->sample = loop_forecast(m, l, &out->scale, 1);
        if (m->excited && !m->local) out->scale = l->sigma;
        if (m->local && out->scale < LEAST_SCALE) out->scale = LEAST_SCALE;
    }
}

void loop_push(const foten_model *m, loop *l, const double *sample) {
    hand hand = hand_of(m, sample + 1);
    if (m->local) {
        double scale, missed = sample[0] - loop_forecast(m, l, &scale, 0);
        analyse(m->local->order, l, sample[0]);
        remember(m, l, scale > 0 ? within(missed / scale, LARGEST_INNOVATION) : 0);
        heed_local(m, l, &hand, 0);
    } else if (m->plus) {
        double e = analyse(m->whole.order, l, sample[0] / behind(&m->whole, l));
        see(m, l, sample[0] / l->level, sample + 1, e / drive(&m->whole, l));
        if (m->n_tones) follow(&m->whole, &hand, l);
        else heed(m, l, &hand, 0);
    } else {
        l->n_coming = 0;
        see(m, l, sample[0], sample + 1, 0);
        heed(m, l, &hand, 0);
    }
}

/* What noise excites, where a unit of it is worth `unit` in scaled acceleration; the swell wanders on. */
static double shock_of(const foten_model *m, loop *l, double z, double unit) {
    double size = swelling(m, l) * l->sigma, most = m->largest[1] / (unit * size);
    if (most > m->largest[0]) most = m->largest[0];
    double e = size * within(z * exp(0.5 * l->tail * z * z), most);
    if (m->swell_sd > 0) {
        double shock = fabs(z) < LARGEST_SHOCK ? fabs(z) : LARGEST_SHOCK, kept = m->swell_kept;
        l->swell = within(kept * l->swell + sqrt(1 - kept * kept) * m->swell_sd * ((shock - MEAN_SIZE) / SIZE_SD), LARGEST_SWELL * m->swell_sd);
    }
    return e;
}

double loop_step(const foten_model *m, loop *l, const hand *hand, const double *noise, double limit, int *cut) {
    double sample;
    if (m->local) {
        sample = step_local(m, l, hand, noise);
        double played = within(sample, limit);
        *cut = played != sample;
        return played;
    }
    if (!m->plus) {
        sample = answer(m, l);
        if (noise && m->excited) sample += shock_of(m, l, *noise, 1);
        double played = within(sample, limit);
        *cut = played != sample;
        l->n_coming -= l->n_coming > 0;
        see(m, l, !m->of_noise ? played : noise ? *noise : 0, hand->condition, 0);
        heed(m, l, hand, 0);
        return played;
    }
    const lattice *of = heard(m);
    double e = m->network_in_loop ? correction(m, l) : 0;
    if (noise) e += shock_of(m, l, *noise, l->gain * l->level);
    sample = behind(of, l) * synthesise(of->order, l, drive(of, l) * e);
    if (m->n_tones) {
        sample += l->tone;
        double alike = exp(-l->turned / PI);
        l->phase -= m->forgetting * (l->phase - l->path);
        l->rate = alike * l->rate + sqrt(1 - alike * alike) * (m->unevenness * within(e, LARGEST_STRAY));
        double turned = turned_by(m, hand);
        l->phase += l->turned * l->rate + turned;
        l->path += turned;
    } else {
        see(m, l, sample / l->level, hand->condition, e);
    }
    heed(m, l, hand, 0);
    double played = within(sample, limit);
    *cut = played != sample;
    return played;
}

/* Play a window's length under the hand, whatever was there before. */
static void begin_window(const foten_model *m, loop *l, const hand *hand, uint64_t seed, uint64_t stream) {
    uint64_t n = TO_BEGIN;
    float *last = l->seen + (window_of(m) - 1) * m->n_inputs, *after = last + m->n_inputs;
    heed(m, l, hand, 1);
    for (int i = 0; i < 2; i++) {
        after[i] = (float)hand->condition[i];
        if (m->n_inputs > 2) last[1 + i] = after[i];
    }
    l->swell = m->swell_sd * within(noise_at(seed, stream, n++), LARGEST_SWELL);
    for (int i = 0; i < window_of(m); i++) {
        int cut;
        double noise = noise_at(seed, stream, n++);
        loop_step(m, l, hand, &noise, LOUDEST_BEGUN, &cut);
    }
}

void loop_listen(const foten_model *m, loop *l, uint64_t seed, uint64_t stream) {
    for (int i = 0; m->of_noise && i < window_of(m); i++) l->seen[i * m->n_inputs] = (float)noise_at(seed, stream, TO_BEGIN + (uint64_t)i);
}

void loop_begin(const foten_model *m, loop *l, const hand *hand, uint64_t seed, uint64_t stream) {
    if (m->local) {
        begin_local(m, l, hand, seed, stream);
        return;
    }
    uint64_t n = TO_BEGIN;
    if (!m->plus) {
        if (m->excited) begin_window(m, l, hand, seed, stream);
        for (int i = 0; m->of_noise && i < window_of(m); i++) see(m, l, 0, hand->condition, 0);
        loop_listen(m, l, seed, stream);
        return;
    }
    const lattice *of = heard(m);
    heed(m, l, hand, 1);
    /* The mean square of z exp(h z^2 / 2) is (1 - 2h)^(-3/2). */
    double size = drive(of, l) * l->sigma * pow(1 - 2 * l->tail, -0.75);
    for (int i = 0; i < of->order; i++) l->states[i] = size * noise_at(seed, stream, n++);
    l->swell = m->swell_sd * within(noise_at(seed, stream, n++), LARGEST_SWELL);
    if (m->n_tones) {
        double sine = noise_at(seed, stream, n++), cosine = noise_at(seed, stream, n++);
        l->phase = l->path = atan2(sine, cosine);
        l->rate = 0;
        heed(m, l, hand, 1);
        return;
    }
    int window = window_of(m);
    memset(l->seen, 0, (size_t)window * (size_t)m->n_inputs * sizeof *l->seen);
    for (int i = 0; i < window; i++) see(m, l, 0, hand->condition, 0);
    for (int i = 0; m->network_in_loop && i < window; i++) {
        int cut;
        double noise = noise_at(seed, stream, n++);
        loop_step(m, l, hand, &noise, INFINITY, &cut);
    }
}

void loop_quiet(const foten_model *m, loop *l) {
    double most = 0;
    for (int i = 0; i < order_of(m); i++) most = fabs(l->states[i]) > most ? fabs(l->states[i]) : most;
    if (most < 1e-100 && order_of(m)) memset(l->states, 0, (size_t)order_of(m) * sizeof *l->states);
    size_t n = numbers_seen(m);
    for (size_t i = 0; i < n; i++)
        if (fabsf(l->seen[i]) < 1e-30f) l->seen[i] = 0;
}
