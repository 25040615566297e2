/* A texture file in memory: its tensors and its card, checked. */
#ifndef FOTEN_FILE_H
#define FOTEN_FILE_H
#include <stddef.h>

#include "arena.h"
#include "foten.h"
#include "json.h"

/* An entry of the header: its name, quoted, and what it says. */
typedef struct { json name, value; } entry;

typedef struct {
    const unsigned char *bytes; /* the file */
    size_t n_bytes;
    const unsigned char *data;  /* where the tensors lie */
    size_t n_data;
    json header;
    entry *entries;             /* of the header, owned */
    size_t n_entries;
    char *text;                 /* of the card, owned */
    json card;
    char *why;
    size_t why_size;
    size_t n_taken;             /* tensors that something asked for */
} texture_file;

foten_status file_open(texture_file *file, const void *bytes, size_t n_bytes, char *why, size_t why_size);
void file_close(texture_file *file);

/* Say why, and return the status. */
foten_status file_refuse(texture_file *file, foten_status status, const char *format, ...)
#if defined(__GNUC__)
    __attribute__((format(printf, 3, 4)))
#endif
    ;

/* The numbers of a tensor of that shape (dimensions up to the first 0), or NULL and a reason: it is missing, of another shape, holds
 * what is not finite, or there is no memory. */
double *file_take(texture_file *file, const char *name, const size_t shape[4], arena *memory);

/* The shape of a tensor, its dimensions counted; -1 where there is none. */
int file_shape(const texture_file *file, const char *name, size_t shape[4]);

/* Count a tensor as taken that somebody else reads, where there is one. */
void file_leave(texture_file *file, const char *name);

/* Whether every tensor was taken once; if not, a reason that names the model. */
int file_all_taken(texture_file *file, const char *model);
#endif
