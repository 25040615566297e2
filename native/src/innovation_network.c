#include "innovation_network.h"

#include <math.h>
#include <string.h>

#include "constants.h"

enum { MAX_NEWTON_STEPS = FOTEN_MAX_NEWTON_STEPS };

/* A matrix (outputs, inputs) of the file by columns. */
static const double *columns_of(texture_file *file, arena *memory, const char *prefix, const char *name, size_t outputs,
                                size_t inputs) {
    const double *rows = file_take(file, memory, prefix, name, (size_t[4]){outputs, inputs});
    double *columns = rows ? arena_take(memory, outputs * inputs, sizeof *columns) : NULL;
    for (size_t o = 0; columns && o < outputs; o++)
        for (size_t i = 0; i < inputs; i++) columns[i * outputs + o] = rows[o * inputs + i];
    return columns;
}

int innovation_read(texture_file *file, arena *memory, const char *prefix, int n_inputs, int n_hidden, int head_width,
                    int n_components, innovation_network *out) {
    size_t h = (size_t)n_hidden, width = (size_t)head_width, k = (size_t)n_components, inputs = (size_t)n_inputs;
    *out = (innovation_network){
        .n_inputs = n_inputs, .n_hidden = n_hidden, .head_width = head_width, .n_components = n_components};
    if (!(out->from_input = columns_of(file, memory, prefix, "recurrent.weight_ih_l0", 3 * h, inputs))) return 0;
    if (!(out->from_hidden = columns_of(file, memory, prefix, "recurrent.weight_hh_l0", 3 * h, h))) return 0;
    if (!(out->input_bias = file_take(file, memory, prefix, "recurrent.bias_ih_l0", (size_t[4]){3 * h}))) return 0;
    if (!(out->hidden_bias = file_take(file, memory, prefix, "recurrent.bias_hh_l0", (size_t[4]){3 * h}))) return 0;
    if (!(out->head = columns_of(file, memory, prefix, "head.weight", width, h + inputs))) return 0;
    if (!(out->head_bias = file_take(file, memory, prefix, "head.bias", (size_t[4]){width}))) return 0;
    if (!(out->out = columns_of(file, memory, prefix, "out.weight", 3 * k, width))) return 0;
    return (out->out_bias = file_take(file, memory, prefix, "out.bias", (size_t[4]){3 * k})) != NULL;
}

void innovation_place(const innovation_network *n, innovation_state *s, block *from) {
    size_t h = (size_t)n->n_hidden, width = (size_t)n->head_width, k = (size_t)n->n_components;
    s->hidden = block_take(from, h, sizeof *s->hidden);
    s->weight = block_take(from, k, sizeof *s->weight);
    s->mean = block_take(from, k, sizeof *s->mean);
    s->scale = block_take(from, k, sizeof *s->scale);
    s->scratch = block_take(from, 6 * h > width + 3 * k ? 6 * h : width + 3 * k, sizeof *s->scratch);
}

static void set_inputs(const innovation_network *n, innovation_state *s, double innovation, double x,
                       const double logs[2], double phase) {
    s->inputs[0] = asinh(innovation);
    s->inputs[1] = asinh(3 * fabs(innovation)) - 1;
    s->inputs[2] = x / 2;
    s->inputs[3] = logs[0];
    s->inputs[4] = logs[1];
    for (int i = INNOVATION_INPUTS, multiple = 1; i < n->n_inputs; i += 2, multiple++) {
        s->inputs[i] = cos(multiple * phase);
        s->inputs[i + 1] = sin(multiple * phase);
    }
}

void innovation_clear(const innovation_network *n, innovation_state *s, const double logs[2], double phase) {
    for (int i = 0; i < n->n_hidden; i++) s->hidden[i] = 0;
    set_inputs(n, s, 0, 0, logs, phase);
}

/* out += columns x, for as many numbers of x as there are. */
static void add_product(double *restrict out, size_t outputs, const double *restrict columns, const double *restrict x,
                        size_t inputs) {
    size_t i = 0;
    for (; i + 4 <= inputs; i += 4) { /* four at a time, so that out is read and written less often */
        const double *restrict a = columns + i * outputs, *restrict b = a + outputs, *restrict c = b + outputs,
                               *restrict d = c + outputs;
        double xa = x[i], xb = x[i + 1], xc = x[i + 2], xd = x[i + 3];
        for (size_t o = 0; o < outputs; o++) out[o] += (a[o] * xa + b[o] * xb) + (c[o] * xc + d[o] * xd);
    }
    for (; i < inputs; i++) {
        const double *restrict a = columns + i * outputs;
        for (size_t o = 0; o < outputs; o++) out[o] += a[o] * x[i];
    }
}

static double logistic(double x) { return 1 / (1 + exp(-x)); }

void innovation_push(const innovation_network *n, innovation_state *s, double innovation, double x,
                     const double logs[2], double phase) {
    size_t h = (size_t)n->n_hidden;
    double *from_inputs = s->scratch, *from_hidden = s->scratch + 3 * h;
    set_inputs(n, s, innovation, x, logs, phase);
    memcpy(from_inputs, n->input_bias, 3 * h * sizeof *from_inputs);
    memcpy(from_hidden, n->hidden_bias, 3 * h * sizeof *from_hidden);
    add_product(from_inputs, 3 * h, n->from_input, s->inputs, (size_t)n->n_inputs);
    add_product(from_hidden, 3 * h, n->from_hidden, s->hidden, h);
    for (size_t j = 0; j < h; j++) {
        double reset = logistic(from_inputs[j] + from_hidden[j]),
               update = logistic(from_inputs[h + j] + from_hidden[h + j]);
        double candidate_preactivation = from_hidden[2 * h + j];
        double candidate = tanh(from_inputs[2 * h + j] + reset * candidate_preactivation);
        s->hidden[j] = (1 - update) * candidate + update * s->hidden[j];
    }
}

