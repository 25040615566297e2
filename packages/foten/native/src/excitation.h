/* The excitation, the random part of a texture: the noise that foten.h defines, with a scale over speed and force. */
#pragma once

#include <stdint.h>

#include "tables.h"

double noise_at(uint64_t seed, uint64_t stream, uint64_t n);

/* The numbers of a stream in turn, from `next` on. */
typedef struct {
    uint64_t seed, stream, next;
} noise_source;

static inline double noise_next(noise_source *from) { return noise_at(from->seed, from->stream, from->next++); }

typedef struct {
    scale sigma;
    double innovation_limit[2]; /* over sigma, and in scaled acceleration */
} excitation;

int excitation_read(texture_file *file, arena *memory, int width, excitation *out);

/* Sigma under a speed and a force, scaled. */
double excitation_sigma(const excitation *e, const double scaled[2]);

/* How likely a residual of a prediction is, whose excitation has that scale, into the prediction. */
void excitation_score(double residual, double scale, foten_prediction *out);

/* An innovation over sigma within the limits, where a unit of it moves the sample by `scale`. */
double excitation_limited(const excitation *e, double innovation, double scale);
