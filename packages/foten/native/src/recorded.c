#include "recorded.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "constants.h"

enum {
    OCTAVE = FOTEN_OCTAVE,
    FIELDS = 5, /* of a moment: log speed, log force, two levels, flags */
    N_NEAREST = FOTEN_N_NEAREST,
    CANDIDATE = FOTEN_CANDIDATE,
    RUN_START = FOTEN_RUN_START,
    N_TAPS = FOTEN_N_TAPS,
    N_PHASES = FOTEN_N_PHASES,
    ONE = FOTEN_ONE,
    CHUNK = 128 /* candidates whose distances are computed at once */
};

/* log2(value + floor) + 10, in steps. */
static int32_t logarithm(double value, double floor_of) {
    double sum = value + floor_of;
    uint64_t x = (uint64_t)floor((sum < 0x1p20 ? sum : 0x1p20) * 1024 + 0.5), mantissa;
    int exponent = 31;
    while (!(x >> exponent)) exponent--;
    mantissa = x << (31 - exponent);
    int32_t steps = exponent * OCTAVE;
    for (int bit = 7; bit >= 0; bit--) {
        mantissa = mantissa * mantissa >> 31;
        uint64_t carry = mantissa >> 32;
        mantissa >>= carry;
        steps += (int32_t)carry << bit;
    }
    return steps;
}

static int32_t log_at(const recorded_innovations *r, int moment, int channel) {
    static const int32_t origin[2] = {FOTEN_SPEED_ORIGIN, FOTEN_FORCE_ORIGIN};
    return ((int32_t)r->moments[moment * FIELDS + channel] << FOTEN_STORED_SHIFT) + origin[channel];
}

static int32_t level_at(const recorded_innovations *r, int moment, int which) {
    return (int32_t)r->moments[moment * FIELDS + 2 + which] << FOTEN_LEVEL_SHIFT;
}

/* Where runs end, and how many candidates have which stored log speed, from those of less on; 0 where one cannot be. */
static int count_moments(const recorded_innovations *r, int before[257]) {
    int end = r->n_moments, run = 0;
    if (!(r->moments[4] & RUN_START)) return 0;
    for (int j = r->n_moments - 1; j >= 0; j--) {
        r->run_end[j] = end;
        if (r->moments[j * FIELDS + 4] & RUN_START) end = j;
    }
    for (int j = 0; j < r->n_moments; j++) {
        const unsigned char *moment = r->moments + j * FIELDS;
        if (moment[4] & RUN_START) run = j;
        if (!(moment[4] & CANDIDATE)) continue;
        if (j - run < MAX_GROWTH || r->run_end[j] - j < FOTEN_N_AHEAD) return 0;
        before[moment[0] + 1]++;
    }
    for (int k = 0; k < 256; k++) before[k + 1] += before[k];
    return before[256] > 0;
}

/* Runs, and candidates in the order of their speed, with their features. */
static int list_moments(texture_file *file, arena *memory, recorded_innovations *r) {
    int before[257] = {0};
    r->run_end = arena_take(memory, (size_t)r->n_moments, sizeof *r->run_end);
    if (!r->run_end) return file_refuse(file, FOTEN_NO_MEMORY, "no memory");
    if (!count_moments(r, before))
        return file_refuse(
            file, FOTEN_BAD_FILE,
            "the recorded innovations have no candidate, or one too near to where its run begins or ends");
    r->n_candidates = before[256];
    if (r->n_candidates > FOTEN_MAX_CANDIDATES)
        return file_refuse(file, FOTEN_BAD_FILE, "the recorded innovations have %d candidates, expected %d at most",
                           r->n_candidates, FOTEN_MAX_CANDIDATES);
    size_t n = (size_t)r->n_candidates;
    r->candidates = arena_take(memory, n, sizeof *r->candidates);
    for (int k = 0; k < RECORDED_FEATURES; k++) r->features[k] = arena_take(memory, n, sizeof *r->features[k]);
    if (memory->failed) return file_refuse(file, FOTEN_NO_MEMORY, "no memory");
    for (int j = 0; j < r->n_moments; j++) {
        if (!(r->moments[j * FIELDS + 4] & CANDIDATE)) continue;
        int at = before[r->moments[j * FIELDS]]++;
        r->candidates[at] = j;
        for (int k = 0; k < 2; k++) {
            r->features[k][at] = (int16_t)log_at(r, j, k);
            r->features[2 + k][at] = (int16_t)(log_at(r, j, k) - log_at(r, j - MAX_GROWTH, k));
            r->features[4 + k][at] = (int16_t)level_at(r, j, k);
        }
    }
    return 1;
}

