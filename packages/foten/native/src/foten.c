#include "foten_network.h"

#include <math.h>
#include <stdio.h>

#include "constants.h"

typedef struct {
    texture_file *file;
    size_t lanes;
    arena *memory;
} maker;

/* Whether a tensor or memory was missing: then nothing is made. */
static int missing(const maker *m) { return m->file->status != FOTEN_OK || m->memory->failed; }

static size_t up(const maker *m, size_t n) { return (n + m->lanes - 1) / m->lanes * m->lanes; }

static float *room(maker *m, size_t n) {
    return missing(m) ? NULL : arena_take(m->memory, n + m->lanes, sizeof(float));
}

/* A tensor of the network in doubles, (rows, columns) or (rows) where columns is 0; NULL where it is not so. */
static const double *tensor(maker *m, const char *layer, const char *part, const char *which, size_t rows,
                            size_t columns) {
    char name[96];
    snprintf(name, sizeof name, "%s%s%s", layer, part, which);
    return missing(m) ? NULL : file_take(m->file, m->memory, "", name, (size_t[4]){rows, columns});
}

/* A map whose outputs lie in blocks, `stride` apart; those of the first are multiplied. */
static linear blocks_of(maker *m, const char *layer, const char *part, size_t outputs, size_t inputs, size_t block,
                        size_t stride, double times) {
    const double *w = tensor(m, layer, part, ".weight", outputs, inputs),
                 *bias = tensor(m, layer, part, ".bias", outputs, 0);
    size_t panel = 2 * m->lanes, padded = up(m, outputs / block * stride);
    float *weights = room(m, padded * inputs), *biases = room(m, padded);
    if (missing(m)) return (linear){0};
    for (size_t o = 0; o < outputs; o++) {
        size_t at = o / block * stride + o % block, first = at / panel * panel,
               wide = padded - first > m->lanes ? panel : m->lanes;
        double by = o < block ? times : 1;
        biases[at] = (float)(bias[o] * by);
        for (size_t i = 0; i < inputs; i++)
            weights[first * inputs + i * wide + at - first] = (float)(w[o * inputs + i] * by);
    }
    return (linear){(int)inputs, (int)padded, weights, biases};
}

static linear linear_of(maker *m, const char *layer, const char *part, size_t outputs, size_t inputs) {
    return blocks_of(m, layer, part, outputs, inputs, outputs, outputs, 1);
}

static norm norm_of(maker *m, const char *layer, const char *part, size_t width) {
    const double *w = tensor(m, layer, part, ".weight", width, 0), *bias = tensor(m, layer, part, ".bias", width, 0);
    float *weight = room(m, up(m, width)), *added = room(m, up(m, width));
    if (missing(m)) return (norm){0};
    for (size_t i = 0; i < width; i++) {
        weight[i] = (float)w[i];
        added[i] = (float)bias[i];
    }
    return (norm){weight, added};
}

static encoder encoder_of(maker *m, const char *layer, size_t width, size_t heads, size_t feed) {
    if (width % heads) heads = 1;
    size_t stride = up(m, width);
    encoder e = {.width = (int)width, .stride = (int)stride, .heads = (int)heads, .hidden_stride = (int)up(m, feed)};
    e.in = blocks_of(m, layer, ".attention_in", 3 * width, width, width, stride, 1 / sqrt((double)(width / heads)));
    e.out = linear_of(m, layer, ".attention_out", width, width);
    e.feed_in = linear_of(m, layer, ".feedforward_in", feed, width);
    e.feed_out = linear_of(m, layer, ".feedforward_out", width, feed);
    e.norm_1 = norm_of(m, layer, ".norm_1", width);
    e.norm_2 = norm_of(m, layer, ".norm_2", width);
    return e;
}

/* Eq. 2. */
static const float *positions_of(maker *m, size_t window, size_t d, size_t stride) {
    float *out = room(m, window * stride);
    for (size_t i = 0; out && i < window; i++)
        for (size_t k = 0; k < d; k++) {
            double angle = (double)i / pow(10000, (double)(k / 2 * 2) / (double)d);
            out[i * stride + k] = (float)(k % 2 ? cos(angle) : sin(angle));
        }
    return out;
}

