/* An encoder layer (Eq. 3-5) that normalises before each of its two parts, and its gradients, in training: the windows
 * of a batch one group after another, so that what is computed of a group stays in the processor's cache.
 *
 * Arrays lie window by window, then token by token: (b, n, ...). Matrices are (outputs, inputs), as PyTorch has them.
 * Compiled once for each instruction set, as src/kernel.c is; a vector's worth of floats after the end of every array
 * that is saved for the way back may be read. Functions return 0, or 1 where there is no memory. */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>

#include "vectors.h"

enum { MIN_ROWS = 20 }; /* of a group of windows: fewer would be loading weights, not multiplying with them */

/* Queries are the last n_queries tokens of each window, one or all. */
typedef struct {
    int b, n, n_queries, width, n_heads, n_fed;
    int share_stride; /* of a key's shares: n_queries, up to full vectors of any instruction set */
    int keeps;        /* what the way back needs, of all windows; or else of a group, which the next overwrites */
    const float *tokens;
    const float *norm_1_weight, *norm_1_bias, *in_weight, *in_bias, *out_weight, *out_bias;
    const float *norm_2_weight, *norm_2_bias, *feed_in_weight, *feed_in_bias, *feed_out_weight, *feed_out_bias;
    /* Of dropout, of all that is mixed, fed and encoded in turn, NULL for none; the least that keeps a value, which is
     * then multiplied by a factor. */
    const short *bits;
    int least_kept;
    float kept_factor;
    float *encoded; /* (b, n_queries, width) */
    /* Of what is kept, tokens without mean and of unit variance, what they were divided by; queries, keys and values;
     * shares of attention, (b, n_heads, n, share_stride); what they mix; and the same of the second part. */
    float *normed_1, *inverse_sd_1, *projected, *shares, *mixed, *normed_2, *inverse_sd_2, *fed;
} encoder_layer;

/* The gradient by what comes out, and by all that goes in; those by the weights are added to what there is. */
typedef struct {
    const float *by_encoded;
    float *by_tokens;
    float *norm_1_weight, *norm_1_bias, *in_weight, *in_bias, *out_weight, *out_bias;
    float *norm_2_weight, *norm_2_bias, *feed_in_weight, *feed_in_bias, *feed_out_weight, *feed_out_bias;
} encoder_gradients;

/* A matrix in memory: element (row, i) lies at row * row_stride + i * step. */
typedef struct {
    const float *at;
    int row_stride, step;
} view;

/* A tile of `product`: rows and vectors are constants where this is expanded. */
INLINE void tile(const int rows, const int vectors, int k, view a, view b, view from, float *out, int out_stride,
                 int columns) {
    vec sum[ROWS][2];
    for (int r = 0; r < rows; r++)
        for (int v = 0; v < vectors; v++)
            sum[r][v] = from.at ? load(from.at + r * from.row_stride + v * LANES) : (vec){0};
    for (int i = 0; i < k; i++) {
        vec of_b[2];
        for (int v = 0; v < vectors; v++) of_b[v] = load(b.at + i * b.row_stride + v * LANES);
        for (int r = 0; r < rows; r++) {
            float x = a.at[r * a.row_stride + i * a.step];
            for (int v = 0; v < vectors; v++) sum[r][v] += of_b[v] * x;
        }
    }
    for (int r = 0; r < rows; r++)
        for (int v = 0; v < vectors; v++) {
            int left = columns - v * LANES;
            if (left >= LANES) store(out + r * out_stride + v * LANES, sum[r][v]);
            else memcpy(out + r * out_stride + v * LANES, &sum[r][v], sizeof(float) * (size_t)left);
        }
}

static void some_tile(int rows, int vectors, int k, view a, view b, view from, float *out, int out_stride,
                      int columns) {
#define WIDE_TILE(n)                                                                                                   \
    case n: tile(n, 2, k, a, b, from, out, out_stride, columns); return;
#define NARROW_TILE(n)                                                                                                 \
    case n: tile(n, 1, k, a, b, from, out, out_stride, columns); return;
    if (vectors == 2) switch (rows) {
            EACH_ROWS(WIDE_TILE)
        }
    else switch (rows) {
            EACH_ROWS(NARROW_TILE)
        }
}