int recorded_read(texture_file *file, arena *memory, int step, int along_path, const innovation_kernel *kernel,
                  recorded_innovations *r) {
    size_t shape[4];
    if (file_shape(file, "recorded.moments", shape) != 2 || shape[0] < 1 || shape[0] > FOTEN_MAX_MOMENTS)
        return file_refuse(file, FOTEN_BAD_FILE, "the file holds no recorded moments, or not from 1 to %d of them",
                           FOTEN_MAX_MOMENTS);
    size_t n = shape[0];
    r->used = 1;
    r->along_path = along_path;
    r->step = step;
    r->kernel = kernel;
    r->n_moments = (int)n;
    r->n_fade = (int)floor(FOTEN_FADE_MS / FOTEN_CONTROL_MS * step + 0.5);
    if (r->n_fade < 1) r->n_fade = 1;
    if (!(r->values = file_take(file, memory, "recorded.", "values", (size_t[4]){256}))) return 0;
    if (!(r->codes = file_bytes(file, memory, "recorded.", "innovations", (size_t[4]){n, (size_t)step}))) return 0;
    if (!(r->moments = file_bytes(file, memory, "recorded.", "moments", (size_t[4]){n, FIELDS}))) return 0;
    r->taps = arena_take(memory, N_PHASES * N_TAPS, sizeof *r->taps);
    r->fade_in = arena_take(memory, (size_t)r->n_fade, sizeof *r->fade_in);
    r->fade_out = arena_take(memory, (size_t)r->n_fade, sizeof *r->fade_out);
    if (memory->failed) return file_refuse(file, FOTEN_NO_MEMORY, "no memory");
    for (int phase = 0; phase < N_PHASES; phase++)
        for (int k = 0; k < N_TAPS; k++) {
            double z = (double)phase / N_PHASES - (k + 1 - N_TAPS / 2), window = cos(PI * z / N_TAPS);
            r->taps[phase * N_TAPS + k] = (z == 0 ? 1 : sin(PI * z) / (PI * z)) * window * window;
        }
    for (int k = 0; k < r->n_fade; k++) {
        double angle = 0.5 * PI * (k + 0.5) / r->n_fade;
        r->fade_in[k] = sin(angle);
        r->fade_out[k] = cos(angle);
    }
    for (int k = 0; k <= 2 * FOTEN_MAX_PACE; k++)
        r->pace[k] = (uint32_t)floor(ONE * exp2((double)(k - FOTEN_MAX_PACE) / OCTAVE) + 0.5);
    return list_moments(file, memory, r);
}

static double innovation_at(const recorded_innovations *r, int64_t place) {
    int64_t at = place / ONE, last = (int64_t)r->n_moments * r->step - 1;
    int phase = (int)(place % ONE * N_PHASES / ONE);
    if (!phase) return r->values[r->codes[at]];
    double sum = 0;
    for (int k = 0; k < N_TAPS; k++) {
        int64_t i = at + k + 1 - N_TAPS / 2;
        i = i < 0 ? 0 : i > last ? last : i;
        sum += r->values[r->codes[i]] * r->taps[phase * N_TAPS + k];
    }
    return sum;
}

/* Of the candidates that may be played, those of the least distance so far, of the earlier moment where two are equal.
 */
typedef struct {
    int n, moments[N_NEAREST];
    int32_t distances[N_NEAREST];
} nearest_moments;

static void consider(const recorded_state *s, int moment, int candidate, int32_t distance, nearest_moments *f) {
    int full = f->n == N_NEAREST, last = f->n - 1;
    if (full && (distance > f->distances[last] || (distance == f->distances[last] && candidate > f->moments[last])))
        return;
    if (candidate >= s->first_excluded && candidate < s->end_excluded) return;
    if (moment >= 0 && abs(candidate - moment) < FOTEN_MIN_DISTANCE) return;
    int at = full ? last : f->n++;
    for (; at; at--) {
        int32_t before = f->distances[at - 1];
        if (before < distance || (before == distance && f->moments[at - 1] < candidate)) break;
        f->distances[at] = before;
        f->moments[at] = f->moments[at - 1];
    }
    f->distances[at] = distance;
    f->moments[at] = candidate;
}

/* Candidates lie in the order of their speed: from the hand's on, upwards and downwards, until speed alone is further
 * than all of the nearest. */
static nearest_moments nearest_to(const recorded_innovations *r, const recorded_state *s, int moment,
                                  const int32_t *query, const int32_t *weights) {
    int32_t distances[CHUNK], largest = FOTEN_MAX_DIFFERENCE;
    int low = 0, high = r->n_candidates;
    while (low < high) { /* how many are slower */
        int middle = (low + high) / 2;
        if (r->features[0][middle] < query[0]) low = middle + 1;
        else high = middle;
    }
    nearest_moments f = {0};
    for (;;) {
        int32_t away[2] = {low ? (query[0] - r->features[0][low - 1]) * weights[0] : INT32_MAX,
                           high < r->n_candidates ? (r->features[0][high] - query[0]) * weights[0] : INT32_MAX};
        int up = away[1] < away[0];
        int32_t nearer = away[up] < largest ? away[up] : largest;
        if (away[up] == INT32_MAX || (f.n == N_NEAREST && nearer * nearer > f.distances[N_NEAREST - 1])) return f;
        int remaining = up ? r->n_candidates - high : low, n = remaining < CHUNK ? remaining : CHUNK,
            first = up ? high : low - n;
        r->kernel->distances((const int16_t *const *)r->features, first, n, query, weights, distances);
        for (int i = 0; i < n; i++) consider(s, moment, r->candidates[first + i], distances[i], &f);
        if (up) high += n;
        else low -= n;
    }
}

