/* The innovation network of foten-plus: how the next innovation is distributed, from those before it, the samples and
 * the hand.
 *
 * In double, and without an instruction set of its own: a step is some 10 000 multiplications, and a rendering is then
 * the same on every processor, but for the last digits of exp and tanh. */
#pragma once

#include "constants.h"
#include "tables.h"

enum { INNOVATION_INPUTS = FOTEN_N_INPUTS, PHASE_INPUTS = FOTEN_N_PHASE_INPUTS };

/* Matrices lie by columns: for each input in turn its weights. */
typedef struct {
    int n_inputs, n_hidden, head_width, n_components;
    const double *from_input, *input_bias; /* (inputs, 3 hidden) */
    const double *from_hidden, *hidden_bias;
    const double *head, *head_bias; /* (hidden + inputs, head_width) */
    const double *out, *out_bias;   /* (head_width, 3 components) */
} innovation_network;

/* Of one stream: the recurrent layer after the last sample, what the network was given of that, and room for a step. */
typedef struct {
    double *hidden, *scratch;
    double inputs[INNOVATION_INPUTS + PHASE_INPUTS];
    double *weight, *mean, *scale; /* of the mixture, once it is asked for */
} innovation_state;

int innovation_read(texture_file *file, arena *memory, const char *prefix, int n_inputs, int n_hidden, int head_width,
                    int n_components, innovation_network *out);

/* With a network of no hidden numbers there is none. */
void innovation_place(const innovation_network *n, innovation_state *s, block *from);

/* As if nothing had come before a sample under these logarithms of speed and force; the phase of tones is of the sample
 * after it, and used where the network is given one. */
void innovation_clear(const innovation_network *n, innovation_state *s, const double logs[2], double phase);

/* Take in a sample: its innovation, what it is over its level, and its logarithms of speed and force. */
void innovation_push(const innovation_network *n, innovation_state *s, double innovation, double x,
                     const double logs[2], double phase);

/* Make ready the mixture of the next innovation; returns its mean. */
double innovation_mixture(const innovation_network *n, innovation_state *s);

/* Of the mixture: the innovation below which lies as much as below a standard normal number. */
double innovation_quantile(const innovation_network *n, const innovation_state *s, double noise);

/* And the other way round; and its negative log-likelihood. */
double innovation_standardised(const innovation_network *n, const innovation_state *s, double innovation);
double innovation_nll(const innovation_network *n, const innovation_state *s, double innovation);

double innovation_sd(const innovation_network *n, const innovation_state *s);