/* a (rows, k) times b (k, columns), added to `from`, whose rows may be one: a bias, or `out` itself; or to nothing.
 * Up to a vector is read after the end of a row of b and of `from`. */
static void product(int rows, int k, int columns, view a, view b, view from, float *out, int out_stride) {
    for (int c = 0; c < columns; c += 2 * LANES) {
        int vectors = columns - c > LANES ? 2 : 1;
        view of_b = {b.at + c, b.row_stride, 1}, start = {from.at ? from.at + c : NULL, from.row_stride, 1};
        for (int done = 0, some; done < rows; done += some) {
            int tiles = (rows - done + ROWS - 1) / ROWS;
            some = (rows - done + tiles - 1) / tiles;
            view of_a = {a.at + done * a.row_stride, a.row_stride, a.step};
            if (start.at) start.at = from.at + c + done * from.row_stride;
            some_tile(some, vectors, k, of_a, of_b, start, out + done * out_stride + c, out_stride, columns - c);
        }
    }
}

static const view nothing = {NULL, 0, 0};

/* b += aᵀ c, for `rows` rows of a and c. */
static void add_outer(int rows, int n, int columns, view a, view c, float *to) {
    view turned = {a.at, a.step, a.row_stride}, before = {to, columns, 1};
    product(n, rows, columns, turned, c, before, to, columns);
}

static void add_rows(int rows, int columns, view a, float *restrict to) {
    for (int r = 0; r < rows; r++) {
        const float *restrict row = a.at + r * a.row_stride;
        for (int c = 0; c < columns; c++) to[c] += row[c];
    }
}

static void drop(const encoder_layer *l, int n, size_t first, float *restrict from) {
    if (!l->bits) return;
    const short *restrict bits = l->bits + first;
    int least = l->least_kept;
    float factor = l->kept_factor;
    for (int i = 0; i < n; i++) from[i] *= bits[i] >= least ? factor : 0;
}

/* Σ a b, and Σ a where b is NULL. */
static float dot(int n, const float *a, const float *b) {
    vec sum = {0};
    int i = 0;
    for (; i + LANES <= n; i += LANES) sum += b ? load(a + i) * load(b + i) : load(a + i);
    float rest = 0;
    for (; i < n; i++) rest += b ? a[i] * b[i] : a[i];
    return sum_of(sum) + rest;
}

static void transpose(int rows, int columns, const float *restrict from, int stride, float *restrict to,
                      int to_stride) {
    for (int c = 0; c < columns; c++)
        for (int r = 0; r < rows; r++) to[c * to_stride + r] = from[r * stride + c];
}

/* Rows of zero mean and unit variance, and what times that is; ε as PyTorch's. */
static void normalise(int rows, int width, view tokens, float *restrict normed, float *inverse_sd) {
    for (int r = 0; r < rows; r++, normed += width) {
        const float *restrict x = tokens.at + r * tokens.row_stride;
        float mean = dot(width, x, NULL) / (float)width;
        for (int i = 0; i < width; i++) normed[i] = x[i] - mean;
        float inverse = inverse_sd[r] = 1 / sqrtf(dot(width, normed, normed) / (float)width + 1e-5f);
        for (int i = 0; i < width; i++) normed[i] *= inverse;
    }
}

static void scale_and_shift(int rows, int width, const float *restrict normed, const float *restrict weight,
                            const float *restrict bias, float *restrict to) {
    for (int r = 0; r < rows; r++, normed += width, to += width)
        for (int i = 0; i < width; i++) to[i] = normed[i] * weight[i] + bias[i];
}

