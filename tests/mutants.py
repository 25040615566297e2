"""Small wrong changes of the sources, each of which some test has to notice; `tests/test_mutants.py` makes them one by one.

Of C a mutant names tokens that stand in a file once, so that a row survives new line breaks. Of Python it names a node of the
syntax tree, so that it survives comments and names of variables too.
"""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import PurePath
from typing import Any

KERNEL = "loops native rendering reference"


@dataclass(frozen=True)
class Mutant:
    """One change."""

    what: str  # is wrong then
    path: str  # of the file, from the root of the repository
    change: Callable[[str], str]  # of its text; ValueError where the place is not there, or not unique
    tests: tuple[str, ...]  # files, of which one fails


def files_of(tests: str) -> tuple[str, ...]:
    """Files of tests by their words: `loop table` are tests/test_loop.py and tests/test_tabular.py."""
    return tuple(f"tests/test_{name}.py" for name in tests.split())


def of_c(path: str, *rows: tuple[str, ...], tests: str = KERNEL) -> list[Mutant]:
    """Mutants of a file in `native`: what is wrong, the tokens that are replaced, by what, other tests than the kernel's."""
    return [
        Mutant(
            what,
            f"packages/foten/native/{path}",
            partial(_tokens_replaced, before, after),
            files_of(more[0] if more else tests),
        )
        for what, before, after, *more in rows
    ]


def of_python(path: str, *rows: tuple[str, ...], tests: str = "") -> list[Mutant]:
    """Mutants of a file in `foten`: what is wrong, the scope, the node in it, what it becomes, and other tests than its own.

    Scope: names of nested classes, functions and assigned names, joined by dots.
    Node: its class in `ast`; a label where it needs one: the function of a call, the name of a name or attribute, the class of an
    operator; the number from 0 in the order of the source, or `all`, where there are more than one.
    Becomes: an expression or statement, in which `it` is the node, and `it.args[0]` and so on its parts; nothing is `pass`.
    """
    own = tests or PurePath(path).stem
    return [
        Mutant(
            what,
            path if path.startswith("packages/") else f"packages/foten/src/foten/{path}",
            partial(_node_replaced, *change),
            files_of(others[0] if others else own),
        )
        for what, *change, others in ((*row[:4], row[4:]) for row in rows)
    ]


def _tokens_replaced(before: str, after: str, source: str) -> str:
    pattern = r"\s*".join(map(re.escape, re.findall(r"\w+|[^\w\s]", before)))
    changed, n = re.subn(pattern, lambda _: after, source)
    if n != 1:
        raise ValueError(f"{before!r} stands there {n} times, expected once")
    return changed


def _node_replaced(scope: str, selector: str, becomes: str, source: str) -> str:
    tree: Any = ast.parse(source)
    statement: Any = ast.parse(becomes or "pass").body[0]
    names = {node.id for node in ast.walk(statement) if isinstance(node, ast.Name)} - {"it", *dir(builtins)}
    if unknown := names - {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)}:
        raise ValueError(f"there is no {unknown}")  # the mutant would die of that
    place = tree
    for name in scope.split("."):
        inside = [node for node in getattr(place, "body", []) if name in _names(node)]
        places = inside or [node for node in ast.walk(place) if name in _names(node)]
        if len(places) != 1:
            raise ValueError(f"{scope} is there {len(places)} times, expected once")
        (place,) = places
    kind, *words = selector.split()
    number = words.pop() if words and (words[-1] == "all" or words[-1].isdigit()) else ""
    nodes = [node for node in ast.walk(place) if type(node).__name__ == kind and words in ([], [_label(node)])]
    nodes.sort(key=lambda node: (node.lineno, node.col_offset))
    if number.isdigit():
        nodes = nodes[int(number) :][:1]
    if not nodes or (len(nodes) > 1 and number != "all"):
        raise ValueError(f"{selector} is in {scope} {len(nodes)} times, expected once")
    return ast.unparse(_Replaced(nodes, becomes or "pass").visit(tree))


