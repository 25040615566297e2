#include "file.h"

#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_HEADER = 4 * 1000 * 1000 }; /* bytes; those of foten train have 15,000 */

int file_refuse(texture_file *file, foten_status status, const char *format, ...) {
    if (file->status != FOTEN_OK) return 0;
    file->status = status;
    va_list arguments;
    va_start(arguments, format);
    if (file->why) vsnprintf(file->why, file->why_size, format, arguments);
    va_end(arguments);
    return 0;
}

/* Once, since a header is long: the card lies in it. */
static int list_entries(texture_file *file, json header) {
    json name, value;
    file->entries = malloc((json_count(header) + 1) * sizeof *file->entries);
    if (!file->entries) return file_refuse(file, FOTEN_NO_MEMORY, "no memory");
    for (const char *position = NULL; json_next(header, &position, &name, &value);)
        file->entries[file->n_entries++] = (entry){name, value};
    return 1;
}

/* Where a tensor begins and ends among the data, as the header says. */
static int ends_of(json tensor_entry, long long *begin, long long *end) {
    json ends[2];
    return json_items(json_member(tensor_entry, "data_offsets"), ends, 2) == 2 && json_integer(ends[0], begin) &&
           json_integer(ends[1], end);
}

/* A file that was copied in part has its header, which comes first. */
static int check_length(texture_file *file) {
    long long begin, end, last = 0;
    for (size_t i = 0; i < file->n_entries; i++)
        if (ends_of(file->entries[i].value, &begin, &end) && end > last) last = end;
    return (unsigned long long)last <= file->n_data ||
           file_refuse(file, FOTEN_BAD_FILE, "the file holds %zu bytes of tensors, expected %lld: is it truncated?",
                       file->n_data, last);
}

/* What an entry of the header says, the last of that name. */
static json entry_of(const texture_file *file, const char *name) {
    for (size_t i = file->n_entries; i > 0; i--)
        if (json_is_string(file->entries[i - 1].name, name)) return file->entries[i - 1].value;
    return (json){NULL, NULL};
}

int file_open(texture_file *file, const void *bytes, size_t n_bytes, char *why, size_t why_size) {
    *file = (texture_file){.why = why, .why_size = why_size};
    if (why && why_size) why[0] = 0;
    if (!bytes || n_bytes < 9)
        return file_refuse(file, FOTEN_BAD_FILE, "the file has %zu bytes, expected a texture file; is it truncated?",
                           bytes ? n_bytes : 0);
    const unsigned char *text = (const unsigned char *)bytes + 8;
    uint64_t length = 0;
    for (int i = 1; i <= 8; i++) length = length << 8 | text[-i];
    if (!length || length > n_bytes - 8 || length > MAX_HEADER)
        return file_refuse(file, FOTEN_BAD_FILE, "this is not a texture file, or it is truncated");
    json header = json_of((const char *)text, (size_t)length);
    file->data = text + length;
    file->n_data = n_bytes - 8 - (size_t)length;
    if (!header.begin || *header.begin != '{')
        return file_refuse(file, FOTEN_BAD_FILE,
                           "this is not a texture file, or it is damaged: its header is not JSON");
    if (!list_entries(file, header) || !check_length(file)) return 0;
    json written = json_member(entry_of(file, "__metadata__"), "foten");
    if (!written.begin)
        return file_refuse(file, FOTEN_BAD_FILE,
                           "this is a safetensors file without a texture card, expected one written by 'foten train'");
    size_t room = (size_t)(written.end - written.begin);
    file->text = malloc(room);
    if (!file->text) return file_refuse(file, FOTEN_NO_MEMORY, "no memory");
    long long n = json_string(written, file->text, room);
    if (n >= 0) file->card = json_of(file->text, (size_t)n);
    return (file->card.begin && *file->card.begin == '{') || file_refuse(file, FOTEN_BAD_FILE, "the card is not JSON");
}

void file_close(texture_file *file) {
    free(file->text);
    free(file->entries);
}

typedef struct {
    char name[160];
    const unsigned char *data;
    size_t n, width; /* numbers, and bytes of each */
} tensor;

