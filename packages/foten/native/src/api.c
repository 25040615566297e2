#include <math.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "actuator.h"
#include "constants.h"
#include "loop.h"
#include "resample.h"
#include "stylus.h"

enum { QUIET_EVERY = 4096 };                                           /* samples */
static const double FADE[2] = {FOTEN_FADE_SPEED, FOTEN_FADE_FORCE};    /* mm/s and N below which a texture fades */
static const double REACH[2] = {FOTEN_REACH_SPEED, FOTEN_REACH_FORCE}; /* that a level grows to at least */

_Static_assert(ATOMIC_LLONG_LOCK_FREE == 2, "a condition is set without waiting: 64 bits have to be written at once");

/* Counted by the rendering thread, and by whoever sets a condition; read from anywhere. Of speed and force, speed comes
 * first. */
enum { N, SPEED_BEYOND, FORCE_BEYOND, SPEED_CLAMPED, FORCE_CLAMPED, BELOW, SATURATED, REFUSED, LIMITED, LOST, COUNTS };

struct foten_state {
    void *memory; /* that it lies in, aligned */
    const foten_model *model;
    uint64_t seed, stream;
    int deterministic, smooth;
    int fresh, unsmoothed; /* the next sample begins the stream; the next condition set begins the low-pass */
    loop *loop;
    resampler *resampler; /* NULL at the texture's own rate */
    actuator actuator;
    section filter;
    memory smoothed[2];
    double *windows;            /* room for those of foten_start */
    _Atomic uint64_t condition; /* two floats: speed and force */
    _Atomic uint64_t counts[COUNTS];
    double last[2]; /* speed and force of the last sample */
};

static uint64_t counted(const foten_state *s, int what) {
    return atomic_load_explicit((_Atomic uint64_t *)&s->counts[what], memory_order_relaxed);
}

/* By the one thread that counts this. */
static void count(foten_state *s, int what, int by) {
    if (by) atomic_store_explicit(&s->counts[what], counted(s, what) + (uint64_t)by, memory_order_relaxed);
}

const char *foten_version(void) { return FOTEN_VERSION; }
int foten_abi(void) { return FOTEN_ABI; }
const char *foten_isa(void) { return isa_here()->name; }

foten_status foten_model_load(const void *bytes, size_t n_bytes, foten_model **model, char *why, size_t why_size) {
    return foten_model_load_with(bytes, n_bytes, NULL, NULL, model, why, why_size);
}

foten_status foten_model_load_with(const void *bytes, size_t n_bytes, foten_predictor predictor, void *user,
                                   foten_model **model, char *why, size_t why_size) {
    texture_file file;
    if (model) *model = NULL;
    if (!model || (!bytes && n_bytes)) { /* an empty file may lie nowhere */
        if (why) snprintf(why, why_size, "%s is NULL", model ? "bytes" : "model");
        return FOTEN_BAD_ARGUMENT;
    }
    if (file_open(&file, bytes, n_bytes, why, why_size)) {
        foten_model *m = calloc(1, sizeof *m);
        if (!m) file_refuse(&file, FOTEN_NO_MEMORY, "no memory");
        else if (model_read(m, &file, isa_here(), predictor, user) && model_prove(m, &file)) *model = m;
        else foten_model_free(m);
    }
    file_close(&file);
    return file.status;
}

void foten_model_free(foten_model *model) {
    if (!model) return;
    arena_free(&model->memory);
    free(model);
}

/* A state's parts in a block, at a rate; NULL where that only measures. */
static foten_state *state_place(const foten_model *model, double rate, block *from) {
    foten_state measured, *s = block_take(from, 1, sizeof *s), *into = s ? s : &measured;
    into->windows = block_take(from, (size_t)model->history * 3, sizeof *into->windows);
    into->resampler = rate == model->rate_hz ? NULL : resampler_place(from, model->rate_hz, rate);
    into->loop = loop_place(model, from); /* last, so that a sanitizer notices what lies beyond its scratch memory */
    return s;
}

static size_t state_bytes(const foten_model *model, double rate) {
    block size = {0};
    state_place(model, rate, &size);
    return size.used + ALIGNED;
}

