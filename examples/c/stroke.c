/* A texture under a stroke that speeds up, as CSV on stdout.
 *
 *     cc stroke.c -I ../../native/include -L ../../build -Wl,-rpath,../../build -lfoten -lm -o stroke
 *     ./stroke denim.foten > stroke.csv
 */
#include <stdio.h>
#include <stdlib.h>

#include "foten.h"

static void *read_file(const char *name, size_t *n) {
    FILE *file = fopen(name, "rb");
    if (!file) return NULL;
    fseek(file, 0, SEEK_END);
    *n = (size_t)ftell(file);
    rewind(file);
    void *bytes = malloc(*n ? *n : 1);
    if (bytes) *n = fread(bytes, 1, *n, file);
    fclose(file);
    return bytes;
}

int main(int n_arguments, char **arguments) {
    if (n_arguments != 2) {
        fprintf(stderr, "usage: stroke TEXTURE.foten\n");
        return 2;
    }
    size_t n_bytes;
    void *bytes = read_file(arguments[1], &n_bytes);
    if (!bytes) {
        fprintf(stderr, "%s: cannot be read\n", arguments[1]);
        return 2;
    }
    foten_model *model;
    char why[256];
    if (foten_model_load(bytes, n_bytes, &model, why, sizeof why) != FOTEN_OK) {
        fprintf(stderr, "%s: %s\n", arguments[1], why);
        return 2;
    }
    free(bytes);
    foten_info info = foten_model_info(model);
    fprintf(stderr, "%s, %s, %g Hz, rendered with %s\n", info.texture, info.model, info.rate_hz, foten_isa());

    foten_state *state = foten_state_new(model, NULL);
    if (!state) return 1;
    enum { BLOCK = 20, BLOCKS = 100 };
    float samples[BLOCK];
    printf("t,speed_mm_s,acceleration_m_s2\n");
    for (int b = 0; b < BLOCKS; b++) {
        float speed = (float)(info.trained_speed[0] + (info.trained_speed[1] - info.trained_speed[0]) * b / BLOCKS);
        foten_set_condition(state, speed, 0.8f);
        foten_render(state, samples, BLOCK);
        for (int i = 0; i < BLOCK; i++) printf("%g,%g,%g\n", (b * BLOCK + i) / info.rate_hz, speed, samples[i]);
    }
    foten_stats stats = foten_statistics(state);
    fprintf(stderr, "%llu samples, %llu of them below the trained range, where the texture fades\n", (unsigned long long)stats.n,
            (unsigned long long)stats.n_below);
    foten_state_free(state);
    foten_model_free(model);
    return 0;
}
