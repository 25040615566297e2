/* A texture file in memory: its tensors and its card, checked. */
#pragma once
#include "arena.h"
#include "foten.h"
#include "json.h"

/* An entry of the header: its name, quoted, and what it says. */
typedef struct {
    json name, value;
} entry;

typedef struct {
    foten_status status; /* what was wrong first, and in `why` the reason */
    char *why;
    size_t why_size;
    const unsigned char *data; /* where the tensors lie */
    size_t n_data;
    entry *entries; /* of the header, owned */
    size_t n_entries;
    char *text; /* of the card, owned */
    json card;
    size_t n_taken; /* tensors that something asked for */
} texture_file;

/* What returns an int here and below returns 0, what returns a pointer NULL, where the file is refused: status and
 * reason are in it then. */
int file_open(texture_file *file, const void *bytes, size_t n_bytes, char *why, size_t why_size);
void file_close(texture_file *file);

/* Returns 0; the first reason is the one. */
__attribute__((format(printf, 3, 4))) int file_refuse(texture_file *file, foten_status status, const char *format, ...);

/* The numbers of the tensor `prefix` `name`, which has that shape (dimensions up to the first 0) and holds only finite
 * ones. */
double *file_take(texture_file *file, arena *memory, const char *prefix, const char *name, const size_t shape[4]);

/* The same, copied. */
int file_copy(texture_file *file, const char *prefix, const char *name, const size_t shape[4], double *out);

/* The bytes of a tensor of that shape. */
const unsigned char *file_bytes(texture_file *file, arena *memory, const char *prefix, const char *name,
                                const size_t shape[4]);

/* The shape of a tensor, its dimensions counted; -1 where there is none. */
int file_shape(const texture_file *file, const char *name, size_t shape[4]);

int file_has(const texture_file *file, const char *name);

/* Count a tensor as taken that somebody else reads, where there is one. */
void file_leave(texture_file *file, const char *name);

/* Whether every tensor was taken once; the reason names the model. */
int file_all_taken(texture_file *file, const char *model);
