/* Constants that the kernel shares with other languages, each defined once for C.
 *
 * A line is a name, a number, and in the comment the constant of the Python package that the number equals;
 * tests/test_native.py compares them all. */
#pragma once

/* What C does not have. */
#define PI 3.14159265358979323846

static inline double clip(double x, double limit) { return x > limit ? limit : x < -limit ? -limit : x; }

/* The texture file and its proof. */
#define FOTEN_FORMAT_VERSION 6           /* foten.models.texture_file.FORMAT_VERSION */
#define FOTEN_MIN_GOLDEN 8               /* foten.models.texture_file.MIN_GOLDEN */
#define FOTEN_ONE_STEP_TOLERANCE 1e-5    /* foten.models.texture_file.ONE_STEP_TOLERANCE */
#define FOTEN_CLOSED_LOOP_TOLERANCE 1e-4 /* foten.models.texture_file.CLOSED_LOOP_TOLERANCE */

/* Sizes: their limits, and what holds where a card does not name one. */
#define FOTEN_MAX_COUNT 65536           /* foten.models.model_sizes.MAX_COUNT */
#define FOTEN_MAX_WINDOW 512            /* foten.models.model_sizes.MAX_WINDOW */
#define FOTEN_MAX_GRAPH_WINDOW 4096     /* foten.models.registry.MAX_GRAPH_WINDOW */
#define FOTEN_MAX_AR_ORDER 40           /* foten.models.piecewise_ar.sizes.MAX_AR_ORDER */
#define FOTEN_USUAL_WINDOW 20           /* foten.models.foten.sizes.FotenSizes.window */
#define FOTEN_USUAL_PLUS_WINDOW 40      /* foten.models.foten_plus.sizes.FotenPlusSizes.window */
#define FOTEN_USUAL_N_HIDDEN 48         /* foten.models.foten_plus.sizes.FotenPlusSizes.n_hidden */
#define FOTEN_USUAL_HEAD_WIDTH 48       /* foten.models.foten_plus.sizes.FotenPlusSizes.head_width */
#define FOTEN_USUAL_N_COMPONENTS 4      /* foten.models.foten_plus.sizes.FotenPlusSizes.n_components */
#define FOTEN_USUAL_TEN_WINDOW 25       /* foten.models.foten.sizes.TenSizes.window */
#define FOTEN_USUAL_AR_WINDOW 21        /* foten.models.piecewise_ar.sizes.PiecewiseArSizes.window */
#define FOTEN_USUAL_D_MODEL 32          /* foten.models.foten.sizes.TenSizes.d_model */
#define FOTEN_USUAL_N_HEADS 4           /* foten.models.foten.sizes.TenSizes.n_heads */
#define FOTEN_USUAL_N_LAYERS 3          /* foten.models.foten.sizes.TenSizes.n_layers */
#define FOTEN_USUAL_D_FEEDFORWARD 128   /* foten.models.foten.sizes.TenSizes.d_feedforward */
#define FOTEN_USUAL_HEAD_1 256          /* foten.models.foten.sizes.TenSizes.head[0] */
#define FOTEN_USUAL_HEAD_2 64           /* foten.models.foten.sizes.TenSizes.head[1] */
#define FOTEN_USUAL_SPECTRAL_WIDTH 32   /* foten.models.foten.sizes.FotenSizes.spectral_width */
#define FOTEN_USUAL_EXCITATION_WIDTH 16 /* foten.models.foten_plus.sizes.FotenPlusSizes.excitation_width */
#define FOTEN_USUAL_ORDER 20            /* foten.models.foten_plus.sizes.FotenPlusSizes.order */
#define FOTEN_USUAL_AR_ORDER 20         /* foten.models.piecewise_ar.sizes.PiecewiseArSizes.order */

