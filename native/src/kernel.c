/* The network for one instruction set: compiled once for each, by definitions of
 *   KERNEL its name,
 *   LANES  floats in a vector,
 *   ROWS   tokens whose sums stay in registers at once: 5, 8 or 11.
 * The vectors are the compiler's own, so that the same lines become AVX-512, AVX2, NEON, wasm's SIMD or plain C. */

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "constants.h"
#include "network.h"

typedef float vec __attribute__((vector_size(4 * LANES)));
typedef int32_t vec_bits __attribute__((vector_size(4 * LANES)));
typedef uint32_t vec_word __attribute__((vector_size(4 * LANES)));

#define INLINE static inline __attribute__((always_inline))

INLINE vec load(const float *p) { vec v; memcpy(&v, p, sizeof v); return v; }
INLINE void store(float *p, vec v) { memcpy(p, &v, sizeof v); }
INLINE vec rectify(vec a) { return (vec)((vec_bits)a & (vec_bits)(a > 0.0f)); }
INLINE vec larger(vec a, vec b) { vec_bits m = a > b; return (vec)(((vec_bits)a & m) | ((vec_bits)b & ~m)); }

INLINE float sum_of(vec v) {
    float f[LANES];
    memcpy(f, &v, sizeof v);
    for (int width = LANES / 2; width; width /= 2)
        for (int i = 0; i < width; i++) f[i] += f[i + width];
    return f[0];
}

/* e^x for x up to 0, within 2 units in the last place; less than e^-50 is e^-50. */
INLINE vec exp_of(vec x) {
    vec least = {0};
    x = larger(x, least - 50.0f); /* e^-50 is nothing beside 1, and nothing that it is multiplied with is denormal */
    vec shifted = x * 1.44269504f + 12582912.0f;
    vec n = shifted - 12582912.0f;
    vec r = x - n * 0.693359375f;
    r = r - n * -2.12194440e-4f;
    vec p = r * 1.9875691500e-4f + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    p = p * (r * r) + r + 1.0f;
    vec_word power = ((vec_word)shifted << 23) + 0x3F800000u; /* unsigned: of what is no number it may overflow */
    return p * (vec)power;
}

/* `rows` tokens times one panel; rows and vectors are constants where this is expanded. */
INLINE void panel(const int rows, const int vectors, int inputs, const float *restrict w, const float *restrict bias,
                  const float *restrict in, int in_stride, float *restrict out, int out_stride, int rectified) {
    vec a[ROWS][2];
    for (int n = 0; n < rows; n++)
        for (int k = 0; k < vectors; k++) a[n][k] = load(bias + k * LANES);
    for (int i = 0; i < inputs; i++, w += vectors * LANES) {
        vec weight[2];
        for (int k = 0; k < vectors; k++) weight[k] = load(w + k * LANES);
        for (int n = 0; n < rows; n++) {
            float x = in[n * in_stride + i];
            for (int k = 0; k < vectors; k++) a[n][k] += weight[k] * x;
        }
    }
    for (int n = 0; n < rows; n++)
        for (int k = 0; k < vectors; k++) store(out + n * out_stride + k * LANES, rectified ? rectify(a[n][k]) : a[n][k]);
}

#define FIRST_5(X) X(1) X(2) X(3) X(4) X(5)
#define FIRST_8(X) FIRST_5(X) X(6) X(7) X(8)
#define FIRST_11(X) FIRST_8(X) X(9) X(10) X(11)
#define JOINED(a, b) a##b
#define FIRST(n) JOINED(FIRST_, n)
#define EACH_ROWS FIRST(ROWS)

static void some_rows(int rows, int vectors, int inputs, const float *w, const float *bias, const float *in, int in_stride,
                      float *out, int out_stride, int rectified) {
#define WIDE(k) case k: panel(k, 2, inputs, w, bias, in, in_stride, out, out_stride, rectified); return;
#define NARROW(k) case k: panel(k, 1, inputs, w, bias, in, in_stride, out, out_stride, rectified); return;
    if (vectors == 2) switch (rows) { EACH_ROWS(WIDE) }
    else switch (rows) { EACH_ROWS(NARROW) }
}

/* n tokens through a linear map; what they are padded with up to full vectors comes out as zeros. */
static void apply(const linear *l, int n, const float *in, int in_stride, float *out, int out_stride, int rectified) {
    int padded = (l->outputs + LANES - 1) / LANES * LANES;
    for (int o = 0; o < padded; o += 2 * LANES) {
        int vectors = padded - o > LANES ? 2 : 1;
        for (int done = 0, rows; done < n; done += rows) {
            int blocks = (n - done + ROWS - 1) / ROWS;
            rows = (n - done + blocks - 1) / blocks;
            some_rows(rows, vectors, l->inputs, l->weights + (size_t)o * (size_t)l->inputs, l->bias + o, in + done * in_stride, in_stride,
                      out + done * out_stride + o, out_stride, rectified);
        }
    }
}

