/* Tones of the path, of a surface that repeats: see foten.dsp.tones. */
#pragma once

#include "tables.h"

typedef struct {
    int n;                    /* multiples of the path's frequency; 0 for a surface that does not repeat */
    speed_force_table values; /* of cosine and sine of each multiple in turn, over the level */
    double phase_increment;   /* in a sample [rad] at 1 mm/s */
    double period_jitter;     /* standard deviation of a period's length, as a share of it */
    double phase_leak;        /* in a sample, of what the jitter moved the phase by, as a share */
} tones;

/* Of one stream. */
typedef struct {
    double *coefficients;   /* of the next sample, scaled */
    double phase, path;     /* of the next sample [rad]: with jitter and without */
    double rate, increment; /* of the phase: by jitter, as a share; by the path, at the last sample [rad] */
    double tone;            /* of the next sample, scaled */
} tones_state;

int tones_read(texture_file *file, arena *memory, int n, int n_speed, int n_force, tones *out);

/* Make ready for the sample after one under a condition; the coefficients stay where that did not change. `level`: of
 * the vibration. */
void tones_set_condition(const tones *t, const scale *level, tones_state *s, const condition *c, int changed);

/* Take the phase that is nearest to n recorded samples (acceleration, speed, force in turn). */
void tones_fit(const tones *t, const scale *level, tones_state *s, const double *windows, int n);

/* After that the tone of each sample but the first, under the condition of the one before. */
double tones_follow(const tones *t, const scale *level, tones_state *s, const condition *before);

/* After that begin the path at the next sample. */
void tones_begin_path(const tones *t, tones_state *s, const condition *last);

/* Take any phase, from two standard normal numbers. */
void tones_draw(tones_state *s, double sine, double cosine);

/* Take in an innovation, and the condition that goes with it. */
void tones_push(const tones *t, tones_state *s, double innovation, const condition *c);
