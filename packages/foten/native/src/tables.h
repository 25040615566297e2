/* Numbers that follow speed and force: tables over both, and standard deviations. */
#pragma once

#include "file.h"

/* Speed and force of a sample as a model is given them: scaled, within the trained range, and the speed [mm/s] that
 * moves tones, which may lie beyond it; and how much of the vibration is left of it near rest, from 0 to 1. */
typedef struct {
    double scaled[2], path_speed, fade;
} condition;

/* Values at the vertices of a grid, bilinear in speed and log force between them, constant outside. */
typedef struct {
    int n_speed, n_force, width;
    const double *speed_knots, *force_knots, *values; /* speed the slower index */
} speed_force_table;

/* A standard deviation over speed and force: a power law with a small network's correction of its logarithm. */
typedef struct {
    int width;
    const double *hidden, *hidden_bias, *out; /* (width, 4), (width), (width) */
    double exponents[5], out_bias, sigma_max, mean[2], sd[2], floor[2];
} scale;

int speed_force_table_read(texture_file *file, arena *memory, const char *prefix, const char *values, int n_speed,
                           int n_force, int width, speed_force_table *out);

/* The `width` values at a speed [mm/s] and a force [N]. */
void speed_force_table_at(const speed_force_table *table, double speed, double force, double *out);

int scale_read(texture_file *file, arena *memory, const char *prefix, int width, scale *out);

/* The standard deviation at speed and force, scaled; `logs` gets the logarithms of both re their means. */
double scale_at(const scale *s, const double scaled[2], double logs[2]);

/* Speed [mm/s] and force [N] of scaled ones, none negative. */
void scale_physical(const scale *s, const double scaled[2], double out[2]);

/* The condition of a recorded sample: tones go by its speed. */
condition condition_of(const scale *level, const double scaled[2]);

/* x, y, x^2, x y, y^2 of logarithms. */
void scale_powers(const double logs[2], double out[5]);
