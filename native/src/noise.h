/* The noise that foten.h defines. */
#ifndef FOTEN_NOISE_H
#define FOTEN_NOISE_H
#include <stdint.h>

double noise_at(uint64_t seed, uint64_t stream, uint64_t n);
#endif
