/* Piecewise AR: local linear models scattered over speed and force, mixed between the three around a hand. As foten.render.ar says. */
#ifndef FOTEN_LOCAL_H
#define FOTEN_LOCAL_H

#include "arena.h"
#include "file.h"

enum { HIGHEST_LOCAL_ORDER = 40 };

typedef struct {
    int order, ma, n_models, n_triangles;
    const double *points, *lsf, *ma_lsf, *variance, *gain, *triangles; /* a model a row; the 4th and 5th NULL for none and 1 */
    double scale[2], mean[2], sd[2];
} local_models;

/* What a hand makes of them: reflections, b_1 ... b_q, the innovations' standard deviation and their gain. */
typedef struct {
    double *reflections, *zeros, root, gain;
    int triangle; /* that the hand was last in, where the next one probably is */
} local_mixture;

/* Read and check the models of a file; NULL, and a reason in the file, where they do not fit. */
const local_models *local_make(texture_file *file, int order, int ma, int n_models, int n_triangles, arena *memory);

/* Mix them for a speed and a force, scaled. */
void local_at(const local_models *models, const double condition[2], local_mixture *out);
#endif
