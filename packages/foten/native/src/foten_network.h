/* The network of foten and ten as one step needs it, its weights laid out for one instruction set. */
#pragma once

#include "innovation_network.h"

/* y = W x + b. Weights lie in panels of two vectors of outputs, the last of one or two: for each input in turn its
 * weights. */
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
    /* Where its numbers lie in the scratch memory, in floats; `hidden` and `fed` lie where `packed` to `weighted` lay
     * before. */
    struct {
        size_t normed, packed, mixed, query, share, weighted, hidden, fed;
    } at;
} encoder;

/* What a card says of the network. */
typedef struct {
    int window, d_model, n_heads, n_layers, d_feedforward, head[2], spectral_width;
    int pre_norm, half_bins;
    int fourier; /* whether there is a spectral branch */
} network_sizes;

/* Where a step's numbers lie in the scratch memory, in floats, and how many floats there are. After the tokens the
 * temporal layers, the spectral branch and the head use the same memory in turn. */
typedef struct {
    size_t tokens, n;
    size_t real, imaginary, magnitude, phase, magnitude_out, phase_out, bins, numbers; /* of the spectral branch */
    size_t features, first, second;                                                    /* of the head */
} network_scratch;

typedef struct {
    int window, d, d_stride, width_stride, n_layers, n_bins, n_magnitudes, first, second;
    int pre_norm, lifted, fourier, n_features; /* n_features: numbers that the branches give the head */
    linear embedding;
    const float *positions; /* window x d_stride */
    const encoder *layers;
    norm last;
    double *real, *imaginary; /* window x n_bins */
    float *cosine, *sine;     /* n_bins */
    float *multiplicity;      /* how many bins each magnitude stands for */
    linear magnitude_in, magnitude_out, phase_in, phase_out;
    encoder magnitude, phase;
    linear spectral_embedding, head_1, head_2;
    float *head_3;
    double head_3_bias;
    network_scratch scratch;
} network;

/* What one instruction set does. `window` holds the samples, then speed and force of the last, scaled. */
typedef struct {
    const char *name;
    int lanes; /* floats in a vector */
    float (*predict)(const network *network, const float *window, float *scratch);
    const innovation_kernel *innovation;
} isa;

extern const isa isa_portable, isa_avx2, isa_avx512, isa_neon, isa_simd128;

/* The best that this processor has, or the one that FOTEN_ISA names if the processor has it. Looked up once. */
const isa *isa_here(void);

/* The network of a file; NULL, and a reason in the file, where it does not fit. */
network *network_make(texture_file *file, const network_sizes *sizes, const isa *isa, arena *memory);