def _names(node: Any) -> list[str]:
    """Names that a node defines."""
    match node:
        case ast.FunctionDef(name=name) | ast.ClassDef(name=name) | ast.AnnAssign(target=ast.Name(id=name)):
            return [name]
        case ast.Assign(targets=targets):
            return [target.id for target in targets if isinstance(target, ast.Name)]
    return []


def _label(node: Any) -> str:
    match node:
        case ast.Name(id=label) | ast.Attribute(attr=label):
            return label
        case ast.Call(func=inner) | ast.Expr(value=inner):
            return _label(inner)
        case ast.BinOp(op=operator) | ast.UnaryOp(op=operator) | ast.BoolOp(op=operator) | ast.Compare(ops=[operator]):
            return type(operator).__name__
    return ""


class _Replaced(ast.NodeTransformer):
    """A tree in which nodes became something else."""

    def __init__(self, nodes: list[Any], becomes: str) -> None:
        self._nodes, self._becomes = nodes, becomes

    def visit(self, node: ast.AST) -> Any:
        if node not in self._nodes:
            return self.generic_visit(node)
        statement: Any = ast.parse(self._becomes).body[0]
        return _Filled(node).visit(statement if isinstance(node, ast.stmt) else statement.value)


class _Filled(ast.NodeTransformer):
    """An expression in which `it` and its parts became a node and its parts."""

    def __init__(self, it: ast.AST) -> None:
        self._it = it

    def visit(self, node: ast.AST) -> Any:
        part = self._part(node)
        return part if isinstance(part, ast.AST) else self.generic_visit(node)

    def _part(self, node: ast.AST) -> Any:
        match node:
            case ast.Name(id="it"):
                return self._it
            case ast.Attribute(value=inner, attr=name):
                return getattr(self._part(inner), name, None)
            case ast.Subscript(value=inner, slice=ast.Constant(value=index)):
                parts = self._part(inner)
                return parts[index] if isinstance(parts, list) else None
        return None


