/* A texture file made ready: sizes, tables over the hand, the network, and the loop that a rendering begins with. */
#ifndef FOTEN_MODEL_H
#define FOTEN_MODEL_H

#include <stddef.h>

#include "arena.h"
#include "file.h"
#include "foten.h"
#include "local.h"
#include "net.h"

/* Values at the vertices of a grid, bilinear in speed and log force between them, constant outside. */
typedef struct {
    int n_speed, n_force, width;
    const double *speed_knots, *force_knots, *values; /* speed the slower index */
} plane;

/* A standard deviation over speed and force: a power law with a small network's correction of its logarithm. */
typedef struct {
    int width;
    const double *hidden, *hidden_bias, *out, *power_law; /* (width, 4), (width), (width), (5) */
    double out_bias, highest, mean[2], sd[2], floor[2];
} scale;

typedef struct {
    int order, gain_before_filter;
    plane reflections;
    scale level;
} lattice;

typedef struct loop loop;

struct foten_model {
    arena memory;
    char *name, *texture;
    int excited, history; /* whether there is a random part with a scale of its own; samples in the windows of the file */
    double rate_hz, lowpass_hz, saturation, mean[3], sd[3], low[2], high[2], exponents[2];

    const isa *isa;
    net *network;              /* of foten, foten-plus and ten */
    foten_predictor predictor; /* of a model that is run elsewhere, and what it is told of itself */
    void *predictor_user;
    int of_noise, hop;         /* whether it sees noise in the place of acceleration; samples that it gives at once */
    int n_inputs;              /* numbers of each sample that either sees */
    const local_models *local; /* of ar */
    double correction_limit;
    int network_in_loop;

    int plus;
    /* foten-plus: `whole` is the lattice of the vibration, `residual` that of what the tones leave, or the same. */
    lattice whole, residual;
    int n_tones;
    plane tones;
    double turn, unevenness, forgetting;
    scale sigma;
    double tail[5], tail_bias, largest[2], swell_kept, swell_sd;

    loop *begin; /* after the warm start */
};

/* Read and check all of a texture file but the proof. The model may have a predictor, for networks that there is no code for here. */
foten_status model_read(foten_model *model, texture_file *file, const isa *isa);

/* A plane's values at a speed [mm/s] and a force [N]: `width` of them. */
void plane_at(const plane *p, double speed, double force, double *out);

double scale_at(const scale *s, const double condition[2], double logarithms[2]);
void powers_of(const double logarithms[2], double out[5]);
void physical_of(const scale *s, const double condition[2], double out[2]);
#endif
