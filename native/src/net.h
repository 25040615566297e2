/* The network of foten, foten-plus and ten as one step needs it, its weights laid out for one instruction set. */
#ifndef FOTEN_NET_H
#define FOTEN_NET_H

#include <stddef.h>

#include "arena.h"
#include "file.h"

/* y = W x + b. Weights lie in panels of two vectors of outputs, the last of one or two: for each input in turn its weights. */
typedef struct {
    int inputs, outputs;
    const float *weights, *bias;
} linear;

typedef struct {
    const float *weight, *bias;
} norm;

/* Self-attention and a feed-forward network (Eq. 3-5). A token's features are `stride` apart from the next token's. */
typedef struct {
    int width, stride, heads, hidden_stride;
    linear in; /* q over the root of a head's size, k and v, each `stride` wide */
    linear out, feed_in, feed_out;
    norm norm_1, norm_2;
} encoder;

/* What a card says of the network. */
typedef struct {
    int window, d_model, n_heads, n_layers, d_feedforward, first, second, spectral_width;
    int pre_norm, half_bins;
    int n_inputs, fourier; /* fourier: whether there is a spectral branch */
} net_sizes;

typedef struct {
    int window, n_inputs, d, d_stride, width, width_stride, n_layers, n_bins, n_magnitudes, first, second;
    int pre_norm, lifted, fourier, n_found; /* n_found: numbers that the branches give the head */
    linear embedding;
    const float *positions; /* window x d_stride */
    const encoder *layers;
    norm last;
    const double *real, *imaginary; /* window x n_bins */
    const float *cosine, *sine;     /* n_bins */
    const float *counted;           /* how many bins each magnitude stands for */
    linear magnitude_in, magnitude_out, phase_in, phase_out;
    encoder magnitude, phase;
    linear spectral_embedding, head_1, head_2;
    const float *head_3;
    double head_3_bias;
    size_t scratch;                 /* floats that a step needs beside */
} net;

/* What one instruction set does. `window` holds n_inputs numbers a sample, then speed and force of the last, scaled. */
typedef struct {
    const char *name;
    int lanes, most; /* floats in a vector of linear maps; in the widest */
    float (*predict)(const net *net, const float *window, float *scratch);
} isa;

/* The network of a file whose tensors begin with `prefix`; NULL, and a reason in the file, where it does not fit. */
net *net_make(texture_file *file, const char *prefix, const net_sizes *sizes, const isa *isa, arena *memory);
#endif
