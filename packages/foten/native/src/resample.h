/* From the texture's rate to that of a device. */
#pragma once

#include <stddef.h>

#include "arena.h"

/* A low-pass of minimum phase at 0.45 of the slower rate, 58 dB down from 0.55 of it. */
typedef struct resampler resampler;

/* The rate of a device over that of the texture, and the other way round. */
enum { MAX_UPSAMPLING = 400, MAX_DOWNSAMPLING = 20 };

resampler *resampler_place(block *from, double rate_in, double rate_out);
void resampler_reset(resampler *r);

void resampler_silence(resampler *r); /* forget what was given, and stay in step */

int resampler_wants(const resampler *r); /* a sample, before one can be taken */
void resampler_give(resampler *r, double sample);
double resampler_take(resampler *r);

size_t resampler_most(const resampler *r, size_t n); /* samples that n given ones make, and those that wait, at most */
double resampler_delay_s(const resampler *r);        /* of slow vibration */
double resampler_rate(const resampler *r);           /* of what is taken [Hz] */
