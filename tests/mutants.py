"""Small wrong changes of the sources, each of which some test has to notice; `tests/test_mutants.py` makes them one by one."""

from __future__ import annotations

from dataclasses import dataclass

KERNEL = ("tests/test_loops.py", "tests/test_native.py", "tests/test_rendering.py", "tests/test_reference.py")
NATIVE = "native/src/"
PACKAGE = "src/foten/"


@dataclass(frozen=True)
class Mutant:
    """One change.

    Attributes:
        what: is wrong then.
        path: of the file, from the root of the repository.
        before, after: text, of which the former stands in the file once.
        tests: files of tests, of which one fails.
    """

    what: str
    path: str
    before: str
    after: str
    tests: tuple[str, ...] = KERNEL


MUTANTS = (
    Mutant(
        "noise without a network has no bound",
        NATIVE + "foten_plus.c",
        "innovation = excitation_limited(&m->excitation, *noise, scale);",
        "innovation = *noise;",
    ),
    Mutant("the saturator is off", NATIVE + "loop.h", "clip(sample, limit)", "sample"),
    Mutant(
        "a network goes on from its uncut sample",
        NATIVE + "window_loop.c",
        "predictor_push(&m->predictor, &l->predictor, played,",
        "predictor_push(&m->predictor, &l->predictor, sample,",
    ),
    Mutant(
        "the fade with speed begins at 10 mm/s", NATIVE + "constants.h", "FOTEN_FADE_SPEED 5.0", "FOTEN_FADE_SPEED 10.0"
    ),
    Mutant(
        "the fade with force begins at 0.2 N", NATIVE + "constants.h", "FOTEN_FADE_FORCE 0.1", "FOTEN_FADE_FORCE 0.2"
    ),
    Mutant(
        "what fades is counted below the range alone", NATIVE + "api.c", "below |= x < fade;", "below |= x < m->low[i];"
    ),
    Mutant(
        "smoothing begins from rest", NATIVE + "api.c", "= settled(&s->filter, speed_force[i]);", "= (memory){0, 0};"
    ),
    Mutant("there is no fade", NATIVE + "api.c", "if (x < fade) c.fade *= x / fade;", ""),
    Mutant("the level does not grow", NATIVE + "api.c", "growth *= pow(kept[i] / m->high[i], m->exponents[i]);", ";"),
    Mutant(
        "the level grows without end",
        NATIVE + "constants.h",
        "FOTEN_EXTRAPOLATION_LIMIT 2.0",
        "FOTEN_EXTRAPOLATION_LIMIT 4.0",
    ),
    Mutant("a slower device is louder", NATIVE + "resample.c", "return sum / r->stretch;", "return sum;"),
    Mutant("the resampler skips a carry", NATIVE + "resample.c", "r->integer + (r->fraction < before)", "r->integer"),
    Mutant(
        "a stroke begins too loud",
        NATIVE + "foten_plus.c",
        "l->lattice.states[i] = size * noise",
        "l->lattice.states[i] = 2 * size * noise",
    ),
    Mutant(
        "a stroke begins silent",
        NATIVE + "foten_plus.c",
        "= size * noise_next(&noise);",
        "= 0 * size * noise_next(&noise);",
    ),
    Mutant(
        "a network's stroke begins with the warm start",
        NATIVE + "window_loop.c",
        "        return;\n    }\n    set_condition(m, l, c, 1);",
        "        return;\n    }\n    return;\n    set_condition(m, l, c, 1);",
    ),
    Mutant(
        "local models begin silent",
        NATIVE + "piecewise_ar_loop.c",
        "size * noise_next(&noise)",
        "0 * size * noise_next(&noise)",
        ("tests/test_piecewise_ar.py", *KERNEL),
    ),
    Mutant(
        "a stroke begins without the gain before the filter",
        NATIVE + "foten_plus.c",
        "double size = gain_before(of, &l->lattice) * l->sigma",
        "double size = l->sigma",
    ),
    Mutant(
        "a network's stroke begins without bound",
        NATIVE + "window_loop.c",
        "m->predictor.window, FOTEN_MAX_INITIAL);",
        "m->predictor.window, INFINITY);",
    ),
    Mutant(
        "a stroke begins without its zeros",
        NATIVE + "piecewise_ar_loop.c",
        "double size = l->mixture.gain * sqrt(power);",
        "double size = l->mixture.gain;",
        ("tests/test_piecewise_ar.py", *KERNEL),
    ),
    Mutant(
        "a network in a bounded loop is given the cut sample",
        NATIVE + "foten_plus.c",
        "innovation * entering, residual / level, l->lattice.logs,",
        "innovation * entering, clip(residual, limit) / level, l->lattice.logs,",
    ),
    Mutant(
        "a scale is stated of another prediction than the rendering's",
        NATIVE + "foten_plus.c",
        "if (m->tones.n || with_network != (in_loop != NULL)) return;",
        "",
    ),
    Mutant(
        "a sample goes by its own condition",
        NATIVE + "window_loop.c",
        "double sample = predictor_predict(&m->predictor, &l->predictor);",
        "set_condition(m, l, c, 0);\n    double sample = predictor_predict(&m->predictor, &l->predictor);",
    ),
    Mutant(
        "the force of a pressure has no exponent",
        PACKAGE + "runtime/stylus.py",
        "self.a * np.exp(self.b * pressure)",
        "self.a * (1 + self.b * pressure)",
        ("tests/test_stylus.py",),
    ),
    Mutant(
        "the force of a pressure begins without contact",
        PACKAGE + "runtime/stylus.py",
        "np.where(pressure > 0, self.a",
        "np.where(pressure >= 0, self.a",
        ("tests/test_stylus.py",),
    ),
    Mutant(
        "the lattice does not leak",
        NATIVE + "constants.h",
        "FOTEN_LEAK 0.9997",
        "FOTEN_LEAK 1.0",
        ("tests/test_native.py", *KERNEL),
    ),
    Mutant(
        "the innovation is not clipped for the jitter",
        NATIVE + "tones.c",
        "clip(innovation, FOTEN_MAX_JITTER_DRIVE)",
        "innovation",
    ),
    Mutant("tones forget nothing", NATIVE + "tones.c", "s->phase -= t->phase_leak * (s->phase - s->path);", ""),
    Mutant(
        "tones stand still",
        NATIVE + "tones.c",
        "s->phase += s->increment * s->rate + increment;",
        "s->phase += s->increment * s->rate;",
    ),
    Mutant(
        "gradients of a chaotic stream grow without end",
        "native/training/training_kernel.c",
        "if (size <= adjoint_limit) continue;",
        "continue;",
        ("tests/test_own_output.py",),
    ),
    Mutant(
        "what is reset counts for what resets it in full",
        "native/training/training_kernel.c",
        "store(candidate_preactivation + i, of_new * reset);",
        "store(candidate_preactivation + i, of_new);",
        ("tests/test_innovations.py",),
    ),
    Mutant(
        "a lattice's states are not led back",
        "native/training/training_kernel.c",
        "r->leak * (c[j] * of_up - k[j] * f[j]);",
        "r->leak * (c[j] * of_up);",
        ("tests/test_own_output.py",),
    ),
    Mutant(
        "a section's own reflection is not led back",
        "native/training/training_kernel.c",
        "f[j] = k[j] * of_up + c[j] * f[j];",
        "f[j] = c[j] * f[j];",
        ("tests/test_own_output.py",),
    ),
    Mutant(
        "what the network draws has no bound",
        NATIVE + "loop.h",
        "return excitation_limited(&m->excitation, next, scale);",
        "return next;",
    ),
    Mutant(
        "the reset gate is open",
        NATIVE + "innovation_network.c",
        "+ reset * candidate_preactivation",
        "+ candidate_preactivation",
    ),
    Mutant(
        "the largest component is always drawn",
        NATIVE + "innovation_network.c",
        "s->weight[i] /= sum;",
        "s->weight[i] = i == 0;",
    ),
    Mutant(
        "the network is given innovations as sigma scales them",
        NATIVE + "foten_plus.c",
        "innovation_push(m->network_in_loop, &l->innovation, innovation * entering, residual",
        "innovation_push(m->network_in_loop, &l->innovation, e, residual",
    ),
    Mutant(
        "the network is in every loop",
        NATIVE + "model.c",
        "m->network_in_loop = s->network_in_loop ? &m->rendering_network : NULL;",
        "m->network_in_loop = &m->network;",
    ),
    Mutant("a prediction leaves the network out", NATIVE + "foten_plus.c", "part == FOTEN_PREDICT_MODEL ||", "0 ||"),
    Mutant(
        "the state is not reset after a prediction",
        NATIVE + "api.c",
        "foten_reset(s, s->seed);\n    return FOTEN_OK;",
        "return FOTEN_OK;",
    ),
    Mutant(
        "a reset keeps the counts",
        NATIVE + "api.c",
        "atomic_store_explicit(&s->counts[i], 0,",
        "atomic_store_explicit(&s->counts[i], counted(s, i),",
    ),
    Mutant("negative forces are taken as they are", NATIVE + "api.c", "if (*force < 0) *force = 0;", ""),
    Mutant(
        "what is no number is passed on",
        NATIVE + "api.c",
        "if (out - out == 0) return out;",
        "return out;",
        ("tests/test_native.py", "tests/test_loops.py", "tests/test_rendering.py", "tests/test_kernel_build.py"),
    ),
    Mutant(
        "a pressure of nothing presses", NATIVE + "stylus.c", "pressure > 0", "pressure >= 0", ("tests/test_stylus.py",)
    ),
    Mutant(
        "Eq. 12 has another steepness",
        PACKAGE + "runtime/stylus.py",
        "b: float = 3.32",
        "b: float = 3.0",
        ("tests/test_stylus.py", "tests/test_native.py"),
    ),
    Mutant(
        "the level is never settled",
        PACKAGE + "training/excitation_fit.py",
        "errors = calibrate_level(loop, excitation, config.seed)\n    if config.volatility",
        "errors = [0.0]",
        ("tests/test_closed_loop_training.py", "tests/test_excitation.py", "tests/test_pipeline.py"),
    ),
    Mutant(
        "the level is settled the wrong way",
        PACKAGE + "training/calibration.py",
        "step = -np.linalg.solve(",
        "step = np.linalg.solve(",
        ("tests/test_closed_loop_training.py", "tests/test_excitation.py", "tests/test_pipeline.py"),
    ),
    Mutant(
        "the best AR is chosen on test blocks",
        PACKAGE + "evaluate/evaluate.py",
        "best_linear(samples, train, split.validation, block)",
        "best_linear(samples, train, split.test, block)",
        ("tests/test_references.py", "tests/test_report.py", "tests/test_evaluate.py"),
    ),
    Mutant(
        "AR(20) is fitted on train and test",
        PACKAGE + "evaluate/evaluate.py",
        '"ar": fit_linear(samples, train, block, ANCHOR_ORDER),',
        '"ar": fit_linear(samples, (*train, *split.test), block, ANCHOR_ORDER),',
        ("tests/test_references.py", "tests/test_report.py", "tests/test_evaluate.py"),
    ),
    Mutant(
        "the network is fitted to the validation blocks",
        PACKAGE + "training/window_fit.py",
        "return self.train[torch.randperm(len(self.train), ",
        "return self.validation[torch.randperm(len(self.validation), ",
        ("tests/test_fit.py", "tests/test_pipeline.py"),
    ),
    Mutant(
        "the last network is kept, not the best",
        PACKAGE + "training/loop.py",
        "best = loss < self.best_loss",
        "best = True",
        ("tests/test_fit.py", "tests/test_pipeline.py"),
    ),
    Mutant(
        "a training that gains nothing goes on",
        PACKAGE + "training/loop.py",
        "if epoch != config.probation or gained >= config.min_gain:",
        "if True:",
        ("tests/test_fit.py", "tests/test_pipeline.py"),
    ),
    Mutant(
        "matrices are not orthogonalised",
        PACKAGE + "training/optimiser.py",
        "orthogonalised(directions), strict=True)",
        "directions, strict=True)",
        ("tests/test_optimiser.py",),
    ),
    Mutant(
        "windows see the sample that they predict",
        PACKAGE + "recording/windows.py",
        "np.arange(-m, 0)",
        "np.arange(-m + 1, 1)",
        ("tests/test_recording.py",),
    ),
    Mutant(
        "the scaling looks at test blocks",
        PACKAGE + "training/blocks.py",
        "fit_scaling(trace, split.train)",
        "fit_scaling(trace, (*split.train, *split.test))",
        ("tests/test_pipeline.py", "tests/test_recording.py"),
    ),
    Mutant(
        "the warm start is the loudest window",
        PACKAGE + "training/texture_builder.py",
        "[(len(near) - 1) // 2]",
        "[-1]",
        ("tests/test_export.py", "tests/test_pipeline.py"),
    ),
    Mutant(
        "the first fifth of a block is scored",
        PACKAGE + "evaluate/free_run.py",
        "SETTLING = 0.2",
        "SETTLING = 0.0",
        ("tests/test_free_run.py",),
    ),
    Mutant(
        "the free run starts from another block",
        PACKAGE + "evaluate/free_run.py",
        "state.start(acceleration[:m], speed[:m], force[:m])",
        "state.start(acceleration[1 : m + 1], speed[:m], force[:m])",
        ("tests/test_free_run.py",),
    ),
    Mutant(
        "kurtosis is not about the mean",
        PACKAGE + "evaluate/free_run.py",
        "6 * mean**2 * second - 3 * mean**4",
        "6 * mean**2 * second",
        ("tests/test_free_run.py",),
    ),
    Mutant(
        "a linear predictor's free run forgets its constant",
        PACKAGE + "evaluate/free_run.py",
        "constant + stable.noise_sd * gaussian",
        "stable.noise_sd * gaussian",
        ("tests/test_free_run.py",),
    ),
    Mutant(
        "the lattice is chosen on one fold",
        PACKAGE + "models/foten_plus/lattice_fit.py",
        "np.average(each.reshape(len(among), len(weights), -1), axis=1, weights=weights).tolist()",
        "each.reshape(len(among), len(weights), -1)[:, 0].tolist()",
        ("tests/test_lattice.py", "tests/test_linear_part.py"),
    ),
    Mutant(
        "tones of any spectrum are taken",
        PACKAGE + "models/foten_plus/fit.py",
        "allowed = TONES_MAY_DISTORT * renderings[0].fitted.distance[0]",
        "allowed = np.inf",
        ("tests/test_pipeline.py", "tests/test_linear_part.py", "tests/test_foten_plus_training.py"),
    ),
    Mutant(
        "a file without proof is accepted",
        NATIVE + "model.c",
        "if (worst <= tolerance) return 1;",
        "return 1;",
        ("tests/test_texture_file.py", *KERNEL),
    ),
    Mutant(
        "only the constant of the level is settled",
        PACKAGE + "training/calibration.py",
        "excitation.power_law.weight += torch.from_numpy(step[None, 1:]).float()",
        "pass",
        ("tests/test_closed_loop_training.py",),
    ),
    Mutant(
        "the excitation has no bound",
        PACKAGE + "training/excitation_fit.py",
        "excitation.innovation_limit.copy_(torch.tensor([float(np.abs(values).max()) for values in left]))",
        "pass",
        ("tests/test_excitation.py",),
    ),
    Mutant(
        "the shape of the excitation is chosen on training blocks",
        PACKAGE + "training/excitation_fit.py",
        "torch.exp(kept * shape[validation]), squared[validation])",
        "torch.exp(kept * shape[train]), squared[train])",
        ("tests/test_excitation.py",),
    ),
    Mutant(
        "a free run is judged on test blocks in training",
        PACKAGE + "training/calibration.py",
        "excitation, loop.blocks.split.validation, seed, DISTANCE_STREAM",
        "excitation, loop.blocks.split.test, seed, DISTANCE_STREAM",
        ("tests/test_pipeline.py",),
    ),
    Mutant(
        "the level is settled on test blocks too",
        PACKAGE + "training/blocks.py",
        "return (*self.split.train, *self.split.validation)",
        "return (*self.split.train, *self.split.validation, *self.split.test)",
        ("tests/test_pipeline.py",),
    ),
    Mutant(
        "the likelihood counts a hand at rest",
        PACKAGE + "training/excitation_fit.py",
        "float(nats[counted].mean())",
        "float(nats.mean())",
        ("tests/test_excitation.py",),
    ),
    Mutant(
        "the best AR is fitted on validation blocks too",
        PACKAGE + "evaluate/one_step.py",
        "fitted = fit_linear(samples, train, block, order, scheduled)",
        "fitted = fit_linear(samples, (*train, *validation), block, order, scheduled)",
        ("tests/test_evaluate.py",),
    ),
    Mutant(
        "the warm start is of a validation block",
        PACKAGE + "training/texture_builder.py",
        "ends, _ = blocks.targets(m)",
        "_, ends = blocks.targets(m)",
        ("tests/test_export.py",),
    ),
    Mutant(
        "the loudness of all of a warm start counts",
        PACKAGE + "training/texture_builder.py",
        "candidates[:, -n_last:, 0]",
        "candidates[:, :, 0]",
        ("tests/test_export.py",),
    ),
    Mutant(
        "the playable texture is not written",
        PACKAGE + "cli/train.py",
        "            write_texture(playable, output)",
        "            pass",
        ("tests/test_cli.py",),
    ),
    Mutant(
        "a network whose innovations are no likelier is in the loop",
        PACKAGE + "models/foten_plus/fit.py",
        "if best.epoch and before - likelihood >= MIN_GAIN_NAT:",
        "if best.epoch:",
        ("tests/test_foten_plus_training.py",),
    ),
    Mutant(
        "what is asymmetric is mirrored",
        PACKAGE + "models/foten_plus/likelihood.py",
        "mirrored and asymmetry(known) < MIRRORED_BELOW",
        "mirrored",
        ("tests/test_innovations.py",),
    ),
    Mutant(
        "chunks are drawn as often at every speed",
        PACKAGE + "models/foten_plus/likelihood.py",
        "probability = (1 / (mean + SLOWNESS)).ravel()",
        "probability = np.ones(mean.size)",
        ("tests/test_innovations.py",),
    ),
    Mutant(
        "what is chosen by is what is reported",
        PACKAGE + "experiments/simulator_reference.py",
        "VALIDATION_HAND = 2",
        "VALIDATION_HAND = 1",
        ("tests/test_simulator_reference.py",),
    ),
    Mutant(
        "what is at rest counts for the likeness",
        PACKAGE + "training/envelope_loss.py",
        "counts = moving[:, None].float()\n        logs",
        "counts = torch.ones_like(moving[:, None].float())\n        logs",
        ("tests/test_own_output.py",),
    ),
    Mutant(
        "an innovation network is fitted to the validation blocks",
        PACKAGE + "models/foten_plus/likelihood.py",
        "self._chunks = _chunks(of, blocks.split.train, warm_up)",
        "self._chunks = _chunks(of, blocks.split.validation, warm_up)",
        ("tests/test_innovations.py",),
    ),
    Mutant(
        "a full disk ends a training",
        PACKAGE + "training/loop.py",
        "except OSError as error:  # of a full disk",
        "except ZeroDivisionError as error:  # of a full disk",
        ("tests/test_fit.py",),
    ),
    Mutant(
        "what a training notes is not shown",
        PACKAGE + "cli/train.py",
        "display.note(note)\n    write_texture",
        "pass\n    write_texture",
        ("tests/test_cli.py",),
    ),
    Mutant(
        "a window may be of any length",
        PACKAGE + "models/model_sizes.py",
        "MAX_WINDOW = 512",
        "MAX_WINDOW = 51200",
        ("tests/test_cli.py",),
    ),
    Mutant(
        "a prediction knows the condition of its own sample",
        PACKAGE + "training/blocks.py",
        "(np.concatenate([one[:, :1], one[:, :-1]], axis=1) for one in channels)",
        "channels",
        ("tests/test_linear_part.py",),
    ),
    Mutant(
        "the order of local models is chosen on test blocks",
        PACKAGE + "models/piecewise_ar/fit.py",
        "recorded = blocks.samples[list(blocks.split.validation)]",
        "recorded = blocks.samples[list(blocks.split.test)]",
        ("tests/test_piecewise_ar_training.py",),
    ),
    Mutant(
        "growth looks at test blocks",
        PACKAGE + "models/foten_plus/fit.py",
        "np.moveaxis(blocks.training_blocks(), 2, 0)",
        "np.moveaxis(blocks.trace.stacked().reshape(blocks.samples.shape), 2, 0)",
        ("tests/test_pipeline.py",),
    ),
    Mutant(
        "a gap in the events is a pen out of reach after 0.4 s",
        NATIVE + "stylus.c",
        "MIN_HOLE_S = 0.04;",
        "MIN_HOLE_S = 0.4;",
        ("tests/test_stylus.py",),
    ),
    Mutant(
        "a pen may be as fast as 50 m per second",
        NATIVE + "stylus.c",
        "MAX_SPEED = 5000;",
        "MAX_SPEED = 50000;",
        ("tests/test_stylus.py",),
    ),
    Mutant(
        "events that came at once shorten the usual step",
        NATIVE + "stylus.c",
        "step > MIN_STEP_S && step < MAX_STEP_S",
        "step < MAX_STEP_S",
        ("tests/test_stylus.py",),
    ),
    Mutant(
        "late events in any order are a new clock",
        NATIVE + "stylus.c",
        "s->late_in_succession && e->t > s->late_t ? s->late_in_succession + 1 : 1",
        "s->late_in_succession + 1",
        ("tests/test_stylus.py",),
    ),
    Mutant(
        "a jump does not let go",
        NATIVE + "stylus.c",
        "if (jumped) s->held[0] = s->held[1] = 0;",
        "",
        ("tests/test_stylus.py",),
    ),
    Mutant(
        "an actuator's new figures begin from rest",
        NATIVE + "actuator.c",
        "made.memory = into->memory;",
        "",
        ("tests/test_actuator.py",),
    ),
    Mutant(
        "the step of a change of rate is cut to 32 bits",
        NATIVE + "resample.c",
        "(uint64_t)ldexp(ratio - (double)r->integer, 64)",
        "(uint64_t)ldexp(ratio - (double)r->integer, 32) << 32",
        ("tests/test_native.py",),
    ),
    Mutant(
        "a ring that runs empty ends in a step",
        PACKAGE + "runtime/live/live.py",
        "falling = min(out.size - n, self._step)",
        "falling = 0",
        ("tests/test_live.py",),
    ),
    Mutant(
        "a speed in m/s is taken as mm/s",
        PACKAGE + "models/texture_file.py",
        "if units.get(channel) not in known:",
        "if False:",
        ("tests/test_texture_file.py",),
    ),
    Mutant(
        "the kernel takes a speed in m/s as mm/s",
        NATIVE + "card.c",
        "if (!check_units(file)) return 0;",
        "",
        ("tests/test_native.py",),
    ),
    Mutant(
        "a terminal is given a name as it is",
        PACKAGE + "console.py",
        "shown(line) for line",
        "line for line",
        ("tests/test_hostile.py",),
    ),
    Mutant(
        "a terminal is given a name of any length",
        PACKAGE + "untrusted.py",
        "return printable(line) if len(line) <= longest else",
        "return printable(line) if True else",
        ("tests/test_hostile.py",),
    ),
)
"""Those that an audit made and the tests of then let pass, and others of the same kind."""
