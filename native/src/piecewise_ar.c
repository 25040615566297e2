#include "piecewise_ar.h"

#include <math.h>
#include <string.h>

#include "clip.h"
#include "constants.h"

static const double PI = 3.14159265358979323846;
static const double FURTHEST[2] = {1e5, 1e4}, LOUDEST = 1e4; /* mm/s and N that a model may stand at; gain in standard deviations */

static double crossed(const double a[2], const double b[2]) { return a[0] * b[1] - a[1] * b[0]; }

/* Corner k of a triangle: which model it is, and where it stands in units of the scale. */
static int corner(const piecewise_ar *m, int triangle, int k, double at[2]) {
    int model = (int)m->triangles[3 * triangle + k];
    for (int i = 0; i < 2; i++) at[i] = m->points[2 * model + i] / m->scale[i];
    return model;
}

/* What each corner counts for a point: all of it, and 0 or more for each where the point lies inside. */
static void shares_of(const double corners[3][2], const double at[2], double shares[3]) {
    double first[2], second[2], away[2];
    for (int i = 0; i < 2; i++) {
        first[i] = corners[1][i] - corners[0][i];
        second[i] = corners[2][i] - corners[0][i];
        away[i] = at[i] - corners[0][i];
    }
    double area = crossed(first, second);
    shares[1] = crossed(away, second) / area;
    shares[2] = crossed(first, away) / area;
    shares[0] = 1 - shares[1] - shares[2];
}

/* Multiply a polynomial of degree n by 1 + b z^-1 + c z^-2. */
static void multiply(double *polynomial, int n, double b, double c) {
    polynomial[n + 1] = polynomial[n + 2] = 0;
    for (int i = n + 2; i > 0; i--) polynomial[i] += b * polynomial[i - 1] + (i > 1 ? c * polynomial[i - 2] : 0);
}

/* A of line spectral frequencies, 1 first. */
static void polynomial_of(const double *angles, int p, double *a) {
    double both[2][FOTEN_HIGHEST_ORDER + 4] = {{1}, {1}};
    int degrees[2] = {0, 0};
    for (int i = 0; i < p; i++) {
        multiply(both[i % 2], degrees[i % 2], -2 * cos(angles[i]), 1);
        degrees[i % 2] += 2;
    }
    if (p % 2) {
        multiply(both[1], degrees[1], 0, -1);
    } else {
        multiply(both[0], degrees[0], 1, 0);
        multiply(both[1], degrees[1], -1, 0);
    }
    for (int i = 0; i <= p; i++) a[i] = 0.5 * (both[0][i] + both[1][i]);
}

/* The reflections of a lattice, its leak included, that is 1/A; a is lost. Returns the product of their cosines. */
static double reflections_of(double *a, int p, double *reflections) {
    double leak = 1, gain = 1;
    for (int i = 1; i <= p; i++) a[i] /= leak *= FOTEN_LEAK;
    for (int i = p; i > 0; i--) {
        double k = clip(a[i], FOTEN_MAX_REFLECTION);
        double lower[FOTEN_HIGHEST_ORDER + 1];
        reflections[i - 1] = k;
        gain *= sqrt(1 - k * k);
        for (int j = 0; j < i; j++) lower[j] = (a[j] - k * a[i - j]) / (1 - k * k);
        memcpy(a, lower, (size_t)i * sizeof *a);
    }
    return gain;
}

/* Angles that rise from 0 to pi, a row of them for each model. */
static int rising(texture_file *file, const char *name, const double *angles, int rows, int n) {
    for (int row = 0; row < rows; row++)
        for (int i = 0; i <= n; i++) {
            double before = i ? angles[row * n + i - 1] : 0, after = i < n ? angles[row * n + i] : PI;
            if (!(after > before)) {
                file_refuse(file, FOTEN_BAD_FILE, "tensor 'piecewise_ar.%s' does not rise from 0 to pi: the filter would not be stable", name);
                return 0;
            }
        }
    return 1;
}

