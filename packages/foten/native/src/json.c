#include "json.h"

#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum { DEEPEST = 64 };

static const char *space(const char *p, const char *end) {
    while (p < end && (*p == ' ' || *p == '\t' || *p == '\n' || *p == '\r')) p++;
    return p;
}

/* What may follow a backslash but u, and what it stands for. */
static const char ESCAPES[] = "\"\\/bfnrt", ESCAPED[] = "\"\\/\b\f\n\r\t";

static int hex(const char *p, const char *end, unsigned *out) {
    if (end - p < 4) return 0;
    *out = 0;
    for (int i = 0; i < 4; i++) {
        static const char digits[] = "0123456789abcdefABCDEF";
        const char *digit = memchr(digits, p[i], 22);
        if (!digit) return 0;
        *out = *out * 16 + (unsigned)(digit - digits - (digit - digits > 15 ? 6 : 0));
    }
    return 1;
}

/* Each skips what it names and returns where it ends, or NULL where it is not well formed. */
static const char *skip_string(const char *p, const char *end) {
    unsigned code;
    if (p >= end || *p != '"') return NULL;
    for (p++; p < end; p++) {
        if ((unsigned char)*p < 0x20) return NULL;
        if (*p == '"') return p + 1;
        if (*p != '\\') continue;
        if (++p >= end || (*p == 'u' ? !hex(p + 1, end, &code) : !memchr(ESCAPES, *p, 8))) return NULL;
        if (*p == 'u') p += 4;
    }
    return NULL;
}

static const char *digits(const char *p, const char *end) {
    if (p >= end || *p < '0' || *p > '9') return NULL;
    while (p < end && *p >= '0' && *p <= '9') p++;
    return p;
}

static const char *skip_number(const char *p, const char *end) {
    if (p < end && *p == '-') p++;
    if (p < end && *p == '0') p++;
    else if (!(p = digits(p, end))) return NULL;
    if (p < end && *p == '.' && !(p = digits(p + 1, end))) return NULL;
    if (p < end && (*p == 'e' || *p == 'E')) {
        p++;
        if (p < end && (*p == '+' || *p == '-')) p++;
        if (!(p = digits(p, end))) return NULL;
    }
    return p;
}

static const char *skip_word(const char *p, const char *end, const char *word) {
    size_t n = strlen(word);
    return (size_t)(end - p) >= n && !memcmp(p, word, n) ? p + n : NULL;
}

static const char *skip(const char *p, const char *end, int depth);

static const char *skip_list(const char *p, const char *end, int depth, char close) {
    p = space(p + 1, end);
    if (p < end && *p == close) return p + 1;
    while (p && p < end) {
        if (close == '}') {
            if (!(p = skip_string(space(p, end), end))) return NULL;
            p = space(p, end);
            if (p >= end || *p++ != ':') return NULL;
        }
        if (!(p = skip(space(p, end), end, depth + 1))) return NULL;
        p = space(p, end);
        if (p >= end) return NULL;
        if (*p == close) return p + 1;
        if (*p++ != ',') return NULL;
    }
    return NULL;
}

static const char *skip(const char *p, const char *end, int depth) {
    if (p >= end || depth > DEEPEST) return NULL;
    switch (*p) {
    case '{': return skip_list(p, end, depth, '}');
    case '[': return skip_list(p, end, depth, ']');
    case '"': return skip_string(p, end);
    case 't': return skip_word(p, end, "true");
    case 'f': return skip_word(p, end, "false");
    case 'n': return skip_word(p, end, "null");
    default: return skip_number(p, end);
    }
}

json json_of(const char *text, size_t n) {
    const char *end = text + n, *begin = space(text, end), *after = skip(begin, end, 0);
    if (!after || space(after, end) != end) return (json){NULL, NULL};
    return (json){begin, after};
}

int json_next(json list, const char **position, json *name, json *value) {
    if (!list.begin || (*list.begin != '{' && *list.begin != '[')) return 0;
    const char *p = space(*position ? *position : list.begin + 1, list.end);
    if (p >= list.end || *p == '}' || *p == ']') return 0;
    if (*p == ',') p = space(p + 1, list.end);
    if (*list.begin == '{') {
        const char *after = skip_string(p, list.end);
        if (!after) return 0;
        if (name) *name = (json){p, after};
        p = space(space(after, list.end) + 1, list.end);
    }
    const char *after = skip(p, list.end, 0);
    if (!after) return 0;
    *value = (json){p, after};
    *position = after;
    return 1;
}

json json_member(json object, const char *name) {
    json member = {NULL, NULL}, key, value;
    const char *position = NULL;
    if (!object.begin || *object.begin != '{') return member;
    while (json_next(object, &position, &key, &value))
        if (json_is_string(key, name)) member = value;
    return member;
}

