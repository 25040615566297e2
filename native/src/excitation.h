/* The excitation, the random part of a texture: the noise that foten.h defines, with a scale over speed and force, heavy tails and volatility. */
#pragma once

#include <stdint.h>

#include "tables.h"

double noise_at(uint64_t seed, uint64_t stream, uint64_t n);

/* The numbers of a stream in turn, from `next` on. */
typedef struct { uint64_t seed, stream, next; } noise_source;

static inline double noise_next(noise_source *from) { return noise_at(from->seed, from->stream, from->next++); }

typedef struct {
    scale sigma;
    double tail[5], tail_bias; /* of h over the logarithms of speed and force */
    double largest[2];         /* of an excitation: over sigma, and in scaled acceleration */
    double volatility_kept, volatility_sd;
} excitation;

/* Of one stream: sigma and h of the next sample, and the volatility, a logarithm. */
typedef struct { double sigma, tail, volatility; } excitation_state;

int excitation_read(texture_file *file, arena *memory, int width, excitation *out);
void excitation_set_condition(const excitation *e, excitation_state *s, const double scaled[2]);

/* By how much the next excitation is larger than usual. */
double excitation_factor(const excitation *e, const excitation_state *s);

/* The standard deviation of a heavy-tailed number, over that of the Gaussian one. */
double excitation_rms(const excitation_state *s);

/* A volatility as if the stream had always been there, from a standard normal number. */
void excitation_draw(const excitation *e, excitation_state *s, double noise);

/* How likely an error of a prediction is, whose excitation has that scale, into the prediction. */
void excitation_score(const excitation_state *s, double missed, double scale, foten_prediction *out);

/* The excitation of a standard normal number, where a unit of it moves the sample by `unit`; the volatility moves on. */
double excitation_next(const excitation *e, excitation_state *s, double noise, double unit);
