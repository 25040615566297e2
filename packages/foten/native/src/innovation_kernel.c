/* The layers of the innovation network for one instruction set: compiled once for each, by definitions of KERNEL, its
 * name, and LANES, the floats in a vector.
 *
 * Vectors lie along outputs, products are not contracted, and what is summed is summed in one order, whatever their
 * width: every instruction set gives the same bits. */
#include "doubles.h"
#include "innovation_network.h"

enum { PART = 4 * WIDTH < PANEL ? 4 * WIDTH : PANEL }; /* outputs of a panel whose sums stay in registers at once */

/* out = start + panels x. Inputs of even and of odd place are summed apart: half as long a chain. */
static void product(double *out, const double *start, const double *panels, size_t outputs, const double *x,
                    size_t inputs) {
    for (size_t o = 0; o < outputs; o += PART) {
        const double *weights = panels + o / PANEL * PANEL * inputs + o % PANEL;
        vec even[PART / WIDTH], odd[PART / WIDTH];
        const vec zero = {0};
        size_t i = 0;
        for (int k = 0; k < PART / WIDTH; k++) {
            even[k] = load(start + o + k * WIDTH);
            odd[k] = zero;
        }
        for (; i + 2 <= inputs; i += 2, weights += 2 * PANEL)
            for (int k = 0; k < PART / WIDTH; k++) {
                even[k] += load(weights + k * WIDTH) * x[i];
                odd[k] += load(weights + PANEL + k * WIDTH) * x[i + 1];
            }
        for (int k = 0; k < PART / WIDTH; k++) {
            if (i < inputs) even[k] += load(weights + k * WIDTH) * x[i];
            store(out + o + k * WIDTH, even[k] + odd[k]);
        }
    }
}

static void push(const innovation_network *n, innovation_state *s) {
    size_t h = n->hidden_stride, hidden = (size_t)n->n_hidden;
    double *gates = s->scratch, *candidates = s->scratch + 3 * h;
    product(gates, n->gate_bias, n->from_input, 3 * h, s->inputs, INNOVATION_INPUTS);
    product(gates, gates, n->from_hidden, 2 * h, s->hidden, hidden);
    product(candidates, n->candidate_bias, n->from_hidden + 2 * h * hidden, h, s->hidden, hidden);
    for (size_t i = 0; i < 2 * h; i += WIDTH) store(gates + i, logistic(load(gates + i))); /* none waits for another */
    for (size_t i = 0; i < h; i += WIDTH) {
        vec reset = load(gates + i), update = load(gates + h + i), candidate_preactivation = load(candidates + i);
        vec candidate = tanh_of(load(gates + 2 * h + i) + reset * candidate_preactivation);
        store(s->hidden + i, (1.0 - update) * candidate + update * load(s->hidden + i));
    }
}

static double expected(const innovation_network *n, innovation_state *s) {
    size_t width = n->head_stride, hidden = (size_t)n->n_hidden, components = (size_t)n->n_components;
    double *both = s->scratch, *head = both + n->both_stride, *out = head + width, largest, sum = 0, weighted = 0;
    const vec zero = {0};
    memcpy(both, s->hidden, hidden * sizeof *both);
    memcpy(both + hidden, s->inputs, sizeof s->inputs);
    product(head, n->head_bias, n->head, width, both, hidden + INNOVATION_INPUTS);
    for (size_t i = 0; i < width; i += WIDTH) store(head + i, tanh_of(load(head + i)));
    product(out, n->out_bias, n->out, n->out_stride, head, (size_t)n->head_width);
    largest = out[0];
    for (size_t i = 1; i < components; i++) largest = out[i] > largest ? out[i] : largest;
    for (size_t i = 0; i < components; i++) {
        double weight = exp_of(zero + (out[i] - largest))[0];
        sum += weight;
        weighted += weight * out[components + i];
    }
    return weighted / sum;
}

static void distances(const int16_t *const features[6], int first, int n, const int32_t *query, const int32_t *weights,
                      int32_t *out) {
    enum { LARGEST = FOTEN_MAX_DIFFERENCE };
    for (int k = 0; k < 6; k++) {
        const int16_t *feature = features[k] + first;
        int32_t q = query[k], weight = weights[k];
        for (int i = 0; i < n; i++) {
            int32_t d = (feature[i] - q) * weight;
            d = d > LARGEST ? LARGEST : d < -LARGEST ? -LARGEST : d;
            out[i] = (k ? out[i] : 0) + d * d;
        }
    }
}

#define NAMED(name) innovation_##name
#define FOR(name) const innovation_kernel NAMED(name) = {push, expected, distances};
FOR(KERNEL)