static const double *never_negative(texture_file *file, const char *name, int n, arena *memory) {
    const double *values = file_take(file, name, (size_t[]){(size_t)n, 0, 0, 0}, memory);
    for (int i = 0; values && i < n; i++)
        if (!(values[i] >= 0)) {
            file_refuse(file, FOTEN_BAD_FILE, "a local model has a negative variance or gain");
            return NULL;
        }
    return values;
}

const piecewise_ar *piecewise_ar_read(texture_file *file, int order, int ma, int n_models, int n_triangles, arena *memory) {
    piecewise_ar *m = arena_take(memory, 1, sizeof *m);
    size_t n = (size_t)n_models;
    const double *pair;
    if (!m) return NULL;
    *m = (piecewise_ar){.order = order, .ma = ma, .n_models = n_models, .n_triangles = n_triangles};
    if (!(m->points = file_take(file, "piecewise_ar.points", (size_t[]){n, 2, 0, 0}, memory))) return NULL;
    if (!(m->lsf = file_take(file, "piecewise_ar.lsf", (size_t[]){n, (size_t)order, 0, 0}, memory))) return NULL;
    if (!rising(file, "lsf", m->lsf, n_models, order)) return NULL;
    const double *variance = never_negative(file, "piecewise_ar.variance", n_models, memory), *gain = NULL;
    double *power = arena_take(memory, n, sizeof *power);
    if (!variance || !power) return NULL;
    if (ma) {
        if (!(m->ma_lsf = file_take(file, "piecewise_ar.ma_lsf", (size_t[]){n, (size_t)ma, 0, 0}, memory))) return NULL;
        if (!rising(file, "ma_lsf", m->ma_lsf, n_models, ma)) return NULL;
        if (!(gain = never_negative(file, "piecewise_ar.gain", n_models, memory))) return NULL;
    }
    for (int i = 0; i < n_models; i++) {
        double a[FOTEN_HIGHEST_ORDER + 1], reflections[FOTEN_HIGHEST_ORDER];
        polynomial_of(m->lsf + i * order, order, a);
        double before = sqrt(variance[i]) * (gain ? gain[i] : 1) / reflections_of(a, order, reflections);
        if (!(before <= LOUDEST)) {
            file_refuse(file, FOTEN_BAD_FILE, "a local model is louder than %g standard deviations", LOUDEST);
            return NULL;
        }
        power[i] = before * before;
    }
    m->power = power;
    if (!(m->triangles = file_take(file, "piecewise_ar.triangles", (size_t[]){(size_t)n_triangles, 3, 0, 0}, memory))) return NULL;
    struct {
        const char *name;
        double *to;
    } pairs[] = {{"piecewise_ar.scale", m->scale}, {"piecewise_ar.mean", m->mean}, {"piecewise_ar.sd", m->sd}};
    for (int k = 0; k < 3; k++) {
        if (!(pair = file_take(file, pairs[k].name, (size_t[]){2, 0, 0, 0}, memory))) return NULL;
        memcpy(pairs[k].to, pair, sizeof m->scale);
    }
    for (int i = 0; i < 2; i++) {
        int fits = m->scale[i] > 0 && m->scale[i] <= FURTHEST[i] && m->sd[i] > 0 && m->sd[i] <= FURTHEST[i] && fabs(m->mean[i]) <= FURTHEST[i];
        for (int k = 0; k < n_models; k++) fits &= m->points[2 * k + i] >= 0 && m->points[2 * k + i] <= FURTHEST[i];
        if (!fits) {
            file_refuse(file, FOTEN_BAD_FILE, "the local models stand at speeds or forces, or are scaled by some, that cannot be");
            return NULL;
        }
    }
    for (int t = 0; t < n_triangles; t++) {
        double at[3][2], first[2], second[2];
        for (int k = 0; k < 3; k++) {
            double model = m->triangles[3 * t + k];
            if (!(model >= 0 && model < n_models && model == floor(model))) {
                file_refuse(file, FOTEN_BAD_FILE, "a triangle of the mesh has a corner that no model is at");
                return NULL;
            }
            corner(m, t, k, at[k]);
        }
        for (int i = 0; i < 2; i++) {
            first[i] = at[1][i] - at[0][i];
            second[i] = at[2][i] - at[0][i];
        }
        if (!(fabs(crossed(first, second)) > FOTEN_LEAST_AREA)) {
            file_refuse(file, FOTEN_BAD_FILE, "a triangle of the mesh is flat: three models in a line, or two in one place");
            return NULL;
        }
    }
    return m;
}

