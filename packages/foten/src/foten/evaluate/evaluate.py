"""The judge: one document of figures for a texture on the test blocks of a recording."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from foten.dsp import Array
from foten.evaluate import free_run as runs
from foten.evaluate.one_step import Linear, best_linear, excitation_scores, fit_linear, one_step, predict
from foten.evaluate.warm_start import synthesised_window, warm_start_runs, warm_start_scores
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.models.foten_plus.recorded_innovations import neighbourhoods
from foten.models.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import RELATIVE, Recording
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.recording.windows import first_scored, targets
from foten.runtime.native import NativeTexture

ONE_STEP_KEYS = ("mae_scaled", "mae_m_s2", "gfc")
REFERENCES = ("zero", "persistence", "ar", "ar_scheduled", "ar_best", "lattice", "bound", "bound_window")
RUNS = ("free_run", "free_run_deterministic", "free_run_ar", "ceiling")
FREE_RUN_KEYS = (
    *("lsd_db", "lsd_long_db", "gfc_raw", "gfc_welch", "level_bias_db", "level_error_db", "level_corr"),
    *("kurtosis", "max_sd"),
)
MIN_SCORED = 64  # samples of a block, of free runs
ANCHOR_ORDER = 20  # of the linear predictor that every model is held against
_WHY_UNKNOWN = {
    "level_bias_db": "what is scored of a block holds no frame of 40 ms",
    "level_corr": "the level does not vary",
    "modulation_db": "less than 1 s of a block is scored",
}


@dataclass(frozen=True)
class SimulatorReference:
    """What only a simulator knows of a recording."""

    realisations: Sequence[Trace] = ()  # the same stroke over fresh roughness, preprocessed as the recording was
    strokes: tuple[Trace, ...] = ()  # of one long stroke by another hand, for listeners: the recorded one, then others
    bound: Array | None = None  # expected absolute one-step error [m/s²] from the infinite past, shape (n,)
    bound_window: Array | None = None  # the same from a window of m
    why_no_bound: str = "known for simulated textures of the linear family alone"


@dataclass(frozen=True)
class Judgement:
    """The document and the signals behind it, for pictures."""

    document: dict[str, Any]  # figures, plain JSON values; None where unknown, with the reason under `reasons`
    trace: Trace  # the preprocessed recording
    blocks: tuple[int, ...]  # that were scored
    scored: slice  # samples of each of them, of free runs
    synthesized: Mapping[str, Array]  # free runs [m/s²] by name, each (n_seeds, n_blocks, block)
    from_warm_start: Mapping[str, Array]  # the same of whole blocks, by what they start from (`evaluate.warm_start`)


def trace_for(
    texture: Texture, recording: Recording, trim_ms: float | None = None, block_ms: float | None = None
) -> Trace:
    """Recording preprocessed as the texture's was, with another trim and block [ms] where they are not None.

    ValueError where they are given of the recording that the texture was trained on, whose blocks are those of its split.
    """
    config = PreprocessConfig.of_card(texture.card["preprocess"])
    cut: dict[str, Any] = {k: v for k, v in {"trim_ms": trim_ms, "block_ms": block_ms}.items() if v is not None}
    if cut and recording.sha256() == texture.card["recording_sha256"]:
        trained = "the texture was trained on this recording and is judged on the blocks of its split"
        raise ValueError(f"{trained}; --trim and --block are for others")
    return preprocess(recording, replace(config, **cut))


def evaluate(
    texture: Texture,
    recording: Recording,
    simulated: SimulatorReference | Callable[[], SimulatorReference] | None = None,
    seed: int = 0,
    on_stage: Callable[[str], None] = lambda stage: None,
    trim_ms: float | None = None,
    block_ms: float | None = None,
    listener: bool = False,
) -> Judgement:
    """All figures of a texture on the test blocks of the recording it was trained on, or on all blocks of another.

    ValueError where the recording is too short, the split does not fit it, or one of the two alone is in relative units.

    Args:
        simulated: what a simulator knows, or what gives it once linear predictors are fitted.
        seed: of the excitation.
        trim_ms, block_ms: of another recording, as of `trace_for`.
        listener: train listeners too, which needs PyTorch and a minute.
    """
    _check_comparable(texture, recording)
    trace = trace_for(texture, recording, trim_ms, block_ms)
    split = _split_of(texture, trace)
    blocks = tuple(range(trace.n_blocks)) if split is None else split.test
    on_stage("one-step")
    samples = texture.scaling.scale(trace.stacked())
    fitted: dict[str, Linear | None] = {}
    if split is not None:
        train, block = split.train, split.block
        fitted = {
            "ar": fit_linear(samples, train, block, ANCHOR_ORDER),
            "ar_scheduled": fit_linear(samples, train, block, ANCHOR_ORDER, scheduled=True),
            "ar_best": best_linear(samples, train, split.validation, block),
        }
    reference = simulated() if callable(simulated) else simulated or SimulatorReference()
    case = _Case(texture, NativeTexture(texture), trace, blocks, split, reference, seed)
    one_step_scores = _one_step(case, samples, fitted)
    on_stage("free run")
    free, synthesized = _free_run(case, fitted.get("ar"))
    warm, from_warm_start = _warm_start(case, fitted.get("ar"), synthesized.get("ceiling"))
    by_listeners = _listener(case, on_stage) if listener else None
    validation = ("mae_scaled", "mae_scaled_lattice", "spectrum_db", "lsd_db", "level_error_db")
    document = {
        "texture": texture.card["texture"],
        "model": texture.card["model"],
        "rate_hz": texture.rate_hz,
        "split": "foreign" if split is None else split.method,
        "split_sha256": None if split is None else split.sha256(),
        "unfinished": texture.unfinished,
        "seed": seed,
        "n_blocks": len(blocks),
        "block": trace.block,
        "sd_m_s2": texture.scaling.sd[0],
        "unit": texture.unit,
        **one_step_scores,
        **free,
        "warm_start": warm,
        "listener": by_listeners,
        "reasons": case.reasons,
        "texture_sha256": texture.sha256(),
        "recording_sha256": trace.recording_sha256,
        "validation": {name: texture.card["metrics"].get(f"validation_{name}") for name in validation},
    }
    return Judgement(document, trace, blocks, case.scored, synthesized, from_warm_start)


def _check_comparable(texture: Texture, recording: Recording) -> None:
    """Refuse other units than the texture's, and a recording that it was trained on in part."""
    units = {texture.card["units"].get("acceleration"), recording.unit("acceleration")}
    if RELATIVE in units and len(units) > 1:
        which = "texture" if texture.unit == RELATIVE else "recording"
        raise ValueError(
            f"the {which} is in relative units and the other in m/s²: their levels cannot be compared; where the sensitivity is "
            "known, import the sound with --unit acceleration=*FACTOR"
        )
    whole, known = texture.card["recording_sha256"], {take.get("sha256") for take in texture.card.get("takes", [])}
    if recording.sha256() != whole and any(take.sha256() in {whole, *known} for take in recording.takes):
        some = "some of it was trained on and some not, or in another order"
        raise ValueError(f"{some}: give the recordings of the training, all of them in its order, or others alone")


