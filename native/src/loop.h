/* One stream of a model at its own rate: what it remembers, and a sample more. All scaled. */
#ifndef FOTEN_LOOP_H
#define FOTEN_LOOP_H

#include "model.h"

/* Speed and force of a sample: scaled and within the trained range, and the speed that a path's tones go by [mm/s]. */
typedef struct {
    double condition[2], path;
} hand;

struct loop {
    double *states;       /* b of the lattice, rest.order */
    double *reflections;  /* of the next sample, and the cosines that go with them */
    double *cosines;
    double *coefficients; /* of the tones, as they are for the next sample */
    float *seen;          /* what the network sees: samples of n_inputs numbers, and speed and force of the last */
    float *scratch;
    float *coming;        /* that a predictor gave, and how many of them are still to come */
    int n_coming;
    hand heeded;          /* what the next sample goes by, the hand of the one before */
    double level, sigma, tail, gain;
    double swell;
    local_mixture local;  /* of ar, for the next sample, and its innovations so far */
    double *past;
    double phase, path, rate, turned, tone;
};

/* The memory of a loop, in a block of its own or, with base NULL, only measured. */
loop *loop_place(const foten_model *model, block *from);
void loop_copy(const foten_model *model, loop *to, const loop *from);

/* Begin after `n` recorded samples (acceleration, speed, force in turn) as a rendering does, or as a prediction of the next sample that the
 * network sees does, `as_prediction`. `n` is at most history. */
void loop_start(const foten_model *model, loop *l, const double *windows, int n, int as_prediction);

/* Let the loop be as if a hand had been there for long, whatever it was started with: states drawn from the noise of a stream. A network that
 * is heard is first played what it looks at, so this takes as many of its steps. */
void loop_begin(const foten_model *model, loop *l, const hand *hand, uint64_t seed, uint64_t stream);

/* The next sample without excitation, and by how much a unit of it moves the sample (0 where there is none). */
double loop_forecast(const foten_model *model, loop *l, double *scale, int with_network);

/* What is expected of the next recorded sample, the standard deviation of what is missed, without volatility, and h of its tails; a scale of 0
 * where that is not known, because a rendering predicts from something else. */
void loop_predict(const foten_model *model, loop *l, foten_prediction_part part, foten_prediction *out);

/* Take in a recorded sample (acceleration, speed, force) after a start `as_prediction`. */
void loop_push(const foten_model *model, loop *l, const double *sample);

/* Let a model of noise have heard a stream's, whatever it was started with; nothing for others. */
void loop_listen(const foten_model *model, loop *l, uint64_t seed, uint64_t stream);

/* The next sample, with its noise or without (NULL), cut to +-limit, under the hand that goes with it. */
double loop_step(const foten_model *model, loop *l, const hand *hand, const double *noise, double limit, int *cut);

/* Set to zero what has become too small to be heard, before it becomes denormal and slow. */
void loop_quiet(const foten_model *model, loop *l);

/* The hand of speed and force scaled, the path by the speed that they stand for. */
hand hand_of(const foten_model *model, const double condition[2]);
#endif
