/* From acceleration to what drives an actuator: see foten.h. */
#pragma once
#include "filter.h"
#include "foten.h"

typedef struct {
    int on;
    section filter;
    memory memory;
    double limit, max_drive; /* max_drive: the largest below the limit */
} actuator;

/* 0 where it cannot be; NULL switches it off. */
int actuator_make(actuator *a, const foten_actuator *of, double rate_hz);
double actuator_drive(actuator *a, double acceleration, int *bent);
