/* Piecewise AR: local linear models scattered over speed and force, mixed between the three around a condition. As
 * foten.models.piecewise_ar.definition says. */
#pragma once

#include "file.h"

typedef struct {
    int order, ma, n_models, n_triangles;
    const double *points, *lsf, *ma_lsf, *power,
        *triangles; /* a model a row; power: the gain squared; ma_lsf NULL for none */
    double scale[2], mean[2], sd[2];
} piecewise_ar;

/* What a condition makes of them, beside reflection coefficients: b_1 ... b_ma, and the gain before the lattice. */
typedef struct {
    double *zeros, gain;
    int triangle; /* that the condition was last in, where the next one probably is */
} mixture;

/* Read and check the models of a file; NULL, and a reason in the file, where they do not fit. */
const piecewise_ar *piecewise_ar_read(texture_file *file, int order, int ma, int n_models, int n_triangles,
                                      arena *memory);

/* Mix them for a speed and a force, scaled. */
void piecewise_ar_at(const piecewise_ar *models, const double scaled[2], mixture *out, double *reflections);
