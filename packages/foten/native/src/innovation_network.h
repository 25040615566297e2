/* The innovation network of foten-plus: what innovation a prediction expects next, from those before it, the samples
 * and the hand. No rendering asks it.
 *
 * In double: a step is some 10 000 multiplications. Every instruction set gives the same bits; C libraries differ in
 * the last digits of asinh. */
#pragma once

#include <stdint.h>

#include "constants.h"
#include "tables.h"

enum { INNOVATION_INPUTS = FOTEN_N_INPUTS };

typedef struct innovation_kernel innovation_kernel;

/* Matrices lie by panels of so many outputs: for each input in turn their weights. What outputs are padded with comes
 * out as zeros. */
enum { PANEL = 16 };

typedef struct {
    int n_hidden, head_width, n_components;
    size_t hidden_stride, both_stride, head_stride, out_stride; /* padded; both: hidden, inputs; out: without scales */
    const innovation_kernel *kernel;
    const double *from_input, *from_hidden;   /* (3 hidden, inputs), (3 hidden, hidden): reset, update, new */
    const double *gate_bias, *candidate_bias; /* 3 hidden; hidden, of what `reset` multiplies */
    const double *head, *head_bias;           /* (head_width, hidden + inputs) */
    const double *out, *out_bias;             /* (3 components, head_width): log weights, means, scales */
} innovation_network;

/* Of one stream: the recurrent layer after the last sample, what the network was given of that, and room for a step. */
typedef struct {
    double *hidden, *scratch;
    double inputs[INNOVATION_INPUTS];
} innovation_state;

/* The layers for one instruction set, see innovation_kernel.c. */
struct innovation_kernel {
    void (*push)(const innovation_network *n, innovation_state *s);       /* the inputs, into the recurrent layer */
    double (*expected)(const innovation_network *n, innovation_state *s); /* the mean of the next mixture */
    /* Distances of `n` recorded candidates from `first` on to a query: see recorded.c. */
    void (*distances)(const int16_t *const features[6], int first, int n, const int32_t *query, const int32_t *weights,
                      int32_t *out);
};

int innovation_read(texture_file *file, arena *memory, int n_hidden, int head_width, int n_components,
                    const innovation_kernel *kernel, innovation_network *out);

void innovation_place(const innovation_network *n, innovation_state *s, block *from);

/* As if nothing had come before. */
void innovation_clear(const innovation_network *n, innovation_state *s);

/* Take in a sample: its innovation, what it is over its level, and its logarithms of speed and force. */
void innovation_push(const innovation_network *n, innovation_state *s, double innovation, double x,
                     const double logs[2]);

/* The expected next innovation, after a sample. */
static inline double innovation_expected(const innovation_network *n, innovation_state *s) {
    return n->kernel->expected(n, s);
}
