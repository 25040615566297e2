/* After construction nothing is allocated: hot_path FILE... counts what rendering asks for, and that it would be
 * counted. A state asks for as much memory as foten_info says, and a file is not blamed for memory that there is not.
 *
 * Linked with --wrap=malloc and so on, so that every call of the library's goes through here. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "foten.h"

static long n_calls, n_asked, failing = -1; /* failing: which of those that ask gets nothing */
static size_t asked;
static int refused(size_t n) {
    n_calls++;
    asked = n;
    return n_asked++ == failing;
}

void *__real_malloc(size_t n);
void *__real_calloc(size_t n, size_t size);
void *__real_realloc(void *p, size_t n);
void __real_free(void *p);
void *__wrap_malloc(size_t n) { return refused(n) ? NULL : __real_malloc(n); }
void *__wrap_calloc(size_t n, size_t size) { return refused(n * size) ? NULL : __real_calloc(n, size); }
void *__wrap_realloc(void *p, size_t n) { return refused(n) ? NULL : __real_realloc(p, n); }
void __wrap_free(void *p) {
    n_calls++;
    __real_free(p);
}

static int failed(const char *path, const char *what, long n, const char *why) {
    fprintf(stderr, "%s: %s (%ld) %s\n", path, what, n, why);
    return 1;
}

int main(int n_arguments, char **arguments) {
    static unsigned char bytes[1 << 24];
    static float out[4096], speed[1024], force[1024];
    for (int i = 1; i < n_arguments; i++) {
        FILE *file = fopen(arguments[i], "rb");
        if (!file) return 2;
        size_t n = fread(bytes, 1, sizeof bytes, file);
        fclose(file);
        char why[256];
        foten_model *model;
        n_calls = n_asked = 0;
        if (foten_model_load(bytes, n, &model, why, sizeof why) != FOTEN_OK)
            return failed(arguments[i], "does not load", (long)n, why);
        if (n_calls == 0)
            return failed(arguments[i], "the counter does not notice what loading allocates", n_calls, "");
        for (long k = 0, n_times = n_asked; k < n_times; k++) {
            foten_model *none;
            failing = k;
            n_asked = 0;
            foten_status status = foten_model_load(bytes, n, &none, why, sizeof why);
            failing = -1;
            if (status != FOTEN_NO_MEMORY || strcmp(why, "no memory"))
                return failed(arguments[i], "said without a piece of memory", k, why);
        }
        foten_options options = {8 * foten_model_info(model).rate_hz, 0, 0, 0, 0};
        foten_state *own = foten_state_new(model, NULL);
        if (asked != foten_model_info(model).state_bytes)
            return failed(arguments[i], "bytes are not what foten_info says", (long)asked, "");
        foten_state *other = foten_state_new(model, &options);
        foten_stylus *stylus = foten_stylus_new(model, NULL);
        foten_actuator actuator = {70, 0.25, 2, 0, 5};
        for (int k = 0; k < 1024; k++) {
            speed[k] = (float)k;
            force[k] = 1;
        }
        n_calls = 0;
        foten_set_actuator(other, &actuator);
        for (int k = 0; k < 8; k++) {
            foten_set_condition(own, (float)(50 * k), 0.5f * (float)k);
            foten_render(own, out, 512);
            foten_render(other, out, 512);
            foten_stylus_push(stylus, k, k, 0.4, 0.01 * k);
            foten_render_stylus(other, stylus, out, 64);
        }
        foten_render_stroke(own, speed, force, 1024, out);
        foten_reset(own, 3);
        foten_statistics(own);
        if (n_calls) return failed(arguments[i], "allocations while rendering", n_calls, "");
        foten_stylus_free(stylus);
        foten_state_free(own);
        foten_state_free(other);
        foten_model_free(model);
    }
    printf("nothing allocated while rendering %d files\n", n_arguments - 1);
    return 0;
}
