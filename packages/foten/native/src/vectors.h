/* Vectors of one instruction set, and linear maps of many tokens: for what is compiled once for each, by definitions of
 *   LANES  floats in a vector,
 *   ROWS   tokens whose sums stay in registers at once: 5, 8 or 11.
 * The vectors are the compiler's own, so that the same lines become AVX-512, AVX2, NEON, wasm's SIMD or plain C. */
#pragma once

#include <stdint.h>
#include <string.h>

#include "foten_network.h"

typedef float vec __attribute__((vector_size(4 * LANES)));
typedef int32_t vec_bits __attribute__((vector_size(4 * LANES)));
typedef uint32_t vec_word __attribute__((vector_size(4 * LANES)));

/* A function of a library that has it once for each instruction set. */
#define JOIN(a, b) a##_##b
#define OF_ISA(name, isa) JOIN(name, isa)
#if defined(_WIN32)
#define EXPORTED(name) __declspec(dllexport) int OF_ISA(name, KERNEL)
#else
#define EXPORTED(name) __attribute__((visibility("default"))) int OF_ISA(name, KERNEL)
#endif

#define INLINE static inline __attribute__((always_inline))

INLINE vec load(const float *p) {
    vec v;
    memcpy(&v, p, sizeof v);
    return v;
}
INLINE void store(float *p, vec v) { memcpy(p, &v, sizeof v); }
INLINE vec rectify(vec a) { return (vec)((vec_bits)a & (vec_bits)(a > 0.0f)); }
INLINE vec larger(vec a, vec b) {
    vec_bits m = a > b;
    return (vec)(((vec_bits)a & m) | ((vec_bits)b & ~m));
}

INLINE float sum_of(vec v) {
    float f[LANES];
    memcpy(f, &v, sizeof v);
    for (int width = LANES / 2; width; width /= 2)
        for (int i = 0; i < width; i++) f[i] += f[i + width];
    return f[0];
}

/* e^x for x up to 0, within 2 units in the last place; less than e^-50 is e^-50. */
INLINE vec exp_of(vec x) {
    vec least = {0};
    x = larger(x, least - 50.0f); /* e^-50 is nothing beside 1, and nothing that it is multiplied with is denormal */
    vec shifted = x * 1.44269504f + 12582912.0f;
    vec n = shifted - 12582912.0f;
    vec r = x - n * 0.693359375f;
    r = r - n * -2.12194440e-4f;
    vec p = r * 1.9875691500e-4f + 1.3981999507e-3f;
    p = p * r + 8.3334519073e-3f;
    p = p * r + 4.1665795894e-2f;
    p = p * r + 1.6666665459e-1f;
    p = p * r + 5.0000001201e-1f;
    p = p * (r * r) + r + 1.0f;
    vec_word power = ((vec_word)shifted << 23) + 0x3F800000u; /* unsigned: of what is no number it may overflow */
    return p * (vec)power;
}

/* `rows` tokens times one panel; rows and vectors are constants where this is expanded. */
INLINE void panel(const int rows, const int vectors, int inputs, const float *restrict w, const float *restrict bias,
                  const float *restrict in, int in_stride, float *restrict out, int out_stride, int rectified) {
    vec a[ROWS][2];
    for (int n = 0; n < rows; n++)
        for (int k = 0; k < vectors; k++) a[n][k] = load(bias + k * LANES);
    for (int i = 0; i < inputs; i++, w += vectors * LANES) {
        vec weight[2];
        for (int k = 0; k < vectors; k++) weight[k] = load(w + k * LANES);
        for (int n = 0; n < rows; n++) {
            float x = in[n * in_stride + i];
            for (int k = 0; k < vectors; k++) a[n][k] += weight[k] * x;
        }
    }
    for (int n = 0; n < rows; n++)
        for (int k = 0; k < vectors; k++)
            store(out + n * out_stride + k * LANES, rectified ? rectify(a[n][k]) : a[n][k]);
}

#define FIRST_5(X) X(1) X(2) X(3) X(4) X(5)
#define FIRST_8(X) FIRST_5(X) X(6) X(7) X(8)
#define FIRST_11(X) FIRST_8(X) X(9) X(10) X(11)
#define JOINED(a, b) a##b
#define FIRST(n) JOINED(FIRST_, n)
#define EACH_ROWS FIRST(ROWS)

static void some_rows(int rows, int vectors, int inputs, const float *w, const float *bias, const float *in,
                      int in_stride, float *out, int out_stride, int rectified) {
#define WIDE(k)                                                                                                        \
    case k: panel(k, 2, inputs, w, bias, in, in_stride, out, out_stride, rectified); return;
#define NARROW(k)                                                                                                      \
    case k: panel(k, 1, inputs, w, bias, in, in_stride, out, out_stride, rectified); return;
    if (vectors == 2) switch (rows) {
            EACH_ROWS(WIDE)
        }
    else switch (rows) {
            EACH_ROWS(NARROW)
        }
}

/* n tokens through a linear map; what they are padded with up to full vectors comes out as zeros. */
static inline void apply(const linear *l, int n, const float *in, int in_stride, float *out, int out_stride,
                         int rectified) {
    int padded = (l->outputs + LANES - 1) / LANES * LANES;
    for (int o = 0; o < padded; o += 2 * LANES) {
        int vectors = padded - o > LANES ? 2 : 1;
        for (int done = 0, rows; done < n; done += rows) {
            int blocks = (n - done + ROWS - 1) / ROWS;
            rows = (n - done + blocks - 1) / blocks;
            some_rows(rows, vectors, l->inputs, l->weights + (size_t)o * (size_t)l->inputs, l->bias + o,
                      in + done * in_stride, in_stride, out + done * out_stride + o, out_stride, rectified);
        }
    }
}
