/* A texture under a stroke of two seconds that speeds up, as CSV on stdout.
 *
 *     cc stroke.c $(foten doctor --c-flags) -o stroke
 *     ./stroke denim.foten > stroke.csv
 */
#include <stdio.h>
#include <stdlib.h>

#include "foten.h"

enum { BLOCK = 32 }; /* samples that a device asks for at once */

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
    if (foten_abi() != FOTEN_ABI) { /* before any other call: structures may differ */
        fprintf(stderr, "the foten library is of another version than the header that this program was built with\n");
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
    foten_status status = foten_model_load(bytes, n_bytes, &model, why, sizeof why);
    free(bytes);
    if (status != FOTEN_OK) {
        fprintf(stderr, "%s: %s\n", arguments[1], why);
        return 2;
    }
    foten_info info = foten_model_info(model);
    fprintf(stderr, "%s, %s, %g Hz, rendered with %s\n", info.texture, info.model, info.rate_hz, foten_isa());

    double rate_hz = info.rate_hz; /* 48000 for a sound card */
    foten_options options = {0};
    options.rate_hz = rate_hz;
    options.smooth = 1;          /* the condition is set once a block: its steps would be perceptible */
    foten_state *state = foten_state_new(model, &options);
    if (!state) {
        fprintf(stderr, "no memory, or a texture of %g Hz cannot be rendered at %g Hz\n", info.rate_hz, options.rate_hz);
        foten_model_free(model);
        return 1;
    }
    size_t n = (size_t)(2 * rate_hz);
    double slow = info.trained_speed[0], fast = info.trained_speed[1];
    printf("t,speed_mm_s,acceleration_m_s2\n");
    for (size_t first = 0; first < n; first += BLOCK) {
        float samples[BLOCK], speed = (float)(slow + (fast - slow) * (double)first / (double)n);
        size_t n_block = n - first < BLOCK ? n - first : BLOCK;
        foten_set_condition(state, speed, 0.8f);
        foten_render(state, samples, n_block);
        for (size_t i = 0; i < n_block; i++) printf("%g,%g,%g\n", (double)(first + i) / rate_hz, speed, samples[i]);
    }
    foten_stats stats = foten_statistics(state);
    fprintf(stderr, "%llu samples, %llu of them so slow or light that the texture fades\n", (unsigned long long)stats.n,
            (unsigned long long)stats.n_below);
    foten_state_free(state);
    foten_model_free(model);
    return 0;
}
