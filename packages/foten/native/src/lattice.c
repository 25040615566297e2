#include "lattice.h"

#include <stdio.h>

int lattice_read(texture_file *file, arena *memory, const char *prefix, int n_speed, int n_force, int order,
                 int level_width, int gain_before_filter, lattice *out) {
    char level[64];
    snprintf(level, sizeof level, "%slevel.", prefix);
    out->order = order;
    out->gain_before_filter = gain_before_filter;
    if (!speed_force_table_read(file, memory, prefix, "reflections", n_speed, n_force, order, &out->reflections))
        return 0;
    for (size_t i = 0; i < (size_t)n_speed * (size_t)n_force * (size_t)order; i++) {
        double size = fabs(out->reflections.values[i]);
        if (!(size < 1))
            return file_refuse(file, FOTEN_BAD_FILE,
                               "a reflection is %g in size, expected less than 1: the lattice would not be stable",
                               size);
    }
    return scale_read(file, memory, level, level_width, &out->level);
}

void lattice_set_condition(const lattice *of, lattice_state *l, const double scaled[2]) {
    double physical[2];
    l->level = scale_at(&of->level, scaled, l->logs);
    scale_physical(&of->level, scaled, physical);
    speed_force_table_at(&of->reflections, physical[0], physical[1], l->reflections);
    lattice_turn(l, of->order);
}
