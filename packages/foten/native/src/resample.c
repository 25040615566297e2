#include "resample.h"

#include <math.h>
#include <stdint.h>
#include <string.h>

#include "resample_table.h"

struct resampler {
    double rate_in;
    double stretch;          /* the kernel's length in samples given, over its own; 1 unless the device is the slower */
    double *history;         /* the last `n` samples given, twice, so that any n of them are contiguous */
    size_t n, at, ahead;     /* ahead: samples to be given before the next is taken */
    uint64_t fraction, step; /* of the place between samples given and its step, in 2^-64 of a sample */
    size_t integer;          /* of the step, samples */
    double ratio;
};

resampler *resampler_place(block *from, double rate_in, double rate_out) {
    double ratio = rate_in / rate_out, stretch = ratio > 1 ? ratio : 1;
    size_t n = (size_t)ceil(TABLE_TAPS * stretch) + 1;
    resampler *r = block_take(from, 1, sizeof *r);
    double *history = block_take(from, 2 * n, sizeof *history);
    if (!from->base) return NULL;
    *r = (resampler){
        .rate_in = rate_in, .stretch = stretch, .history = history, .n = n, .ratio = ratio, .integer = (size_t)ratio};
    r->step = (uint64_t)ldexp(ratio - (double)r->integer, 64);
    resampler_reset(r);
    return r;
}

void resampler_reset(resampler *r) {
    memset(r->history, 0, 2 * r->n * sizeof *r->history);
    r->at = 0;
    r->ahead = 1;
    r->fraction = 0;
}

int resampler_wants(const resampler *r) { return r->ahead > 0; }

void resampler_give(resampler *r, double sample) {
    r->at = (r->at ? r->at : r->n) - 1; /* backwards: the newest comes first */
    r->history[r->at] = r->history[r->at + r->n] = sample;
    r->ahead--;
}

double resampler_take(resampler *r) {
    const double *newest = r->history + r->at;
    double place = (double)(r->fraction >> 11) * (1.0 / 9007199254740992.0) / r->stretch * TABLE_STEPS,
           apart = TABLE_STEPS / r->stretch, sum = 0;
    for (size_t i = 0; i < r->n && place < TABLE_STEPS * TABLE_TAPS; i++, place += apart) {
        int left = (int)place;
        double share = place - left;
        sum += newest[i] * (TABLE[left] + share * ((double)TABLE[left + 1] - TABLE[left]));
    }
    uint64_t before = r->fraction;
    r->fraction += r->step;
    r->ahead += r->integer + (r->fraction < before);
    return sum / r->stretch;
}

void resampler_silence(resampler *r) { memset(r->history, 0, 2 * r->n * sizeof *r->history); }

size_t resampler_most(const resampler *r, size_t n) { return (size_t)ceil((double)(n + 1) / r->ratio) + 1; }

double resampler_rate(const resampler *r) { return r->rate_in / r->ratio; }

double resampler_delay_s(const resampler *r) {
    double sum = 0, moment = 0;
    for (int i = 0; i < TABLE_STEPS * TABLE_TAPS; i++) {
        sum += TABLE[i];
        moment += (double)i * TABLE[i];
    }
    return moment / sum / TABLE_STEPS * r->stretch / r->rate_in;
}