/* Eq. 6 and the last row of Eq. 9; what is zero in exact arithmetic is zero, so that a real bin has phase 0 or pi. */
static void transform_of(maker *m, network *n, int half) {
    int window = n->window, bins = n->n_bins;
    n->real = arena_take(m->memory, (size_t)window * (size_t)bins, sizeof *n->real);
    n->imaginary = arena_take(m->memory, (size_t)window * (size_t)bins, sizeof *n->imaginary);
    n->cosine = room(m, (size_t)bins);
    n->sine = room(m, (size_t)bins);
    n->multiplicity = room(m, (size_t)bins);
    if (missing(m)) return;
    for (int t = 0; t < window; t++)
        for (int k = 0; k < bins; k++) {
            int turns = t * k % window;
            double angle = 2 * PI * turns / window;
            n->real[t * bins + k] = (4 * turns) % window == 0 && (2 * turns) % window ? 0 : cos(angle);
            n->imaginary[t * bins + k] = (2 * turns) % window ? -sin(angle) : 0;
        }
    for (int k = 0; k < bins; k++) {
        double angle = 2 * PI * k / window;
        int mirrored = k >= 1 && k < (window + 1) / 2;
        double weight = (half && mirrored ? 2.0 : 1.0) / window;
        n->cosine[k] = (float)(weight * cos(angle));
        n->sine[k] = (float)(weight * sin(angle));
        n->multiplicity[k] = n->n_magnitudes < bins && mirrored ? 2.0f : 1.0f;
    }
}

static void spectral_of(maker *m, network *n, const network_sizes *s) {
    size_t width = (size_t)s->spectral_width, heads = (size_t)s->n_heads, feed = (size_t)s->d_feedforward;
    n->n_bins = s->half_bins ? s->window / 2 + 1 : s->window;
    n->n_magnitudes = s->window / 2 + 1; /* magnitudes k and m - k are equal */
    n->width_stride = (int)up(m, width);
    transform_of(m, n, s->half_bins);
    if (n->lifted) {
        n->magnitude_in = linear_of(m, "spectral.", "magnitude_in", width, 1);
        n->magnitude_out = linear_of(m, "spectral.", "magnitude_out", 1, width);
        n->phase_in = linear_of(m, "spectral.", "phase_in", width, 1);
        n->phase_out = linear_of(m, "spectral.", "phase_out", 1, width);
    }
    n->magnitude = encoder_of(m, "spectral.magnitude_layer", width, heads, feed);
    n->phase = encoder_of(m, "spectral.phase_layer", width, heads, feed);
    n->spectral_embedding = linear_of(m, "spectral_embedding", "", (size_t)s->d_model, 1);
}

/* Floats from `at` on, for n of them; `at` moves past them, to the next cache line. */
static size_t reserve(size_t *at, size_t n) {
    size_t from = *at, line = ALIGNED / sizeof(float);
    *at = (from + n + line - 1) / line * line;
    return from;
}

static size_t larger(size_t a, size_t b) { return a > b ? a : b; }

/* Lay out what an encoder layer of n tokens needs from `begin` on, where the last `asked` are asked for; returns where
 * that ends. */
static size_t lay_out_encoder(encoder *e, size_t n, size_t asked, size_t begin, size_t lanes) {
    size_t attending = begin, stride = (size_t)e->stride, size = (size_t)(e->width / e->heads);
    e->at.normed = reserve(&attending, n * stride);
    size_t feeding = attending;
    e->at.packed = reserve(&attending, 3 * n * stride);
    e->at.mixed = reserve(&attending, asked * stride);
    e->at.query = reserve(&attending, size * lanes);
    e->at.share = reserve(&attending, n * lanes);
    e->at.weighted = reserve(&attending, size * lanes);
    e->at.hidden = reserve(&feeding, asked * (size_t)e->hidden_stride);
    e->at.fed = reserve(&feeding, asked * stride);
    return larger(attending, feeding);
}