/* Whether a point lies in a triangle, and what its corners count. */
static int inside(const piecewise_ar *m, int triangle, const double at[2], double shares[3]) {
    double corners[3][2];
    for (int k = 0; k < 3; k++) corner(m, triangle, k, corners[k]);
    shares_of(corners, at, shares);
    return shares[0] > FOTEN_INSIDE && shares[1] > FOTEN_INSIDE && shares[2] > FOTEN_INSIDE;
}

/* The triangle with the edge nearest to a point outside of all, and what its corners count at the nearest place. */
static int nearest_edge(const piecewise_ar *m, const double at[2], double shares[3]) {
    double best = INFINITY;
    int nearest = 0;
    for (int k = 0; k < 3; k++)
        for (int t = 0; t < m->n_triangles; t++) {
            double begin[2], end[2], over = 0, length = 0, distance = 0;
            corner(m, t, k, begin);
            corner(m, t, (k + 1) % 3, end);
            for (int i = 0; i < 2; i++) {
                over += (at[i] - begin[i]) * (end[i] - begin[i]);
                length += (end[i] - begin[i]) * (end[i] - begin[i]);
            }
            double share = over / length;
            share = share < 0 ? 0 : share > 1 ? 1 : share;
            for (int i = 0; i < 2; i++) {
                double off = at[i] - begin[i] - share * (end[i] - begin[i]);
                distance += off * off;
            }
            if (distance < best) {
                best = distance;
                nearest = t;
                shares[k] = 1 - share;
                shares[(k + 1) % 3] = share;
                shares[(k + 2) % 3] = 0;
            }
        }
    return nearest;
}

void piecewise_ar_at(const piecewise_ar *m, const double scaled[2], mixture *out, double *reflections) {
    int p = m->order, q = m->ma;
    double at[2], shares[3], angles[FOTEN_HIGHEST_ORDER] = {0}, a[FOTEN_HIGHEST_ORDER + 1], sum = 0, power = 0;
    for (int i = 0; i < 2; i++) {
        double physical = scaled[i] * m->sd[i] + m->mean[i];
        at[i] = (physical > 0 ? physical : 0) / m->scale[i];
    }
    if (!inside(m, out->triangle, at, shares)) {
        int t = 0;
        while (t < m->n_triangles && !inside(m, t, at, shares)) t++;
        out->triangle = t < m->n_triangles ? t : nearest_edge(m, at, shares);
    }
    int models[3];
    for (int k = 0; k < 3; k++) {
        models[k] = (int)m->triangles[3 * out->triangle + k];
        shares[k] = shares[k] > 0 ? shares[k] : 0;
        sum += shares[k];
    }
    for (int k = 0; k < 3; k++) shares[k] /= sum;
    for (int i = 0; i < p; i++)
        for (int k = 0; k < 3; k++) angles[i] += shares[k] * m->lsf[models[k] * p + i];
    polynomial_of(angles, p, a);
    reflections_of(a, p, reflections);
    for (int k = 0; k < 3; k++) power += shares[k] * m->power[models[k]];
    out->gain = sqrt(power);
    if (!q) return;
    for (int i = 0; i < q; i++) {
        angles[i] = 0;
        for (int k = 0; k < 3; k++) angles[i] += shares[k] * m->ma_lsf[models[k] * q + i];
    }
    polynomial_of(angles, q, a);
    memcpy(out->zeros, a + 1, (size_t)q * sizeof *a);
}
