/* foten: haptic textures in real time. A condition (speed and force) goes in, vibration comes out.
 *
 *     foten_model *model;
 *     char why[256];
 *     if (foten_model_load(bytes, n_bytes, &model, why, sizeof why) != FOTEN_OK) { puts(why); return 1; }
 *     foten_state *state = foten_state_new(model, NULL);     // allocates, once
 *     if (!state) { puts("no memory, or a rate that cannot be"); return 1; }
 *
 *     foten_set_condition(state, 80.0f, 0.8f);               // mm/s and N; from any thread; does not wait
 *     foten_render(state, samples, n);                       // m/s2; does not allocate, lock, log or touch files
 *
 *     foten_state_free(state);
 *     foten_model_free(model);
 *
 * A model is a texture file (.foten), checked and ready to run. It never changes. Any number of states on any threads
 * may share it, and it must outlive them. A state is one rendering of it. `foten_set_condition` and `foten_statistics`
 * may be called from any thread; all other functions of a state from one thread at a time. Where a pointer is NULL that
 * the comment does not allow to be, a function has no effect and returns FOTEN_BAD_ARGUMENT, NULL or zeros.
 *
 * Units: acceleration m/s2, speed mm/s, force N, rates Hz. "Scaled" means less the mean and over the standard deviation
 * in the file's card.
 *
 * Noise: sample n of stream s under seed k is one number, the same in every language and on every processor.
 * (w0..w3) = Philox4x32-10 of counter (n mod 2^32, n div 2^32, s mod 2^32, s div 2^32) and key (k mod 2^32, k div 2^32)
 * (Salmon et al., SC 2011). Let t be the sum of the eight 16-bit halves of w0..w3, x = (t - 262140) / sqrt(8 (2^32 - 1)
 * / 12) and g = x (0.97846856 + 0.00750807 x^2): zero mean, unit variance, kurtosis 3, |g| < 5.68. Samples from 2^63 on
 * are used to begin a stream.
 *
 * The same model, seed and conditions give the same bytes, whatever the block sizes, in one build with one mathematical
 * library; of a network of windows, as the paper's, on one instruction set too. Else the last digits differ.
 */
#ifndef FOTEN_H
#define FOTEN_H

#include <stddef.h>
#include <stdint.h>

#if defined(_WIN32) && defined(FOTEN_BUILDING)
#define FOTEN_API __declspec(dllexport)
#elif defined(_WIN32) && !defined(FOTEN_STATIC)
#define FOTEN_API __declspec(dllimport)
#elif defined(__GNUC__)
#define FOTEN_API __attribute__((visibility("default")))
#else
#define FOTEN_API
#endif

