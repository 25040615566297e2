#ifndef FOTEN_CLIP_H
#define FOTEN_CLIP_H

static inline double clip(double x, double limit) { return x > limit ? limit : x < -limit ? -limit : x; }
#endif
