#include "predictor.h"

#include <math.h>
#include <string.h>

static size_t n_numbers(const predictor *p) { return p->window ? (size_t)p->window * (size_t)p->n_inputs + 2 : 0; }

void predictor_place(const predictor *p, predictor_state *s, block *from) {
    s->window = block_take(from, n_numbers(p), sizeof *s->window);
    s->pending = block_take(from, (size_t)p->hop, sizeof *s->pending);
}

void predictor_clear(const predictor *p, predictor_state *s) {
    memset(s->window, 0, n_numbers(p) * sizeof *s->window);
    s->n_pending = 0;
}

void predictor_fill(const predictor *p, predictor_state *s, const double scaled[2]) {
    predictor_clear(p, s);
    for (int i = 0; i < p->window; i++) predictor_push(p, s, 0, scaled);
}

void predictor_set_condition(const predictor *p, predictor_state *s, const double scaled[2]) {
    float *after = s->window + p->window * p->n_inputs, *last = after - p->n_inputs;
    for (int i = 0; i < 2; i++) {
        after[i] = (float)scaled[i];
        if (p->n_inputs > 2) last[1 + i] = (float)scaled[i];
    }
}

void predictor_push(const predictor *p, predictor_state *s, double sample, const double scaled[2]) {
    int n = p->n_inputs;
    memmove(s->window, s->window + n, (size_t)(p->window - 1) * (size_t)n * sizeof *s->window);
    float *last = s->window + (p->window - 1) * n;
    last[0] = (float)sample;
    predictor_set_condition(p, s, scaled);
    if (s->n_pending) s->n_pending--;
}

double predictor_predict(const predictor *p, predictor_state *s) {
    if (p->network) return p->isa->predict(p->network, s->window, s->scratch);
    if (!s->n_pending) {
        p->function(p->user, s->window, s->pending, p->hop);
        s->n_pending = p->hop;
    }
    double sample = s->pending[p->hop - s->n_pending];
    if (isfinite(sample)) return sample;
    s->n_pending = 1; /* which ends the hop */
    return 0;
}

void predictor_quiet(const predictor *p, predictor_state *s) {
    size_t n = n_numbers(p);
    for (size_t i = 0; i < n; i++)
        if (fabsf(s->window[i]) < 1e-30f) s->window[i] = 0;
}