foten_info foten_model_info(const foten_model *m) {
    if (!m) return (foten_info){0};
    foten_info info = {m->name,
                       m->texture,
                       m->rate_hz,
                       m->history,
                       m->excited,
                       {m->low[0], m->high[0]},
                       {m->low[1], m->high[1]},
                       m->sd[0],
                       m->lowpass_hz,
                       state_bytes(m, m->rate_hz),
                       m->predictor.function && !m->predictor.network};
    return info;
}

foten_state *foten_state_new(const foten_model *model, const foten_options *options) {
    foten_options o = options ? *options : (foten_options){0};
    if (!model) return NULL;
    double rate = o.rate_hz == 0 ? model->rate_hz : o.rate_hz;
    if (!(rate >= model->rate_hz / MAX_DOWNSAMPLING && rate <= model->rate_hz * MAX_UPSAMPLING)) return NULL;
    size_t n = state_bytes(model, rate);
    unsigned char *memory = malloc(n);
    if (!memory) return NULL;
    memset(memory, 0, n);
    block aligned = {memory + (-(uintptr_t)memory & (ALIGNED - 1)), 0};
    foten_state *s = state_place(model, rate, &aligned);
    s->memory = memory;
    s->model = model;
    s->stream = o.stream;
    s->deterministic = o.deterministic;
    s->smooth = o.smooth;
    s->filter = lowpass(model->lowpass_hz, model->rate_hz);
    foten_reset(s, o.seed);
    return s;
}

void foten_state_free(foten_state *state) {
    if (state) free(state->memory);
}

void foten_reset(foten_state *s, uint64_t seed) {
    if (!s) return;
    s->seed = seed;
    s->fresh = s->unsmoothed = 1;
    for (int i = 0; i < COUNTS; i++) atomic_store_explicit(&s->counts[i], 0, memory_order_relaxed);
    s->last[0] = s->last[1] = 0;
    loop_copy(s->model, s->loop, s->model->begin);
    if (s->resampler) resampler_reset(s->resampler);
    s->actuator.memory = (memory){0, 0};
}

foten_status foten_set_actuator(foten_state *s, const foten_actuator *of) {
    if (!s) return FOTEN_BAD_ARGUMENT;
    double rate = s->resampler ? resampler_rate(s->resampler) : s->model->rate_hz;
    return actuator_make(&s->actuator, of, rate) ? FOTEN_OK : FOTEN_BAD_ARGUMENT;
}

/* A sample as it leaves. What is no number, which nothing that was checked gives, is silence, and the loop begins
 * again. */
static float output_of(foten_state *s, double sample) {
    int bent;
    float out = (float)actuator_drive(&s->actuator, sample, &bent);
    count(s, LIMITED, bent);
    if (out - out == 0) return out;
    count(s, LOST, 1);
    loop_copy(s->model, s->loop, s->model->begin);
    s->fresh = 1;
    if (s->resampler) resampler_silence(s->resampler);
    s->actuator.memory = (memory){0, 0};
    return 0;
}

foten_status foten_start(foten_state *s, const float *acceleration, const float *speed, const float *force) {
    if (!s || !acceleration || !speed || !force) return FOTEN_BAD_ARGUMENT;
    const foten_model *m = s->model;
    for (int t = 0; t < m->history; t++) {
        const float sample[3] = {acceleration[t], speed[t], force[t]};
        for (int k = 0; k < 3; k++) s->windows[3 * t + k] = (sample[k] - m->mean[k]) / m->sd[k];
    }
    return foten_start_scaled(s, s->windows);
}

static int all_finite(const double *numbers, size_t n) {
    for (size_t i = 0; i < n; i++)
        if (!isfinite(numbers[i])) return 0;
    return 1;
}

foten_status foten_start_scaled(foten_state *s, const double *windows) {
    if (!s || !windows || !all_finite(windows, 3 * (size_t)s->model->history)) return FOTEN_BAD_ARGUMENT;
    s->model->kind->start(s->model, s->loop, windows, s->model->history, 0);
    s->fresh = 0;
    return FOTEN_OK;
}

