/* What predicts the next sample from a window: a network of this library, or a function of somebody else's. */
#pragma once

#include "excitation.h"
#include "foten_network.h"

/* Window 0: there is none. */
typedef struct {
    int window, n_inputs; /* samples that it is given, and numbers of each: acceleration alone, or speed, force and
                             noise as well */
    const isa *isa;
    const network *network; /* NULL where the function predicts */
    foten_predictor function;
    void *user;
} predictor;

/* Of one stream: the window, n_inputs numbers a sample, then speed and force of the last; and memory for a step of the
 * network, which holds nothing between steps. */
typedef struct {
    float *window, *scratch;
} predictor_state;

/* All but the memory for a step, which need not survive a sample. */
void predictor_place(const predictor *p, predictor_state *s, block *from);

void predictor_clear(const predictor *p, predictor_state *s);

/* The noise of the samples in the window, where it holds noise: a stream's in turn. */
void predictor_take_noise(const predictor *p, predictor_state *s, noise_source *noise);

/* Another speed and force of the last sample. */
void predictor_set_condition(const predictor *p, predictor_state *s, const double scaled[2]);

/* Take in a sample, its speed and force, and its noise. */
void predictor_push(const predictor *p, predictor_state *s, double sample, const double scaled[2], double noise);

/* Put another sample in the place of the last one, and return that. */
double predictor_replace_last(const predictor *p, predictor_state *s, double sample);

/* The next sample; 0 where somebody else's function gives no finite number. */
double predictor_predict(const predictor *p, predictor_state *s);

/* Set numbers to zero that are too small to matter, before they become denormal and slow. */
void predictor_quiet(const predictor *p, predictor_state *s);
