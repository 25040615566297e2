/* The noise that foten.h defines. */
#ifndef FOTEN_NOISE_H
#define FOTEN_NOISE_H
#include <stdint.h>

double noise_at(uint64_t seed, uint64_t stream, uint64_t n);

/* The numbers of a stream in turn, from `next` on. */
typedef struct {
    uint64_t seed, stream, next;
} noise_source;

static inline double noise_next(noise_source *from) { return noise_at(from->seed, from->stream, from->next++); }
#endif
