#include "predictor.h"

#include <math.h>
#include <string.h>

enum { NOISE = 3 }; /* its place among the numbers of a sample */

static size_t n_numbers(const predictor *p) { return p->window ? (size_t)p->window * (size_t)p->n_inputs + 2 : 0; }

void predictor_place(const predictor *p, predictor_state *s, block *from) {
    s->window = block_take(from, n_numbers(p), sizeof *s->window);
}

void predictor_clear(const predictor *p, predictor_state *s) { memset(s->window, 0, n_numbers(p) * sizeof *s->window); }

void predictor_take_noise(const predictor *p, predictor_state *s, noise_source *noise) {
    for (int i = 0; p->n_inputs > NOISE && i < p->window; i++)
        s->window[i * p->n_inputs + NOISE] = (float)noise_next(noise);
}

void predictor_set_condition(const predictor *p, predictor_state *s, const double scaled[2]) {
    float *after = s->window + p->window * p->n_inputs, *last = after - p->n_inputs;
    for (int i = 0; i < 2; i++) {
        after[i] = (float)scaled[i];
        if (p->n_inputs > 1) last[1 + i] = (float)scaled[i];
    }
}

void predictor_push(const predictor *p, predictor_state *s, double sample, const double scaled[2], double noise) {
    int n = p->n_inputs;
    memmove(s->window, s->window + n, (size_t)(p->window - 1) * (size_t)n * sizeof *s->window);
    float *last = s->window + (p->window - 1) * n;
    last[0] = (float)sample;
    if (n > NOISE) last[NOISE] = (float)noise;
    predictor_set_condition(p, s, scaled);
}

double predictor_replace_last(const predictor *p, predictor_state *s, double sample) {
    float *last = s->window + (p->window - 1) * p->n_inputs;
    double before = *last;
    *last = (float)sample;
    return before;
}

double predictor_predict(const predictor *p, predictor_state *s) {
    if (p->network) return p->isa->predict(p->network, s->window, s->scratch);
    double sample = p->function(p->user, s->window);
    return isfinite(sample) ? sample : 0;
}

void predictor_quiet(const predictor *p, predictor_state *s) {
    size_t n = n_numbers(p);
    for (size_t i = 0; i < n; i++)
        if (fabsf(s->window[i]) < 1e-30f) s->window[i] = 0;
}
