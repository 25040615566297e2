/* The innovation network of foten-plus: how the next innovation is distributed, from those before it, the samples and
 * the hand.
 *
 * In double: a step is some 10 000 multiplications. Every instruction set gives the same bits; C libraries differ in
 * the last digits of asinh, erfc and the like. */
#pragma once

#include <stdint.h>

#include "constants.h"
#include "tables.h"

enum { INNOVATION_INPUTS = FOTEN_N_INPUTS, PHASE_INPUTS = FOTEN_N_PHASE_INPUTS };

typedef struct innovation_kernel innovation_kernel;

/* Matrices lie by panels of so many outputs: for each input in turn their weights. What outputs are padded with comes
 * out as zeros. */
enum { PANEL = 16 };

typedef struct {
    int n_inputs, n_hidden, head_width, n_components;
    size_t hidden_stride, both_stride, head_stride, out_stride; /* padded; both: hidden, and inputs at most */
    const innovation_kernel *kernel;
    const double *from_input, *from_hidden;   /* (3 hidden, inputs), (3 hidden, hidden): reset, update, new */
    const double *gate_bias, *candidate_bias; /* 3 hidden; hidden, of what `reset` multiplies */
    const double *head, *head_bias;           /* (head_width, hidden + inputs) */
    const double *out, *out_bias;             /* (3 components, head_width) */
} innovation_network;

/* Of one stream: the recurrent layer after the last sample, what the network was given of that, and room for a step. */
typedef struct {
    double *hidden, *scratch;
    double inputs[INNOVATION_INPUTS + PHASE_INPUTS];
    double *weight, *mean, *scale; /* of the mixture, once it is asked for; padded */
} innovation_state;

/* The layers for one instruction set, see innovation_kernel.c. */
struct innovation_kernel {
    void (*push)(const innovation_network *n, innovation_state *s); /* the inputs, into the recurrent layer */
    void (*mixture)(const innovation_network *n, innovation_state *s);
    /* Distances of `n` recorded candidates from `first` on to a query: see recorded.c. */
    void (*distances)(const int16_t *const features[6], int first, int n, const int32_t *query, const int32_t *weights,
                      int32_t *out);
};

int innovation_read(texture_file *file, arena *memory, const char *prefix, int n_inputs, int n_hidden, int head_width,
                    int n_components, const innovation_kernel *kernel, innovation_network *out);

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
