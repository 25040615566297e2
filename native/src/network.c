#include "network.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

typedef struct {
    texture_file *file;
    const char *prefix;
    int lanes;
    arena *memory;
    int missing; /* whether something was */
} maker;

static size_t up(size_t n, int lanes) { return (n + (size_t)lanes - 1) / (size_t)lanes * (size_t)lanes; }

static float *room(maker *m, size_t n) {
    float *out = arena_take(m->memory, n + (size_t)m->lanes, sizeof(float));
    m->missing |= !out;
    return out;
}

/* A tensor of the network in doubles, (rows, columns) or (rows) where columns is 0; NULL where it is not so. */
static const double *tensor(maker *m, const char *layer, const char *part, size_t rows, size_t columns) {
    char name[160];
    snprintf(name, sizeof name, "%s%s%s", m->prefix, layer, part);
    size_t shape[4] = {rows, columns, 0, 0};
    double *out = m->missing ? NULL : file_take(m->file, name, shape, m->memory);
    m->missing |= !out;
    return out;
}

/* Output o goes to place[o], times times[o]; where these are NULL to o, times 1. */
static linear pack(maker *m, const double *w, const double *bias, size_t outputs, size_t inputs, size_t padded, const size_t *place,
                   const double *times) {
    size_t vector = (size_t)m->lanes;
    padded = up(padded, m->lanes);
    float *weights = room(m, padded * inputs), *biases = room(m, padded);
    if (m->missing) return (linear){0};
    for (size_t o = 0; o < outputs; o++) {
        size_t at = place ? place[o] : o, first = at / (2 * vector) * (2 * vector);
        size_t wide = padded - first > vector ? 2 * vector : vector;
        double by = times ? times[o] : 1;
        biases[at] = (float)(bias[o] * by);
        for (size_t i = 0; i < inputs; i++) weights[first * inputs + i * wide + at - first] = (float)(w[o * inputs + i] * by);
    }
    return (linear){(int)inputs, (int)padded, weights, biases};
}

static linear linear_of(maker *m, const char *layer, size_t outputs, size_t inputs) {
    const double *w = tensor(m, layer, ".weight", outputs, inputs), *bias = tensor(m, layer, ".bias", outputs, 0);
    return m->missing ? (linear){0} : pack(m, w, bias, outputs, inputs, outputs, NULL, NULL);
}

static norm norm_of(maker *m, const char *layer, size_t width) {
    const double *w = tensor(m, layer, ".weight", width, 0), *bias = tensor(m, layer, ".bias", width, 0);
    float *weight = room(m, up(width, m->lanes)), *added = room(m, up(width, m->lanes));
    if (m->missing) return (norm){0};
    for (size_t i = 0; i < width; i++) {
        weight[i] = (float)w[i];
        added[i] = (float)bias[i];
    }
    return (norm){weight, added};
}