/* Speed and force. */
#define FOTEN_FADE_SPEED 2.0          /* foten.models.conditions.FADE_SPEED */
#define FOTEN_FADE_FORCE 0.1          /* foten.models.conditions.FADE_FORCE */
#define FOTEN_EXTRAPOLATION_LIMIT 2.0 /* foten.models.conditions.EXTRAPOLATION_LIMIT */
#define FOTEN_REACH_SPEED 400.0       /* foten.models.conditions.REACH_SPEED */
#define FOTEN_REACH_FORCE 6.0         /* foten.models.conditions.REACH_FORCE */
#define FOTEN_FORCE_FLOOR 0.05        /* foten.dsp.speed_force_table.FORCE_FLOOR */
#define FOTEN_MIN_TRIANGLE_AREA 1e-9  /* foten.dsp.speed_force_table.MIN_TRIANGLE_AREA */
#define FOTEN_INSIDE -1e-12           /* foten.dsp.speed_force_table._INSIDE */
#define FOTEN_STYLUS_NEWTONS 0.13     /* foten.runtime.stylus.PressureCalibration.a */
#define FOTEN_STYLUS_STEEPNESS 3.32   /* foten.runtime.stylus.PressureCalibration.b */
#define FOTEN_ACTUATOR_LOWEST_HZ 20.0 /* foten.runtime.actuator.ActuatorProfile.lowest_hz */

/* Lattices, tones and spectra. */
#define FOTEN_LEAK 0.9997            /* foten.dsp.lattice.LEAK */
#define FOTEN_MAX_REFLECTION 0.99999 /* foten.dsp.lattice.MAX_REFLECTION */
#define FOTEN_MAX_JITTER_DRIVE 3.0   /* foten.dsp.tones.MAX_JITTER_DRIVE */
#define FOTEN_N_CANDIDATES 32        /* foten.dsp.tones.N_CANDIDATES */
#define FOTEN_WEAKEST_BIN 1e-10      /* foten.dsp.spectrum.WEAKEST_BIN */

/* Noise and excitation. */
#define FOTEN_PHILOX_MULTIPLIER_0 0xD2511F53 /* foten.dsp.noise._MULTIPLIER_0 */
#define FOTEN_PHILOX_MULTIPLIER_1 0xCD9E8D57 /* foten.dsp.noise._MULTIPLIER_1 */
#define FOTEN_PHILOX_WEYL_0 0x9E3779B9       /* foten.dsp.noise._WEYL_0 */
#define FOTEN_PHILOX_WEYL_1 0xBB67AE85       /* foten.dsp.noise._WEYL_1 */
#define FOTEN_NOISE_SUM_SD 53509.91992145008 /* foten.dsp.noise._SUM_SD */
#define FOTEN_NOISE_LINEAR 0.97846856        /* foten.dsp.noise._LINEAR */
#define FOTEN_NOISE_CUBIC 0.00750807         /* foten.dsp.noise._CUBIC */
#define FOTEN_N_INPUTS 5                     /* foten.models.foten_plus.sizes.N_INPUTS */

