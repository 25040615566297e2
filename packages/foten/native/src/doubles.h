/* Vectors of doubles, and functions of each of them that give the same bits on every processor, whatever their width:
 * compiled without contraction. */
#pragma once

#include <stdint.h>
#include <string.h>

#ifndef LANES
#define LANES 4 /* floats in a vector, which every processor has */
#endif
enum { WIDTH = LANES / 2 };

typedef double vec __attribute__((vector_size(8 * WIDTH)));
typedef int64_t vec_bits __attribute__((vector_size(8 * WIDTH)));
typedef uint64_t vec_word __attribute__((vector_size(8 * WIDTH)));

#define INLINE static inline __attribute__((always_inline))

INLINE vec load(const double *p) {
    vec v;
    memcpy(&v, p, sizeof v);
    return v;
}
INLINE void store(double *p, vec v) { memcpy(p, &v, sizeof v); }

INLINE vec choose(vec_bits mask, vec a, vec b) { return (vec)(((vec_bits)a & mask) | ((vec_bits)b & ~mask)); }

/* e^x within 1e-15 of itself, x held to +-700, between which nothing is denormal: the Taylor series about the nearest
 * multiple of log 2. */
INLINE vec exp_of(vec x) {
    const vec zero = {0};
    x = choose(x < -700.0, zero - 700.0, choose(x > 700.0, zero + 700.0, x));
    vec shifted = x * 0x1.71547652b82fep0 + 0x1.8p52; /* over log 2; what is left after so large a sum is whole */
    vec n = shifted - 0x1.8p52;
    vec r = x - n * 0x1.62e42feep-1 - n * 0x1.a39ef35793c76p-33; /* log 2 in two parts: n times the first is exact */
    vec square = r * r; /* terms of even and of odd degree apart: half as long a chain */
    vec even = square * (1.0 / 479001600) + 1.0 / 3628800, odd = square * (1.0 / 6227020800) + 1.0 / 39916800;
    even = even * square + 1.0 / 40320;
    odd = odd * square + 1.0 / 362880;
    even = even * square + 1.0 / 720;
    odd = odd * square + 1.0 / 5040;
    even = even * square + 1.0 / 24;
    odd = odd * square + 1.0 / 120;
    even = even * square + 1.0 / 2;
    odd = odd * square + 1.0 / 6;
    even = even * square + 1.0;
    odd = odd * square + 1.0;
    return (vec)((vec_word)(odd * r + even) + ((vec_word)shifted << 52));
}

INLINE vec logistic(vec x) { return 1.0 / (1.0 + exp_of(-x)); }
INLINE vec tanh_of(vec x) { return 1.0 - 2.0 / (1.0 + exp_of(2.0 * x)); }
