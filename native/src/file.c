#include "file.h"

#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LONGEST_HEADER = 4 * 1000 * 1000 };

foten_status file_refuse(texture_file *file, foten_status status, const char *format, ...) {
    if (file->why && file->why_size) {
        va_list arguments;
        va_start(arguments, format);
        vsnprintf(file->why, file->why_size, format, arguments);
        va_end(arguments);
        file->why = NULL; /* the first reason is the one */
    }
    return status;
}

/* Once, since a header is long: the card lies in it. */
static int list_entries(texture_file *file) {
    json name, value;
    size_t n = json_count(file->header);
    file->entries = malloc((n + 1) * sizeof *file->entries);
    if (!file->entries) return 0;
    for (const char *position = NULL; json_next(file->header, &position, &name, &value);) file->entries[file->n_entries++] = (entry){name, value};
    return 1;
}

/* What an entry of the header says, the last of that name. */
static json entry_of(const texture_file *file, const char *name) {
    size_t n = strlen(name);
    for (size_t i = file->n_entries; i > 0; i--) {
        const entry *e = &file->entries[i - 1];
        if ((size_t)(e->name.end - e->name.begin) == n + 2 && !memcmp(e->name.begin + 1, name, n)) return e->value;
    }
    return (json){NULL, NULL};
}

foten_status file_open(texture_file *file, const void *bytes, size_t n_bytes, char *why, size_t why_size) {
    memset(file, 0, sizeof *file);
    file->why = why;
    file->why_size = why_size;
    if (why && why_size) why[0] = 0;
    if (!bytes || n_bytes < 9)
        return file_refuse(file, FOTEN_BAD_FILE, "the file has %zu bytes, expected a texture file; is it truncated?", bytes ? n_bytes : 0);
    file->bytes = bytes;
    file->n_bytes = n_bytes;
    uint64_t length = 0;
    for (int i = 7; i >= 0; i--) length = length << 8 | file->bytes[i];
    if (!length || length > n_bytes - 8 || length > LONGEST_HEADER)
        return file_refuse(file, FOTEN_BAD_FILE, "this is not a texture file, or it is truncated");
    file->header = json_of((const char *)file->bytes + 8, (size_t)length);
    file->data = file->bytes + 8 + length;
    file->n_data = n_bytes - 8 - (size_t)length;
    if (!file->header.begin || *file->header.begin != '{')
        return file_refuse(file, FOTEN_BAD_FILE, "this is not a texture file, or it is damaged: its header is not JSON");
    if (!list_entries(file)) return file_refuse(file, FOTEN_NO_MEMORY, "no memory");
    json written = json_member(entry_of(file, "__metadata__"), "foten");
    if (!written.begin)
        return file_refuse(file, FOTEN_BAD_FILE, "this is a safetensors file without a texture card, expected one written by 'foten train'");
    size_t room = (size_t)(written.end - written.begin);
    file->text = malloc(room);
    if (!file->text) return file_refuse(file, FOTEN_NO_MEMORY, "no memory");
    long long n = json_string(written, file->text, room);
    file->card = n < 0 ? (json){NULL, NULL} : json_of(file->text, (size_t)n);
    if (!file->card.begin || *file->card.begin != '{') return file_refuse(file, FOTEN_BAD_FILE, "the card is not JSON");
    return FOTEN_OK;
}

void file_close(texture_file *file) {
    free(file->text);
    free(file->entries);
    file->text = NULL;
    file->entries = NULL;
    file->n_entries = 0;
}

typedef struct { const unsigned char *data; size_t n; int wide; } place;

/* Where a tensor lies: nothing is trusted, neither its shape nor its offsets. */
static int locate(const texture_file *file, const char *name, size_t shape[4], place *at) {
    json tensor = entry_of(file, name), sizes = json_member(tensor, "shape"), offsets = json_member(tensor, "data_offsets"), item;
    json kind = json_member(tensor, "dtype");
    int dimensions = 0;
    size_t n = 1;
    const char *position = NULL;
    if (!tensor.begin || !sizes.begin || *sizes.begin != '[') return -1;
    while (json_next(sizes, &position, NULL, &item)) {
        long long size;
        if (dimensions == 4 || !json_integer(item, &size) || size < 0 || size > 1 << 28) return -1;
        shape[dimensions++] = (size_t)size;
        if (size && n > (SIZE_MAX >> 8) / (size_t)size) return -1;
        n *= (size_t)size;
    }
    long long ends[2];
    int i = 0;
    for (position = NULL; json_next(offsets, &position, NULL, &item); i++)
        if (i == 2 || !json_integer(item, &ends[i])) return -1;
    int wide = json_is_string(kind, "F64");
    if (i != 2 || (!wide && !json_is_string(kind, "F32"))) return -1;
    if (ends[0] < 0 || ends[1] < ends[0] || (unsigned long long)ends[1] > file->n_data) return -1;
    if ((unsigned long long)(ends[1] - ends[0]) != (unsigned long long)n * (wide ? 8 : 4)) return -1;
    at->data = file->data + ends[0];
    at->n = n;
    at->wide = wide;
    return dimensions;
}

int file_shape(const texture_file *file, const char *name, size_t shape[4]) {
    place at;
    return locate(file, name, shape, &at);
}

static double number_at(const place *at, size_t i) {
    uint64_t bits = 0;
    int size = at->wide ? 8 : 4;
    for (int k = size - 1; k >= 0; k--) bits = bits << 8 | at->data[i * (size_t)size + (size_t)k];
    if (at->wide) {
        double x;
        memcpy(&x, &bits, 8);
        return x;
    }
    uint32_t half = (uint32_t)bits;
    float x;
    memcpy(&x, &half, 4);
    return x;
}

double *file_take(texture_file *file, const char *name, const size_t shape[4], arena *memory) {
    size_t stored[4];
    place at;
    int dimensions = locate(file, name, stored, &at), expected = 0;
    if (dimensions < 0) {
        file_refuse(file, FOTEN_BAD_FILE, "the texture file has no tensor '%s', or it is damaged", name);
        return NULL;
    }
    while (expected < 4 && shape[expected]) expected++;
    int same = expected == dimensions;
    for (int i = 0; same && i < dimensions; i++) same = stored[i] == shape[i];
    if (!same) {
        file_refuse(file, FOTEN_BAD_FILE, "tensor '%s' has another shape than the card says", name);
        return NULL;
    }
    double *out = arena_take(memory, at.n, sizeof *out);
    if (!out) {
        file_refuse(file, FOTEN_NO_MEMORY, "no memory");
        return NULL;
    }
    for (size_t i = 0; i < at.n; i++) {
        out[i] = number_at(&at, i);
        if (!(out[i] - out[i] == 0)) {
            file_refuse(file, FOTEN_BAD_FILE, "tensor '%s' holds NaN or infinity", name);
            return NULL;
        }
    }
    file->n_taken++;
    return out;
}

void file_leave(texture_file *file, const char *name) {
    if (entry_of(file, name).begin) file->n_taken++;
}

int file_all_taken(texture_file *file, const char *model) {
    size_t n = file->n_entries;
    if (n == file->n_taken + 1) return 1; /* and the card */
    file_refuse(file, FOTEN_BAD_FILE, "the file holds %zu tensors, expected the %zu of '%s'", n - 1, file->n_taken, model);
    return 0;
}
