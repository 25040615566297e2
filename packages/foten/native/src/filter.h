/* Filters of second order, one sample at a time. */
#pragma once

#include <math.h>

#include "constants.h"

typedef struct {
    double b0, b1, b2, a1, a2;
} section;
typedef struct {
    double first, second;
} memory;

/* The Butterworth low-pass that recordings went through, as foten.dsp.filters has it. */
static inline section lowpass(double cutoff_hz, double rate_hz) {
    double w = tan(PI * cutoff_hz / rate_hz), damping = 2 * cos(PI / 4);
    double norm = 1 + damping * w + w * w, b = w * w / norm;
    return (section){b, 2 * b, b, 2 * (w * w - 1) / norm, (1 - damping * w + w * w) / norm};
}

static inline double filtered(const section *s, memory *m, double x) {
    double y = s->b0 * x + m->first;
    m->first = s->b1 * x - s->a1 * y + m->second;
    m->second = s->b2 * x - s->a2 * y;
    if (fabs(m->first) + fabs(m->second) < 1e-30) m->first = m->second = 0;
    return y;
}

/* What a low-pass that passes a constant unchanged remembers after a long time of it. */
static inline memory settled(const section *s, double x) { return (memory){(1 - s->b0) * x, (s->b2 - s->a2) * x}; }
