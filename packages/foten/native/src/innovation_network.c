#include "innovation_network.h"

#include <math.h>

/* Outputs that n of them are padded to. */
static size_t padded(size_t n) { return (n + PANEL - 1) / PANEL * PANEL; }

/* A matrix (outputs, inputs) of the file by panels, or a bias where inputs is 0; its outputs in blocks of `size`, each
 * padded. */
static double *panels_of(texture_file *file, arena *memory, const char *name, size_t outputs, size_t inputs,
                         size_t size) {
    size_t n = inputs ? inputs : 1;
    const double *rows = file_take(file, memory, "network.", name, (size_t[4]){outputs, inputs});
    double *panels = rows ? arena_take(memory, outputs / size * padded(size) * n, sizeof *panels) : NULL;
    for (size_t o = 0; panels && o < outputs; o++) {
        size_t at = o / size * padded(size) + o % size;
        for (size_t i = 0; i < n; i++) panels[at / PANEL * PANEL * n + i * PANEL + at % PANEL] = rows[o * n + i];
    }
    return panels;
}

int innovation_read(texture_file *file, arena *memory, int n_hidden, int head_width, int n_components,
                    const innovation_kernel *kernel, innovation_network *out) {
    size_t h = (size_t)n_hidden, width = (size_t)head_width, k = (size_t)n_components, inputs = INNOVATION_INPUTS;
    double *gate_bias, *hidden_bias;
    *out = (innovation_network){.n_hidden = n_hidden,
                                .head_width = head_width,
                                .n_components = n_components,
                                .hidden_stride = padded(h),
                                .both_stride = padded(h + inputs),
                                .head_stride = padded(width),
                                .out_stride = padded(2 * k),
                                .kernel = kernel};
    if (!(out->from_input = panels_of(file, memory, "recurrent.weight_ih_l0", 3 * h, inputs, h))) return 0;
    if (!(out->from_hidden = panels_of(file, memory, "recurrent.weight_hh_l0", 3 * h, h, h))) return 0;
    if (!(out->gate_bias = gate_bias = panels_of(file, memory, "recurrent.bias_ih_l0", 3 * h, 0, h))) return 0;
    if (!(hidden_bias = panels_of(file, memory, "recurrent.bias_hh_l0", 3 * h, 0, h))) return 0;
    for (size_t i = 0; i < 2 * padded(h); i++) gate_bias[i] += hidden_bias[i];
    out->candidate_bias = hidden_bias + 2 * padded(h);
    if (!(out->head = panels_of(file, memory, "head.weight", width, h + inputs, width))) return 0;
    if (!(out->head_bias = panels_of(file, memory, "head.bias", width, 0, width))) return 0;
    if (!(out->out = panels_of(file, memory, "out.weight", 3 * k, width, 3 * k))) return 0;
    return (out->out_bias = panels_of(file, memory, "out.bias", 3 * k, 0, 3 * k)) != NULL;
}

void innovation_place(const innovation_network *n, innovation_state *s, block *from) {
    size_t h = n->hidden_stride, recurrent = 4 * h, mixture = n->both_stride + n->head_stride + n->out_stride;
    s->hidden = block_take(from, h, sizeof *s->hidden);
    s->scratch = block_take(from, recurrent > mixture ? recurrent : mixture, sizeof *s->scratch);
}

void innovation_clear(const innovation_network *n, innovation_state *s) {
    for (size_t i = 0; i < n->hidden_stride; i++) s->hidden[i] = 0;
}

void innovation_push(const innovation_network *n, innovation_state *s, double innovation, double x,
                     const double logs[2]) {
    s->inputs[0] = asinh(innovation);
    s->inputs[1] = asinh(3 * fabs(innovation)) - 1;
    s->inputs[2] = x / 2;
    s->inputs[3] = logs[0];
    s->inputs[4] = logs[1];
    n->kernel->push(n, s);
}