static encoder encoder_of(maker *m, const char *layer, size_t width, size_t heads, size_t feed) {
    char name[96];
    if (width % heads) heads = 1;
    encoder e = {.width = (int)width, .stride = (int)up(width, m->lanes), .heads = (int)heads, .hidden_stride = (int)up(feed, m->lanes)};
    snprintf(name, sizeof name, "%s.attention_in", layer);
    const double *w = tensor(m, name, ".weight", 3 * width, width), *bias = tensor(m, name, ".bias", 3 * width, 0);
    size_t *place = arena_take(m->memory, 3 * width, sizeof *place);
    double *times = arena_take(m->memory, 3 * width, sizeof *times);
    m->missing |= !place || !times;
    if (m->missing) return e;
    for (size_t o = 0; o < 3 * width; o++) {
        place[o] = o / width * (size_t)e.stride + o % width;
        times[o] = o < width ? 1 / sqrt((double)(width / heads)) : 1;
    }
    e.in = pack(m, w, bias, 3 * width, width, 3 * (size_t)e.stride, place, times);
    snprintf(name, sizeof name, "%s.attention_out", layer);
    e.out = linear_of(m, name, width, width);
    snprintf(name, sizeof name, "%s.feedforward_in", layer);
    e.feed_in = linear_of(m, name, feed, width);
    snprintf(name, sizeof name, "%s.feedforward_out", layer);
    e.feed_out = linear_of(m, name, width, feed);
    snprintf(name, sizeof name, "%s.norm_1", layer);
    e.norm_1 = norm_of(m, name, width);
    snprintf(name, sizeof name, "%s.norm_2", layer);
    e.norm_2 = norm_of(m, name, width);
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
    const double pi = 3.14159265358979323846;
    int window = n->window, bins = n->n_bins;
    double *real = arena_take(m->memory, (size_t)window * (size_t)bins, sizeof *real);
    double *imaginary = arena_take(m->memory, (size_t)window * (size_t)bins, sizeof *imaginary);
    float *cosine = room(m, (size_t)bins), *sine = room(m, (size_t)bins), *multiplicity = room(m, (size_t)bins);
    m->missing |= !real || !imaginary;
    if (m->missing) return;
    for (int t = 0; t < window; t++)
        for (int k = 0; k < bins; k++) {
            int turns = t * k % window;
            double angle = 2 * pi * turns / window;
            real[t * bins + k] = (4 * turns) % window == 0 && (2 * turns) % window ? 0 : cos(angle);
            imaginary[t * bins + k] = (2 * turns) % window ? -sin(angle) : 0;
        }
    for (int k = 0; k < bins; k++) {
        double angle = 2 * pi * k / window;
        int mirrored = k >= 1 && k < (window + 1) / 2;
        double weight = (half && mirrored ? 2.0 : 1.0) / window;
        cosine[k] = (float)(weight * cos(angle));
        sine[k] = (float)(weight * sin(angle));
        multiplicity[k] = n->n_magnitudes < bins && mirrored ? 2.0f : 1.0f;
    }
    n->real = real;
    n->imaginary = imaginary;
    n->cosine = cosine;
    n->sine = sine;
    n->multiplicity = multiplicity;
}

static void spectral_of(maker *m, network *n, const network_sizes *s) {
    size_t width = (size_t)s->spectral_width, heads = (size_t)s->n_heads, feed = (size_t)s->d_feedforward;
    n->n_bins = s->half_bins ? s->window / 2 + 1 : s->window;
    n->n_magnitudes = s->window / 2 + 1; /* magnitudes k and m - k are equal */
    n->width_stride = (int)up(width, m->lanes);
    transform_of(m, n, s->half_bins);
    if (n->lifted) {
        n->magnitude_in = linear_of(m, "spectral.magnitude_in", width, 1);
        n->magnitude_out = linear_of(m, "spectral.magnitude_out", 1, width);
        n->phase_in = linear_of(m, "spectral.phase_in", width, 1);
        n->phase_out = linear_of(m, "spectral.phase_out", 1, width);
    }
    n->magnitude = encoder_of(m, "spectral.magnitude_layer", width, heads, feed);
    n->phase = encoder_of(m, "spectral.phase_layer", width, heads, feed);
    n->spectral_embedding = linear_of(m, "spectral_embedding", (size_t)s->d_model, 1);
}

/* Floats from `at` on, for n of them; `at` moves past them, to the next cache line. */
static size_t reserve(size_t *at, size_t n) {
    size_t from = *at, line = ALIGNED / sizeof(float);
    *at = (from + n + line - 1) / line * line;
    return from;
}

/* Lay out what an encoder layer of n tokens needs from `begin` on, where the last `asked` are asked for; returns where that ends. */
static size_t lay_out_encoder(encoder *e, size_t n, size_t asked, size_t begin, size_t queries) {
    size_t attending = begin, feeding, stride = (size_t)e->stride, size = (size_t)(e->width / e->heads);
    e->at.normed = reserve(&attending, n * stride);
    feeding = attending;
    e->at.packed = reserve(&attending, 3 * n * stride);
    e->at.mixed = reserve(&attending, asked * stride);
    e->at.query = reserve(&attending, size * queries);
    e->at.share = reserve(&attending, n * queries);
    e->at.weighted = reserve(&attending, size * queries);
    e->at.hidden = reserve(&feeding, asked * (size_t)e->hidden_stride);
    e->at.fed = reserve(&feeding, asked * stride);
    return attending > feeding ? attending : feeding;
}

