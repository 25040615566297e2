/* From acceleration to what drives an actuator: see foten.h. */
#ifndef FOTEN_ACTUATOR_H
#define FOTEN_ACTUATOR_H
#include "foten.h"

typedef struct {
    int on;
    double b0, b1, b2, a1, a2, first, second, limit, most; /* most: the largest drive below the limit */
} actuator;

int actuator_make(actuator *a, const foten_actuator *of, double rate_hz); /* 0 where it cannot be; NULL switches it off */
void actuator_reset(actuator *a);
double actuator_drive(actuator *a, double acceleration, int *bent);
#endif
