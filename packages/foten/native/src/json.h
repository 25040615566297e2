/* JSON in memory, read in place: a value is where it begins and ends. Nothing is allocated. */
#pragma once
#include <stddef.h>

typedef struct {
    const char *begin, *end;
} json; /* begin is NULL where there is none */

/* The value that a text is, if the text is nothing but one well-formed value, no deeper than 64. */
json json_of(const char *text, size_t n);

/* A member of an object, the last of that name; none for anything else. Names are compared as they are written, escapes
 * included. */
json json_member(json object, const char *name);

/* The items of an array, or the members of an object, one after the other: *position begins at NULL. */
int json_next(json list, const char **position, json *name, json *value);

int json_number(json value, double *out);     /* 1 if it is a finite number */
int json_integer(json value, long long *out); /* 1 if it is an integer, written as one, within +-2^53 */
int json_boolean(json value, int *out);
int json_is_string(json value, const char *text);
/* Copy a string, its escapes undone, as UTF-8 with a zero at the end; returns its length, or -1 where it is none or is
 * too long. */
long long json_string(json value, char *out, size_t size);
size_t json_count(json list);
int json_items(json list, json *out, int room); /* of an array of at most `room`: how many; -1 for anything else */
