/* Memory that is asked for piece by piece and given back at once. */
#pragma once
#include <stddef.h>

enum { ALIGNED = 64 }; /* bytes: a cache line, and the widest vector */

typedef struct piece piece;
typedef struct {
    piece *last;
    int failed;
} arena;

/* Zeros, aligned; NULL, and `failed` from then on, where there is no memory. */
void *arena_take(arena *from, size_t n, size_t size);
void arena_free(arena *from);

/* The same in one block that is measured first: with base NULL nothing is given, and `used` grows. */
typedef struct {
    unsigned char *base;
    size_t used;
} block;
void *block_take(block *from, size_t n, size_t size);
