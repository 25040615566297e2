#include "excitation.h"

#include <math.h>

#include "constants.h"

static void philox(uint32_t c[4], uint32_t k0, uint32_t k1) {
    for (int round = 0; round < 10; round++) {
        uint64_t product_0 = (uint64_t)FOTEN_PHILOX_MULTIPLIER_0 * c[0],
                 product_1 = (uint64_t)FOTEN_PHILOX_MULTIPLIER_1 * c[2];
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
    double *limit = out->innovation_limit;
    if (!scale_read(file, memory, "excitation.", width, &out->sigma)) return 0;
    if (!file_copy(file, "excitation.", "innovation_limit", (size_t[4]){2}, limit)) return 0;
    return (limit[0] >= 0 && limit[1] >= 0) ||
           file_refuse(file, FOTEN_BAD_FILE, "tensor 'excitation.innovation_limit' is negative");
}

double excitation_sigma(const excitation *e, const double scaled[2]) {
    double logs[2];
    return scale_at(&e->sigma, scaled, logs);
}

void excitation_score(double residual, double scale, foten_prediction *out) {
    double z = residual / scale;
    out->scale = scale;
    out->standardised = z;
    out->nll = 0.5 * z * z + log(scale) + 0.5 * log(2 * PI);
}

double excitation_limited(const excitation *e, double innovation, double scale) {
    double limit = e->innovation_limit[1] / scale;
    return clip(innovation, limit < e->innovation_limit[0] ? limit : e->innovation_limit[0]);
}
