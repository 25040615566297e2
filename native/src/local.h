/* Piecewise AR: local linear models scattered over speed and force, mixed between the three around a hand. As foten.render.ar says. */
#ifndef FOTEN_LOCAL_H
#define FOTEN_LOCAL_H

#include "arena.h"
#include "file.h"

enum { HIGHEST_LOCAL_ORDER = 40 };

typedef struct {
    int order, ma, n_models, n_triangles;
    const double *points, *lsf, *ma_lsf, *power, *triangles; /* a model a row; power: of what drives it; ma_lsf NULL for none */
    double scale[2], mean[2], sd[2];
} local_models;

/* What a hand makes of them: reflections, b_1 ... b_q, and what an innovation of unit variance drives the lattice with. */
typedef struct {
    double *reflections, *zeros, drive;
    int triangle; /* that the hand was last in, where the next one probably is */
} local_mixture;

/* Read and check the models of a file; NULL, and a reason in the file, where they do not fit. */
const local_models *local_make(texture_file *file, int order, int ma, int n_models, int n_triangles, arena *memory);

/* Mix them for a speed and a force, scaled. */
void local_at(const local_models *models, const double condition[2], local_mixture *out);
#endif
