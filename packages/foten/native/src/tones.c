#include "tones.h"

#include <math.h>

#include "constants.h"

int tones_read(texture_file *file, arena *memory, int n, int n_speed, int n_force, tones *out) {
    double params[3];
    out->n = n;
    if (!speed_force_table_read(file, memory, "tones.", "values", n_speed, n_force, 2 * n, &out->values)) return 0;
    if (!file_copy(file, "tones.", "phase_params", (size_t[4]){3}, params)) return 0;
    if (!(params[0] >= 0 && fabs(params[1]) <= 10 && params[2] >= 0 && params[2] <= 1))
        return file_refuse(file, FOTEN_BAD_FILE, "tensor 'tones.phase_params' is out of range");
    out->phase_increment = params[0];
    out->period_jitter = params[1];
    out->phase_leak = params[2];
    return 1;
}

static double increment_of(const tones *t, const condition *c) { return t->phase_increment * c->path_speed; }

/* The sum of tones of coefficients c_1, s_1, c_2, ... at a phase. */
static double sum_at(const double *coefficients, int n, double phase) {
    double sum = 0, c = cos(phase), s = sin(phase), cosine = c, sine = s;
    for (int k = 0; k < n; k++) {
        sum += coefficients[2 * k] * cosine + coefficients[2 * k + 1] * sine;
        double next = cosine * c - sine * s;
        sine = sine * c + cosine * s;
        cosine = next;
    }
    return sum;
}

/* Coefficients for the sample after one under a condition. Of each multiple as much as the rate can hold: all up to
 * 0.45 of it, nothing from 0.5. */
static void coefficients_at(const tones *t, const scale *level_over, const condition *c, double increment,
                            double *out) {
    double logs[2], physical[2], level = scale_at(level_over, c->scaled, logs);
    scale_physical(level_over, c->scaled, physical);
    speed_force_table_at(&t->values, physical[0], physical[1], out);
    for (int k = 0; k < t->n; k++) {
        double anti_alias_gain = 10 - 10 * (k + 1) * increment / PI;
        anti_alias_gain = anti_alias_gain > 1 ? 1 : anti_alias_gain < 0 ? 0 : anti_alias_gain;
        out[2 * k] *= level * anti_alias_gain;
        out[2 * k + 1] *= level * anti_alias_gain;
    }
}

void tones_set_condition(const tones *t, const scale *level, tones_state *s, const condition *c, int changed) {
    s->increment = increment_of(t, c);
    if (changed) coefficients_at(t, level, c, s->increment, s->coefficients);
    s->tone = sum_at(s->coefficients, t->n, s->phase);
}

void tones_fit(const tones *t, const scale *level_over, tones_state *s, const double *windows, int n) {
    double best = INFINITY, error[FOTEN_N_CANDIDATES] = {0}, travelled = 0;
    s->phase = s->path = 0;
    for (int i = 1; i < n; i++) {
        condition before = condition_of(level_over, windows + 3 * i - 2);
        double increment = increment_of(t, &before), logs[2], level = scale_at(level_over, before.scaled, logs);
        travelled += increment;
        coefficients_at(t, level_over, &before, increment, s->coefficients);
        for (int k = 0; k < FOTEN_N_CANDIDATES; k++) {
            double off =
                (windows[3 * i] - sum_at(s->coefficients, t->n, travelled + 2 * PI * k / FOTEN_N_CANDIDATES)) / level;
            error[k] += off * off;
        }
    }
    for (int k = 0; k < FOTEN_N_CANDIDATES; k++)
        if (error[k] < best) {
            best = error[k];
            s->phase = 2 * PI * k / FOTEN_N_CANDIDATES;
        }
}

double tones_follow(const tones *t, const scale *level, tones_state *s, const condition *before) {
    double increment = increment_of(t, before);
    s->path += increment;
    coefficients_at(t, level, before, increment, s->coefficients);
    return sum_at(s->coefficients, t->n, s->path + s->phase);
}

/* The way to the first sample belongs to the recording, and nothing of it is kept: the phase is taken within half a
 * turn. */
void tones_begin_path(const tones *t, tones_state *s, const condition *last) {
    s->phase = s->path + s->phase + increment_of(t, last);
    s->phase -= 2 * PI * floor((s->phase + PI) / (2 * PI));
    s->path = s->rate = 0;
}

void tones_draw(tones_state *s, double sine, double cosine) {
    s->phase = s->path = atan2(sine, cosine);
    s->rate = 0;
}

void tones_push(const tones *t, tones_state *s, double innovation, const condition *c) {
    double memory = exp(-s->increment / PI), increment = increment_of(t, c);
    s->phase -= t->phase_leak * (s->phase - s->path);
    s->rate =
        memory * s->rate + sqrt(1 - memory * memory) * (t->period_jitter * clip(innovation, FOTEN_MAX_JITTER_DRIVE));
    s->phase += s->increment * s->rate + increment;
    s->path += increment;
}