def _split_of(texture: Texture, trace: Trace) -> Split | None:
    """The texture's split, where the trace is of its own recording."""
    if trace.recording_sha256 != texture.card["recording_sha256"]:
        return None
    split = Split.from_fields(texture.card["split"])
    if (split.n_blocks, split.block) != (trace.n_blocks, trace.block):
        of_recording = f"the recording gives {trace.n_blocks} of {trace.block}"
        raise ValueError(f"the split is of {split.n_blocks} blocks of {split.block}, {of_recording}")
    return split


@dataclass(frozen=True)
class _Case:
    """A texture on blocks of a trace, and the reasons why figures are unknown."""

    texture: Texture
    kernel: NativeTexture
    trace: Trace
    blocks: tuple[int, ...]
    split: Split | None  # None of a foreign recording
    simulated: SimulatorReference
    seed: int
    reasons: dict[str, str] = field(default_factory=dict)

    @property
    def scored(self) -> slice:
        """Samples of a block that free runs are scored on: none of a recorded window that one of them starts from."""
        return runs.scored(self.trace.block, max(self.texture.window, ANCHOR_ORDER))


def _warm_start(case: _Case, linear: Linear | None, ceiling: Array | None) -> tuple[dict[str, Any], dict[str, Array]]:
    texture, trace = case.texture, case.trace
    window = None
    if linear is None or case.split is None:
        case.reasons["warm_start.synthesised"] = "no training blocks to fit AR(20) on, or too few"
    else:
        window = synthesised_window(linear, trace, case.split.train, texture)
    runs = warm_start_runs(texture, case.kernel, trace, case.blocks, window, case.seed, case.split)
    scored = runs if ceiling is None else {**runs, "ceiling": ceiling}
    return warm_start_scores(trace.picked(case.blocks)[0], scored, trace.rate_hz, texture.scaling.sd[0]), runs


def _listener(case: _Case, on_stage: Callable[[str], None]) -> dict[str, Any] | None:
    """Scores of listeners under a long stroke of the simulator, else under the test blocks."""
    if not case.texture.has_excitation:
        case.reasons["listener"] = f"{case.texture.card['model']} carries no excitation"
        return None
    from foten.evaluate.listener import listener_scores, long_stroke, rendering

    strokes = [long_stroke(stroke) for stroke in case.simulated.strokes]
    recorded, *others = strokes or [long_stroke(case.trace, case.blocks)]
    try:
        excluded = [] if strokes else neighbourhoods(case.split, case.trace, case.blocks)
        rendered = partial(rendering, case.kernel, recorded, excluded=excluded)
        in_m_s2 = case.texture.unit != RELATIVE
        return listener_scores(recorded, rendered, others, case.seed, on_stage, in_m_s2)
    except ValueError as error:
        case.reasons["listener"] = str(error)
        return None


