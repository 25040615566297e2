/* The network for one instruction set: compiled once for each, by definitions of KERNEL, its name, and of what
 * `vectors.h` says. */

#include <math.h>

#include "constants.h"
#include "vectors.h"

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
            store(out + i, (load(in + i) - mean) * scale * load(g->weight + i) +
                               load(g->bias + i)); /* weight 0 in the padding */
    }
}

/* Softmax attention of the queries from `first` on to all n tokens: lanes are queries, so nothing is summed across
 * lanes. */
static void attend(const encoder *e, int n, int first, const float *multiplicity, float *scratch) {
    int size = e->width / e->heads, stride = 3 * e->stride;
    const float *packed = scratch + e->at.packed;
    float *query = scratch + e->at.query, *share = scratch + e->at.share, *weighted = scratch + e->at.weighted,
          *out = scratch + e->at.mixed;
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
                for (int d = 0; d < size; d++)
                    out[(size_t)(from - first + j) * e->stride + h * size + d] = weighted[d * LANES + j];
        }
    }
}

/* Tokens through an encoder layer, in place; from `first` on alone are asked for, and end up at the beginning. */
static void encode(const encoder *e, int pre_norm, int n, int first, float *tokens, const float *multiplicity,
                   float *scratch) {
    int stride = e->stride, asked = n - first;
    float *normed = scratch + e->at.normed, *mixed = scratch + e->at.mixed, *hidden = scratch + e->at.hidden,
          *fed = scratch + e->at.fed;
    if (pre_norm) normalise(&e->norm_1, n, e->width, tokens, normed, stride);
    apply(&e->in, n, pre_norm ? normed : tokens, stride, scratch + e->at.packed, 3 * stride, 0);
    memset(mixed, 0, sizeof(float) * (size_t)asked * stride);
    attend(e, n, first, multiplicity, scratch);
    float *projected = normed;
    apply(&e->out, asked, mixed, stride, projected, stride, 0);
    for (int i = 0; i < asked * stride; i += LANES)
        store(tokens + i, load(tokens + first * stride + i) + load(projected + i));
    if (!pre_norm) normalise(&e->norm_1, asked, e->width, tokens, tokens, stride);
    if (pre_norm) normalise(&e->norm_2, asked, e->width, tokens, normed, stride);
    apply(&e->feed_in, asked, pre_norm ? normed : tokens, stride, hidden, e->hidden_stride, 1);
    apply(&e->feed_out, asked, hidden, e->hidden_stride, fed, stride, 0);
    for (int i = 0; i < asked * stride; i += LANES) store(tokens + i, load(tokens + i) + load(fed + i));
    if (!pre_norm) normalise(&e->norm_2, asked, e->width, tokens, tokens, stride);
}

/* A bin's number through the lift, an encoder layer and back. */
static void encode_bins(const network *net, const linear *lift, const encoder *e, const linear *back, int n,
                        const float *in, const float *multiplicity, float *out, float *scratch) {
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
    float *magnitude = scratch + at->magnitude, *phase = scratch + at->phase, *m_out = scratch + at->magnitude_out,
          *p_out = scratch + at->phase_out;
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
        if (!(re[k] * re[k] > FOTEN_WEAKEST_BIN * energy))
            re[k] = 0; /* nothing but rounding, as the sign of an angle of pi would be */
        if (!(im[k] * im[k] > FOTEN_WEAKEST_BIN * energy)) im[k] = 0;
        phase[k] = (float)atan2(im[k], re[k]);
        magnitude[k] = (float)size;
    }
    encode_bins(net, &net->magnitude_in, &net->magnitude, &net->magnitude_out, net->n_magnitudes, magnitude,
                net->multiplicity, m_out, scratch);
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
    float *tokens = scratch + at->tokens, *features = scratch + at->features, *first = scratch + at->first,
          *second = scratch + at->second;
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
#define INNOVATION(name) innovation_##name
#define ISA(name)                                                                                                      \
    extern const innovation_kernel INNOVATION(name);                                                                   \
    const isa NAMED(name) = {QUOTED(name), LANES, predict, &INNOVATION(name)};
ISA(KERNEL)