MUTANTS = (
    *of_c(
        "src/foten_plus.c",
        (
            "what enters has no bound",
            "excitation_limited(&m->excitation, innovation, scale_of_noise(m, l))",
            "innovation",
        ),
        ("a stroke begins too loud", "l->lattice.states[i] = size", "l->lattice.states[i] = 2 * size"),
        ("a stroke begins silent", "= size * noise_next(&noise);", "= 0 * size * noise_next(&noise);"),
        ("a stroke begins without the gain before the filter", "gain_before(of, &l->lattice) * l->sigma", "l->sigma"),
        ("with tones a sample has a likelihood", "else if (!m->tones.n)", "else"),
        ("the network is given samples, not over their level", "sample / l->lattice.level;", "sample;"),
        ("a prediction leaves the network out", "part == FOTEN_PREDICT_MODEL", "0"),
        ("the first prediction has no scale", "l->sigma = excitation_sigma(&m->excitation, last.scaled);", ""),
    ),
    *of_c("src/loop.h", ("the saturator is off", "clip(sample, limit)", "sample")),
    *of_c(
        "src/window_loop.c",
        ("a network goes on from silence", "&l->predictor, played,", "&l->predictor, 0 * played,", f"export {KERNEL}"),
        ("a network goes on from its uncut sample", "&l->predictor, played,", "&l->predictor, sample,"),
        ("a stroke begins with the warm start", "}\n    set_condition(", "}\n    return;\n    set_condition("),
        ("a network's stroke begins without bound", "window, FOTEN_MAX_INITIAL);", "window, INFINITY);"),
        ("a sample goes by its own condition", "double sample =", "set_condition(m, l, c, 0);\n    double sample ="),
    ),
    *of_c(
        "src/constants.h",
        ("the fade with speed begins at 10 mm/s", "FOTEN_FADE_SPEED 2.0", "FOTEN_FADE_SPEED 10.0"),
        ("the fade with force begins at 0.2 N", "FOTEN_FADE_FORCE 0.1", "FOTEN_FADE_FORCE 0.2"),
        ("the level grows without end", "FOTEN_EXTRAPOLATION_LIMIT 2.0", "FOTEN_EXTRAPOLATION_LIMIT 4.0"),
        ("the level grows by far", "FOTEN_REACH_FORCE 6.0", "FOTEN_REACH_FORCE 60.0"),
        ("the lattice does not leak", "FOTEN_LEAK 0.9997", "FOTEN_LEAK 1.0"),
    ),
    *of_c(
        "src/api.c",
        ("what fades is counted below the range alone", "below |= x < low;", "below |= x < m->low[i];"),
        ("smoothing begins from rest", "= settled(&s->filter, speed_force[i]);", "= (memory){0, 0};"),
        (
            "below the range there is no law",
            "if (x < low) growth *= pow((x > fade ? x : fade) / low, m->exponents[i]);",
            "",
        ),
        ("there is no fade", "if (x < fade) c.fade *= x / fade;", ""),
        ("the level does not grow", "growth *= pow(held[i] / m->high[i], m->exponents[i]);", ";"),
        ("a prediction leaves its state", "foten_reset(s, s->seed);\n    return FOTEN_OK;", "return FOTEN_OK;"),
        ("a reset keeps the counts", "(&s->counts[i], 0,", "(&s->counts[i], counted(s, i),"),
        ("negative forces are taken as they are", "if (*force < 0) *force = 0;", ""),
        ("NaN is passed on", "if (out - out == 0) return", "return", "native loops rendering kernel_build"),
    ),
    *of_c(
        "src/resample.c",
        ("a slower device is louder", "return sum / r->stretch;", "return sum;"),
        ("the resampler skips a carry", "r->integer + (r->fraction < before)", "r->integer"),
        ("a rate's step has 32 bits", "(double)r->integer, 64)", "(double)r->integer, 32) << 32", "native"),
        ("a reset keeps the place between samples", "r->ahead = 1; r->fraction = 0;", "r->ahead = 1;", "native"),
    ),
    *of_c(
        "src/piecewise_ar_loop.c",
        ("local models begin silent", "size * noise_next(&noise)", "0 * size * noise_next(&noise)"),
        ("a stroke begins without its zeros", "l->mixture.gain * sqrt(power);", "l->mixture.gain;"),
        tests=f"piecewise_ar {KERNEL}",
    ),
    *of_c(
        "src/tones.c",
        ("the innovation is not clipped for the jitter", "clip(innovation, FOTEN_MAX_JITTER_DRIVE)", "innovation"),
        ("tones forget nothing", "s->phase -= t->phase_leak * (s->phase - s->path);", ""),
        ("tones stand still", "s->increment * s->rate + increment;", "s->increment * s->rate;"),
    ),
    *of_c(
        "training/training_kernel.c",
        (
            "the update gate is not led back",
            "store(d + k * h + i, of_next * update);",
            "store(d + k * h + i, of_next);",
        ),
        (
            "what is reset counts in full",
            "store(candidate_preactivation + i, of_new * reset",
            "store(candidate_preactivation + i, of_new",
            "training_kernel",
        ),
        tests="training_kernel",
    ),
    *of_c(
        "training/encoder_layer.c",
        ("what is dropped goes back", "drop(l, g.rows * fed, in_all * (size_t)w + query * (size_t)fed, by_fed);", ""),
        (
            "a query's mean share is not led back",
            "(load(by + i * stride) - mean) * scale",
            "load(by + i * stride) * scale",
        ),
        ("the residual of attention is not led back", "by_hidden[i] += by_encoded[i];", ";"),
        tests="training_kernel",
    ),
    *of_c(
        "src/innovation_kernel.c",
        ("the reset gate is open", "+ reset * candidate_preactivation", "+ candidate_preactivation"),
        ("all components weigh alike", "double weight = exp_of(zero + (out[i] - largest))[0];", "double weight = 1;"),
    ),
    *of_c(
        "src/model.c",
        ("a file is not proved", "if (worst <= tolerance) return 1;", "return 1;", f"texture_file {KERNEL}"),
        ("steps of a network are proved from its own", "m->kind->replace_last ?", "0 ?", f"export {KERNEL}"),
    ),
    *of_c(
        "src/stylus.c",
        ("a pressure of nothing presses", "pressure > 0", "pressure >= 0"),
        ("a gap in the events is a pen out of reach after 0.4 s", "MIN_HOLE_S = 0.04;", "MIN_HOLE_S = 0.4;"),
        ("a pen may be as fast as 50 m per second", "MAX_SPEED = 5000;", "MAX_SPEED = 50000;"),
        ("events that came at once shorten the usual step", "step > MIN_STEP_S && step <", "step <"),
        ("late events in any order are a new clock", "s->late_in_succession && e->t > s->late_t ?", "1 ?"),
        ("a jump does not let go", "if (jumped) s->held[0] = s->held[1] = 0;", ""),
        ("a pen goes on from how it moved before it stood", "= s->velocity[0] = s->velocity[1] = 0;", "= 0;"),
        tests="stylus",
    ),
    *of_c("src/actuator.c", ("new figures begin from rest", "designed.memory = into->memory;", ""), tests="actuator"),
    *of_c("src/card.c", ("a speed in m/s is taken as mm/s", "if (!check_units(file)) return 0;", ""), tests="native"),
    *of_c(
        "src/file.c",
        ("of a name twice the first counts", "i = file->n_entries; i > 0; i--", "i = 1; i <= file->n_entries; i++"),
        ("a tensor may be there twice", "n == file->n_taken ||", "n >= file->n_taken ||"),
        tests="texture_file",
    ),
    *of_c(
        "src/equaliser.h",
        ("a band-pass may grow at 0 Hz or at half the rate", "&& fabs(filter[1]) < 1 + filter[2]", ""),
        tests="equaliser",
    ),
    *of_python("untrusted.py", ("a doubled name", "_unique", "Compare Lt", "it.left and False"), tests="texture_file"),
    *of_python(
        "runtime/stylus.py",
        ("the force of a pressure has no exponent", "PressureCalibration.force", "Call exp", "1 + it.args[0]"),
        ("the force of a pressure begins without contact", "PressureCalibration.force", "Compare", "it.left >= 0"),
        ("Eq. 12 has another steepness", "PressureCalibration.b", "Constant", "3.0", "stylus native"),
    ),
    *of_python("runtime/live/live.py", ("an empty ring ends in a step", "Ring._fade", "Call min 1", "0"), tests="live"),
    *of_python(
        "training/calibration.py",
        ("no level is calibrated", "calibrate_excitation", "Call calibrate_level", "it.args[1], [0.0, 0.0, 0.0]"),
        ("the level is calibrated the wrong way", "calibrate_level", "Call empirical_bayes", "-it"),
        ("only the constant of the level is calibrated", "_adjusted", "BinOp Add 1", "it.left"),
        ("the excitation has no bound", "calibrate_excitation", "Call Excitation", "it.func(it.args[0], (1e6, 1e6))"),
        ("the likelihood counts rest", "calibrate_excitation", "Call mean", "it.func.value.value.mean()"),
        (
            "training sees test blocks",
            "ClosedLoop.free_run_errors",
            "Attribute validation",
            "it.value.test",
            "pipeline",
        ),
    ),
    *of_python(
        "training/calibration.py",
        (
            "the shape of a scale is chosen on training blocks",
            "fit_scale",
            "Call _gaussian_nll",
            "it.func(it.args[0].left + share * shape[:n_train], squared[:n_train])",
        ),
        ("a scale's gradient forgets its bend", "_minimised.by_hidden", "BinOp Mult 0", "it.left"),
    ),
    *of_python(
        "training/job.py",
        ("the scaling looks at test blocks", "scaled_blocks", "Attribute train", "(*it, *it.value.test)"),
        ("the level is settled on test blocks too", "known", "Attribute validation", "(*it, *it.value.test)"),
        (
            "a prediction knows its own condition",
            "condition_before",
            "GeneratorExp",
            "it.generators[0].iter",
            "linear_model",
        ),
        tests="pipeline recording",
    ),
    *of_python(
        "training/texture_builder.py",
        ("the warm start is the loudest window", "pick_warm_start", "BinOp FloorDiv 1", "-1", "export pipeline"),
        ("the warm start is of a validation block", "pick_warm_start", "Call targets", "it[::-1]"),
        ("the loudness of all of a warm start counts", "pick_warm_start", "UnaryOp USub", "None"),
        tests="export",
    ),
    *of_python(
        "training/window_fit.py",
        ("the network is fitted to the validation blocks", "shuffled", "Attribute train all", "it.value.validation"),
    ),
    *of_python(
        "training/window_fit.py",
        ("windows are validated on samples of their own", "one_step_windows", "Compare GtE", "it.left >= 0"),
        tests="export",
    ),
    *of_python(
        "training/checkpoint.py",
        ("the last network is kept, not the best", "Progress.add", "Compare Lt", "True"),
        ("a checkpoint forgets the loops before", "Checkpoint.save", "Attribute _loops 1", "{name: it[name]}"),
        ("a full disk ends a training", "Checkpoint.save", "Name OSError", "ZeroDivisionError"),
        tests="loop",
    ),
    *of_python(
        "training/loop.py",
        ("a training that gains nothing goes on", "should_continue", "BoolOp Or", "True"),
        ("the network of the last step is validated", "run_loop.finish", "Call validate", "it.func(network)"),
        ("an average is of all steps alike", "run_loop.train", "Call min", "it.args[1]"),
        ("gradients are not clipped", "gradient_step", "Compare Gt", "False"),
        ("the averaged weights are not in the checkpoint", "run_loop", "IfExp 1", "{}"),
    ),
    *of_python("training/loop.py", ("no orthogonalisation", "Optimiser.step", "Call orthogonalised", "it.args[0]")),
    *of_python(
        "models/foten_plus/fit.py",
        ("tones of any spectrum are taken", "best_candidate", "BinOp Mult", "np.inf"),
        (
            "growth looks at test blocks",
            "extrapolation_exponents",
            "Call training_blocks",
            "it.func.value.trace.stacked().reshape(it.func.value.samples.shape)",
            "pipeline",
        ),
        tests="foten_plus_fit",
    ),
    *of_python(
        "models/foten_plus/network.py",
        ("a likelihood validates the network of the last step", "validate", "Name averaged", "network"),
        ("what is asymmetric is mirrored", "innovations_of", "BoolOp And", "it.values[0]"),
        ("chunks are drawn as often at every speed", "Chunks", "BinOp Div 1", "it**0"),
        ("a network is fitted to validation blocks", "Batches", "Attribute train", "it.value.validation"),
        tests="innovation_network",
    ),
    *of_python(
        "models/foten_plus/linear_model.py",
        ("the lattice is chosen on one fold", "select_lattices.errors_of", "Call average", "it.args[0][0]"),
        tests="lattice linear_model",
    ),
    *of_python(
        "models/piecewise_ar/fit.py",
        ("local models' order is chosen on test blocks", "_validation_error", "Attribute validation", "it.value.test"),
        tests="piecewise_ar_fit",
    ),
    *of_python("models/model_sizes.py", ("a window of any length", "MAX_WINDOW", "Constant", "51200"), tests="cli"),
    *of_python("models/texture_file.py", ("a speed in m/s is taken as mm/s", "_check_units", "Compare NotIn", "False")),
    *of_python(
        "recording/windows.py",
        ("windows see the sample that they predict", "window_indices", "Call arange", "it + 1"),
        tests="recording",
    ),
    *of_python(
        "evaluate/evaluate.py",
        ("the best AR is chosen on test blocks", "evaluate", "Attribute validation", "it.value.test"),
        (
            "AR(20) is fitted on train and test",
            "evaluate",
            "Call fit_linear 0",
            "it.func(it.args[0], (*it.args[1], *split.test), it.args[2], it.args[3])",
        ),
        tests="one_step report evaluate",
    ),
    *of_python(
        "evaluate/one_step.py",
        (
            "the best AR is fitted on validation blocks too",
            "best_linear",
            "Call array_split",
            "it.func((*it.args[0], *validation), it.args[1])",
        ),
        tests="evaluate",
    ),
    *of_python("evaluate/metrics.py", ("kurtosis is not about the mean", "kurtosis", "BinOp Sub 1", "it.left")),
    *of_python(
        "evaluate/free_run.py",
        ("the first fifth of a block is scored", "SETTLING", "Constant", "0.0"),
        ("a linear predictor's free run forgets its constant", "synthesize_linear", "BinOp Add 0", "it.right"),
        ("the nearest block is that of unscaled speed and force", "nearest_training_blocks", "BinOp Div", "it.left"),
    ),
    *of_python("evaluate/warm_start.py", ("levels by unscaled speed", "synthesised_window", "BinOp Div 0", "it.left")),
    *of_python(
        "simulation/contact_mechanics.py",
        ("pieces fade the wrong way", "joined_pieces", "BinOp Div", "1 - it"),
        ("a loop has a seam", "under_ball", "Constant 5", "'reflect'"),
    ),
    *of_python(
        "editing/edit.py",
        ("a residual keeps its exponents", "with_exponents", "Call lattices", "('lattice.',)"),
        tests="editing",
    ),
    *of_python(
        "editing/blend.py",
        ("a blend's tones are out of step", "_blended_tones", "Call in_step", "it.args[0]"),
        tests="editing",
    ),
    *of_python("simulation/simulate.py", ("a tool that leans is heavier", "sensor_channels", "Call sqrt 0", "1.0")),
    *of_python(
        "runtime/loops.py",
        (
            "the free run starts from another block",
            "render_strokes.render",
            "Call start",
            "it.func(*(np.roll(window[stroke], 1) for window in windows))",
        ),
        tests="free_run",
    ),
    *of_python(
        "dsp/equaliser.py",
        ("the equaliser does not know how speed changes", "terms", "BinOp Sub 0", "0 * it"),
        ("gains of the equaliser are not held", "MAX_LOG_GAIN", "Constant", "9.0"),
    ),
    *of_python(
        "packages/foten-study/src/foten_study/adaptive.py",
        ("particles that are drawn anew spread too little", "PreferenceSearch._draw_anew", "Call sqrt", "1 - SHRINK"),
    ),
    *of_python(
        "datasets/tabular.py",
        ("every step back is midnight", "clock_seconds", "UnaryOp USub 0", "0"),
        tests="importing",
    ),
    *of_python("datasets/timing.py", ("jitter is excused", "irregular", "Call min", "it.args[0]"), tests="importing"),
    *of_python(
        "models/foten_plus/tones_fit.py",
        ("the jitter's variance is not over the distance", "_period_jitter", "BinOp Sub 3", "it.left"),
        tests="tones",
    ),
    *of_python(
        "packages/foten-study/src/foten_study/store.py",
        ("practice answers lead the level search", "Store.levels", "Constant 1", "it.replace('> 0', '>= 0')"),
        tests="study_store",
    ),
    *of_python(
        "packages/foten-study/src/foten_study/participant_store.py",
        ("pauses are contact", "contact_s", "Compare Gt 0", "True"),
        tests="study_store",
    ),
    *of_python(
        "studio/levels.py",
        ("gains are over the widest range", "_conditions", "Call max", "it.func.value.min(0)"),
        ("gains are up to the highest range", "_conditions", "Call min", "it.func.value.max(0)"),
        tests="live_contact",
    ),
    *of_python(
        "export/clip.py",
        ("the level is held from the first sample on", "_followed", "Name HOLD_S", "held if i else HOLD_S"),
        tests="clips",
    ),
    *of_python("export/hjif.py", ("an RMS as an amplitude", "_chirp", "BinOp Mult 1", "it.right"), tests="clips"),
    *of_python("cli/simulator_reference.py", ("chosen by the test hand", "VALIDATION_HAND", "Constant", "1")),
    *of_python(
        "cli/train.py",
        ("the playable texture is not written", "on_playable", "Expr write_texture", ""),
        ("what a training notes is not shown", "_shown", "Expr note 3", ""),
        tests="cli",
    ),
    *of_python("console.py", ("a name is shown as it is", "_shown_lines", "Call shown", "it.args[0]"), tests="hostile"),
    *of_python("untrusted.py", ("a name of any length", "shown", "Compare LtE", "True"), tests="hostile"),
)
"""Those that an audit made and the tests of then let pass, and others of the same kind."""
