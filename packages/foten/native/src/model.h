/* A texture file made ready: what every kind of model has, the parts of each kind, and the loop that a rendering begins
 * with. */
#pragma once

#include "equaliser.h"
#include "excitation.h"
#include "innovation_network.h"
#include "lattice.h"
#include "piecewise_ar.h"
#include "predictor.h"
#include "recorded.h"
#include "tones.h"

typedef struct loop loop;
typedef struct loop_kind loop_kind;

struct foten_model {
    arena memory;
    char *name, *texture;
    int history; /* samples in the windows of the file */
    double rate_hz, lowpass_hz, saturation, mean[3], sd[3], low[2], high[2], exponents[2]; /* as the card has them */

    const loop_kind *kind;
    int excited;     /* whether there is a random part with a scale of its own */
    int takes_noise; /* whether somebody else's function predicts, which is given noise as well */

    predictor predictor;   /* of networks and graphs */
    excitation excitation; /* of foten-plus, and of a network that has one */

    /* Of foten-plus: lattice and network that predict the vibration, the lattice of what tones leave, and which of both
     * lattices a rendering excites. */
    lattice lattice, residual;
    innovation_network network;
    const struct lattice *excited_lattice;
    tones tones;
    equaliser equaliser;
    recorded_innovations recorded;
    int warm_up; /* samples that the network takes in before it is asked */

    const piecewise_ar *piecewise_ar; /* of piecewise AR */

    loop *begin; /* after the warm start */
};

/* Read and check all of a texture file but the proof. The function, for graphs, may be NULL. */
int model_read(foten_model *model, texture_file *file, const isa *isa, foten_predictor function, void *user);

/* Replay the golden windows of a file that was read, and keep the loop that renderings begin with. */
int model_prove(foten_model *model, texture_file *file);

static inline int model_is_random(const foten_model *m) { return m->excited || m->takes_noise; }
