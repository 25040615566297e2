/* foten: a haptic texture under a hand. Speed and force in, vibration out, in real time.
 *
 *     foten_model *model;
 *     char why[256];
 *     if (foten_model_load(bytes, n_bytes, &model, why, sizeof why) != FOTEN_OK) { puts(why); return 1; }
 *     foten_state *state = foten_state_new(model, NULL);     // allocates, once
 *
 *     foten_set_condition(state, 80.0f, 0.8f);                    // mm/s and N, from any thread, without waiting
 *     foten_render(state, samples, n);                       // m/s2, from one thread: no allocation, lock, log or file
 *
 *     foten_state_free(state);
 *     foten_model_free(model);
 *
 * A model is a texture file (.foten) in memory, checked and made ready; nothing changes it, and any number of states on any threads
 * may share it; it has to outlive them. A state is one hand on it. `foten_set_condition` and `foten_statistics` may be called from any
 * thread, all else of a state from one at a time. Pointers are not NULL but where it is said.
 *
 * Units everywhere: acceleration m/s2, speed mm/s, force N, rates Hz.
 *
 * Noise: sample n of the texture's own rate in stream s under seed k is the number that this defines, in every language and
 * on every processor. (w0..w3) = Philox4x32-10 of counter (n mod 2^32, n div 2^32, s mod 2^32, s div 2^32) and key (k mod 2^32, k div 2^32)
 * (Salmon et al., SC 2011). Let t be the sum of the eight 16-bit halves of w0..w3, x = (t - 262140) / sqrt(8 (2^32 - 1) / 12)
 * and g = x (0.97846856 + 0.00750807 x^2): zero mean, unit variance, kurtosis 3, |g| < 5.68.
 * The samples from 2^63 on are what a stream begins with.
 *
 * The same model, seed and hand give the same bytes whatever the sizes of the blocks that are asked for: in one build, on one
 * instruction set, with one mathematical library. From one to another the last places differ.
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
#define FOTEN_ABI 4 /* of this header's structures and functions; foten_abi() has to be the same */

typedef struct foten_model foten_model;
typedef struct foten_state foten_state;

typedef enum {
    FOTEN_OK = 0,
    FOTEN_BAD_FILE = 1,     /* the bytes are no texture file, are damaged, or of another format version */
    FOTEN_BAD_ARGUMENT = 2, /* a speed, force, rate or pointer that cannot be */
    FOTEN_NO_MEMORY = 3,
    FOTEN_NO_PROOF = 4,    /* the processor does not reproduce the golden windows of the file */
    FOTEN_NO_PREDICTOR = 5 /* the file's model is run by something else: foten_model_load_with */
} foten_status;

/* The library's FOTEN_ABI and FOTEN_VERSION, and the instruction set that it uses here: "avx512", "avx2", "neon", "simd128" or "portable".
 * FOTEN_ISA in the environment asks for another one that the processor has; set it before the first call. */
FOTEN_API int foten_abi(void);
FOTEN_API const char *foten_version(void);
FOTEN_API const char *foten_isa(void);

/* What a texture file says of itself. */
typedef struct {
    const char *model;           /* "foten", "foten-plus", ... */
    const char *texture;         /* its name; both live as long as the model */
    double rate_hz;              /* its own */
    int window;                  /* samples that a prediction is given */
    int has_excitation;          /* whether it has a random part */
    double trained_speed[2];     /* mm/s, lowest and highest that it was recorded at */
    double trained_force[2];     /* N */
    double acceleration_sd;      /* m/s2, of the recording */
    double lowpass_hz;           /* that the speed and force of the recording went through */
    size_t state_bytes;          /* that a state at the texture's own rate asks for */
    int hop;                     /* samples that a predictor is asked for at once; 0 where none is asked */
} foten_info;

/* Check a texture file in memory and make it ready; the bytes may be freed afterwards. `why` gets one line for people, and may be
 * NULL. On anything but FOTEN_OK, *model is NULL. Replays the golden windows: milliseconds for a file of `foten train`. */
FOTEN_API foten_status foten_model_load(const void *bytes, size_t n_bytes, foten_model **model, char *why, size_t why_size);
FOTEN_API void foten_model_free(foten_model *model);

/* The same for networks that this library has no code for, those of the systems that foten is compared with: their files hold an ONNX graph,
 * and whoever runs it gives what comes after a window, `window` samples of acceleration, speed and force in turn, oldest first, all in the
 * units of the network: `n_next` samples, foten_info.hop of the file. In the place of the acceleration, "dftnet" and "gan" are given the
 * noise numbers of these samples. It is asked for the golden windows while the file is loaded, and once a hop from each thread that renders,
 * from several at once where several do; it and `user` have to outlive the model. Such a rendering is as real-time as its predictor is, which
 * may allocate or wait. What is not finite counts as 0, and ends the hop. Without a predictor, such a file is FOTEN_NO_PREDICTOR; other files
 * do not ask one. */