/* From the gradient by what `scale_and_shift` gives, in place, that by the rows before `normalise`. */
static void normalise_back(int rows, int width, const float *normed, const float *inverse_sd,
                           const float *restrict weight, float *by, float *restrict by_weight,
                           float *restrict by_bias) {
    for (int r = 0; r < rows; r++, normed += width, by += width) {
        for (int i = 0; i < width; i++) {
            by_weight[i] += by[i] * normed[i];
            by_bias[i] += by[i];
            by[i] *= weight[i];
        }
        float mean = dot(width, by, NULL) / (float)width, along = dot(width, by, normed) / (float)width;
        for (int i = 0; i < width; i++) by[i] = inverse_sd[r] * (by[i] - mean - normed[i] * along);
    }
}

/* Shares of scores, in place: (n, stride) of n keys, a vector of queries after the other. */
static void soft_maximum(int n, int vectors, int stride, float scale, float *scores) {
    for (int v = 0; v < vectors; v++, scores += LANES) {
        vec most = load(scores), sum = {0};
        for (int i = 1; i < n; i++) most = larger(most, load(scores + i * stride));
        for (int i = 0; i < n; i++) {
            vec share = exp_of(scale * (load(scores + i * stride) - most));
            sum += share;
            store(scores + i * stride, share);
        }
        vec inverse = 1.0f / sum;
        for (int i = 0; i < n; i++) store(scores + i * stride, load(scores + i * stride) * inverse);
    }
}

/* And back: from the gradient by the shares, in place, that by the scores. */
static void soft_maximum_back(int n, int vectors, int stride, float scale, const float *shares, float *by) {
    for (int v = 0; v < vectors; v++, shares += LANES, by += LANES) {
        vec mean = {0};
        for (int i = 0; i < n; i++) mean += load(shares + i * stride) * load(by + i * stride);
        for (int i = 0; i < n; i++)
            store(by + i * stride, load(shares + i * stride) * (load(by + i * stride) - mean) * scale);
    }
}

/* What the parts of a layer share: its sizes, and where its queries lie among its tokens. */
typedef struct {
    int rows, tokens; /* queries and tokens of the group */
    int first, step;  /* of the group's queries among its tokens */
    int windows;
} group;

static group group_at(const encoder_layer *l, int window, int most) {
    int windows = l->b - window < most ? l->b - window : most;
    return (group){windows * l->n_queries, windows * l->n, l->n - l->n_queries, l->n_queries > 1 ? 1 : l->n, windows};
}

static int windows_of_group(const encoder_layer *l) { return (MIN_ROWS + l->n_queries - 1) / l->n_queries; }

/* Of one window, all heads: what values the queries mix. `turned`: room for a head's queries, zeros after them. */
static void attend(const encoder_layer *l, const float *projected, float *shares, float *mixed, float *turned) {
    int w = l->width, size = w / l->n_heads, stride = l->share_stride, vectors = (l->n_queries + LANES - 1) / LANES;
    for (int at = 0; at < w; at += size, shares += l->n * stride) {
        const float *query = projected + 3 * w * (l->n - l->n_queries) + at, *key = projected + w + at,
                    *value = key + w;
        transpose(l->n_queries, size, query, 3 * w, turned, stride);
        product(l->n, size, vectors * LANES, (view){key, 3 * w, 1}, (view){turned, stride, 1}, nothing, shares, stride);
        soft_maximum(l->n, vectors, stride, 1 / sqrtf((float)size), shares);
        product(l->n_queries, l->n, size, (view){shares, 1, stride}, (view){value, 3 * w, 1}, nothing, mixed + at, w);
    }
}

/* And back: from the gradient by what is mixed, that by queries, keys and values. `turned`: as above; `by`: room for a
 * head's shares. */
