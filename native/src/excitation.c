#include "excitation.h"

#include <math.h>
#include <string.h>

#include "clip.h"
#include "constants.h"

int excitation_read(texture_file *file, arena *memory, int width, excitation *out) {
    const double *values;
    if (!scale_read(file, memory, "excitation.", width, &out->sigma)) return 0;
    if (!(values = table_take(file, memory, "excitation.", "tail.weight", 1, 5))) return 0;
    memcpy(out->tail, values, sizeof out->tail);
    if (!(values = table_take(file, memory, "excitation.", "tail.bias", 1, 0))) return 0;
    out->tail_bias = *values;
    if (!(values = table_take(file, memory, "excitation.", "largest", 2, 0))) return 0;
    memcpy(out->largest, values, sizeof out->largest);
    if (!(out->largest[0] >= 0 && out->largest[1] >= 0)) {
        file_refuse(file, FOTEN_BAD_FILE, "tensor 'excitation.largest' is negative");
        return 0;
    }
    if (!(values = table_take(file, memory, "excitation.", "volatility", 2, 0))) return 0;
    out->volatility_kept = values[0];
    out->volatility_sd = values[1];
    if (!(values[0] >= 0 && values[0] <= 1 && values[1] >= 0)) {
        file_refuse(file, FOTEN_BAD_FILE, "tensor 'excitation.volatility' is out of range");
        return 0;
    }
    return 1;
}

void excitation_set_condition(const excitation *e, excitation_state *s, const double scaled[2]) {
    double logs[2], powers[5], tail = e->tail_bias;
    s->sigma = scale_at(&e->sigma, scaled, logs);
    scale_powers(logs, powers);
    for (int k = 0; k < 5; k++) tail += e->tail[k] * powers[k];
    s->tail = FOTEN_HEAVIEST_TAIL / (1 + exp(-tail));
}

double excitation_factor(const excitation *e, const excitation_state *s) { return exp(s->volatility - e->volatility_sd * e->volatility_sd); }

void excitation_draw(const excitation *e, excitation_state *s, double noise) {
    s->volatility = e->volatility_sd * clip(noise, FOTEN_LARGEST_VOLATILITY);
}

double excitation_next(const excitation *e, excitation_state *s, double z, double unit) {
    double size = excitation_factor(e, s) * s->sigma, most = e->largest[1] / (unit * size);
    if (most > e->largest[0]) most = e->largest[0];
    double out = size * clip(z * exp(0.5 * s->tail * z * z), most);
    if (e->volatility_sd > 0) {
        double shock = fabs(z) < FOTEN_LARGEST_SHOCK ? fabs(z) : FOTEN_LARGEST_SHOCK, kept = e->volatility_kept;
        double moved = kept * s->volatility + sqrt(1 - kept * kept) * e->volatility_sd * ((shock - FOTEN_MEAN_SIZE) / FOTEN_SIZE_SD);
        s->volatility = clip(moved, FOTEN_LARGEST_VOLATILITY * e->volatility_sd);
    }
    return out;
}