void foten_run_scaled(foten_state *s, const double *conditions, const double *noise, double limit, size_t n,
                      double *out) {
    if (!s || !conditions || !out) return;
    for (size_t i = 0; i < n; i++) {
        condition c = {{conditions[3 * i], conditions[3 * i + 1]}, conditions[3 * i + 2], 1};
        out[i] = s->model->kind->step(s->model, s->loop, &c, noise ? noise + i : NULL, limit);
    }
}

void foten_exclude_recorded(foten_state *s, int first, int end) {
    if (!s) return;
    s->loop->recorded.first_excluded = first;
    s->loop->recorded.end_excluded = end;
}

foten_status foten_predict(foten_state *s, const double *samples, size_t n, foten_prediction_part part,
                           foten_prediction *out) {
    if (!s || !samples || !out) return FOTEN_BAD_ARGUMENT;
    const foten_model *m = s->model;
    size_t window = (size_t)m->history;
    if (n < window || !all_finite(samples, 3 * n)) return FOTEN_BAD_ARGUMENT;
    m->kind->start(m, s->loop, samples, m->history, 1);
    for (size_t t = window; t < n; t++) {
        m->kind->predict(m, s->loop, part, samples[3 * t], &out[t - window]);
        m->kind->push(m, s->loop, samples + 3 * t);
    }
    foten_reset(s, s->seed);
    return FOTEN_OK;
}

/* Check a condition: what is negative becomes 0, since a tool that leaves a surface may measure less than nothing, and
 * counts as refused. Returns 0 where one is no number, and the condition stays as it was. */
static int accepted(foten_state *s, float *speed, float *force) {
    int numbers = *speed - *speed == 0 && *force - *force == 0;
    if (!numbers || *speed < 0 || *force < 0) atomic_fetch_add_explicit(&s->counts[REFUSED], 1, memory_order_relaxed);
    if (*speed < 0) *speed = 0;
    if (*force < 0) *force = 0;
    return numbers;
}

void foten_set_condition(foten_state *s, float speed, float force) {
    if (!s || !accepted(s, &speed, &force)) return;
    uint64_t both;
    memcpy(&both, (const float[2]){speed, force}, sizeof both);
    atomic_store_explicit(&s->condition, both, memory_order_release);
}

static void condition_set(const foten_state *s, double out[2]) {
    uint64_t both = atomic_load_explicit(&s->condition, memory_order_acquire);
    float speed_force[2];
    memcpy(speed_force, &both, sizeof both);
    out[0] = speed_force[0];
    out[1] = speed_force[1];
}

/* A sample of the texture's own rate, m/s2, under a speed and a force. */
static double sample_of(foten_state *s, const double speed_force[2]) {
    const foten_model *m = s->model;
    uint64_t n = counted(s, N);
    condition c = {.fade = 1};
    double growth = 1, held[2];
    int below = 0;
    for (int i = 0; i < 2; i++) {
        double x = speed_force[i], clamped = x < m->low[i] ? m->low[i] : x > m->high[i] ? m->high[i] : x;
        double low = m->low[i] > FADE[i] ? m->low[i] : FADE[i], fade = m->exponents[i] > 0 ? FADE[i] : low;
        double limit = FOTEN_EXTRAPOLATION_LIMIT * m->high[i];
        if (limit < REACH[i]) limit = REACH[i];
        below |= x < low;
        count(s, SPEED_BEYOND + i, x > m->high[i]);
        count(s, SPEED_CLAMPED + i, x > limit);
        held[i] = x < limit ? x : limit;
        c.scaled[i] = (clamped - m->mean[1 + i]) / m->sd[1 + i];
        if (x < fade) c.fade *= x / fade;
        if (held[i] > m->high[i]) growth *= pow(held[i] / m->high[i], m->exponents[i]);
        if (x < low) growth *= pow((x > fade ? x : fade) / low, m->exponents[i]);
    }
    c.path_speed = held[0];
    if (s->fresh) {
        noise_source initial = {s->seed, s->stream, FOTEN_FIRST_INITIAL};
        if (!s->deterministic) m->kind->begin(m, s->loop, &c, initial);
        s->fresh = 0;
    }
    int random = !s->deterministic && model_is_random(m);
    double noise = random ? noise_at(s->seed, s->stream, n) : 0;
    double vibration = m->kind->step(m, s->loop, &c, random ? &noise : NULL, m->saturation);
    s->last[0] = speed_force[0];
    s->last[1] = speed_force[1];
    count(s, N, 1);
    count(s, BELOW, below);
    count(s, SATURATED, s->loop->cut);
    if ((n + 1) % QUIET_EVERY == 0) m->kind->quiet(m, s->loop);
    return (vibration * m->sd[0] + m->mean[0] * c.fade) * growth;
}

