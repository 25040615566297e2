/* A texture file of any bytes: loading it, and rendering it where it loads, reads and writes nothing that is not its
 * own.
 *
 * Built with FOTEN_FUZZING, which lets a file pass that fails its proof: else nothing but the reader would be reached.
 * With libFuzzer (clang -fsanitize=fuzzer) as it is; with any other compiler FOTEN_STANDALONE gives it a main of its
 * own, which mutates the files that it is given: fuzz_file N FILE... */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "foten.h"

static void expect_finite(const float *samples, size_t n) {
    for (size_t i = 0; i < n; i++)
        if (!isfinite(samples[i])) abort();
}

/* Of a network that is run elsewhere: now and then what is no number. */
static float answer(void *user, const float *window) {
    (void)user;
    float x = 0.9f * window[0] + 0.1f * window[1];
    return x > 0.5f && x < 0.51f ? NAN : x;
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t n) {
    foten_model *model;
    char why[200];
    foten_status status = foten_model_load_with(data, n, answer, NULL, &model, why, sizeof why);
    if ((status == FOTEN_OK) != (model != NULL)) abort();
    if (status != FOTEN_OK && !why[0]) abort();
    if (!model) return 0;
    foten_options options = {n % 2 ? 0 : 3 * foten_model_info(model).rate_hz, n, 0, 0, n % 3 == 0};
    foten_state *state = foten_state_new(model, &options);
    if (state) {
        float out[64];
        for (int i = 0; i < 4; i++) {
            foten_set_condition(state, (float)(i * 1e5), (float)i);
            foten_render(state, out, 16);
            expect_finite(out, 16);
        }
        /* What is asked for in which order and in what sizes, the last bytes say. */
        const foten_actuator coil = {70, 0.25, 2, 0, 5};
        for (size_t i = 0; i < 8 && i < n; i++) {
            float speed[8], force[8], stroke[8 * 400 + 400 + 2];
            size_t asked = data[n - 1 - i] % 8u;
            for (size_t k = 0; k < 8; k++) {
                speed[k] = (float)(40 * k);
                force[k] = data[n - 1 - i];
            }
            switch (data[n - 1 - i] / 8u % 4u) {
            case 0: foten_render(state, out, asked); break;
            case 1:
                if (foten_render_stroke(state, speed, force, asked, stroke) > foten_rendered(state, asked)) abort();
                break;
            case 2: foten_set_actuator(state, asked % 2 ? &coil : NULL); break;
            default: foten_reset(state, asked);
            }
        }
        foten_reset(state, 1);
        foten_stylus *stylus = foten_stylus_new(model, NULL);
        if (stylus) {
            foten_stylus_push(stylus, 1, 2, 0.5, 3);
            foten_stylus_push(stylus, 2, 2, 0.5, 3.01);
            foten_render_stylus(state, stylus, out, 16);
            expect_finite(out, 16);
            foten_stylus_free(stylus);
        }
        foten_state_free(state);
    }
    foten_model_free(model);
    return 0;
}

#ifdef FOTEN_STANDALONE
static uint64_t random_state = 1;
static uint64_t random_number(uint64_t below) {
    random_state = random_state * 6364136223846793005u + 1442695040888963407u;
    return below ? (random_state >> 20) % below : 0;
}

/* A few of: a byte or a number changed, a piece left out, doubled or taken from elsewhere in the file. */
static size_t mutate(uint8_t *data, size_t n, size_t room) {
    for (uint64_t times = 1 + random_number(4); times && n > 16; times--) {
        size_t header = 8 + (size_t)data[0] + ((size_t)data[1] << 8);
        /* Half of the time in the header: its length, the card, where tensors lie. */
        size_t at = (size_t)random_number(random_number(2) && header < n ? header : n),
               length = (size_t)random_number(16);
        switch (random_number(6)) {
        case 0: data[at] ^= (uint8_t)(1u << random_number(8)); break;
        case 1: data[at] = (uint8_t)random_number(256); break;
        case 2: data[at] = (uint8_t)"0123456789-e.,:[]{}\""[random_number(20)]; break;
        case 3:
            if (at + length < n) {
                memmove(data + at, data + at + length, n - at - length);
                n -= length;
            }
            break;
        case 4:
            if (n + length < room && at + length < n) {
                memmove(data + at + length, data + at, n - at);
                n += length;
            }
            break;
        default:
            if (at + length < n) memmove(data + at, data + random_number(n - length), length);
        }
    }
    return random_number(50) ? n : (size_t)random_number(n + 1);
}

int main(int n_arguments, char **arguments) {
    if (n_arguments < 3) {
        fprintf(stderr, "usage: fuzz_file N FILE...\n");
        return 2;
    }
    long n_runs = strtol(arguments[1], NULL, 10), n_loaded = 0;
    enum { ROOM = 1 << 16 };
    static uint8_t files[64][ROOM], data[ROOM];
    size_t sizes[64];
    int n_files = n_arguments - 2 < 64 ? n_arguments - 2 : 64;
    for (int i = 0; i < n_files; i++) {
        FILE *file = fopen(arguments[2 + i], "rb");
        if (!file) return 2;
        sizes[i] = fread(files[i], 1, ROOM, file);
        fclose(file);
        foten_model *model;
        char why[200];
        if (foten_model_load(files[i], sizes[i], &model, why, sizeof why) == FOTEN_OK) n_loaded++;
        else fprintf(stderr, "%s: %s\n", arguments[2 + i], why);
        foten_model_free(model);
    }
    for (long run = 0; run < n_runs; run++) {
        int i = (int)random_number((uint64_t)n_files);
        memcpy(data, files[i], sizes[i]);
        LLVMFuzzerTestOneInput(data, mutate(data, sizes[i], ROOM));
    }
    printf("%d files, %ld of them load; %ld mutations\n", n_files, n_loaded, n_runs);
    return 0;
}
#endif
