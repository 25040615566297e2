#include "arena.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

struct piece {
    piece *before;
};

static size_t aligned(size_t n) { return (n + ALIGNED - 1) / ALIGNED * ALIGNED; }

void *arena_take(arena *from, size_t n, size_t size) {
    size_t bytes = aligned(n * size + 1);
    from->failed |= size && n > (SIZE_MAX / 2) / size;
    piece *new = from->failed ? NULL : malloc(sizeof *new + ALIGNED + bytes);
    from->failed = !new;
    if (!new) return NULL;
    new->before = from->last;
    from->last = new;
    uintptr_t begin = ((uintptr_t)(new + 1) + ALIGNED - 1) & ~(uintptr_t)(ALIGNED - 1);
    return memset((void *)begin, 0, bytes);
}

void arena_free(arena *from) {
    while (from->last) {
        piece *before = from->last->before;
        free(from->last);
        from->last = before;
    }
}

void *block_take(block *from, size_t n, size_t size) {
    void *at = from->base ? from->base + from->used : NULL;
    from->used += aligned(n * size + 1);
    return at;
}
