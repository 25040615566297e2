/* Recorded innovations that are played back: see foten.models.foten_plus.recorded_innovations. */
#pragma once

#include "innovation_network.h"

enum { RECORDED_FEATURES = 6, MAX_GROWTH = FOTEN_N_GROWTH };

typedef struct {
    int used, along_path, step, n_moments, n_candidates, n_fade;
    const double *values;                  /* of the 256 codes */
    const unsigned char *codes, *moments;  /* (n_moments, step) and (n_moments, 5) */
    int32_t *run_end, *candidates;         /* of each moment; which moments are candidates */
    int16_t *features[RECORDED_FEATURES];  /* of candidates */
    double *taps, *fade_in, *fade_out;     /* (phases, taps), (n_fade) */
    uint32_t pace[2 * FOTEN_MAX_PACE + 1]; /* of a difference of log speed */
    const innovation_kernel *kernel;
} recorded_innovations;

/* Of one stream. */
typedef struct {
    double next;                      /* innovation over sigma of the next sample */
    int64_t place, previous;          /* in the recording, in 1/65536 sample; -1 for none */
    int64_t pace, previous_pace;      /* of each, in a sample */
    int n_faded, tick;                /* samples of the fade that were played, and since the last decision */
    int age, length;                  /* of the stretch, in decisions */
    int n_history;                    /* decisions so far, as many as count */
    int32_t history[MAX_GROWTH][2];   /* log speed and log force at the last decisions, in a ring */
    int first_excluded, end_excluded; /* moments that are no candidates, while training judges its own */
} recorded_state;

/* `step`: samples between decisions at the texture's rate. */
int recorded_read(texture_file *file, arena *memory, int step, int along_path, const innovation_kernel *kernel,
                  recorded_innovations *out);

/* Begin without a stretch, and make the first innovation ready. */
void recorded_begin(const recorded_innovations *r, recorded_state *s, const double physical[2], const double *noise);

/* Make the next innovation ready, under a speed [mm/s] and force [N], from a number of noise or none. */
void recorded_advance(const recorded_innovations *r, recorded_state *s, const double physical[2], const double *noise);
