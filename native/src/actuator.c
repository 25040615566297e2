#include "actuator.h"

#include <math.h>

#include "constants.h"

static const double PI = 3.14159265358979323846, KNEE = 0.8, LOWEST_RATE_HZ = 4000, TIMES_RESONANCE = 16, DAMPED = 0.70710678118654752;

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
    if (!isfinite(of->gain) || of->gain == 0 || !(of->limit >= 0) || !(of->resonance_hz >= 0) || !(of->damping >= 0)) return 0;
    /* The filter's memory stays where only the figures change. */
    actuator made = {.on = 1, .limit = of->limit, .most = below(of->limit), .first = into->first, .second = into->second}, *a = &made;
    if (of->resonance_hz == 0) {
        a->b0 = 1 / of->gain;
        a->first = a->second = 0;
        if (!isfinite(a->b0)) return 0;
        *into = made;
        return 1;
    }
    /* Nearer to the rate the bilinear transform would be more than 0.3 dB off between 40 and 400 Hz. */
    if (!(rate_hz >= LOWEST_RATE_HZ && of->resonance_hz * TIMES_RESONANCE <= rate_hz) || !(lowest < rate_hz / 4) || !(of->damping < 100)) return 0;
    /* Bilinear, each of the two corners where it belongs: (s^2 + 2 z w s + w^2), s = (1 - z^-1) / (1 + z^-1), w = tan(pi f / rate). */
    double w = tan(PI * of->resonance_hz / rate_hz), v = tan(PI * lowest / rate_hz);
    double norm = 1 + 2 * DAMPED * v + v * v, gain = 1 / (of->gain * norm);
    a->b0 = gain * (1 + 2 * of->damping * w + w * w);
    a->b1 = gain * 2 * (w * w - 1);
    a->b2 = gain * (1 - 2 * of->damping * w + w * w);
    a->a1 = 2 * (v * v - 1) / norm;
    a->a2 = (1 - 2 * DAMPED * v + v * v) / norm;
    if (!isfinite(a->b0) || !isfinite(a->b1) || !isfinite(a->b2)) return 0;
    *into = made;
    return 1;
}

void actuator_reset(actuator *a) { a->first = a->second = 0; }

double actuator_drive(actuator *a, double x, int *bent) {
    *bent = 0;
    if (!a->on) return x;
    double y = a->b0 * x + a->first;
    a->first = a->b1 * x - a->a1 * y + a->second;
    a->second = a->b2 * x - a->a2 * y;
    if (fabs(a->first) + fabs(a->second) < 1e-30) a->first = a->second = 0;
    double size = a->limit > 0 ? fabs(y) / a->limit : 0;
    if (size <= KNEE) return y;
    *bent = 1;
    double drive = a->limit * (KNEE + (1 - KNEE) * tanh((size - KNEE) / (1 - KNEE)));
    return copysign(drive < a->most ? drive : a->most, y);
}
