/* What training foten-plus spends its time on: the recurrent unit of the innovation network over chunks, forward and
 * back, all streams of a batch side by side; and the lattices of a recording, section by section. A library of its own,
 * libfoten_training, which comes with the Python package alone; `training.training_kernel` binds it.
 *
 * Arrays lie sample by sample, then stream by stream: (n, s, ...). Rows of hidden states and the like are padded to a
 * multiple of 16, those of weights with zeros, so that what is computed there stays zero. Matrices are (outputs,
 * inputs), their rows padded too. Functions return 0, or 1 where there is no memory. Compiled once for each instruction
 * set, as src/kernel.c is. */
#include <math.h>
#include <stddef.h>
#include <stdlib.h>

#include "vectors.h"

enum { GATES = 3 }; /* reset, update, new */

/* A gated recurrent unit (Cho et al. 2014, as PyTorch has it) of n samples and s streams. */
typedef struct {
    int n, s, n_hidden;
    const float *weight, *bias;     /* of what goes from hidden to hidden, (3 n_hidden, n_hidden) and (3 n_hidden) */
    const float *from_input;        /* what the inputs add to the gates, (n, s, 3 n_hidden) */
    float *hidden;                  /* (n + 1, s, n_hidden), the first given */
    float *gates;                   /* (n, s, 3 n_hidden) */
    float *candidate_preactivation; /* what `reset` multiplies, (n, s, n_hidden) */
} recurrent_unit;

INLINE vec choose(vec_bits mask, vec a, vec b) { return (vec)(((vec_bits)a & mask) | ((vec_bits)b & ~mask)); }
INLINE vec minus_size(vec x) { return choose(x < 0.0f, x, -x); }

INLINE vec logistic(vec x) {
    vec e = exp_of(minus_size(x)), share = 1.0f / (1.0f + e);
    return choose(x < 0.0f, e * share, share);
}

INLINE vec tanh_of(vec x) {
    vec e = exp_of(2.0f * minus_size(x)), t = (1.0f - e) / (1.0f + e);
    return choose(x < 0.0f, -t, t);
}

/* A linear map whose weights are laid out in `room`, (outputs, inputs) of a matrix with rows of `stride`, or of its
 * transpose. */
static linear map_of(const float *matrix, const float *bias, int outputs, int inputs, int stride, int transposed,
                     float *room) {
    for (int o = 0; o < outputs; o++) {
        int first = o / (2 * LANES) * (2 * LANES), wide = outputs - first > LANES ? 2 * LANES : LANES;
        float *to = room + (size_t)first * (size_t)inputs + (o - first);
        for (int i = 0; i < inputs; i++) to[i * wide] = transposed ? matrix[i * stride + o] : matrix[o * stride + i];
    }
    return (linear){inputs, outputs, room, bias};
}

/* A sample of the unit. */
static void unit(const linear *map, int s, int h, const float *from_input, const float *now, float *next, float *gates,
                 float *candidate_preactivation, float *of_hidden) {
    apply(map, s, now, h, of_hidden, GATES * h, 0);
    for (int k = 0; k < s; k++, from_input += GATES * h, of_hidden += GATES * h, gates += GATES * h,
             candidate_preactivation += h, now += h, next += h)
        for (int i = 0; i < h; i += LANES) {
            vec reset = logistic(load(from_input + i) + load(of_hidden + i)),
                update = logistic(load(from_input + h + i) + load(of_hidden + h + i));
            vec candidate = load(of_hidden + 2 * h + i),
                new = tanh_of(load(from_input + 2 * h + i) + reset * candidate);
            store(gates + i, reset);
            store(gates + h + i, update);
            store(gates + 2 * h + i, new);
            store(candidate_preactivation + i, candidate);
            store(next + i, new + update * (load(now + i) - new));
        }
}

/* And back: `d` is the gradient by the next hidden states, and becomes that by those before them; `gates` becomes that
 * by what of the inputs goes into them, and `candidate_preactivation` that by what it is itself. Room: 4 n_hidden
 * states a stream. */