/* Where a tensor lies: nothing is trusted, neither its shape nor its offsets. */
static int locate(const texture_file *file, size_t shape[4], tensor *at) {
    json tensor_entry = entry_of(file, at->name), kind = json_member(tensor_entry, "dtype"), sizes[4];
    int dimensions = json_items(json_member(tensor_entry, "shape"), sizes, 4);
    at->width = json_is_string(kind, "F64") ? 8 : json_is_string(kind, "F32") ? 4 : json_is_string(kind, "U8") ? 1 : 0;
    long long size, begin, end;
    size_t n = 1;
    if (dimensions < 0 || !ends_of(tensor_entry, &begin, &end) || !at->width) return -1;
    for (int i = 0; i < dimensions; i++) {
        if (!json_integer(sizes[i], &size) || size < 0 || size > 1 << 28 ||
            (size && n > (SIZE_MAX >> 8) / (size_t)size))
            return -1;
        shape[i] = (size_t)size;
        n *= shape[i];
    }
    if (begin < 0 || end < begin || (unsigned long long)end > file->n_data) return -1;
    if ((unsigned long long)(end - begin) != (unsigned long long)n * at->width) return -1;
    at->data = file->data + begin;
    at->n = n;
    return dimensions;
}

int file_shape(const texture_file *file, const char *name, size_t shape[4]) {
    tensor at;
    snprintf(at.name, sizeof at.name, "%s", name);
    return locate(file, shape, &at);
}

static double number_at(const tensor *at, size_t i) {
    uint64_t bits = 0;
    for (size_t k = at->width; k > 0; k--) bits = bits << 8 | at->data[i * at->width + k - 1];
    uint32_t half = (uint32_t)bits;
    double x;
    float narrow;
    memcpy(&x, &bits, 8);
    memcpy(&narrow, &half, 4);
    return at->width == 8 ? x : narrow;
}

/* Locate a tensor that has to have a shape. */
static int locate_shaped(texture_file *file, const char *prefix, const char *name, const size_t shape[4], tensor *at) {
    size_t stored[4];
    int expected = 0;
    snprintf(at->name, sizeof at->name, "%s%s", prefix, name);
    int dimensions = locate(file, stored, at);
    if (dimensions < 0)
        return file_refuse(file, FOTEN_BAD_FILE, "the texture file has no tensor '%s', or it is damaged", at->name);
    while (expected < 4 && shape[expected]) expected++;
    if (expected == dimensions && !memcmp(stored, shape, (size_t)dimensions * sizeof *stored)) return 1;
    return file_refuse(file, FOTEN_BAD_FILE, "tensor '%s' has another shape than the card says", at->name);
}

static int copy(texture_file *file, const tensor *at, double *out) {
    if (at->width == 1) return file_refuse(file, FOTEN_BAD_FILE, "tensor '%s' is of bytes, expected floats", at->name);
    for (size_t i = 0; i < at->n; i++) {
        out[i] = number_at(at, i);
        if (!(out[i] - out[i] == 0))
            return file_refuse(file, FOTEN_BAD_FILE, "tensor '%s' holds NaN or infinity", at->name);
    }
    file->n_taken++;
    return 1;
}

double *file_take(texture_file *file, arena *memory, const char *prefix, const char *name, const size_t shape[4]) {
    tensor at;
    if (!locate_shaped(file, prefix, name, shape, &at)) return NULL;
    double *out = arena_take(memory, at.n, sizeof *out);
    if (!out) file_refuse(file, FOTEN_NO_MEMORY, "no memory");
    return out && copy(file, &at, out) ? out : NULL;
}

const unsigned char *file_bytes(texture_file *file, arena *memory, const char *prefix, const char *name,
                                const size_t shape[4]) {
    tensor at;
    if (!locate_shaped(file, prefix, name, shape, &at)) return NULL;
    if (at.width != 1) {
        file_refuse(file, FOTEN_BAD_FILE, "tensor '%s' is of floats, expected bytes", at.name);
        return NULL;
    }
    unsigned char *out = arena_take(memory, at.n, 1);
    if (!out) file_refuse(file, FOTEN_NO_MEMORY, "no memory");
    else memcpy(out, at.data, at.n);
    file->n_taken++;
    return out;
}

int file_copy(texture_file *file, const char *prefix, const char *name, const size_t shape[4], double *out) {
    tensor at;
    return locate_shaped(file, prefix, name, shape, &at) && copy(file, &at, out);
}

int file_has(const texture_file *file, const char *name) { return entry_of(file, name).begin != NULL; }

void file_leave(texture_file *file, const char *name) { file->n_taken += (size_t)file_has(file, name); }

int file_all_taken(texture_file *file, const char *model) {
    size_t n = file->n_entries - 1; /* the card is no tensor */
    return n == file->n_taken ||
           file_refuse(file, FOTEN_BAD_FILE, "the file holds %zu tensors, expected the %zu of '%s'", n, file->n_taken,
                       model);
}
