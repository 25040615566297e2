/* A stream of a model at its own rate: its state, and a sample more. All scaled. */
#pragma once

#include <math.h>

#include "model.h"

/* All that must survive a sample: this, and the arrays that it points to, which follow it in one block. Each kind of
 * loop uses its part. */
struct loop {
    condition condition;         /* of the last sample, which the next one goes by */
    lattice_state lattice;       /* foten-plus, piecewise AR */
    double sigma;                /* of the excitation at the next sample: foten-plus, networks */
    tones_state tones;           /* foten-plus */
    equaliser_state equaliser;   /* foten-plus */
    recorded_state recorded;     /* foten-plus */
    double physical[2];          /* speed [mm/s] and force [N] of the last sample, for these two */
    innovation_state innovation; /* foten-plus: of predictions */
    predictor_state predictor;   /* networks, graphs */
    mixture mixture;             /* piecewise AR */
    double *innovations;         /* piecewise AR: the last ones, the youngest first */
    int cut;                     /* whether the last sample was */
};

/* What differs between the three kinds of loops. */
struct loop_kind {
    /* Take the arrays of a loop from a block, or only measure them. */
    void (*place)(const foten_model *model, loop *l, block *from);

    /* Go on from n recorded samples (acceleration, speed, force in turn), at most the model's history: as a rendering
     * does, or, `as_prediction`, as a one-step prediction does. */
    void (*start)(const foten_model *model, loop *l, const double *windows, int n, int as_prediction);

    /* Take a state as after a long time under a condition, whatever was before, from a stream's noise. */
    void (*begin)(const foten_model *model, loop *l, const condition *c, noise_source noise);

    /* Predict the next sample, which was recorded, after a start `as_prediction`. */
    void (*predict)(const foten_model *model, loop *l, foten_prediction_part part, double recorded,
                    foten_prediction *out);

    /* Take in a recorded sample (acceleration, speed, force), after that. */
    void (*push)(const foten_model *model, loop *l, const double *sample);

    /* By how much a unit of noise moves the next sample of a rendering; 0 without an excitation. */
    double (*scale)(const foten_model *model, const loop *l);

    /* The next sample, with a number of noise or without (NULL), cut to +-limit and faded, and the condition that goes
     * with it. */
    double (*step)(const foten_model *model, loop *l, const condition *c, const double *noise, double limit);

    /* Set numbers to zero that are too small to matter, before they become denormal and slow. */
    void (*quiet)(const foten_model *model, loop *l);

    /* Put another sample in the place of the last one, and return that; NULL where all is in double, so that the
     * proof's steps leave rounding small. */
    double (*replace_last)(const foten_model *model, loop *l, double sample);
};

extern const loop_kind lattice_loop, window_loop, piecewise_ar_loop;

/* The memory of a loop, in a block of its own or, with base NULL, only measured. */
loop *loop_place(const foten_model *model, block *from);
void loop_copy(const foten_model *model, loop *to, const loop *from);

/* Whether a condition is another one for tables over speed and force than that of the last sample. */
static inline int loop_moved(const loop *l, const condition *c) {
    return c->scaled[0] != l->condition.scaled[0] || c->scaled[1] != l->condition.scaled[1];
}

/* Cut a sample; whatever the loop goes on from, what leaves it is the cut one, faded. */
static inline double loop_cut(loop *l, double sample, double limit) {
    double played = clip(sample, limit);
    l->cut = played != sample;
    return played;
}

/* Run for n samples under a condition. */
static inline void loop_run(const foten_model *model, loop *l, const condition *c, noise_source *noise, int n,
                            double limit) {
    for (int i = 0; i < n; i++) {
        double z = noise_next(noise);
        model->kind->step(model, l, c, &z, limit);
    }
}