static void unit_back(const linear *map, int s, int h, float *d, const float *now, float *gates,
                      float *candidate_preactivation, float *room) {
    float *by_preactivation = room, *added = room + (size_t)(GATES * h) * (size_t)s;
    for (int k = 0; k < s;
         k++, now += h, gates += GATES * h, candidate_preactivation += h, by_preactivation += GATES * h)
        for (int i = 0; i < h; i += LANES) {
            vec of_next = load(d + k * h + i), reset = load(gates + i), update = load(gates + h + i),
                new = load(gates + 2 * h + i);
            vec of_new = of_next * (1.0f - update) * (1.0f - new * new);
            vec of_update = of_next * (load(now + i) - new) * update * (1.0f - update);
            vec of_reset = of_new * load(candidate_preactivation + i) * reset * (1.0f - reset);
            store(gates + i, of_reset);
            store(by_preactivation + i, of_reset);
            store(gates + h + i, of_update);
            store(by_preactivation + h + i, of_update);
            store(gates + 2 * h + i, of_new);
            store(by_preactivation + 2 * h + i, of_new * reset);
            store(candidate_preactivation + i, of_new * reset);
            store(d + k * h + i, of_next * update);
        }
    apply(map, s, room, GATES * h, added, h, 0);
    for (int i = 0; i < s * h; i += LANES) store(d + i, load(d + i) + load(added + i));
}

EXPORTED(foten_train_unit)(const recurrent_unit *u) {
    int s = u->s, h = u->n_hidden;
    size_t row = (size_t)(s * h);
    float *memory = malloc(sizeof(float) * (size_t)(GATES * h) * (size_t)(h + s));
    if (!memory) return 1;
    linear map = map_of(u->weight, u->bias, GATES * h, h, h, 0, memory);
    for (int t = 0; t < u->n; t++) {
        size_t at = (size_t)t * row;
        unit(&map, s, h, u->from_input + GATES * at, u->hidden + at, u->hidden + at + row, u->gates + GATES * at,
             u->candidate_preactivation + at, memory + GATES * h * h);
    }
    free(memory);
    return 0;
}

/* From the gradient by each of the hidden states but the first, (n, s, n_hidden), that by what goes into the gates, in
 * place of `gates` and `candidate_preactivation`. */
EXPORTED(foten_train_unit_back)(const recurrent_unit *u, const float *by_hidden) {
    int s = u->s, h = u->n_hidden;
    size_t row = (size_t)(s * h);
    float *memory = calloc((size_t)(GATES * h * h) + (size_t)h + (2 + GATES) * row, sizeof(float));
    if (!memory) return 1;
    float *zero = memory, *d = zero + h, *room = d + row;
    linear map = map_of(u->weight, zero, h, GATES * h, h, 1, room + (1 + GATES) * row);
    for (int t = u->n - 1; t >= 0; t--) {
        size_t at = (size_t)t * row;
        for (size_t i = 0; i < row; i += LANES) store(d + i, load(d + i) + load(by_hidden + at + i));
        unit_back(&map, s, h, d, u->hidden + at, u->gates + GATES * at, u->candidate_preactivation + at, room);
    }
    free(memory);
    return 0;
}

/* Blocks of a signal on their way through a lattice whose reflections follow speed and force (`dsp.lattice`,
 * `dsp.speed_force_table`). A sample lies between four vertices, or at a table's only one. In float64. */
typedef struct {
    int n_blocks, n, n_vertices;
    int to_faster, to_firmer; /* from a vertex to the next one; 0 where there is none */
    double leak;
    const int *vertex;             /* the slowest and softest of the four, (n_blocks, n) */
    const double *faster, *firmer; /* the share of the way to the other ones, (n_blocks, n) */
    const double *error_weight;    /* of squared errors, (n_blocks, n) */
    double *forward, *backward;    /* f and b after some sections, (n_blocks, n) */
    double *gain;                  /* product of their cosines, (n_blocks, n) */
} lattice_blocks;

typedef double quad __attribute__((vector_size(32)));

