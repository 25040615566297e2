/* Multiply-adds a second that this core does at most in each width of vector, and how long a call of nothing takes: the
 * arithmetic floor.
 *
 * Prints lines of a name and a number. Twelve independent sums of vectors hide the latency of an addition; the best of
 * many short runs is what the core can do, whatever else the machine is at. */
#define _POSIX_C_SOURCE 199309L
#include <stdint.h>
#include <stdio.h>
#include <time.h>

enum { SUMS = 12, ROUNDS = 20000, TRIALS = 200 };

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

#define PEAK(name, lanes, target)                                                                                      \
    typedef float name##_vec __attribute__((vector_size(4 * lanes)));                                                  \
    target static double name(void) {                                                                                  \
        name##_vec a[SUMS], factor, added;                                                                             \
        for (int k = 0; k < lanes; k++) {                                                                              \
            factor[k] = 0.999f;                                                                                        \
            added[k] = 1e-3f;                                                                                          \
        }                                                                                                              \
        for (int i = 0; i < SUMS; i++) a[i] = added * (float)i;                                                        \
        double best = 1e9;                                                                                             \
        for (int trial = 0; trial < TRIALS; trial++) {                                                                 \
            double begin = now();                                                                                      \
            for (int round = 0; round < ROUNDS; round++)                                                               \
                for (int i = 0; i < SUMS; i++) {                                                                       \
                    a[i] = a[i] * factor + added;                                                                      \
                    __asm__ volatile("" : "+v"(a[i]));                                                                 \
                }                                                                                                      \
            double took = now() - begin;                                                                               \
            if (took < best) best = took;                                                                              \
        }                                                                                                              \
        volatile float kept = 0;                                                                                       \
        for (int i = 0; i < SUMS; i++) kept += a[i][0];                                                                \
        return (double)SUMS * ROUNDS * lanes / best;                                                                   \
    }

#if defined(__x86_64__)
PEAK(avx512, 16, __attribute__((target("avx512f,fma"))))
PEAK(avx2, 8, __attribute__((target("avx2,fma"))))
#endif

int main(void) {
#if defined(__x86_64__)
    __builtin_cpu_init();
    if (__builtin_cpu_supports("avx512f")) printf("avx512 %.6g\n", avx512());
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) printf("avx2 %.6g\n", avx2());
#endif
    return 0;
}
