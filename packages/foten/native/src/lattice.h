/* The normalised lattice of foten.dsp.lattice: a linear filter as a chain of rotations, stable however its coefficients
 * move. */
#pragma once

#include <math.h>

#include "constants.h"
#include "tables.h"

/* Of one stream. Coefficients are those of the next sample. */
typedef struct {
    double *states;               /* b_0 ... b_(order-1) */
    double *reflections;          /* k_1 ... k_order */
    double *cosines, all_cosines; /* sqrt(1 - k^2), and their product, by which an innovation moves the sample that
                                     leaves the filter */
    double level, logs[2];        /* where there is a level over speed and force; logarithms of these re their means */
} lattice_state;

/* A level and reflection coefficients over speed and force. */
typedef struct lattice {
    int order, gain_before_filter; /* whether the level scales what enters the filter, or what leaves it */
    speed_force_table reflections;
    scale level;
} lattice;

int lattice_read(texture_file *file, arena *memory, const char *prefix, int n_speed, int n_force, int order,
                 int level_width, int gain_before_filter, lattice *out);

/* Make ready for the sample after one under a speed and force. */
void lattice_set_condition(const lattice *of, lattice_state *l, const double scaled[2]);

static inline double gain_before(const lattice *of, const lattice_state *l) {
    return of->gain_before_filter ? l->level : 1;
}
static inline double gain_after(const lattice *of, const lattice_state *l) {
    return of->gain_before_filter ? 1 : l->level;
}

static inline void lattice_place(lattice_state *l, int order, block *from) {
    l->states = block_take(from, (size_t)order, sizeof *l->states);
    l->reflections = block_take(from, (size_t)order, sizeof *l->reflections);
    l->cosines = block_take(from, (size_t)order, sizeof *l->cosines);
}

static inline void lattice_clear(lattice_state *l, int order) {
    for (int i = 0; i < order; i++) l->states[i] = 0;
}

/* Make ready what goes with new reflections. */
static inline void lattice_turn(lattice_state *l, int order) {
    for (int i = 0; i < order; i++) l->cosines[i] = sqrt(1 - l->reflections[i] * l->reflections[i]);
    l->all_cosines = 1;
    for (int i = 0; i < order; i++) l->all_cosines *= l->cosines[i];
}

/* The next sample without innovation. */
static inline double lattice_predict(const lattice_state *l, int order) {
    double f = 0;
    for (int i = order - 1; i >= 0; i--) f = l->cosines[i] * f - l->reflections[i] * (FOTEN_LEAK * l->states[i]);
    return f;
}

/* Take in a sample; returns its innovation. */
static inline double lattice_analyse(lattice_state *l, int order, double sample) {
    double f = sample, before = sample;
    for (int i = 0; i < order; i++) {
        double k = l->reflections[i], c = l->cosines[i], b = FOTEN_LEAK * l->states[i];
        double backward = (b + k * f) / c;
        f = (f + k * b) / c;
        l->states[i] = before;
        before = backward;
    }
    return f;
}

/* Take in an innovation; returns its sample. */
static inline double lattice_synthesise(lattice_state *l, int order, double innovation) {
    double f = innovation;
    for (int i = order - 1; i >= 0; i--) {
        double k = l->reflections[i], c = l->cosines[i], b = FOTEN_LEAK * l->states[i];
        if (i + 1 < order) l->states[i + 1] = k * f + c * b;
        f = c * f - k * b;
    }
    l->states[0] = f;
    return f;
}

/* Set states to zero that are too small to matter, before they become denormal and slow. */
static inline void lattice_quiet(lattice_state *l, int order) {
    for (int i = 0; i < order; i++)
        if (!(fabs(l->states[i]) < 1e-100)) return;
    lattice_clear(l, order);
}