static void normalise(const norm *g, int n, int width, const float *in, float *out, int stride) {
    float share = 1.0f / (float)width;
    for (int t = 0; t < n; t++, in += stride, out += stride) {
        vec total = {0}, squares = {0};
        for (int i = 0; i < stride; i += LANES) total += load(in + i);
        float mean = sum_of(total) * share;
        for (int i = 0; i < stride; i += LANES) {
            vec d = load(in + i) - mean;
            for (int k = width - i; k < LANES; k++) d[k] = 0; /* of the padding nothing is to count */
            squares += d * d;
        }
        float variance = sum_of(squares) * share;
        float scale = 1.0f / sqrtf(variance + 1e-5f);
        for (int i = 0; i < stride; i += LANES)
            store(out + i, (load(in + i) - mean) * scale * load(g->weight + i) + load(g->bias + i)); /* weight 0 in the padding */
    }
}

/* Softmax attention of the queries from `first` on to all n tokens: lanes are queries, so nothing is summed across lanes. */
static void attend(const encoder *e, int n, int first, const float *multiplicity, float *scratch) {
    int size = e->width / e->heads, stride = 3 * e->stride;
    const float *packed = scratch + e->at.packed;
    float *query = scratch + e->at.query, *share = scratch + e->at.share, *weighted = scratch + e->at.weighted, *out = scratch + e->at.mixed;
    for (int from = first; from < n; from += LANES) {
        int some = n - from < LANES ? n - from : LANES;
        for (int h = 0; h < e->heads; h++) {
            const float *q = packed + (size_t)from * stride + h * size;
            const float *k = packed + e->stride + h * size, *v = packed + 2 * e->stride + h * size;
            for (int d = 0; d < size; d++)
                for (int j = 0; j < LANES; j++) query[d * LANES + j] = j < some ? q[j * stride + d] : 0.0f;
            vec most = {0};
            most -= 1e30f;
            for (int j = 0; j < n; j++) {
                vec s = {0};
                for (int d = 0; d < size; d++) s += load(query + d * LANES) * k[j * stride + d];
                store(share + j * LANES, s);
                most = larger(most, s);
            }
            vec total = {0};
            for (int j = 0; j < n; j++) {
                vec s = exp_of(load(share + j * LANES) - most);
                if (multiplicity) s *= multiplicity[j];
                store(share + j * LANES, s);
                total += s;
            }
            vec inverse = 1.0f / total;
            for (int d = 0; d < size; d++) {
                vec m = {0};
                for (int j = 0; j < n; j++) m += load(share + j * LANES) * v[j * stride + d];
                store(weighted + d * LANES, m * inverse);
            }
            for (int j = 0; j < some; j++)
                for (int d = 0; d < size; d++) out[(size_t)(from - first + j) * e->stride + h * size + d] = weighted[d * LANES + j];
        }
    }
}

/* Tokens through an encoder layer, in place; from `first` on alone are asked for, and end up at the beginning. */
static void encode(const encoder *e, int pre_norm, int n, int first, float *tokens, const float *multiplicity, float *scratch) {
    int stride = e->stride, asked = n - first;
    float *normed = scratch + e->at.normed, *mixed = scratch + e->at.mixed, *hidden = scratch + e->at.hidden, *fed = scratch + e->at.fed;
    if (pre_norm) normalise(&e->norm_1, n, e->width, tokens, normed, stride);
    apply(&e->in, n, pre_norm ? normed : tokens, stride, scratch + e->at.packed, 3 * stride, 0);
    memset(mixed, 0, sizeof(float) * (size_t)asked * stride);
    attend(e, n, first, multiplicity, scratch);
    float *projected = normed;
    apply(&e->out, asked, mixed, stride, projected, stride, 0);
    for (int i = 0; i < asked * stride; i += LANES) store(tokens + i, load(tokens + first * stride + i) + load(projected + i));
    if (!pre_norm) normalise(&e->norm_1, asked, e->width, tokens, tokens, stride);
    if (pre_norm) normalise(&e->norm_2, asked, e->width, tokens, normed, stride);
    apply(&e->feed_in, asked, pre_norm ? normed : tokens, stride, hidden, e->hidden_stride, 1);
    apply(&e->feed_out, asked, hidden, e->hidden_stride, fed, stride, 0);
    for (int i = 0; i < asked * stride; i += LANES) store(tokens + i, load(tokens + i) + load(fed + i));
    if (!pre_norm) normalise(&e->norm_2, asked, e->width, tokens, tokens, stride);
}