typedef void (*foten_predictor)(void *user, const float *window, float *next, int n_next);
FOTEN_API foten_status foten_model_load_with(const void *bytes, size_t n_bytes, foten_predictor predictor, void *user, foten_model **model,
                                             char *why, size_t why_size);
FOTEN_API foten_info foten_model_info(const foten_model *model);

typedef struct {
    double rate_hz;     /* of what is rendered: the texture's own (0), or any from a 20th of it to 400 times it; see foten_delay_s */
    uint64_t seed;      /* of the noise */
    uint64_t stream;    /* of the noise; hands of different streams are independent */
    int deterministic;  /* 1 leaves the random part out */
    int smooth;         /* 1 puts the hand that is set through foten_info.lowpass_hz, as the recording's was; see foten_set_condition */
} foten_options;

/* NULL for the options is all zeros. NULL is returned where there is no memory or the rate cannot be. */
FOTEN_API foten_state *foten_state_new(const foten_model *model, const foten_options *options);
FOTEN_API void foten_state_free(foten_state *state);

/* Begin again, as a new state with that seed; the hand that is set and the actuator stay. A state begins as if the hand of its first sample
 * had been there for long, by chance; a deterministic one, and a model without a random part, with the window in the file. Where the
 * network is heard, the first sample takes as many of its steps as its window is long. */
FOTEN_API void foten_reset(foten_state *state, uint64_t seed);

/* Go on from a recorded window instead: foten_info.window samples of acceleration, speed and force, all finite. A model of noise goes on from
 * its hand alone. */
FOTEN_API foten_status foten_start(foten_state *state, const float *acceleration, const float *speed_mm_s, const float *force_n);

/* The loop by itself, as training and tests want it: in the units of the network (the card's scaling), in double, with noise that is given, and
 * without fade, growth and counting. `windows` holds foten_info.window samples of acceleration, speed and force in turn, the
 * condition of each of n samples is its speed and force, and the speed that tones go by [mm/s]. Without noise (NULL) the
 * loop is deterministic. A sample is cut to +-limit where the model's loop is to hear no more. */
FOTEN_API foten_status foten_start_scaled(foten_state *state, const double *windows);
FOTEN_API void foten_run_scaled(foten_state *state, const double *condition, const double *noise, double limit, size_t n, double *out);

/* One step ahead along a recording: n samples of acceleration, speed and force in turn, scaled. Each from foten_info.window on is predicted
 * from those before it; out gets n - foten_info.window predictions. The state begins again afterwards. FOTEN_BAD_ARGUMENT where there are fewer
 * samples than a window, one is not finite, or the model predicts spectra and no sample. */
typedef enum {
    FOTEN_PREDICT_MODEL = 0,     /* all of the model */
    FOTEN_PREDICT_LINEAR = 1,    /* of "foten-plus" its lattice alone; else all */
    FOTEN_PREDICT_RENDERING = 2  /* what a rendering uses: the network only where it is in the loop */
} foten_prediction_part;

typedef struct {
    double sample; /* scaled */
    double scale;  /* standard deviation of the innovation at its usual volatility, scaled; 0 where it is not known, or there is no excitation */
    double tail;   /* h of z exp(h z^2 / 2), z normal */
} foten_prediction;

FOTEN_API foten_status foten_predict(foten_state *state, const double *samples, size_t n, foten_prediction_part part, foten_prediction *out);

/* Tell where the hand is. What is negative is taken as 0; where one is not a finite number, the hand stays where it was. Both are
 * counted as refused.
 *
 * A texture expects a hand as smooth as that of its recording, which went through a low-pass of 20 Hz. A game that tells its hand 60 times
 * a second gives steps, and an encoder's velocity noise, and both are felt: ask for `smooth` then, which delays by 11 ms. */
FOTEN_API void foten_set_condition(foten_state *state, float speed_mm_s, float force_n);

/* Render n samples at the state's rate under the hand that was last set. The hand is looked at once for each sample of the texture's rate. */
FOTEN_API void foten_render(foten_state *state, float *acceleration, size_t n);

/* Render a stroke: n speeds and forces, one for each sample of the texture's own rate, give foten_rendered(state, n) samples at most.
 * Returns how many. The hand that `foten_set_condition` knows is not changed. */
FOTEN_API size_t foten_render_stroke(foten_state *state, const float *speed_mm_s, const float *force_n, size_t n, float *acceleration);
FOTEN_API size_t foten_rendered(const foten_state *state, size_t n);

/* By how much the rendering comes after the hand because of the change of rate [s]: 0 at the texture's own. */
FOTEN_API double foten_delay_s(const foten_state *state);

