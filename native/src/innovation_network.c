#include "innovation_network.h"

#include <math.h>

#include "constants.h"
#include "doubles.h"

enum { MAX_NEWTON_STEPS = FOTEN_MAX_NEWTON_STEPS };

/* Outputs that n of them are padded to. */
static size_t padded(size_t n) { return (n + PANEL - 1) / PANEL * PANEL; }

/* A matrix (outputs, inputs) of the file by panels, or a bias where inputs is 0; its outputs in blocks of `size`, each
 * padded. */
static double *panels_of(texture_file *file, arena *memory, const char *prefix, const char *name, size_t outputs,
                         size_t inputs, size_t size) {
    size_t n = inputs ? inputs : 1;
    const double *rows = file_take(file, memory, prefix, name, (size_t[4]){outputs, inputs});
    double *panels = rows ? arena_take(memory, outputs / size * padded(size) * n, sizeof *panels) : NULL;
    for (size_t o = 0; panels && o < outputs; o++) {
        size_t at = o / size * padded(size) + o % size;
        for (size_t i = 0; i < n; i++) panels[at / PANEL * PANEL * n + i * PANEL + at % PANEL] = rows[o * n + i];
    }
    return panels;
}

int innovation_read(texture_file *file, arena *memory, const char *prefix, int n_inputs, int n_hidden, int head_width,
                    int n_components, const innovation_kernel *kernel, innovation_network *out) {
    size_t h = (size_t)n_hidden, width = (size_t)head_width, k = (size_t)n_components, inputs = (size_t)n_inputs;
    double *gate_bias, *hidden_bias;
    *out = (innovation_network){.n_inputs = n_inputs,
                                .n_hidden = n_hidden,
                                .head_width = head_width,
                                .n_components = n_components,
                                .hidden_stride = padded(h),
                                .both_stride = padded(h + INNOVATION_INPUTS + PHASE_INPUTS),
                                .head_stride = padded(width),
                                .out_stride = padded(3 * k),
                                .kernel = kernel};
    if (!(out->from_input = panels_of(file, memory, prefix, "recurrent.weight_ih_l0", 3 * h, inputs, h))) return 0;
    if (!(out->from_hidden = panels_of(file, memory, prefix, "recurrent.weight_hh_l0", 3 * h, h, h))) return 0;
    if (!(out->gate_bias = gate_bias = panels_of(file, memory, prefix, "recurrent.bias_ih_l0", 3 * h, 0, h))) return 0;
    if (!(hidden_bias = panels_of(file, memory, prefix, "recurrent.bias_hh_l0", 3 * h, 0, h))) return 0;
    for (size_t i = 0; i < 2 * padded(h); i++) gate_bias[i] += hidden_bias[i];
    out->candidate_bias = hidden_bias + 2 * padded(h);
    if (!(out->head = panels_of(file, memory, prefix, "head.weight", width, h + inputs, width))) return 0;
    if (!(out->head_bias = panels_of(file, memory, prefix, "head.bias", width, 0, width))) return 0;
    if (!(out->out = panels_of(file, memory, prefix, "out.weight", 3 * k, width, 3 * k))) return 0;
    return (out->out_bias = panels_of(file, memory, prefix, "out.bias", 3 * k, 0, 3 * k)) != NULL;
}

void innovation_place(const innovation_network *n, innovation_state *s, block *from) {
    size_t h = n->hidden_stride, k = padded((size_t)n->n_components), recurrent = 4 * h,
           mixture = n->both_stride + n->head_stride + n->out_stride;
    s->hidden = block_take(from, h, sizeof *s->hidden);
    s->weight = block_take(from, k, sizeof *s->weight);
    s->mean = block_take(from, k, sizeof *s->mean);
    s->scale = block_take(from, k, sizeof *s->scale);
    s->scratch = block_take(from, recurrent > mixture ? recurrent : mixture, sizeof *s->scratch);
}

static void set_inputs(const innovation_network *n, innovation_state *s, double innovation, double x,
                       const double logs[2], double phase) {
    s->inputs[0] = asinh(innovation);
    s->inputs[1] = asinh(3 * fabs(innovation)) - 1;
    s->inputs[2] = x / 2;
    s->inputs[3] = logs[0];
    s->inputs[4] = logs[1];
    if (n->n_inputs == INNOVATION_INPUTS) return;
    double *phased = s->inputs + INNOVATION_INPUTS, cosine = cos(phase), sine = sin(phase);
    phased[0] = cosine;
    phased[1] = sine;
    phased[2] = cosine * cosine - sine * sine;
    phased[3] = 2 * sine * cosine;
}

void innovation_clear(const innovation_network *n, innovation_state *s, const double logs[2], double phase) {
    for (size_t i = 0; i < n->hidden_stride; i++) s->hidden[i] = 0;
    set_inputs(n, s, 0, 0, logs, phase);
}

void innovation_push(const innovation_network *n, innovation_state *s, double innovation, double x,
                     const double logs[2], double phase) {
    set_inputs(n, s, innovation, x, logs, phase);
    n->kernel->push(n, s);
}

double innovation_mixture(const innovation_network *n, innovation_state *s) {
    double expected = 0;
    n->kernel->mixture(n, s);
    for (int i = 0; i < n->n_components; i++) expected += s->weight[i] * s->mean[i];
    return expected;
}

static double below(double z) { return 0.5 * erfc(-z * sqrt(0.5)); }

/* Newton's method on log F, within the smallest and the largest of the components' own quantiles; the upper half by the
 * mirror image, since only small probabilities are known to many digits. */
double innovation_quantile(const innovation_network *n, const innovation_state *s, double noise) {
    double sign = noise > 0 ? -1 : 1, z = -fabs(noise), p = below(z), low = INFINITY, high = -INFINITY, x = 0,
           narrowest = INFINITY;
    for (int i = 0; i < n->n_components; i++) {
        double quantile = sign * s->mean[i] + s->scale[i] * z; /* of a component by itself */
        low = quantile < low ? quantile : low;
        high = quantile > high ? quantile : high;
        narrowest = s->scale[i] < narrowest ? s->scale[i] : narrowest;
        x += s->weight[i] * quantile;
    }
    for (int step = 0; step < MAX_NEWTON_STEPS; step++) {
        vec shares = {0}, densities = {0}; /* of two numbers, in this file */
        for (int i = 0; i < n->n_components; i += WIDTH) {
            vec deviation = (x - sign * load(s->mean + i)) / load(s->scale + i), of_normal = {0};
            for (int k = 0; k < WIDTH; k++) of_normal[k] = below(deviation[k]);
            shares += load(s->weight + i) * of_normal;
            densities += load(s->weight + i) * exp_of(-0.5 * deviation * deviation) / load(s->scale + i);
        }
        double share = shares[0] + shares[1], density = densities[0] + densities[1], error = log(share / p),
               step_to = x - error * share / (density / sqrt(2 * PI));
        if (error < 0) low = x;
        else high = x;
        if (!(step_to >= low && step_to <= high)) step_to = 0.5 * (low + high);
        int converged = fabs(step_to - x) <= FOTEN_NEWTON_PRECISION * narrowest;
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