def _one_step(case: _Case, samples: Array, fitted: Mapping[str, Linear | None]) -> dict[str, Any]:
    texture, kernel, trace, reasons = case.texture, case.kernel, case.trace, case.reasons
    result: dict[str, Any] = dict.fromkeys(ONE_STEP_KEYS)
    references: dict[str, dict[str, Any]] = {name: dict.fromkeys(ONE_STEP_KEYS) for name in REFERENCES}
    best = fitted.get("ar_best")
    references["ar_best"].update(order=best and best.window, scheduled=best and best.scheduled)
    block, first, sd = trace.block, max(first_scored(trace.block), texture.window), texture.scaling.sd[0]
    document = {"first_scored": first, "one_step": result, "references": references}
    if block < first + 8:
        reasons["one_step"] = f"blocks of {block} samples; the first {first} of each are history"
        return document
    n = targets(case.blocks, block, first).reshape(len(case.blocks), -1)
    recorded = samples[n, 0]
    predicted = {"zero": np.zeros(n.shape), "persistence": samples[n - 1, 0]}
    if texture.sizes.has_linear_part:
        predicted["lattice"] = predict(kernel, samples, n, "linear").sample
    else:
        reasons["references.lattice"] = f"{texture.card['model']} has no linear part"
    if not fitted:
        reasons["references.ar"] = "a foreign recording has no training blocks to fit linear predictors on"
    for name, linear in fitted.items():
        if linear is None:
            reasons[f"references.{name}"] = "fewer than two training windows for each coefficient"
        else:
            predicted[name] = linear.predict(samples, n)
    for name, values in predicted.items():
        references[name].update(one_step(recorded, values, sd, predicted.get("ar")))
    if not texture.predicts_samples:
        reasons["one_step"] = f"{texture.card['model']} predicts spectra, and no sample"
    else:
        result.update(one_step(recorded, predict(kernel, samples, n).sample, sd, predicted.get("ar")))
    if texture.sizes.excited:
        counted = (trace.speed[n] >= MOVING_SPEED) & (trace.force[n] >= MOVING_FORCE)
        scores = excitation_scores(kernel, samples, n, counted)
        if scores["nll"] is None:
            reasons["one_step.nll"] = "the excitation is that of a rendering, or the hand was at rest"
        result.update({**scores, "intervals": {**result["intervals"], **scores["intervals"]}})
    for name, bound in (("bound", case.simulated.bound), ("bound_window", case.simulated.bound_window)):
        if bound is None:
            reasons[f"references.{name}"] = case.simulated.why_no_bound
        else:
            mae = float(bound[n].mean())
            references[name].update(mae_scaled=mae / sd, mae_m_s2=mae)
    return document


def _free_run(case: _Case, linear: Linear | None) -> tuple[dict[str, Any], dict[str, Array]]:
    texture, trace, blocks, reasons = case.texture, case.trace, case.blocks, case.reasons
    scores: dict[str, Any] = {name: dict.fromkeys(FREE_RUN_KEYS) for name in RUNS}
    recorded, *_ = trace.picked(blocks)
    if recorded[:, case.scored].shape[1] < MIN_SCORED:
        needed = f"{MIN_SCORED} samples after the first {case.scored.start}"
        reasons["free_run"] = f"blocks of {trace.block} samples are too short for a spectrum, which takes {needed}"
        return scores, {}
    signals: dict[str, Array] = {}
    saturated: dict[str, int] = {}
    for name, excitation in (("free_run", True), ("free_run_deterministic", False)):
        if excitation and not texture.has_excitation:
            reasons[name] = f"{texture.card['model']} carries no excitation"
        else:
            signals[name], saturated[name] = runs.synthesize(
                case.kernel, trace, blocks, excitation, case.seed, split=case.split
            )
    if linear is not None:
        signals["free_run_ar"] = runs.synthesize_linear(linear, trace, blocks, texture.scaling, case.seed)
    else:
        reasons["free_run_ar"] = "no training blocks to fit AR(20) on, or too few"
    ceiling_of = None
    if case.simulated.realisations:
        signals["ceiling"] = np.stack([realisation.picked(blocks)[0] for realisation in case.simulated.realisations])
        ceiling_of = f"{len(case.simulated.realisations)} further realisations of the same stroke"
    elif case.split is not None:
        signals["ceiling"] = runs.nearest_training_blocks(trace, blocks, case.split.train)
        ceiling_of = "the training block nearest in speed and force"
    else:
        reasons["ceiling"] = "a foreign recording has no training blocks"
    for name, signal in signals.items():
        n_history = {"ceiling": 0, "free_run_ar": ANCHOR_ORDER}.get(name, texture.window)
        scores[name] = runs.free_run(
            recorded, signal, trace.rate_hz, texture.scaling.sd[0], n_history, case.scored.start
        )
        reasons.update({f"{name}.{key}": why for key, why in _WHY_UNKNOWN.items() if scores[name][key] is None})
        if name in saturated:
            scores[name]["n_saturated"] = saturated[name]
    scores["ceiling"]["of"] = ceiling_of
    return scores, signals
