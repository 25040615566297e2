/* What predicts the next sample from a window: a network of this library, or a function of somebody else's. */
#pragma once

#include "network.h"

/* Window 0: there is none. */
typedef struct {
    int window, n_inputs;     /* samples that it is given, and numbers of each: 1, or 3 with speed and force */
    const isa *isa;
    const network *network;   /* NULL where the function predicts */
    foten_predictor function;
    void *user;
    int hop;                  /* samples that the function gives at once */
} predictor;

/* Of one stream: the window, n_inputs numbers a sample, then speed and force of the last; samples that are predicted already; and memory for a
 * step of the network, which holds nothing between steps. */
typedef struct {
    float *window, *pending, *scratch;
    int n_pending;
} predictor_state;

/* All but the memory for a step, which need not survive a sample. */
void predictor_place(const predictor *p, predictor_state *s, block *from);

/* A window of zeros, or of nothing but a condition. */
void predictor_clear(const predictor *p, predictor_state *s);
void predictor_fill(const predictor *p, predictor_state *s, const double scaled[2]);

/* Another speed and force of the last sample. */
void predictor_set_condition(const predictor *p, predictor_state *s, const double scaled[2]);

/* Take in a sample, and its speed and force. */
void predictor_push(const predictor *p, predictor_state *s, double sample, const double scaled[2]);

/* The next sample; 0 where somebody else's function gives no finite number. */
double predictor_predict(const predictor *p, predictor_state *s);

/* Set numbers to zero that are too small to matter, before they become denormal and slow. */
void predictor_quiet(const predictor *p, predictor_state *s);
