/* What a texture file's card says, checked. */
#pragma once

#include "model.h"

enum {
    CARD_TEN = 1,
    CARD_FOTEN = 2,
    CARD_PLUS = 4,
    CARD_AR = 8,
    CARD_GRAPH = 16,
    CARD_NETWORKS = CARD_TEN | CARD_FOTEN
};

/* All that a card may say of a model's sizes. */
typedef struct {
    network_sizes network;
    int model; /* one of the above */
    int excitation_width, order, n_speed, n_force, n_tones, n_tone_speed, n_tone_force, residual_order,
        n_residual_speed, n_residual_force;
    int n_hidden, head_width, n_components;
    int excitation, gain_before_filter, residual_gain_before_filter, equalised, recorded, along_path;
    int ma, n_models, n_triangles;
} card_sizes;

/* The format version and the sizes; `has_function`: whether somebody else's function runs graphs. */
int card_read_sizes(texture_file *file, int has_function, card_sizes *sizes);

/* Everything else, into the model. */
int card_read(foten_model *model, texture_file *file, const card_sizes *sizes);
