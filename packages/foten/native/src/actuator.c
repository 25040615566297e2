#include "actuator.h"

static const double KNEE = 0.8, MIN_RATE_HZ = 4000, MIN_RATE_OVER_RESONANCE = 16, DAMPED = 0.70710678118654752;

/* The largest float below a number, as drives leave: tanh comes to 1, and rounding goes up as well. */
static float below(double limit) {
    float nearest = (float)limit;
    return nearest < limit ? nearest : nextafterf(nearest, 0);
}

int actuator_make(actuator *into, const foten_actuator *of, double rate_hz) {
    if (!of) {
        *into = (actuator){0};
        return 1;
    }
    double lowest = of->lowest_hz > 0 ? of->lowest_hz : FOTEN_ACTUATOR_LOWEST_HZ;
    if (!isfinite(of->gain) || of->gain == 0 || !(of->limit >= 0) || !(of->resonance_hz >= 0) || !(of->damping >= 0))
        return 0;
    actuator designed = {.on = 1, .limit = of->limit, .max_drive = below(of->limit), .filter.b0 = 1 / of->gain};
    if (of->resonance_hz > 0) {
        /* Nearer to the rate the bilinear transform would be more than 0.3 dB off between 40 and 400 Hz. */
        if (!(rate_hz >= MIN_RATE_HZ && of->resonance_hz * MIN_RATE_OVER_RESONANCE <= rate_hz && lowest < rate_hz / 4 &&
              of->damping < 100))
            return 0;
        /* Bilinear, each of the two corners where it belongs: (s^2 + 2 z w s + w^2), s = (1 - z^-1) / (1 + z^-1), w =
         * tan(pi f / rate). */
        double w = tan(PI * of->resonance_hz / rate_hz), v = tan(PI * lowest / rate_hz);
        double norm = 1 + 2 * DAMPED * v + v * v, gain = 1 / (of->gain * norm);
        designed.filter = (section){gain * (1 + 2 * of->damping * w + w * w), gain * 2 * (w * w - 1),
                                    gain * (1 - 2 * of->damping * w + w * w), 2 * (v * v - 1) / norm,
                                    (1 - 2 * DAMPED * v + v * v) / norm};
        designed.memory = into->memory; /* which stays where only the figures change */
    }
    if (!isfinite(designed.filter.b0) || !isfinite(designed.filter.b1) || !isfinite(designed.filter.b2)) return 0;
    *into = designed;
    return 1;
}

double actuator_drive(actuator *a, double x, int *bent) {
    *bent = 0;
    if (!a->on) return x;
    double y = filtered(&a->filter, &a->memory, x), size = a->limit > 0 ? fabs(y) / a->limit : 0;
    if (size <= KNEE) return y;
    *bent = 1;
    double drive = a->limit * (KNEE + (1 - KNEE) * tanh((size - KNEE) / (1 - KNEE)));
    return copysign(drive < a->max_drive ? drive : a->max_drive, y);
}