typedef struct {
    uint64_t n;              /* samples of the texture's own rate so far */
    uint64_t n_speed_beyond, n_force_beyond;   /* of those, above the trained range, where the level grows */
    uint64_t n_speed_clamped, n_force_clamped; /* of these, above twice of it, where nothing changes any more */
    uint64_t n_below;        /* below the trained range of either, where the vibration fades */
    uint64_t n_saturated;    /* that the saturator cut */
    uint64_t n_refused;      /* hands that were not finite or negative */
    uint64_t n_limited;      /* samples of the output that the actuator's limit bent */
    uint64_t n_lost;         /* samples that were no numbers, and silence instead; none of a file that `foten train` wrote */
} foten_stats;

/* The hand that the last sample was rendered under [mm/s, N]; from the rendering thread. */
FOTEN_API void foten_condition(const foten_state *state, float *speed_mm_s, float *force_n);

/* Since the last reset; from any thread. */
FOTEN_API foten_stats foten_statistics(const foten_state *state);

/* A stylus: where a pen is, at whatever times its device tells, into the speed and force of a hand.
 *
 * Speed is the norm of the velocity through the low-pass that the texture was trained with, force is a exp(b p) of a pressure p in
 * 0..1 through the same, 0 where the pen is lifted (Eq. 12 of the paper; a and b are the tablet's own). Between events the
 * velocity is carried on, by a part of its last change and at most by its own size, which halves its delay: 5 to 2 ms at 60 to 240
 * events a second that are told at once, beside the 11 ms of the low-pass, which the training has as well. Force is held: 10 to 3 ms.
 *
 * Events that are not finite, are not later than the one before, or come faster than they are rendered are counted and left out. A jump
 * faster than 5 m/s, or out of a hole of ten usual steps, is a pen that was lifted. Without events the hand stands still, after
 * 25 ms or three usual steps; a pen that is lifted is quiet at once, by the low-pass. Events count from the block on that is
 * rendered after them: blocks longer than 20 ms delay the hand by as much, and a tap within one is lost. */
typedef struct foten_stylus foten_stylus;

typedef struct {
    double newtons, steepness; /* a [N] and b; of each 0 for the paper's, 0.13 and 3.32 */
} foten_stylus_options;

typedef struct {
    uint64_t n;              /* events taken */
    uint64_t n_refused;      /* not finite */
    uint64_t n_late;         /* not later than the one before */
    uint64_t n_dropped;      /* more than 256 waiting */
    uint64_t n_clipped;      /* pressures outside of 0..1, cut to it */
    uint64_t n_jumps;        /* movements in the air */
} foten_stylus_stats;

FOTEN_API foten_stylus *foten_stylus_new(const foten_model *model, const foten_stylus_options *options);
FOTEN_API void foten_stylus_free(foten_stylus *stylus);

/* From one thread, without waiting: position [mm], pressure 0..1 (0 is lifted) and the device's time [s]. */
FOTEN_API void foten_stylus_push(foten_stylus *stylus, double x_mm, double y_mm, double pressure, double t_s);

/* From another thread: the hand at the next sample of the texture's own rate; and a rendering under it. */
FOTEN_API void foten_stylus_next(foten_stylus *stylus, float *speed_mm_s, float *force_n);
FOTEN_API void foten_render_stylus(foten_state *state, foten_stylus *stylus, float *acceleration, size_t n);
FOTEN_API foten_stylus_stats foten_stylus_statistics(const foten_stylus *stylus);

/* An actuator: what has to drive it, so that the stylus moves as was rendered.
 *
 * A voice coil whose housing hangs on a spring gives acceleration / drive = gain s^2 / (s^2 + 2 damping w s + w^2), w = 2 pi resonance_hz. The
 * drive is the rendering through the inverse, made proper by a high-pass of second order at lowest_hz, 20 Hz where that is 0:
 * what an actuator cannot give below its resonance costs current by the square of the distance. Above 0.8 of the limit the
 * drive bends, so that it never reaches it. (McMahan & Kuchenbecker, Haptics Symposium 2014; the derivation is ours.) */
typedef struct {
    double resonance_hz, damping; /* 0 for none: the drive is acceleration / gain */
    double gain;                  /* m/s2 for one of drive (V, A, or full scale); negative where the wires are turned round */
    double lowest_hz;
    double limit;                 /* of the drive; 0 for none */
} foten_actuator;

/* From now on the state renders drive; NULL for acceleration again. For a resonance the rate has to be 4000 Hz or more, and sixteen
 * times it; actuator times filter is then within 0.3 dB of flat from 40 to 400 Hz. Refused figures change nothing. */
FOTEN_API foten_status foten_set_actuator(foten_state *state, const foten_actuator *actuator);

/* The noise by itself: samples first .. first + n - 1. */
FOTEN_API void foten_noise(uint64_t seed, uint64_t stream, uint64_t first, size_t n, double *out);

#ifdef __cplusplus
}
#endif
#endif