static void follow_path(const recorded_innovations *r, recorded_state *s, int moment, int32_t log_speed) {
    if (!r->along_path) return;
    int32_t ahead = log_speed - log_at(r, moment, 0), limit = FOTEN_MAX_PACE;
    s->pace = r->pace[(ahead > limit ? limit : ahead < -limit ? -limit : ahead) + limit];
}

static void decide(const recorded_innovations *r, recorded_state *s, const double physical[2], const double *noise) {
    static const int32_t weights[RECORDED_FEATURES] = {FOTEN_WEIGHT_0, FOTEN_WEIGHT_1, FOTEN_WEIGHT_2,
                                                       FOTEN_WEIGHT_3, FOTEN_WEIGHT_4, FOTEN_WEIGHT_5};
    int32_t logs[2] = {logarithm(physical[0], FOTEN_SPEED_FLOOR), logarithm(physical[1], FOTEN_RECORDED_FORCE_FLOOR)},
            query[RECORDED_FEATURES] = {logs[0], logs[1]}, used[RECORDED_FEATURES];
    int moment = s->place < 0 ? -1 : (int)(s->place / ONE / r->step), at = s->n_history % MAX_GROWTH;
    for (int k = 0; k < 2; k++) {
        for (int i = 0; !s->n_history && i < MAX_GROWTH; i++) s->history[i][k] = logs[k];
        query[2 + k] = logs[k] - s->history[at][k];
        query[4 + k] = moment < 0 ? 0 : level_at(r, moment, k);
        s->history[at][k] = logs[k];
    }
    s->n_history = s->n_history + 1 < 2 * MAX_GROWTH ? s->n_history + 1 : MAX_GROWTH;
    s->age++;
    if (moment >= 0) {
        int strayed = abs(logs[0] - log_at(r, moment, 0)) > FOTEN_MAX_SPEED_DIFFERENCE ||
                      abs(logs[1] - log_at(r, moment, 1)) > FOTEN_MAX_FORCE_DIFFERENCE;
        int ended = s->age >= s->length || r->run_end[moment] - moment < FOTEN_N_MARGIN;
        if (!ended && !(strayed && s->age >= FOTEN_MIN_AGE)) {
            follow_path(r, s, moment, logs[0]);
            return;
        }
    }
    for (int k = 0; k < RECORDED_FEATURES; k++) used[k] = k >= 4 && moment < 0 ? 0 : weights[k];
    nearest_moments nearest = nearest_to(r, s, moment, query, used);
    if (!nearest.n) {
        s->place = -1;
        return;
    }
    uint64_t number = noise ? (uint64_t)(fabs(*noise) * 0x1p32) : 0;
    s->length = FOTEN_MIN_LENGTH + (int)(number / N_NEAREST % (FOTEN_MAX_LENGTH - FOTEN_MIN_LENGTH + 1));
    s->age = 0;
    if (moment >= 0) {
        s->previous = s->place;
        s->previous_pace = s->pace;
        s->n_faded = 0;
    }
    moment = nearest.moments[number % (uint64_t)nearest.n];
    s->place = (int64_t)moment * r->step * ONE;
    follow_path(r, s, moment, logs[0]);
}

void recorded_begin(const recorded_innovations *r, recorded_state *s, const double physical[2], const double *noise) {
    *s = (recorded_state){.place = -1,
                          .previous = -1,
                          .pace = ONE,
                          .previous_pace = ONE,
                          .n_faded = r->n_fade,
                          .first_excluded = s->first_excluded,
                          .end_excluded = s->end_excluded};
    recorded_advance(r, s, physical, noise);
}

void recorded_advance(const recorded_innovations *r, recorded_state *s, const double physical[2], const double *noise) {
    if (s->tick == 0) decide(r, s, physical, noise);
    s->tick = s->tick + 1 < r->step ? s->tick + 1 : 0;
    if (s->place < 0) {
        s->next = noise ? *noise : 0;
        return;
    }
    s->next = innovation_at(r, s->place);
    if (s->n_faded < r->n_fade) {
        s->next = r->fade_in[s->n_faded] * s->next + r->fade_out[s->n_faded] * innovation_at(r, s->previous);
        s->previous += s->previous_pace;
        s->n_faded++;
    }
    s->place += s->pace;
}