double innovation_mixture(const innovation_network *n, innovation_state *s) {
    size_t h = (size_t)n->n_hidden, width = (size_t)n->head_width, k = (size_t)n->n_components;
    double *head = s->scratch, *out = s->scratch + width, largest, sum = 0, expected = 0;
    memcpy(head, n->head_bias, width * sizeof *head);
    add_product(head, width, n->head, s->hidden, h);
    add_product(head, width, n->head + h * width, s->inputs, (size_t)n->n_inputs);
    for (size_t i = 0; i < width; i++) head[i] = tanh(head[i]);
    memcpy(out, n->out_bias, 3 * k * sizeof *out);
    add_product(out, 3 * k, n->out, head, width);
    largest = out[0];
    for (size_t i = 1; i < k; i++) largest = out[i] > largest ? out[i] : largest;
    for (size_t i = 0; i < k; i++) sum += s->weight[i] = exp(out[i] - largest);
    for (size_t i = 0; i < k; i++) {
        s->weight[i] /= sum;
        s->mean[i] = out[k + i];
        s->scale[i] = exp(FOTEN_LOG_SCALE_LIMIT * tanh(out[2 * k + i] / FOTEN_LOG_SCALE_LIMIT));
        expected += s->weight[i] * s->mean[i];
    }
    return expected;
}

static double below(double z) { return 0.5 * erfc(-z * sqrt(0.5)); }

/* Newton's method on log F, within the smallest and the largest of the components' own quantiles; the upper half by the
 * mirror image, since only small probabilities are known to many digits. */
double innovation_quantile(const innovation_network *n, const innovation_state *s, double noise) {
    double sign = noise > 0 ? -1 : 1, z = -fabs(noise), log_p = log(below(z)), low = INFINITY, high = -INFINITY, x = 0;
    for (int i = 0; i < n->n_components; i++) {
        double quantile = sign * s->mean[i] + s->scale[i] * z; /* of a component by itself */
        low = quantile < low ? quantile : low;
        high = quantile > high ? quantile : high;
        x += s->weight[i] * quantile;
    }
    for (int step = 0; step < MAX_NEWTON_STEPS; step++) {
        double share = 0, density = 0;
        for (int i = 0; i < n->n_components; i++) {
            double deviation = (x - sign * s->mean[i]) / s->scale[i];
            share += s->weight[i] * below(deviation);
            density += s->weight[i] * exp(-0.5 * deviation * deviation) / s->scale[i];
        }
        double error = log(share) - log_p, step_to = x - error * share / (density / sqrt(2 * PI));
        if (error < 0) low = x;
        else high = x;
        if (!(step_to >= low && step_to <= high)) step_to = 0.5 * (low + high);
        int converged = fabs(step_to - x) <= FOTEN_NEWTON_PRECISION * (1 + fabs(x));
        x = step_to;
        if (converged) break;
    }
    return sign * x;
}

/* The logarithm of that, where there is no number for it as well: by the first terms of its asymptotic series. */
static double log_below(double z) {
    double square = z * z;
    return z > -30 ? log(below(z))
                   : -0.5 * square - log(-z * sqrt(2 * PI)) + log1p((-1 + (3 - 15 / square) / square) / square);
}

/* The number below which lies a share of at most a half of standard normal ones, by its logarithm: from a bound that
 * log p <= -z^2 / 2 - log 2 gives, every step of Newton's method stays below the root, since the logarithm of the share
 * is concave. */
static double normal_quantile(double log_p) {
    double square = -2 * (log_p + log(2)), z = -sqrt(square > 0 ? square : 0);
    for (int step = 0; step < MAX_NEWTON_STEPS; step++) {
        double log_share = log_below(z), step_by = (log_share - log_p) * sqrt(2 * PI) * exp(log_share + 0.5 * z * z);
        z -= step_by;
        if (fabs(step_by) <= FOTEN_NEWTON_PRECISION * (1 + fabs(z))) break;
    }
    return z;
}

/* The logarithm of a sum of exponentials, a term more. */
static double log_sum(double a, double b) {
    double larger = a > b ? a : b;
    return larger == -INFINITY ? larger : larger + log1p(exp((a < b ? a : b) - larger));
}

double innovation_standardised(const innovation_network *n, const innovation_state *s, double innovation) {
    double under = -INFINITY, over = -INFINITY;
    for (int i = 0; i < n->n_components; i++) {
        double z = (innovation - s->mean[i]) / s->scale[i], share = log(s->weight[i]);
        under = log_sum(under, share + log_below(z));
        over = log_sum(over, share + log_below(-z));
    }
    return under < over ? normal_quantile(under) : -normal_quantile(over);
}

double innovation_nll(const innovation_network *n, const innovation_state *s, double innovation) {
    double largest = -INFINITY, sum = 0;
    for (int pass = 0; pass < 2; pass++)
        for (int i = 0; i < n->n_components; i++) {
            double z = (innovation - s->mean[i]) / s->scale[i],
                   term = log(s->weight[i]) - log(s->scale[i]) - 0.5 * z * z;
            if (pass) sum += exp(term - largest);
            else largest = term > largest ? term : largest;
        }
    return 0.5 * log(2 * PI) - largest - log(sum);
}

double innovation_sd(const innovation_network *n, const innovation_state *s) {
    double expected = 0, square = 0;
    for (int i = 0; i < n->n_components; i++) expected += s->weight[i] * s->mean[i];
    for (int i = 0; i < n->n_components; i++) {
        double off = s->mean[i] - expected;
        square += s->weight[i] * (off * off + s->scale[i] * s->scale[i]);
    }
    return sqrt(square);
}
