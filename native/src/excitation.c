#include "excitation.h"

#include <math.h>

#include "constants.h"

static void philox(uint32_t c[4], uint32_t k0, uint32_t k1) {
    for (int round = 0; round < 10; round++) {
        uint64_t product_0 = (uint64_t)FOTEN_PHILOX_MULTIPLIER_0 * c[0], product_1 = (uint64_t)FOTEN_PHILOX_MULTIPLIER_1 * c[2];
        uint32_t c1 = c[1], c3 = c[3];
        c[0] = (uint32_t)(product_1 >> 32) ^ c1 ^ k0;
        c[1] = (uint32_t)product_1;
        c[2] = (uint32_t)(product_0 >> 32) ^ c3 ^ k1;
        c[3] = (uint32_t)product_0;
        k0 += FOTEN_PHILOX_WEYL_0;
        k1 += FOTEN_PHILOX_WEYL_1;
    }
}

double noise_at(uint64_t seed, uint64_t stream, uint64_t n) {
    uint32_t c[4] = {(uint32_t)n, (uint32_t)(n >> 32), (uint32_t)stream, (uint32_t)(stream >> 32)};
    philox(c, (uint32_t)seed, (uint32_t)(seed >> 32));
    int32_t total = 0;
    for (int i = 0; i < 4; i++) total += (int32_t)(c[i] & 0xFFFFu) + (int32_t)(c[i] >> 16);
    /* Built without contraction: these four operations are the same on every processor. */
    double x = ((double)total - 262140.0) / FOTEN_NOISE_SUM_SD;
    double square = x * x;
    double factor = FOTEN_NOISE_CUBIC * square;
    return x * (FOTEN_NOISE_LINEAR + factor);
}

int excitation_read(texture_file *file, arena *memory, int width, excitation *out) {
    double volatility[2];
    if (!scale_read(file, memory, "excitation.", width, &out->sigma)) return 0;
    if (!file_copy(file, "excitation.", "tail.weight", (size_t[4]){1, 5}, out->tail)) return 0;
    if (!file_copy(file, "excitation.", "tail.bias", (size_t[4]){1}, &out->tail_bias)) return 0;
    if (!file_copy(file, "excitation.", "largest", (size_t[4]){2}, out->largest)) return 0;
    if (!(out->largest[0] >= 0 && out->largest[1] >= 0)) return file_refuse(file, FOTEN_BAD_FILE, "tensor 'excitation.largest' is negative");
    if (!file_copy(file, "excitation.", "volatility", (size_t[4]){2}, volatility)) return 0;
    if (!(volatility[0] >= 0 && volatility[0] <= 1 && volatility[1] >= 0))
        return file_refuse(file, FOTEN_BAD_FILE, "tensor 'excitation.volatility' is out of range");
    out->volatility_kept = volatility[0];
    out->volatility_sd = volatility[1];
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

double excitation_rms(const excitation_state *s) { return pow(1 - 2 * s->tail, -0.75); }

/* The z of z exp(h z^2 / 2) = u by Newton's method on log |z|: from above the root of a convex function every step stays above. */
static double gaussianised(double u, double tail) {
    double log_u = log(fabs(u) > 1e-300 ? fabs(u) : 1e-300), q = log_u;
    for (int i = 0; i < 20; i++) {
        double spread = tail * exp(2 * q);
        q -= (q + 0.5 * spread - log_u) / (1 + spread);
    }
    return copysign(exp(q), u);
}

void excitation_score(const excitation_state *s, double missed, double scale, foten_prediction *out) {
    double z = gaussianised(missed / scale, s->tail), spread = s->tail * z * z;
    out->scale = scale;
    out->standardised = z;
    out->nll = 0.5 * (z * z + spread) + log1p(spread) + log(scale) + 0.5 * log(2 * PI);
}

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