static size_t larger(size_t a, size_t b) { return a > b ? a : b; }

/* Lay out the scratch memory of a step. */
static void lay_out(network *n, encoder *layers, const isa *isa) {
    size_t window = (size_t)n->window, bins = (size_t)n->n_bins, queries = (size_t)isa->queries, double_size = sizeof(double) / sizeof(float);
    size_t at = 0, most;
    network_scratch *s = &n->scratch;
    s->tokens = reserve(&at, window * (size_t)n->d_stride);
    size_t after_tokens = at;
    most = after_tokens;
    for (int i = 0; i < n->n_layers; i++)
        most = larger(most, lay_out_encoder(&layers[i], window, i == n->n_layers - 1 ? 1 : window, after_tokens, queries));
    if (n->fourier) {
        s->real = reserve(&at, bins * double_size);
        s->imaginary = reserve(&at, bins * double_size);
        s->magnitude = reserve(&at, bins);
        s->phase = reserve(&at, bins);
        s->magnitude_out = reserve(&at, bins);
        s->phase_out = reserve(&at, bins);
        s->bins = reserve(&at, bins * (size_t)n->width_stride);
        size_t layer = at;
        s->numbers = reserve(&at, bins * (size_t)isa->lanes); /* after the layer */
        most = larger(most, at);
        most = larger(most, lay_out_encoder(&n->magnitude, (size_t)n->n_magnitudes, (size_t)n->n_magnitudes, layer, queries));
        most = larger(most, lay_out_encoder(&n->phase, bins, bins, layer, queries));
    }
    at = after_tokens;
    s->features = reserve(&at, (size_t)n->n_features + 2);
    s->first = reserve(&at, larger((size_t)n->head_1.outputs, (size_t)n->d_stride)); /* the spectral token before that */
    s->second = reserve(&at, (size_t)n->head_2.outputs);
    s->n = larger(most, at);
}

network *network_make(texture_file *file, const char *prefix, const network_sizes *s, const isa *isa, arena *memory) {
    maker make = {file, prefix, isa->lanes, memory, 0}, *m = &make;
    network *n = arena_take(memory, 1, sizeof *n);
    encoder *layers = arena_take(memory, (size_t)s->n_layers, sizeof *layers);
    if (!n || !layers) return NULL;
    size_t d = (size_t)s->d_model, n_features = d * (size_t)(1 + s->fourier);
    *n = (network){.window = s->window, .n_inputs = s->n_inputs, .d = s->d_model, .width = s->spectral_width, .n_layers = s->n_layers,
               .first = s->first, .second = s->second, .pre_norm = s->pre_norm,
               .lifted = s->spectral_width > 1, .fourier = s->fourier, .n_features = (int)n_features};
    n->d_stride = (int)up(d, m->lanes);
    n->embedding = linear_of(m, "temporal.embedding", d, (size_t)s->n_inputs);
    n->positions = positions_of(m, (size_t)s->window, d, (size_t)n->d_stride);
    for (int i = 0; i < s->n_layers && !m->missing; i++) {
        char name[64];
        snprintf(name, sizeof name, "temporal.layers.%d", i);
        layers[i] = encoder_of(m, name, d, (size_t)s->n_heads, (size_t)s->d_feedforward);
    }
    n->layers = layers;
    if (s->pre_norm) n->last = norm_of(m, "temporal.norm", d);
    if (s->fourier) spectral_of(m, n, s);
    n->head_1 = linear_of(m, "head_1", (size_t)s->first, n_features + 2);
    n->head_2 = linear_of(m, "head_2", (size_t)s->second, (size_t)s->first);
    const double *w = tensor(m, "head_3", ".weight", 1, (size_t)s->second), *bias = tensor(m, "head_3", ".bias", 1, 0);
    float *head = room(m, (size_t)s->second);
    if (m->missing) return NULL;
    for (int i = 0; i < s->second; i++) head[i] = (float)w[i];
    n->head_3 = head;
    n->head_3_bias = bias[0];
    lay_out(n, layers, isa);
    return n;
}
