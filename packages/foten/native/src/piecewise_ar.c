#include "piecewise_ar.h"

#include <math.h>
#include <string.h>

#include "constants.h"

static const double FURTHEST[2] = {1e5, 1e4},
                    LOUDEST = 1e4; /* mm/s and N that a model may stand at; gain in standard deviations */

static const char PREFIX[] = "piecewise_ar.";

/* Twice the area of the triangle from a point to two others, negative on the other side. */
static double crossed(const double from[2], const double a[2], const double b[2]) {
    return (a[0] - from[0]) * (b[1] - from[1]) - (a[1] - from[1]) * (b[0] - from[0]);
}

/* Where the model at corner k of a triangle stands, in units of the scale. */
static void corner(const piecewise_ar *m, int triangle, int k, double at[2]) {
    int model = (int)m->triangles[3 * triangle + k];
    for (int i = 0; i < 2; i++) at[i] = m->points[2 * model + i] / m->scale[i];
}

/* Multiply a polynomial of degree n by 1 + b z^-1 + c z^-2. */
static void multiply(double *polynomial, int n, double b, double c) {
    polynomial[n + 1] = polynomial[n + 2] = 0;
    for (int i = n + 2; i > 0; i--) polynomial[i] += b * polynomial[i - 1] + (i > 1 ? c * polynomial[i - 2] : 0);
}

/* A of line spectral frequencies, 1 first. */
static void polynomial_of(const double *angles, int p, double *a) {
    double both[2][FOTEN_MAX_AR_ORDER + 4] = {{1}, {1}};
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
        double lower[FOTEN_MAX_AR_ORDER + 1];
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
            if (!(after > before))
                return file_refuse(
                    file, FOTEN_BAD_FILE,
                    "tensor 'piecewise_ar.%s' does not rise from 0 to pi: the filter would not be stable", name);
        }
    return 1;
}

static const double *never_negative(texture_file *file, const char *name, size_t n, arena *memory) {
    const double *values = file_take(file, memory, PREFIX, name, (size_t[4]){n});
    for (size_t i = 0; values && i < n; i++)
        if (!(values[i] >= 0)) file_refuse(file, FOTEN_BAD_FILE, "a local model has a negative variance or gain");
    return file->status == FOTEN_OK ? values : NULL;
}

/* The squares of the gains before the lattices, from the variances and, with zeros, the gains of the file. */
static int read_powers(texture_file *file, piecewise_ar *m, arena *memory) {
    size_t n = (size_t)m->n_models;
    const double *variance = never_negative(file, "variance", n, memory), *gain = NULL;
    double *power = arena_take(memory, n, sizeof *power);
    if (!variance || !power) return 0;
    if (m->ma) {
        if (!(m->ma_lsf = file_take(file, memory, PREFIX, "ma_lsf", (size_t[4]){n, (size_t)m->ma}))) return 0;
        if (!rising(file, "ma_lsf", m->ma_lsf, m->n_models, m->ma) || !(gain = never_negative(file, "gain", n, memory)))
            return 0;
    }
    for (size_t i = 0; i < n; i++) {
        double a[FOTEN_MAX_AR_ORDER + 1], reflections[FOTEN_MAX_AR_ORDER];
        polynomial_of(m->lsf + i * (size_t)m->order, m->order, a);
        double before = sqrt(variance[i]) * (gain ? gain[i] : 1) / reflections_of(a, m->order, reflections);
        if (!(before <= LOUDEST))
            return file_refuse(file, FOTEN_BAD_FILE, "a local model is louder than %g standard deviations", LOUDEST);
        power[i] = before * before;
    }
    m->power = power;
    return 1;
}

/* Whether models stand, and are scaled, where speed and force can be. */
static int near(const piecewise_ar *m) {
    int fits = 1;
    for (int i = 0; i < 2; i++) {
        fits &= m->scale[i] > 0 && m->scale[i] <= FURTHEST[i] && m->sd[i] > 0 && m->sd[i] <= FURTHEST[i] &&
                fabs(m->mean[i]) <= FURTHEST[i];
        for (int k = 0; k < m->n_models; k++) fits &= m->points[2 * k + i] >= 0 && m->points[2 * k + i] <= FURTHEST[i];
    }
    return fits;
}