/* Recorded innovations. */
#define FOTEN_CONTROL_MS 4.0            /* foten.models.foten_plus.recorded_innovations.CONTROL_MS */
#define FOTEN_FADE_MS 6.0               /* foten.models.foten_plus.recorded_innovations.FADE_MS */
#define FOTEN_OCTAVE 256                /* foten.models.foten_plus.recorded_innovations.OCTAVE */
#define FOTEN_SPEED_FLOOR 20.0          /* foten.models.foten_plus.recorded_innovations.SPEED_FLOOR */
#define FOTEN_RECORDED_FORCE_FLOOR 0.05 /* foten.models.foten_plus.recorded_innovations.FORCE_FLOOR */
#define FOTEN_SPEED_ORIGIN 3666         /* foten.models.foten_plus.recorded_innovations.SPEED_ORIGIN */
#define FOTEN_FORCE_ORIGIN 1452         /* foten.models.foten_plus.recorded_innovations.FORCE_ORIGIN */
#define FOTEN_STORED_SHIFT 3            /* foten.models.foten_plus.recorded_innovations.STORED_SHIFT */
#define FOTEN_LEVEL_SHIFT 4             /* foten.models.foten_plus.recorded_innovations.LEVEL_SHIFT */
#define FOTEN_N_GROWTH 10               /* foten.models.foten_plus.recorded_innovations.N_GROWTH */
#define FOTEN_N_NEAREST 12              /* foten.models.foten_plus.recorded_innovations.N_NEAREST */
#define FOTEN_MAX_DIFFERENCE 14000      /* foten.models.foten_plus.recorded_innovations.MAX_DIFFERENCE */
#define FOTEN_MIN_LENGTH 20             /* foten.models.foten_plus.recorded_innovations.MIN_LENGTH */
#define FOTEN_MAX_LENGTH 62             /* foten.models.foten_plus.recorded_innovations.MAX_LENGTH */
#define FOTEN_MIN_AGE 6                 /* foten.models.foten_plus.recorded_innovations.MIN_AGE */
#define FOTEN_MAX_SPEED_DIFFERENCE 74   /* foten.models.foten_plus.recorded_innovations.MAX_SPEED_DIFFERENCE */
#define FOTEN_MAX_FORCE_DIFFERENCE 148  /* foten.models.foten_plus.recorded_innovations.MAX_FORCE_DIFFERENCE */
#define FOTEN_MIN_DISTANCE 15           /* foten.models.foten_plus.recorded_innovations.MIN_DISTANCE */
#define FOTEN_N_AHEAD 20                /* foten.models.foten_plus.recorded_innovations.N_AHEAD */
#define FOTEN_N_MARGIN 8                /* foten.models.foten_plus.recorded_innovations.N_MARGIN */
#define FOTEN_CANDIDATE 1               /* foten.models.foten_plus.recorded_innovations.CANDIDATE */
#define FOTEN_RUN_START 2               /* foten.models.foten_plus.recorded_innovations.RUN_START */
#define FOTEN_N_TAPS 16                 /* foten.models.foten_plus.recorded_innovations.N_TAPS */
#define FOTEN_N_PHASES 64               /* foten.models.foten_plus.recorded_innovations.N_PHASES */
#define FOTEN_MAX_PACE 256              /* foten.models.foten_plus.recorded_innovations.MAX_PACE */
#define FOTEN_ONE 65536                 /* foten.models.foten_plus.recorded_innovations.ONE */
#define FOTEN_MAX_MOMENTS 4194304       /* foten.models.foten_plus.recorded_innovations.MAX_MOMENTS */
#define FOTEN_MAX_CANDIDATES 16384      /* foten.models.foten_plus.recorded_innovations.MAX_CANDIDATES */
#define FOTEN_WEIGHT_0 23               /* foten.models.foten_plus.recorded_innovations.WEIGHTS[0] */
#define FOTEN_WEIGHT_1 12               /* foten.models.foten_plus.recorded_innovations.WEIGHTS[1] */
#define FOTEN_WEIGHT_2 9                /* foten.models.foten_plus.recorded_innovations.WEIGHTS[2] */
#define FOTEN_WEIGHT_3 5                /* foten.models.foten_plus.recorded_innovations.WEIGHTS[3] */
#define FOTEN_WEIGHT_4 3                /* foten.models.foten_plus.recorded_innovations.WEIGHTS[4] */
#define FOTEN_WEIGHT_5 3                /* foten.models.foten_plus.recorded_innovations.WEIGHTS[5] */

/* The equaliser. */
#define FOTEN_N_BANDS 8             /* foten.dsp.level.N_BANDS */
#define FOTEN_N_LOWPASSES 3         /* foten.dsp.equaliser.N_LOWPASSES */
#define FOTEN_REFERENCE_SPEED 100.0 /* foten.dsp.equaliser.REFERENCE_SPEED */
#define FOTEN_REFERENCE_FORCE 1.0   /* foten.dsp.equaliser.REFERENCE_FORCE */
#define FOTEN_FLOOR_SPEED 5.0       /* foten.dsp.equaliser.FLOOR_SPEED */
#define FOTEN_FLOOR_FORCE 0.05      /* foten.dsp.equaliser.FLOOR_FORCE */
#define FOTEN_MAX_LOG_GAIN 1.0      /* foten.dsp.equaliser.MAX_LOG_GAIN */

/* How a stream begins. */
#define FOTEN_FIRST_INITIAL 0x8000000000000000 /* foten.models.definitions.FIRST_INITIAL */
#define FOTEN_MAX_INITIAL 50.0                 /* foten.models.window_model.MAX_INITIAL */
#define FOTEN_SETTLING_SAMPLES 256             /* foten.models.piecewise_ar.definition.SETTLING_SAMPLES */
#define FOTEN_MAX_INNOVATION 100.0             /* foten.models.piecewise_ar.definition.MAX_INNOVATION */
