/* Many states on one core: contacts FILE SHARE SECONDS TICK_US holds as many states as fit in SHARE of a tick, and
 * counts late ticks.
 *
 * At each tick every state renders the samples of its texture that are due. Seconds take turns with seconds in which
 * the loop only waits as long as rendering takes, by the same clock: what those miss is the machine's. Prints one line
 * of JSON. */
#define _POSIX_C_SOURCE 200809L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "foten.h"

enum { TIMED = 4000 };

static int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

static void sleep_until(int64_t due) {
    struct timespec t = {due / 1000000000, due % 1000000000};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &t, NULL) != 0) {}
}

static int by_size(const void *a, const void *b) {
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return x < y ? -1 : x > y;
}

static void render(foten_state **states, int n, int samples, double t, const foten_info *info) {
    float out[256];
    for (int i = 0; i < n; i++) {
        double share = 0.5 - 0.4 * cos(3.1 * t + i);
        foten_set_condition(
            states[i], (float)(info->trained_speed[0] + share * (info->trained_speed[1] - info->trained_speed[0])),
            (float)(info->trained_force[0] + (1 - share) * (info->trained_force[1] - info->trained_force[0])));
        foten_render(states[i], out, (size_t)samples);
    }
}

int main(int n_arguments, char **arguments) {
    if (n_arguments != 5) {
        fprintf(stderr, "contacts FILE SHARE SECONDS TICK_US\n");
        return 2;
    }
    static unsigned char bytes[1 << 24];
    FILE *file = fopen(arguments[1], "rb");
    if (!file) {
        perror(arguments[1]);
        return 2;
    }
    size_t size = fread(bytes, 1, sizeof bytes, file);
    fclose(file);
    char why[256];
    foten_model *model;
    if (foten_model_load(bytes, size, &model, why, sizeof why) != FOTEN_OK) {
        fprintf(stderr, "%s\n", why);
        return 1;
    }
    foten_info info = foten_model_info(model);
    double share = atof(arguments[2]);
    int seconds = atoi(arguments[3]);
    int64_t tick = (int64_t)(1000 * atof(arguments[4]));
    int samples = (int)(info.rate_hz * (double)tick * 1e-9 + 0.5);
    if (samples < 1 || samples > 256 || share < 0 || share > 1 || seconds < 2) {
        fprintf(stderr,
                "a tick of %g us has %d samples of the texture, expected 1 to 256; share 0 to 1; 2 seconds or more\n",
                1e-3 * (double)tick, samples);
        return 2;
    }
    /* How long one state takes for a tick. */
    foten_state *first = foten_state_new(model, NULL);
    static int64_t took[TIMED];
    for (int k = 0; k < TIMED; k++) {
        int64_t begin = now_ns();
        render(&first, 1, samples, 1e-9 * (double)tick * k, &info);
        took[k] = now_ns() - begin;
    }
    qsort(took, TIMED, sizeof *took, by_size);
    double p50 = (double)took[TIMED / 2];
    int n = (int)(share * (double)tick / p50);
    if (n < 1) n = 1; /* SHARE 0 asks for one state */
    foten_state **states = malloc((size_t)n * sizeof *states);
    for (int i = 0; states && i < n; i++) {
        foten_options options = {0, 0, (uint64_t)i, 0};
        states[i] = foten_state_new(model, &options);
        if (!states[i]) states = NULL;
    }
    if (!states) {
        fprintf(stderr, "no memory for %d states\n", n);
        return 1;
    }
    long ticks[2] = {0, 0}, missed[2] = {0, 0};
    int64_t worked = 0, rounds = 0;
    int64_t due = now_ns() + tick;
    int per_second = (int)(1000000000 / tick);
    for (int second = 0; second < 2 * seconds; second++) {
        int empty = second % 2;
        /* In the first second what an empty one has to last becomes known. */
        int64_t lasts = rounds ? worked / rounds : 0;
        for (int k = 0; k < per_second; k++) {
            sleep_until(due);
            int64_t begin = now_ns();
            if (empty)
                while (now_ns() - begin < lasts) {}
            else {
                render(states, n, samples, 1e-9 * (double)begin, &info);
                worked += now_ns() - begin;
                rounds++;
            }
            int64_t end = now_ns(), gone = (end - due) / tick; /* deadlines that passed before it was done */
            ticks[empty] += (long)gone + 1;
            missed[empty] += (long)gone;
            due += (gone + 1) * tick;
        }
    }
    printf("{\"isa\": \"%s\", \"p50_us\": %.3f, \"tick_us\": %.1f, \"contacts\": %.1f, \"n_states\": %d, \"mean_us\": "
           "%.2f, \"n_ticks\": %ld, \"n_missed\": %ld, "
           "\"n_empty_ticks\": %ld, \"n_empty_missed\": %ld}\n",
           foten_isa(), 1e-3 * p50, 1e-3 * (double)tick, (double)tick / p50, n, 1e-3 * (double)worked / (double)rounds,
           ticks[0], missed[0], ticks[1], missed[1]);
    for (int i = 0; i < n; i++) foten_state_free(states[i]);
    free(states);
    foten_state_free(first);
    foten_model_free(model);
    return 0;
}
