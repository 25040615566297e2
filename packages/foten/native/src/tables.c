#include "tables.h"

#include <math.h>

#include "constants.h"
#include "doubles.h"

enum { MAX_VERTICES = 1 << 28, CHUNK = 8 };

int speed_force_table_read(texture_file *file, arena *memory, const char *prefix, const char *values, int n_speed,
                           int n_force, int width, speed_force_table *out) {
    long long vertices = (long long)n_speed * n_force;
    *out = (speed_force_table){.n_speed = n_speed, .n_force = n_force, .width = width};
    if (vertices > MAX_VERTICES) return file_refuse(file, FOTEN_BAD_FILE, "the card has more vertices than can be");
    if (!(out->speed_knots = file_take(file, memory, prefix, "speed_knots", (size_t[4]){(size_t)n_speed}))) return 0;
    if (!(out->force_knots = file_take(file, memory, prefix, "force_knots", (size_t[4]){(size_t)n_force}))) return 0;
    if (!(out->values = file_take(file, memory, prefix, values, (size_t[4]){(size_t)vertices, (size_t)width})))
        return 0;
    for (int i = 0; i < 2; i++) {
        const double *knots = i ? out->force_knots : out->speed_knots;
        for (int k = 1; k < (i ? n_force : n_speed); k++)
            if (!(knots[k] > knots[k - 1]))
                return file_refuse(file, FOTEN_BAD_FILE, "the knots of speed or force do not rise");
    }
    return 1;
}

/* The knot at or below which a value lies, and its share of the next one. */
static int knot_at(const double *knots, int n, double value, double *share) {
    *share = 0;
    if (n == 1 || value <= knots[0]) return 0;
    if (value >= knots[n - 1]) {
        *share = 1;
        return n - 2;
    }
    int low = 0, high = n - 1;
    while (high - low > 1) {
        int middle = (low + high) / 2;
        if (knots[middle] <= value) low = middle;
        else high = middle;
    }
    *share = (value - knots[low]) / (knots[low + 1] - knots[low]);
    return low;
}

void speed_force_table_at(const speed_force_table *t, double speed, double force, double *out) {
    double over_speed, over_force;
    int i = knot_at(t->speed_knots, t->n_speed, speed, &over_speed);
    int j = knot_at(t->force_knots, t->n_force, log((force > 0 ? force : 0) + FOTEN_FORCE_FLOOR), &over_force);
    size_t width = (size_t)t->width, row = (size_t)t->n_force * width;
    const double *a = t->values + (size_t)i * row + (size_t)j * width, *b = t->n_force > 1 ? a + width : a;
    const double *c = t->n_speed > 1 ? a + row : a, *d = t->n_speed > 1 ? b + row : b;
    double wa = (1 - over_speed) * (1 - over_force), wb = (1 - over_speed) * over_force;
    double wc = over_speed * (1 - over_force), wd = over_speed * over_force;
    if (t->n_speed * t->n_force == 1)
        for (size_t k = 0; k < width; k++) out[k] = a[k];
    else
        for (size_t k = 0; k < width; k++) out[k] = wa * a[k] + wb * b[k] + wc * c[k] + wd * d[k];
}

int scale_read(texture_file *file, arena *memory, const char *prefix, int width, scale *out) {
    out->width = width;
    if (!(out->hidden = file_take(file, memory, prefix, "hidden.weight", (size_t[4]){(size_t)width, 4}))) return 0;
    if (!(out->hidden_bias = file_take(file, memory, prefix, "hidden.bias", (size_t[4]){(size_t)width}))) return 0;
    if (!(out->out = file_take(file, memory, prefix, "out.weight", (size_t[4]){1, (size_t)width}))) return 0;
    if (!file_copy(file, prefix, "out.bias", (size_t[4]){1}, &out->out_bias)) return 0;
    if (!file_copy(file, prefix, "exponents", (size_t[4]){5}, out->exponents)) return 0;
    if (!file_copy(file, prefix, "sigma_max", (size_t[4]){1}, &out->sigma_max) ||
        !file_copy(file, prefix, "mean", (size_t[4]){2}, out->mean))
        return 0;
    if (!file_copy(file, prefix, "sd", (size_t[4]){2}, out->sd) ||
        !file_copy(file, prefix, "floor", (size_t[4]){2}, out->floor))
        return 0;
    if (!(out->sigma_max > 0)) return file_refuse(file, FOTEN_BAD_FILE, "tensor '%ssigma_max' is not positive", prefix);
    for (int i = 0; i < 2; i++)
        if (!(out->floor[i] > 0 && out->mean[i] + out->floor[i] > 0))
            return file_refuse(file, FOTEN_BAD_FILE, "tensor '%sfloor' is not positive", prefix);
    return 1;
}

double scale_at(const scale *s, const double scaled[2], double logs[2]) {
    double physical[2], powers[5];
    scale_physical(s, scaled, physical);
    for (int i = 0; i < 2; i++) logs[i] = log((physical[i] + s->floor[i]) / (s->mean[i] + s->floor[i]));
    scale_powers(logs, powers);
    double log_scale = s->out_bias;
    for (int k = 0; k < 5; k++) log_scale += s->exponents[k] * powers[k];
    for (int h = 0; h < s->width; h += CHUNK) {
        int n = s->width - h < CHUNK ? s->width - h : CHUNK;
        double hidden[CHUNK] = {0};
        for (int k = 0; k < n; k++) {
            const double *w = s->hidden + 4 * (h + k);
            hidden[k] = s->hidden_bias[h + k] + w[0] * scaled[0] + w[1] * scaled[1] + w[2] * logs[0] + w[3] * logs[1];
        }
        for (int k = 0; k < n; k += WIDTH) store(hidden + k, tanh_of(load(hidden + k)));
        for (int k = 0; k < n; k++) log_scale += s->out[h + k] * hidden[k];
    }
    double out = exp(log_scale);
    return out < s->sigma_max ? out : s->sigma_max;
}

void scale_physical(const scale *s, const double scaled[2], double out[2]) {
    for (int i = 0; i < 2; i++) {
        double x = scaled[i] * s->sd[i] + s->mean[i];
        out[i] = x > 0 ? x : 0;
    }
}

condition condition_of(const scale *level, const double scaled[2]) {
    double physical[2];
    scale_physical(level, scaled, physical);
    return (condition){{scaled[0], scaled[1]}, physical[0], 1};
}

void scale_powers(const double logs[2], double out[5]) {
    out[0] = logs[0];
    out[1] = logs[1];
    out[2] = logs[0] * logs[0];
    out[3] = logs[0] * logs[1];
    out[4] = logs[1] * logs[1];
}