#ifdef __cplusplus
extern "C" {
#endif

#define FOTEN_VERSION "0.1.0"
#define FOTEN_VERSION_MAJOR 0
#define FOTEN_VERSION_MINOR 1
/* Of this header's structures and functions; foten_abi() has to be the same: compare them before anything else. */
#define FOTEN_ABI 7

typedef struct foten_model foten_model;
typedef struct foten_state foten_state;

typedef enum {
    FOTEN_OK = 0,
    FOTEN_BAD_FILE = 1,     /* not a texture file, damaged, or of another format version */
    FOTEN_BAD_ARGUMENT = 2, /* a speed, force, rate or pointer is invalid */
    FOTEN_NO_MEMORY = 3,
    FOTEN_NO_PROOF = 4,    /* this processor does not reproduce the golden windows in the file */
    FOTEN_NO_PREDICTOR = 5 /* the file holds a graph: use foten_model_load_with */
} foten_status;

/* The library's FOTEN_ABI and FOTEN_VERSION, and the instruction set in use: "avx512", "avx2", "neon", "simd128" or
 * "portable". The environment variable FOTEN_ISA selects another one that the processor has; set it before the first
 * call. */
FOTEN_API int foten_abi(void);
FOTEN_API const char *foten_version(void);
FOTEN_API const char *foten_isa(void);

typedef struct {
    const char *model;       /* family: "foten", "foten-plus", ... */
    const char *texture;     /* name; both strings live as long as the model */
    double rate_hz;          /* the texture's own sample rate */
    int window;              /* samples that a prediction is given */
    int has_excitation;      /* whether there is a random part that the library draws */
    double trained_speed[2]; /* mm/s, lowest and highest recorded */
    double trained_force[2]; /* N */
    double acceleration_sd;  /* m/s2, standard deviation of the recording */
    double lowpass_hz;       /* cutoff of the low-pass on the recorded speed and force */
    size_t state_bytes;      /* memory of a state at the texture's own rate */
    int asks_predictor;      /* whether a foten_predictor is asked for each sample */
} foten_info;

/* Load a texture file from memory. The bytes may be freed afterwards. The file is checked and its golden windows are
 * replayed, which takes milliseconds. On failure *model is NULL and `why` holds one line for people, cut to `why_size`
 * bytes; `why` may be NULL. */
FOTEN_API foten_status foten_model_load(const void *bytes, size_t n_bytes, foten_model **model, char *why,
                                        size_t why_size);
FOTEN_API void foten_model_free(foten_model *model);

/* Load a file whose network this library has no code for, an ONNX graph. The caller runs it: `predictor` is given a
 * window of `window` samples, oldest first, of four numbers each: acceleration, speed and force, scaled, and the noise
 * of the sample, standard normal; it returns the next sample, scaled. It is called for the golden windows during
 * loading, and for each sample by each rendering thread, by several threads at once where several render. It and `user`
 * must outlive the model. It may allocate or wait; the rendering then does too. A number that is not finite counts as
 * 0. Without a predictor such a file is FOTEN_NO_PREDICTOR. For other files the predictor is not used. */
#define FOTEN_PREDICTOR_INPUTS 4
typedef float (*foten_predictor)(void *user, const float *window);
FOTEN_API foten_status foten_model_load_with(const void *bytes, size_t n_bytes, foten_predictor predictor, void *user,
                                             foten_model **model, char *why, size_t why_size);
FOTEN_API foten_info foten_model_info(const foten_model *model);

typedef struct {
    double rate_hz;    /* of the output: 0 for the texture's own, or 1/20 of it to 400 times it; see foten_delay_s */
    uint64_t seed;     /* of the noise */
    uint64_t stream;   /* of the noise; streams are independent */
    int deterministic; /* 1: no random part */
    int smooth;        /* 1: low-pass conditions at foten_info.lowpass_hz, as the recording; see foten_set_condition */
} foten_options;

/* Make a state. NULL options are all zeros. Returns NULL if there is no memory, the model is NULL, or options->rate_hz
 * is none of these: 0, or from foten_info.rate_hz / 20 to 400 foten_info.rate_hz. A texture of 10 kHz has states from
 * 500 Hz to 4 MHz. */
FOTEN_API foten_state *foten_state_new(const foten_model *model, const foten_options *options);
FOTEN_API void foten_state_free(foten_state *state);

/* Begin again, as a new state with this seed; the condition and the actuator stay. A state begins as if its first
 * condition had lasted for a long time, with random initial values; so does the low-pass of `smooth`. A deterministic
 * state, or a model without a random part, begins with the window in the file. The first sample of a network of windows
 * with an excitation takes as many of its steps as a window is long. */
FOTEN_API void foten_reset(foten_state *state, uint64_t seed);

/* Go on from a recorded window: foten_info.window samples of acceleration, speed and force, all finite; their noise
 * counts as 0. */
FOTEN_API foten_status foten_start(foten_state *state, const float *acceleration, const float *speed_mm_s,
                                   const float *force_n);

/* The closed loop alone, for training and tests: scaled, in double, with given noise, without fade, growth and counts.
 * `windows` holds foten_info.window samples, each acceleration, speed and force. `condition` holds for each of n
 * samples the scaled speed, the scaled force, and the speed that moves tones [mm/s]. NULL noise gives the deterministic
 * loop. Samples are cut to +-limit; a model whose loop is not bounded by itself goes on from the cut sample. */
FOTEN_API foten_status foten_start_scaled(foten_state *state, const double *windows);
FOTEN_API void foten_run_scaled(foten_state *state, const double *condition, const double *noise, double limit,
                                size_t n, double *out);

/* Recorded moments from `first` to before `end` are not played, until the next foten_reset: a rendering that is judged
 * beside a recording plays none of its own. */
FOTEN_API void foten_exclude_recorded(foten_state *state, int first, int end);

typedef enum {
    FOTEN_PREDICT_MODEL = 0, /* the complete model; of "foten-plus" the sample alone */
    FOTEN_PREDICT_LINEAR = 1 /* the lattice of "foten-plus" alone, as in its renderings; other models complete */
} foten_prediction_part;

/* What is not known is 0, and so is the scale if nothing is random. */
typedef struct {
    double sample;       /* scaled */
    double scale;        /* standard deviation of the random part, scaled */
    double standardised; /* what came, as a standard normal number if the distribution is right */
    double nll;          /* negative log-likelihood of what came [nat, scaled] */
} foten_prediction;

/* Predict a recording one step ahead. `samples` holds n samples, each acceleration, speed and force, scaled. Each
 * sample from foten_info.window on is predicted from those before it; `out` gets n - foten_info.window predictions. The
 * state is reset afterwards. FOTEN_BAD_ARGUMENT if there are fewer samples than a window, one is not finite, or the
 * model is one of noise, which predicts no samples. */
FOTEN_API foten_status foten_predict(foten_state *state, const double *samples, size_t n, foten_prediction_part part,
                                     foten_prediction *out);

/* Set the condition. Negative values count as 0. If a value is not finite, the condition stays as it was. Both are
 * counted as refused.
 *
 * Textures expect conditions as smooth as the recorded ones, which went through a 20 Hz low-pass. Steps, as of a game
 * that sets the condition 60 times a second, and an encoder's velocity noise are perceptible. The option `smooth`
 * removes them and delays by 11 ms. The condition is 0 until it is set: set it before the first sample is rendered, or
 * smoothing begins from rest. */
FOTEN_API void foten_set_condition(foten_state *state, float speed_mm_s, float force_n);

/* Render n samples at the state's rate. The condition is read once per sample of the texture's own rate. */
FOTEN_API void foten_render(foten_state *state, float *acceleration, size_t n);

/* Render a stroke: n speeds and forces, one per sample of the texture's own rate. Writes at most foten_rendered(state,
 * n) samples and returns how many. The condition set by `foten_set_condition` does not change. */
FOTEN_API size_t foten_render_stroke(foten_state *state, const float *speed_mm_s, const float *force_n, size_t n,
                                     float *acceleration);
FOTEN_API size_t foten_rendered(const foten_state *state, size_t n);

/* Delay of the output by the change of rate [s]; 0 at the texture's own rate. */
FOTEN_API double foten_delay_s(const foten_state *state);

/* Above its trained range a texture's level grows by powers of speed and force that `foten train` fitted to the
 * recording, or is held where it could fit none: `foten info` names them. */
typedef struct {
    uint64_t n;                                /* samples rendered at the texture's own rate */
    uint64_t n_speed_beyond, n_force_beyond;   /* of those: above the trained range */
    uint64_t n_speed_clamped, n_force_clamped; /* of these: above where the level grows no more */
    uint64_t n_below;                          /* of n: below 2 mm/s, 0.1 N or the trained range */
    uint64_t n_saturated;                      /* cut by the saturator */
    uint64_t n_refused;                        /* conditions that were negative or not finite */
    uint64_t n_limited;                        /* output samples in the range where the actuator's limit acts */
    uint64_t n_lost;                           /* not finite, now 0; none with a file of `foten train` */
} foten_stats;

/* The condition of the last sample [mm/s, N]; from the rendering thread. */
FOTEN_API void foten_condition(const foten_state *state, float *speed_mm_s, float *force_n);

/* Counts since the last reset; from any thread. */
FOTEN_API foten_stats foten_statistics(const foten_state *state);

/* A stylus: positions and pressures at irregular times become conditions.
 *
 * Speed is the norm of the velocity after the low-pass that the texture was trained with. Force is a exp(b p) of a
 * pressure p in 0..1 after the same low-pass, and 0 when the pen is lifted (Eq. 12 of the paper; a and b belong to the
 * tablet). Between events the velocity is extrapolated by part of its last change, at most by its own size. This halves
 * its delay: 5 to 2 ms at 60 to 240 events a second, if they are pushed at once, plus 11 ms of the low-pass, which the
 * training has too. Force is held: 10 to 3 ms.
 *
 * Events are counted and dropped if they are not finite, are not later than the one before, or arrive faster than they
 * are rendered. A jump faster than 5 m/s, or after a gap of ten usual steps, counts as a lifted pen. Without events the
 * speed becomes 0 after 25 ms or three usual steps. A lifted pen fades within the low-pass. Events take effect at the
 * next block: a block longer than 20 ms delays the condition by as much, and a tap within it is lost. */
typedef struct foten_stylus foten_stylus;

typedef struct {
    double newtons, steepness; /* a [N] and b; 0 for the paper's, 0.13 and 3.32 */
} foten_stylus_options;

typedef struct {
    uint64_t n;         /* events used */
    uint64_t n_refused; /* not finite */
    uint64_t n_late;    /* not later than the one before */
    uint64_t n_dropped; /* more than 256 waiting */
    uint64_t n_clipped; /* pressures outside 0..1, clipped */
    uint64_t n_jumps;   /* movements in the air */
} foten_stylus_stats;

/* Make a stylus. NULL options are all zeros. Returns NULL if there is no memory, the model is NULL, or the options are
 * not 0 <= newtons < 1e6 and |steepness| < 100. */
FOTEN_API foten_stylus *foten_stylus_new(const foten_model *model, const foten_stylus_options *options);
FOTEN_API void foten_stylus_free(foten_stylus *stylus);

/* Add an event: position [mm], pressure 0..1 (0 is lifted), the device's time [s]. From one thread; does not wait. */
FOTEN_API void foten_stylus_push(foten_stylus *stylus, double x_mm, double y_mm, double pressure, double t_s);

/* From another thread: the condition of the next sample at the texture's own rate; or a rendering under these
 * conditions. */
FOTEN_API void foten_stylus_next(foten_stylus *stylus, float *speed_mm_s, float *force_n);
FOTEN_API void foten_render_stylus(foten_state *state, foten_stylus *stylus, float *acceleration, size_t n);
FOTEN_API foten_stylus_stats foten_stylus_statistics(const foten_stylus *stylus);

/* An actuator: the state renders its drive signal instead of acceleration.
 *
 * A voice coil with its housing on a spring has acceleration / drive = gain s^2 / (s^2 + 2 damping w s + w^2), w = 2 pi
 * resonance_hz. The drive is the acceleration through the inverse, with a second-order high-pass at lowest_hz, since
 * the current that vibration below the resonance takes grows with the square of the distance. Above 0.8 of the limit
 * the drive is compressed and never reaches the limit. (McMahan & Kuchenbecker, Haptics Symposium 2014; the derivation
 * is ours.) */
typedef struct {
    double resonance_hz, damping; /* 0 for none: the drive is acceleration / gain */
    double gain;                  /* m/s2 per unit of drive (V, A, or full scale); negative for reversed wires */
    double lowest_hz;             /* 0 for 20 Hz */
    double limit;                 /* of the drive; 0 for none */
} foten_actuator;

/* Render the drive of this actuator from now on; NULL for acceleration again. With a resonance the rate must be at
 * least 4000 Hz and sixteen times the resonance; actuator times filter is then within 0.3 dB of flat from 40 to 400 Hz.
 * Invalid figures change nothing. */
FOTEN_API foten_status foten_set_actuator(foten_state *state, const foten_actuator *actuator);

/* The noise itself: samples first .. first + n - 1. */
FOTEN_API void foten_noise(uint64_t seed, uint64_t stream, uint64_t first, size_t n, double *out);

#ifdef __cplusplus
}
#endif
#endif