static void attend_back(const encoder_layer *l, const float *projected, const float *shares, const float *by_mixed,
                        float *by_projected, float *turned, float *by) {
    int w = l->width, size = w / l->n_heads, stride = l->share_stride, vectors = (l->n_queries + LANES - 1) / LANES;
    int first = 3 * w * (l->n - l->n_queries);
    for (int at = 0; at < w; at += size, shares += l->n * stride, projected += size, by_projected += size) {
        const float *query = projected + first, *key = projected + w, *value = key + w;
        view mixed = {by_mixed + at, w, 1};
        transpose(l->n_queries, size, mixed.at, w, turned, stride);
        product(l->n, size, vectors * LANES, (view){value, 3 * w, 1}, (view){turned, stride, 1}, nothing, by, stride);
        product(l->n, l->n_queries, size, (view){shares, stride, 1}, mixed, nothing, by_projected + 2 * w, 3 * w);
        soft_maximum_back(l->n, vectors, stride, 1 / sqrtf((float)size), shares, by);
        product(l->n_queries, l->n, size, (view){by, 1, stride}, (view){key, 3 * w, 1}, nothing, by_projected + first,
                3 * w);
        product(l->n, l->n_queries, size, (view){by, stride, 1}, (view){query, 3 * w, 1}, nothing, by_projected + w,
                3 * w);
    }
}

enum { LINE = 16 }; /* floats of a line of the cache, where each part of a block begins */

/* The first whole line of a block. */
static float *aligned(float *block) { return block + (LINE - (uintptr_t)block / sizeof(float) % LINE) % LINE; }

/* Floats for n of them from a block, which moves past them and a vector more. */
static float *taken(float **block, int n) {
    float *from = *block;
    *block += (n + LANES + LINE - 1) / LINE * LINE;
    return from;
}

EXPORTED(foten_train_encoder)(const encoder_layer *l) {
    int w = l->width, fed = l->n_fed, most = windows_of_group(l), all = most * l->n, size = w / l->n_heads;
    size_t in_all = (size_t)l->b * (size_t)l->n_queries, weights = (size_t)w * (size_t)(4 * w + 2 * fed);
    size_t floats = weights + (size_t)(all * w + most * l->n_queries * w + size * l->share_stride) + 8 * (LANES + LINE);
    float *memory = malloc(floats * sizeof(float)), *block = aligned(memory);
    if (!memory) return 1;
    float *in = taken(&block, 3 * w * w), *out = taken(&block, w * w), *feed_in = taken(&block, w * fed),
          *feed_out = taken(&block, w * fed);
    float *normed = taken(&block, all * w), *inner = taken(&block, most * l->n_queries * w), *turned = block;
    transpose(3 * w, w, l->in_weight, w, in, 3 * w);
    transpose(w, w, l->out_weight, w, out, w);
    transpose(fed, w, l->feed_in_weight, w, feed_in, fed);
    transpose(w, fed, l->feed_out_weight, fed, feed_out, w);
    for (int window = 0; window < l->b; window += most) {
        group g = group_at(l, window, most);
        size_t token = (size_t)window * (size_t)l->n, query = (size_t)window * (size_t)l->n_queries;
        size_t token_at = l->keeps ? token : 0, query_at = l->keeps ? query : 0;
        const float *tokens = l->tokens + token * (size_t)w;
        float *normed_1 = l->normed_1 + token_at * (size_t)w, *projected = l->projected + token_at * (size_t)(3 * w),
              *mixed = l->mixed + query_at * (size_t)w, *encoded = l->encoded + query * (size_t)w,
              *normed_2 = l->normed_2 + query_at * (size_t)w, *hidden = l->fed + query_at * (size_t)fed;
        normalise(g.tokens, w, (view){tokens, w, 1}, normed_1, l->inverse_sd_1 + token_at);
        scale_and_shift(g.tokens, w, normed_1, l->norm_1_weight, l->norm_1_bias, normed);
        product(g.rows, w, w, (view){normed + g.first * w, g.step * w, 1}, (view){in, 3 * w, 1},
                (view){l->in_bias, 0, 1}, projected + g.first * 3 * w, g.step * 3 * w);
        product(g.tokens, w, 2 * w, (view){normed, w, 1}, (view){in + w, 3 * w, 1}, (view){l->in_bias + w, 0, 1},
                projected + w, 3 * w);
        for (int k = 0; k < g.windows; k++)
            attend(l, projected + k * l->n * 3 * w,
                   l->shares +
                       ((l->keeps ? (size_t)window : 0) + (size_t)k) * (size_t)(l->n_heads * l->n * l->share_stride),
                   mixed + k * l->n_queries * w, turned);
        product(g.rows, w, w, (view){mixed, w, 1}, (view){out, w, 1}, (view){l->out_bias, 0, 1}, encoded, w);
        drop(l, g.rows * w, query * (size_t)w, encoded);
        for (int r = 0; r < g.rows; r++)
            for (int i = 0; i < w; i++) encoded[r * w + i] += tokens[(g.first + r * g.step) * w + i];
        normalise(g.rows, w, (view){encoded, w, 1}, normed_2, l->inverse_sd_2 + query_at);
        scale_and_shift(g.rows, w, normed_2, l->norm_2_weight, l->norm_2_bias, inner);
        product(g.rows, w, fed, (view){inner, w, 1}, (view){feed_in, fed, 1}, (view){l->feed_in_bias, 0, 1}, hidden,
                fed);
        for (int i = 0; i < g.rows * fed; i++) hidden[i] = hidden[i] > 0 ? hidden[i] : 0;
        drop(l, g.rows * fed, in_all * (size_t)w + query * (size_t)fed, hidden);
        product(g.rows, fed, w, (view){hidden, fed, 1}, (view){feed_out, w, 1}, (view){l->feed_out_bias, 0, 1}, inner,
                w);
        drop(l, g.rows * w, in_all * (size_t)(w + fed) + query * (size_t)w, inner);
        for (int i = 0; i < g.rows * w; i++) encoded[i] += inner[i];
    }
    free(memory);
    return 0;
}

