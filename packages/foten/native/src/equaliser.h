/* The equaliser of foten.dsp.equaliser: gains of bands by speed, how speed has changed, and force. */
#pragma once

#include <math.h>

#include "constants.h"
#include "tables.h"

enum { BANDS = FOTEN_N_BANDS, LOWPASSES = FOTEN_N_LOWPASSES, TERMS = 9 + 4 * LOWPASSES };

typedef struct {
    int used;
    double weights[TERMS][BANDS], filters[3][BANDS], smoothing[LOWPASSES];
} equaliser;

/* Of one stream: log speed behind each low-pass, and what is in the band-passes. */
typedef struct {
    double behind[LOWPASSES], states[2][BANDS];
} equaliser_state;

static inline int equaliser_read(texture_file *file, arena *memory, equaliser *out) {
    const double *weights, *filters, *shares;
    if (!(weights = file_take(file, memory, "equaliser.", "weights", (size_t[4]){BANDS, TERMS}))) return 0;
    if (!(filters = file_take(file, memory, "equaliser.", "filters", (size_t[4]){BANDS, 3}))) return 0;
    if (!(shares = file_take(file, memory, "equaliser.", "smoothing", (size_t[4]){LOWPASSES}))) return 0;
    int stable = 1;
    for (int b = 0; b < BANDS; b++) {
        const double *filter = filters + 3 * b;
        stable &= fabs(filter[2]) < 1 && fabs(filter[1]) < 1 + filter[2];
        for (int i = 0; i < TERMS; i++) out->weights[i][b] = weights[b * TERMS + i];
        for (int i = 0; i < 3; i++) out->filters[i][b] = filter[i];
    }
    for (int i = 0; i < LOWPASSES; i++) {
        stable &= shares[i] > 0 && shares[i] <= 1;
        out->smoothing[i] = shares[i];
    }
    out->used = 1;
    return stable ? 1 : file_refuse(file, FOTEN_BAD_FILE, "a band-pass of the equaliser is unstable");
}

static inline double equaliser_log(double value, double floor, double reference) {
    return log((value + floor) / (reference + floor));
}

/* As after a long time at a speed [mm/s], from silence. */
static inline void equaliser_settle(equaliser_state *s, double speed) {
    *s = (equaliser_state){{0}};
    for (int i = 0; i < LOWPASSES; i++) s->behind[i] = equaliser_log(speed, FOTEN_FLOOR_SPEED, FOTEN_REFERENCE_SPEED);
}

/* What leaves of the next sample, under its speed and force [mm/s, N]. */
static inline double equaliser_step(const equaliser *e, equaliser_state *s, double sample, const double physical[2]) {
    double x = equaliser_log(physical[0], FOTEN_FLOOR_SPEED, FOTEN_REFERENCE_SPEED),
           y = equaliser_log(physical[1], FOTEN_FLOOR_FORCE, FOTEN_REFERENCE_FORCE), square = x * x,
           terms[TERMS] = {1, x, y, square, x * y, y * y, square * x, square * y, square * square},
           log_gain[BANDS] = {0}, leaving = sample;
    for (int i = 0; i < LOWPASSES; i++) {
        s->behind[i] += e->smoothing[i] * (x - s->behind[i]);
        double change = x - s->behind[i], *of_change = terms + 9 + 4 * i;
        of_change[0] = change;
        of_change[1] = change * change;
        of_change[2] = change * x;
        of_change[3] = change * y;
    }
    for (int i = 0; i < TERMS; i++)
        for (int b = 0; b < BANDS; b++) log_gain[b] += e->weights[i][b] * terms[i];
    for (int b = 0; b < BANDS; b++) {
        double in_band = e->filters[0][b] * sample + s->states[0][b];
        s->states[0][b] = s->states[1][b] - e->filters[1][b] * in_band;
        s->states[1][b] = -e->filters[0][b] * sample - e->filters[2][b] * in_band;
        leaving += (exp(clip(log_gain[b], FOTEN_MAX_LOG_GAIN)) - 1) * in_band;
    }
    return leaving;
}

/* Set states to zero that are too small to matter. */
static inline void equaliser_quiet(equaliser_state *s) {
    for (int b = 0; b < BANDS; b++)
        for (int i = 0; i < 2; i++)
            if (fabs(s->states[i][b]) < 1e-100) s->states[i][b] = 0;
}