INLINE quad load_quad(const double *p) {
    quad v;
    memcpy(&v, p, sizeof v);
    return v;
}

INLINE double sum_of_quad(quad v) { return v[0] + v[1] + v[2] + v[3]; }

/* Shares of the slower and softer vertex, the firmer, the faster, and the faster and firmer one. */
INLINE quad shares(const lattice_blocks *l, size_t at) {
    double faster = l->faster[at], firmer = l->firmer[at], both = faster * firmer;
    return (quad){1 - faster - firmer + both, firmer - both, faster - both, both};
}

/* Of each block's next section, from sample `first` > 0 on: the sums of w (f² + b²) / 2 and of w f b, b delayed. */
EXPORTED(foten_train_block_sums)(const lattice_blocks *l, int first, double *power, double *correlation) {
    for (int block = 0; block < l->n_blocks; block++) {
        size_t at = (size_t)block * (size_t)l->n;
        const double *f = l->forward + at, *b = l->backward + at - 1, *w = l->error_weight + at;
        quad squares = {0}, products = {0};
        int t = first;
        for (; t + 4 <= l->n; t += 4) {
            quad forward = load_quad(f + t), backward = l->leak * load_quad(b + t), weight = load_quad(w + t);
            squares += weight * (forward * forward + backward * backward);
            products += weight * forward * backward;
        }
        power[block] = sum_of_quad(squares), correlation[block] = sum_of_quad(products);
        for (; t < l->n; t++) {
            double backward = l->leak * b[t];
            power[block] += w[t] * (f[t] * f[t] + backward * backward);
            correlation[block] += w[t] * f[t] * backward;
        }
        power[block] /= 2;
    }
    return 0;
}

/* The same sums over all blocks, by pairs of vertices, (n_vertices, n_vertices), and by vertex. */
EXPORTED(foten_train_vertex_sums)(const lattice_blocks *l, int first, double *power, double *correlation) {
    int offset[4] = {0, l->to_firmer, l->to_faster, l->to_faster + l->to_firmer};
    for (int block = 0; block < l->n_blocks; block++)
        for (int t = first; t < l->n;) {
            size_t at = (size_t)block * (size_t)l->n + (size_t)t;
            int vertex = l->vertex[at];
            quad by_pair[4] = {{0}, {0}, {0}, {0}}, by_vertex = {0};
            for (; t < l->n && l->vertex[at] == vertex; t++, at++) {
                double f = l->forward[at], b = l->leak * l->backward[at - 1], w = l->error_weight[at];
                quad share = shares(l, at), of_power = share * (w * (f * f + b * b) / 2);
                for (int i = 0; i < 4; i++) by_pair[i] += share[i] * of_power;
                by_vertex += share * (w * f * b);
            }
            for (int i = 0; i < 4; i++) {
                double *row = power + (size_t)(vertex + offset[i]) * (size_t)l->n_vertices + vertex;
                for (int j = 0; j < 4; j++) row[offset[j]] += by_pair[i][j];
                correlation[vertex + offset[i]] += by_vertex[i];
            }
        }
    return 0;
}

/* f, b and the gain after the next section, by its reflections at the vertices. */
EXPORTED(foten_train_section)(const lattice_blocks *l, const double *reflections) {
    size_t n = (size_t)l->n;
    double *delayed = malloc(3 * n * sizeof(double)), *k = delayed + n, *over = k + n;
    if (!delayed) return 1;
    for (int block = 0; block < l->n_blocks; block++) {
        size_t at = (size_t)block * n;
        double *restrict f = l->forward + at, *restrict b = l->backward + at, *restrict gain = l->gain + at;
        delayed[0] = 0;
        for (size_t t = 1; t < n; t++) delayed[t] = l->leak * b[t - 1];
        for (size_t t = 0; t < n; t++) {
            if (l->n_vertices > 1 || t == 0) {
                const double *from = reflections + l->vertex[at + t];
                quad share = shares(l, at + t);
                k[t] = share[0] * from[0] + share[1] * from[l->to_firmer] + share[2] * from[l->to_faster] +
                       share[3] * from[l->to_faster + l->to_firmer];
                over[t] = sqrt(1 - k[t] * k[t]);
            } else k[t] = k[0], over[t] = over[0];
        }
        for (size_t t = 0; t < n; t++) {
            double forward = f[t], backward = delayed[t], cosine = over[t], inverse = 1 / cosine;
            f[t] = (forward + k[t] * backward) * inverse;
            b[t] = (backward + k[t] * forward) * inverse;
            gain[t] *= cosine;
        }
    }
    free(delayed);
    return 0;
}