/* The next sample under the condition that is set or, where there is one, that of a stylus. */
static double sample_under(foten_state *s, foten_stylus *stylus) {
    double speed_force[2];
    if (stylus) {
        stylus_next(stylus, speed_force);
        return sample_of(s, speed_force);
    }
    condition_set(s, speed_force);
    for (int i = 0; s->smooth && i < 2; i++) {
        if (s->unsmoothed) s->smoothed[i] = settled(&s->filter, speed_force[i]);
        double smoothed = filtered(&s->filter, &s->smoothed[i], speed_force[i]);
        speed_force[i] = smoothed > 0 ? smoothed : 0; /* a second-order low-pass undershoots by 4 % */
    }
    s->unsmoothed = 0;
    return sample_of(s, speed_force);
}

static void render(foten_state *s, foten_stylus *stylus, float *out, size_t n) {
    if (stylus) stylus_block(stylus);
    for (size_t i = 0; i < n; i++) {
        while (s->resampler && resampler_wants(s->resampler)) resampler_give(s->resampler, sample_under(s, stylus));
        out[i] = output_of(s, s->resampler ? resampler_take(s->resampler) : sample_under(s, stylus));
    }
}

void foten_render(foten_state *s, float *out, size_t n) {
    if (s && out) render(s, NULL, out, n);
}

void foten_render_stylus(foten_state *s, foten_stylus *stylus, float *out, size_t n) {
    if (s && stylus && out) render(s, stylus, out, n);
}

size_t foten_render_stroke(foten_state *s, const float *speed, const float *force, size_t n, float *out) {
    double held[2];
    size_t rendered = 0;
    if (!s || !speed || !force || !out) return 0;
    condition_set(s, held);
    for (size_t i = 0; i <= n; i++) {
        /* What the last sample of the texture's still has to give, after a block that ended between two of them, comes
         * first. */
        while (s->resampler && !resampler_wants(s->resampler))
            out[rendered++] = output_of(s, resampler_take(s->resampler));
        if (i == n) break;
        float now[2] = {speed[i], force[i]};
        if (accepted(s, &now[0], &now[1])) {
            held[0] = now[0];
            held[1] = now[1];
        }
        double sample = sample_of(s, held);
        if (s->resampler) resampler_give(s->resampler, sample);
        else out[rendered++] = output_of(s, sample);
    }
    return rendered;
}

size_t foten_rendered(const foten_state *s, size_t n) {
    return s && s->resampler ? resampler_most(s->resampler, n) : s ? n : 0;
}
double foten_delay_s(const foten_state *s) { return s && s->resampler ? resampler_delay_s(s->resampler) : 0; }

void foten_condition(const foten_state *s, float *speed, float *force) {
    if (!s || !speed || !force) return;
    *speed = (float)s->last[0];
    *force = (float)s->last[1];
}

foten_stats foten_statistics(const foten_state *s) {
    if (!s) return (foten_stats){0};
    return (foten_stats){counted(s, N),
                         counted(s, SPEED_BEYOND),
                         counted(s, FORCE_BEYOND),
                         counted(s, SPEED_CLAMPED),
                         counted(s, FORCE_CLAMPED),
                         counted(s, BELOW),
                         counted(s, SATURATED),
                         counted(s, REFUSED),
                         counted(s, LIMITED),
                         counted(s, LOST)};
}

void foten_noise(uint64_t seed, uint64_t stream, uint64_t first, size_t n, double *out) {
    for (size_t i = 0; out && i < n; i++) out[i] = noise_at(seed, stream, first + i);
}