EXPORTED(foten_train_encoder_back)(const encoder_layer *l, const encoder_gradients *to) {
    int w = l->width, fed = l->n_fed, most = windows_of_group(l), all = most * l->n, size = w / l->n_heads,
        rows = most * l->n_queries;
    size_t in_all = (size_t)l->b * (size_t)l->n_queries;
    size_t floats = (size_t)w * (size_t)(4 * w + 2 * fed) + (size_t)(rows * (4 * w + fed)) + (size_t)(all * 4 * w) +
                    (size_t)((size + l->n) * l->share_stride) + 14 * (LANES + LINE);
    float *memory = malloc(floats * sizeof(float)), *block = aligned(memory);
    if (!memory) return 1;
    /* Read after their ends, so in room of their own. */
    float *in = taken(&block, 3 * w * w), *out = taken(&block, w * w), *feed_in = taken(&block, w * fed),
          *feed_out = taken(&block, w * fed);
    memcpy(in, l->in_weight, sizeof(float) * (size_t)(3 * w * w));
    memcpy(out, l->out_weight, sizeof(float) * (size_t)(w * w));
    memcpy(feed_in, l->feed_in_weight, sizeof(float) * (size_t)(w * fed));
    memcpy(feed_out, l->feed_out_weight, sizeof(float) * (size_t)(w * fed));
    float *by_out = taken(&block, rows * w), *by_fed = taken(&block, rows * fed), *by_hidden = taken(&block, rows * w),
          *inner = taken(&block, rows * w), *by_mixed = taken(&block, rows * w), *normed = taken(&block, all * w),
          *by_projected = taken(&block, all * 3 * w), *turned = taken(&block, size * l->share_stride),
          *by_shares = block;
    memset(turned, 0, sizeof(float) * (size_t)(size * l->share_stride));
    for (int window = 0; window < l->b; window += most) {
        group g = group_at(l, window, most);
        size_t token = (size_t)window * (size_t)l->n, query = (size_t)window * (size_t)l->n_queries;
        const float *normed_1 = l->normed_1 + token * (size_t)w, *projected = l->projected + token * (size_t)(3 * w),
                    *mixed = l->mixed + query * (size_t)w, *normed_2 = l->normed_2 + query * (size_t)w,
                    *hidden = l->fed + query * (size_t)fed, *by_encoded = to->by_encoded + query * (size_t)w;
        float *by_tokens = to->by_tokens + token * (size_t)w;
        size_t row = sizeof(float) * (size_t)(g.rows * w);
        /* The feed-forward network. */
        memcpy(by_out, by_encoded, row);
        drop(l, g.rows * w, in_all * (size_t)(w + fed) + query * (size_t)w, by_out);
        add_outer(g.rows, w, fed, (view){by_out, w, 1}, (view){hidden, fed, 1}, to->feed_out_weight);
        add_rows(g.rows, w, (view){by_out, w, 1}, to->feed_out_bias);
        product(g.rows, w, fed, (view){by_out, w, 1}, (view){feed_out, fed, 1}, nothing, by_fed, fed);
        for (int i = 0; i < g.rows * fed; i++) by_fed[i] = hidden[i] > 0 ? by_fed[i] : 0;
        drop(l, g.rows * fed, in_all * (size_t)w + query * (size_t)fed, by_fed);
        scale_and_shift(g.rows, w, normed_2, l->norm_2_weight, l->norm_2_bias, inner);
        add_outer(g.rows, fed, w, (view){by_fed, fed, 1}, (view){inner, w, 1}, to->feed_in_weight);
        add_rows(g.rows, fed, (view){by_fed, fed, 1}, to->feed_in_bias);
        product(g.rows, fed, w, (view){by_fed, fed, 1}, (view){feed_in, w, 1}, nothing, by_hidden, w);
        normalise_back(g.rows, w, normed_2, l->inverse_sd_2 + query, l->norm_2_weight, by_hidden, to->norm_2_weight,
                       to->norm_2_bias);
        for (int i = 0; i < g.rows * w; i++) by_hidden[i] += by_encoded[i];
        /* Attention. */
        memcpy(by_out, by_hidden, row);
        drop(l, g.rows * w, query * (size_t)w, by_out);
        add_outer(g.rows, w, w, (view){by_out, w, 1}, (view){mixed, w, 1}, to->out_weight);
        add_rows(g.rows, w, (view){by_out, w, 1}, to->out_bias);
        product(g.rows, w, w, (view){by_out, w, 1}, (view){out, w, 1}, nothing, by_mixed, w);
        for (int k = 0; k < g.windows; k++)
            attend_back(l, projected + k * l->n * 3 * w,
                        l->shares + (size_t)(window + k) * (size_t)(l->n_heads * l->n * l->share_stride),
                        by_mixed + k * l->n_queries * w, by_projected + k * l->n * 3 * w, turned, by_shares);
        view by_query = {by_projected + g.first * 3 * w, g.step * 3 * w, 1}, by_rest = {by_projected + w, 3 * w, 1};
        scale_and_shift(g.tokens, w, normed_1, l->norm_1_weight, l->norm_1_bias, normed);
        add_outer(g.rows, w, w, by_query, (view){normed + g.first * w, g.step * w, 1}, to->in_weight);
        add_outer(g.tokens, 2 * w, w, by_rest, (view){normed, w, 1}, to->in_weight + w * w);
        add_rows(g.rows, w, by_query, to->in_bias);
        add_rows(g.tokens, 2 * w, by_rest, to->in_bias + w);
        product(g.tokens, 2 * w, w, by_rest, (view){in + w * w, w, 1}, nothing, by_tokens, w);
        product(g.rows, w, w, by_query, (view){in, w, 1}, (view){by_tokens + g.first * w, g.step * w, 1},
                by_tokens + g.first * w, g.step * w);
        normalise_back(g.tokens, w, normed_1, l->inverse_sd_1 + token, l->norm_1_weight, by_tokens, to->norm_1_weight,
                       to->norm_1_bias);
        for (int r = 0; r < g.rows; r++)
            for (int i = 0; i < w; i++) by_tokens[(g.first + r * g.step) * w + i] += by_hidden[r * w + i];
    }
    free(memory);
    return 0;
}