/* x of a x = b for a square matrix and in the place of b, by elimination; the logarithm of its determinant, which is to
 * be positive. */
static double solve(int n, double *restrict a, double *restrict b) {
    double log_determinant = 0;
    for (int i = 0; i < n; i++) {
        int pivot = i;
        for (int j = i + 1; j < n; j++) pivot = fabs(a[j * n + i]) > fabs(a[pivot * n + i]) ? j : pivot;
        if (pivot != i) {
            for (int j = i; j < n; j++) {
                double other = a[i * n + j];
                a[i * n + j] = a[pivot * n + j], a[pivot * n + j] = other;
            }
            double other = b[i];
            b[i] = b[pivot], b[pivot] = other;
        }
        log_determinant += log(fabs(a[i * n + i]));
        for (int j = i + 1; j < n; j++) {
            double times = a[j * n + i] / a[i * n + i];
            for (int k = i + 1; k < n; k++) a[j * n + k] -= times * a[i * n + k];
            b[j] -= times * b[i];
        }
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int j = i + 1; j < n; j++) b[i] -= a[i * n + j] * b[j];
        b[i] /= a[i * n + i];
    }
    return log_determinant;
}

/* Deviations d of n vertices with likelihood exp(score d - d information d / 2), given a Gaussian prior whose
 * covariance is a sum of parts (n_parts, n, n), each times the square of one of some scales, the first of them 0: the
 * posterior mean under the prior of the greatest evidence that a search finds, one part at a time, each twice. */
typedef struct {
    int n, n_parts, n_scales;
    const double *scales, *parts, *information, *score;
    double *mean;
} deviations;

EXPORTED(foten_train_deviations)(const deviations *d) {
    int n = d->n, square = n * n;
    double *memory = calloc((size_t)((d->n_parts + 1) * (square + n) + d->n_parts), sizeof(double));
    if (!memory) return 1;
    double *systems = memory, *moments = systems + d->n_parts * square, *system = moments + d->n_parts * n,
           *mean = system + square, *chosen = mean + n, best = 0;
    /* The mean solves (1 + P information) d = P score. */
    for (int row = 0; row < d->n_parts * n; row++)
        for (int k = 0; k < n; k++) {
            double part = d->parts[row * n + k];
            for (int j = 0; j < n; j++) systems[row * n + j] += part * d->information[k * n + j];
            moments[row] += part * d->score[k];
        }
    memset(d->mean, 0, sizeof(double) * (size_t)n);
    for (int step = 0; step < 2 * d->n_parts; step++) {
        double *scale = chosen + step % d->n_parts, likeliest = *scale;
        for (int tried = 0; tried < d->n_scales; tried++) {
            *scale = d->scales[tried];
            memset(system, 0, sizeof(double) * (size_t)(square + n));
            for (int i = 0; i < n; i++) system[i * n + i] = 1;
            for (int part = 0; part < d->n_parts; part++) {
                double times = chosen[part] * chosen[part];
                if (times == 0) continue;
                for (int i = 0; i < square; i++) system[i] += times * systems[part * square + i];
                for (int i = 0; i < n; i++) mean[i] += times * moments[part * n + i];
            }
            double evidence = -solve(n, system, mean) / 2;
            for (int i = 0; i < n; i++) evidence += d->score[i] * mean[i] / 2;
            if (evidence <= best + 1e-9) continue;
            best = evidence, likeliest = *scale;
            memcpy(d->mean, mean, sizeof(double) * (size_t)n);
        }
        *scale = likeliest;
    }
    free(memory);
    return 0;
}