/* Lay out the scratch memory of a step. */
static void lay_out(network *n, encoder *layers, size_t lanes) {
    size_t window = (size_t)n->window, bins = (size_t)n->n_bins, magnitudes = (size_t)n->n_magnitudes, at = 0;
    network_scratch *s = &n->scratch;
    s->tokens = reserve(&at, window * (size_t)n->d_stride);
    size_t after_tokens = at, most = at;
    for (int i = 0; i < n->n_layers; i++)
        most =
            larger(most, lay_out_encoder(&layers[i], window, i == n->n_layers - 1 ? 1 : window, after_tokens, lanes));
    if (n->fourier) {
        s->real = reserve(&at, bins * (sizeof(double) / sizeof(float)));
        s->imaginary = reserve(&at, bins * (sizeof(double) / sizeof(float)));
        s->magnitude = reserve(&at, bins);
        s->phase = reserve(&at, bins);
        s->magnitude_out = reserve(&at, bins);
        s->phase_out = reserve(&at, bins);
        s->bins = reserve(&at, bins * (size_t)n->width_stride);
        size_t layer = at;
        s->numbers = reserve(&at, bins * lanes); /* after the layer */
        most = larger(most, larger(at, lay_out_encoder(&n->phase, bins, bins, layer, lanes)));
        most = larger(most, lay_out_encoder(&n->magnitude, magnitudes, magnitudes, layer, lanes));
    }
    at = after_tokens;
    s->features = reserve(&at, (size_t)n->n_features + 2);
    s->first =
        reserve(&at, larger((size_t)n->head_1.outputs, (size_t)n->d_stride)); /* the spectral token before that */
    s->second = reserve(&at, (size_t)n->head_2.outputs);
    s->n = larger(most, at);
}

network *network_make(texture_file *file, const network_sizes *s, const isa *isa, arena *memory) {
    maker make = {file, (size_t)isa->lanes, memory}, *m = &make;
    network *n = arena_take(memory, 1, sizeof *n);
    encoder *layers = arena_take(memory, (size_t)s->n_layers, sizeof *layers);
    if (!n || !layers) return NULL;
    size_t d = (size_t)s->d_model, first = (size_t)s->head[0], second = (size_t)s->head[1],
           n_features = d * (size_t)(1 + s->fourier);
    *n = (network){.window = s->window,
                   .d = s->d_model,
                   .d_stride = (int)up(m, d),
                   .n_layers = s->n_layers,
                   .layers = layers,
                   .first = s->head[0],
                   .second = s->head[1],
                   .pre_norm = s->pre_norm,
                   .lifted = s->spectral_width > 1,
                   .fourier = s->fourier,
                   .n_features = (int)n_features};
    n->embedding = linear_of(m, "temporal.embedding", "", d, 1);
    n->positions = positions_of(m, (size_t)s->window, d, (size_t)n->d_stride);
    for (int i = 0; i < s->n_layers && !missing(m); i++) {
        char name[64];
        snprintf(name, sizeof name, "temporal.layers.%d", i);
        layers[i] = encoder_of(m, name, d, (size_t)s->n_heads, (size_t)s->d_feedforward);
    }
    if (s->pre_norm) n->last = norm_of(m, "temporal.norm", "", d);
    if (s->fourier) spectral_of(m, n, s);
    n->head_1 = linear_of(m, "head_1", "", first, n_features + 2);
    n->head_2 = linear_of(m, "head_2", "", second, first);
    const double *w = tensor(m, "head_3", "", ".weight", 1, second), *bias = tensor(m, "head_3", "", ".bias", 1, 0);
    n->head_3 = room(m, second);
    if (missing(m)) return NULL;
    for (size_t i = 0; i < second; i++) n->head_3[i] = (float)w[i];
    n->head_3_bias = bias[0];
    lay_out(n, layers, m->lanes);
    return n;
}