size_t json_count(json list) {
    json value;
    const char *position = NULL;
    size_t n = 0;
    while (json_next(list, &position, NULL, &value)) n++;
    return n;
}

int json_items(json list, json *out, int room) {
    json item;
    const char *position = NULL;
    int n = 0;
    if (!list.begin || *list.begin != '[') return -1;
    while (json_next(list, &position, NULL, &item)) {
        if (n == room) return -1;
        out[n++] = item;
    }
    return n;
}

/* Decimal to binary without strtod, which reads another decimal point in some countries. Exact where mantissa and power
 * are. */
int json_number(json value, double *out) {
    if (!value.begin || (*value.begin != '-' && (*value.begin < '0' || *value.begin > '9'))) return 0;
    char text[64] = {0};
    size_t n = (size_t)(value.end - value.begin);
    if (n >= sizeof text) return 0;
    memcpy(text, value.begin, n);
    uint64_t mantissa = 0;
    int power = 0, digits_so_far = 0, negative = text[0] == '-';
    const char *p = text + negative;
    for (int after_point = 0; (*p >= '0' && *p <= '9') || *p == '.'; p++) {
        if (*p == '.') {
            after_point = 1;
            continue;
        }
        if (digits_so_far < 19) {
            mantissa = mantissa * 10 + (uint64_t)(*p - '0');
            if (mantissa) digits_so_far++;
            power -= after_point;
        } else {
            power += !after_point;
        }
    }
    if (*p == 'e' || *p == 'E') power += (int)strtol(p + 1, NULL, 10) % 100000;
    long double x = (long double)mantissa;
    while (power && x > 0 && x < 1e400L) { /* powers up to 27 are exact where a long double has 64 bits */
        int step = power > 27 ? 27 : power < -27 ? -27 : power;
        long double ten = 1;
        for (int i = 0; i < abs(step); i++) ten *= 10;
        x = step < 0 ? x / ten : x * ten;
        power -= step;
    }
    double result = (double)(negative ? -x : x);
    if (!(result - result == 0)) return 0;
    *out = result;
    return 1;
}

int json_integer(json value, long long *out) {
    double number;
    if (!json_number(value, &number) || number < -9007199254740992.0 || number > 9007199254740992.0) return 0;
    for (const char *p = value.begin; p < value.end; p++)
        if (strchr(".eE", *p)) return 0;
    *out = (long long)number;
    return 1;
}

int json_boolean(json value, int *out) {
    if (!value.begin || (*value.begin != 't' && *value.begin != 'f')) return 0;
    *out = *value.begin == 't';
    return 1;
}

int json_is_string(json value, const char *text) {
    size_t n = strlen(text);
    return value.begin && *value.begin == '"' && (size_t)(value.end - value.begin) == n + 2 &&
           !memcmp(value.begin + 1, text, n);
}

static size_t utf8(unsigned code, char *out) {
    static const unsigned FIRST[] = {0, 0, 0xC0, 0xE0, 0xF0};
    size_t n = code < 0x80 ? 1 : code < 0x800 ? 2 : code < 0x10000 ? 3 : 4;
    for (size_t i = n - 1; i > 0; i--, code >>= 6) out[i] = (char)(0x80 | (code & 0x3F));
    out[0] = (char)(FIRST[n] | code);
    return n;
}

/* What \uXXXX stands for, or two of them that are a pair; *p is at the u, and moves on. */
static unsigned code_point(const char **p, const char *end) {
    unsigned code, low;
    hex(*p + 1, end, &code);
    *p += 5;
    if (code < 0xD800 || code >= 0xE000) return code;
    int paired = code < 0xDC00 && end - *p >= 6 && (*p)[0] == '\\' && (*p)[1] == 'u' && hex(*p + 2, end, &low);
    if (!paired || low < 0xDC00 || low >= 0xE000) return 0xFFFD;
    *p += 6;
    return 0x10000 + ((code - 0xD800) << 10) + (low - 0xDC00);
}

long long json_string(json value, char *out, size_t size) {
    if (!value.begin || *value.begin != '"') return -1;
    size_t n = 0;
    for (const char *p = value.begin + 1, *end = value.end - 1; p < end;) {
        char piece[4] = {*p++};
        size_t length = 1;
        if (piece[0] == '\\' && *p == 'u') length = utf8(code_point(&p, end), piece);
        else if (piece[0] == '\\') piece[0] = ESCAPED[strchr(ESCAPES, *p++) - ESCAPES];
        if (n + length >= size) return -1;
        memcpy(out + n, piece, length);
        n += length;
    }
    if (n >= size) return -1;
    out[n] = 0;
    return (long long)n;
}