/* A bin's number through the lift, an encoder layer and back. */
static void encode_bins(const network *net, const linear *lift, const encoder *e, const linear *back, int n, const float *in,
                        const float *multiplicity, float *out, float *scratch) {
    int stride = net->width_stride;
    float *tokens = scratch + net->scratch.bins, *numbers = scratch + net->scratch.numbers;
    if (net->lifted) {
        apply(lift, n, in, 1, tokens, stride, 0);
    } else {
        memset(tokens, 0, sizeof(float) * (size_t)n * (size_t)stride);
        for (int i = 0; i < n; i++) tokens[i * stride] = in[i];
    }
    encode(e, net->pre_norm, n, 0, tokens, multiplicity, scratch);
    if (net->lifted) apply(back, n, tokens, stride, numbers, LANES, 0);
    for (int i = 0; i < n; i++) out[i] = net->lifted ? numbers[i * LANES] : tokens[i * stride];
}

static double spectral(const network *net, const float *window, float *scratch) {
    int m = net->window, n = net->n_bins;
    const network_scratch *at = &net->scratch;
    double *re = (double *)(scratch + at->real), *im = (double *)(scratch + at->imaginary);
    float *magnitude = scratch + at->magnitude, *phase = scratch + at->phase, *m_out = scratch + at->magnitude_out, *p_out = scratch + at->phase_out;
    double energy = 0;
    for (int k = 0; k < n; k++) re[k] = im[k] = 0;
    for (int t = 0; t < m; t++) {
        double a = window[t];
        for (int k = 0; k < n; k++) {
            re[k] += a * net->real[t * n + k];
            im[k] += a * net->imaginary[t * n + k];
        }
    }
    for (int k = 0; k < n; k++) energy += re[k] * re[k] + im[k] * im[k];
    for (int k = 0; k < n; k++) {
        double power = re[k] * re[k] + im[k] * im[k], size = sqrt(power + 1e-16);
        if (!(re[k] * re[k] > FOTEN_WEAKEST_BIN * energy)) re[k] = 0; /* nothing but rounding, as the sign of an angle of pi would be */
        if (!(im[k] * im[k] > FOTEN_WEAKEST_BIN * energy)) im[k] = 0;
        phase[k] = (float)atan2(im[k], re[k]);
        magnitude[k] = (float)size;
    }
    encode_bins(net, &net->magnitude_in, &net->magnitude, &net->magnitude_out, net->n_magnitudes, magnitude, net->multiplicity, m_out, scratch);
    encode_bins(net, &net->phase_in, &net->phase, &net->phase_out, n, phase, NULL, p_out, scratch);
    double sum = 0;
    for (int k = 0; k < n; k++) {
        double size = m_out[k < net->n_magnitudes ? k : m - k];
        sum += size * (net->cosine[k] * cos((double)p_out[k]) + net->sine[k] * sin((double)p_out[k]));
    }
    return sum;
}

static float predict(const network *net, const float *window, float *scratch) {
    int m = net->window, stride = net->d_stride, d = net->d, n = net->n_features;
    const network_scratch *at = &net->scratch;
    float *tokens = scratch + at->tokens, *features = scratch + at->features, *first = scratch + at->first, *second = scratch + at->second;
    apply(&net->embedding, m, window, 1, tokens, stride, 0);
    for (int i = 0; i < m * stride; i += LANES) store(tokens + i, load(tokens + i) + load(net->positions + i));
    for (int layer = 0; layer < net->n_layers; layer++)
        encode(&net->layers[layer], net->pre_norm, m, layer == net->n_layers - 1 ? m - 1 : 0, tokens, NULL, scratch);
    if (net->pre_norm) normalise(&net->last, 1, d, tokens, tokens, stride);
    float spectral_sample = net->fourier ? (float)spectral(net, window, scratch) : 0;
    memcpy(features, tokens, sizeof(float) * (size_t)d);
    if (net->fourier) {
        apply(&net->spectral_embedding, 1, &spectral_sample, 1, first, stride, 0);
        memcpy(features + d, first, sizeof(float) * (size_t)d);
    }
    features[n] = window[m];
    features[n + 1] = window[m + 1];
    apply(&net->head_1, 1, features, n + 2, first, net->first, 1);
    apply(&net->head_2, 1, first, net->first, second, net->second, 1);
    double out = net->head_3_bias;
    for (int i = 0; i < net->second; i++) out += (double)second[i] * net->head_3[i];
    return (float)out;
}

#define NAMED(name) isa_##name
#define QUOTED(name) #name
#define ISA(name) const isa NAMED(name) = {QUOTED(name), LANES, predict};
ISA(KERNEL)