static int check_triangle(texture_file *file, const piecewise_ar *m, int triangle) {
    double corners[3][2];
    for (int k = 0; k < 3; k++) {
        double model = m->triangles[3 * triangle + k];
        if (!(model >= 0 && model < m->n_models && model == floor(model)))
            return file_refuse(file, FOTEN_BAD_FILE, "a triangle of the mesh has a corner that no model is at");
        corner(m, triangle, k, corners[k]);
    }
    if (fabs(crossed(corners[0], corners[1], corners[2])) > FOTEN_MIN_TRIANGLE_AREA) return 1;
    return file_refuse(file, FOTEN_BAD_FILE,
                       "a triangle of the mesh is flat: three models in a line, or two in one place");
}

const piecewise_ar *piecewise_ar_read(texture_file *file, int order, int ma, int n_models, int n_triangles,
                                      arena *memory) {
    piecewise_ar *m = arena_take(memory, 1, sizeof *m);
    size_t n = (size_t)n_models;
    if (!m) return NULL;
    *m = (piecewise_ar){.order = order, .ma = ma, .n_models = n_models, .n_triangles = n_triangles};
    if (!(m->points = file_take(file, memory, PREFIX, "points", (size_t[4]){n, 2}))) return NULL;
    if (!(m->lsf = file_take(file, memory, PREFIX, "lsf", (size_t[4]){n, (size_t)order}))) return NULL;
    if (!rising(file, "lsf", m->lsf, n_models, order) || !read_powers(file, m, memory)) return NULL;
    if (!(m->triangles = file_take(file, memory, PREFIX, "triangles", (size_t[4]){(size_t)n_triangles, 3})))
        return NULL;
    if (!file_copy(file, PREFIX, "scale", (size_t[4]){2}, m->scale) ||
        !file_copy(file, PREFIX, "mean", (size_t[4]){2}, m->mean))
        return NULL;
    if (!file_copy(file, PREFIX, "sd", (size_t[4]){2}, m->sd)) return NULL;
    if (!near(m))
        file_refuse(file, FOTEN_BAD_FILE,
                    "the local models stand at speeds or forces, or are scaled by some, that cannot be");
    for (int t = 0; t < n_triangles && file->status == FOTEN_OK; t++) check_triangle(file, m, t);
    return file->status == FOTEN_OK ? m : NULL;
}

/* Whether a point lies in a triangle, and what its corners count for it. */
static int inside(const piecewise_ar *m, int triangle, const double at[2], double shares[3]) {
    double corners[3][2];
    for (int k = 0; k < 3; k++) corner(m, triangle, k, corners[k]);
    double area = crossed(corners[0], corners[1], corners[2]);
    shares[1] = crossed(corners[0], at, corners[2]) / area;
    shares[2] = crossed(corners[0], corners[1], at) / area;
    shares[0] = 1 - shares[1] - shares[2];
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
            if (!(distance < best)) continue;
            best = distance;
            nearest = t;
            shares[k] = 1 - share;
            shares[(k + 1) % 3] = share;
            shares[(k + 2) % 3] = 0;
        }
    return nearest;
}

/* A of the line spectral frequencies between those of three models. */
static void mix(const double *lsf, int n, const int models[3], const double shares[3], double *a) {
    double angles[FOTEN_MAX_AR_ORDER] = {0};
    for (int i = 0; i < n; i++)
        for (int k = 0; k < 3; k++) angles[i] += shares[k] * lsf[models[k] * n + i];
    polynomial_of(angles, n, a);
}

void piecewise_ar_at(const piecewise_ar *m, const double scaled[2], mixture *out, double *reflections) {
    double at[2], shares[3], a[FOTEN_MAX_AR_ORDER + 1], sum = 0, power = 0;
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
    for (int k = 0; k < 3; k++) power += shares[k] * m->power[models[k]];
    out->gain = sqrt(power);
    mix(m->lsf, m->order, models, shares, a);
    reflections_of(a, m->order, reflections);
    if (!m->ma) return;
    mix(m->ma_lsf, m->ma, models, shares, a);
    memcpy(out->zeros, a + 1, (size_t)m->ma * sizeof *a);
}
