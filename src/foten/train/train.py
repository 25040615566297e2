"""Recording to texture: the whole left side of the flow in one function."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

import foten
from foten.architecture import (
    FotenPlusArchitecture,
    GraphArchitecture,
    PredictorArchitecture,
    TenArchitecture,
)
from foten.dsp.level import FRAME_MS, frame_levels, frame_means
from foten.models import build
from foten.models.dftnet import Dftnet
from foten.models.excited import Excited
from foten.models.foten_plus import FotenPlus
from foten.models.gan import Gan
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Recording
from foten.recording.split import Split, split_blocks
from foten.recording.trace import Trace
from foten.recording.windows import targets, windows
from foten.render.forecast import Forecast, excitation_fit
from foten.render.synthesizer import FADE_FORCE, FADE_SPEED
from foten.texture_file import Texture
from foten.train.adversarial import fit_adversarial
from foten.train.card import card_of, recorded_peak
from foten.train.config import UNUSED, WARM_START, TrainConfig
from foten.train.excitation import TorchEngine, engine_of, fit_excitation, free_run_distance
from foten.train.export import export
from foten.train.fit import Data, Epoch, Progress, fit, pick_device, predict, reproducible
from foten.train.goals import ahead, spectra, taught
from foten.train.linear_part import LinearPart, fit_linear_parts
from foten.train.prepared import Prepared, prepare
from foten.train.together import fit_together

Array = NDArray[np.float64]

NETWORK_IS_NEARER = 0.98  # times the free run's distance without it
TONES_MAY_PAINT = 1.05  # times the log-spectral distance without them, on the validation blocks
WARM_START_NEAR = 100  # of so many training windows one is near enough to begin from
WARM_START_RINGS_MS = 20.0  # the end of a window, which is heard in what comes after
NAT_DB = 20 / math.log(10)


@dataclass(frozen=True)
class Trained:
    """A trained texture and how it came about."""

    texture: Texture
    trace: Trace
    split: Split
    progress: Progress
    lattice_mae: float | None
    """One-step validation error of the lattice alone, scaled; None without one."""


@dataclass(frozen=True)
class Lesson:
    """A network, and what it is to be fitted to."""

    network: nn.Module
    data: Data


def train_texture(
    recording: Recording,
    key: str,
    architecture: TenArchitecture | GraphArchitecture,
    config: TrainConfig,
    preprocess_config: PreprocessConfig | None = None,
    split_method: str = "regrouped",
    split_seed: int = 0,
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
    checkpoint: Path | None = None,
    resume: bool = False,
    texture_name: str = "",
    licence: str = "",
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Trained:
    """Return a texture learned from a recording.

    Raises:
        ValueError: the recording does not fit the configuration; the message names the option.
    """
    learning = _learning(
        recording,
        key,
        architecture,
        config,
        preprocess_config or PreprocessConfig(),
        split_method,
        split_seed,
        on_epoch,
        checkpoint,
        resume,
        texture_name,
        licence,
        on_stage,
    )
    with reproducible():
        begun = _begun(learning)
        if isinstance(begun, Trained):
            return begun
        return _ended(learning, fit(begun.network, begun.data, config, on_epoch, checkpoint, resume))


def train_together(
    recordings: Sequence[Recording],
    key: str,
    architecture: TenArchitecture | GraphArchitecture,
    configs: Sequence[TrainConfig],
    preprocess_config: PreprocessConfig,
    split_seeds: Sequence[int],
) -> list[Trained | Exception]:
    """Return textures learned from as many recordings, their networks fitted as one batched model; or why one is not.

    Recordings with as many training windows are learned together: see `fit_together`.
    """
    found: dict[int, Trained | Exception] = {}
    learnings, lessons = {}, dict[int, Lesson]()
    with reproducible():
        for k, recording in enumerate(recordings):
            learnings[k] = _learning(
                recording, key, architecture, configs[k], preprocess_config, "regrouped", split_seeds[k]
            )
            try:
                begun = _begun(learnings[k])
            except Exception as error:  # is told of its recording, of which the others are independent
                found[k] = error
                continue
            assert isinstance(begun, Lesson), key
            lessons[k] = begun
        for n in sorted({len(lesson.data.train) for lesson in lessons.values()}):
            alike = {k: lesson for k, lesson in lessons.items() if len(lesson.data.train) == n}
            try:
                fitted = fit_together(
                    [lesson.network for lesson in alike.values()],
                    [lesson.data for lesson in alike.values()],
                    [configs[k] for k in alike],
                )
            except Exception as error:  # a GPU's memory, say: those of another length are done or to come
                found |= dict.fromkeys(alike, error)
                continue
            for k, progress in zip(alike, fitted, strict=True):
                try:
                    found[k] = (
                        progress if isinstance(progress, ValueError) else _ended(learnings[k], progress)
                    )
                except Exception as error:
                    found[k] = error
    return [found[k] for k in range(len(recordings))]


def _begun(learning: Generator[Lesson, Progress, Trained]) -> Lesson | Trained:
    try:
        return next(learning)
    except StopIteration as done:
        trained: Trained = done.value
        return trained


def _ended(learning: Generator[Lesson, Progress, Trained], progress: Progress) -> Trained:
    try:
        learning.send(progress)
    except StopIteration as done:
        trained: Trained = done.value
        return trained
    raise AssertionError("a texture is one lesson")


def _learning(
    recording: Recording,
    key: str,
    architecture: TenArchitecture | GraphArchitecture,
    config: TrainConfig,
    preprocess_config: PreprocessConfig,
    split_method: str,
    split_seed: int,
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
    checkpoint: Path | None = None,
    resume: bool = False,
    texture_name: str = "",
    licence: str = "",
    on_stage: Callable[[str], None] = lambda stage: None,
) -> Generator[Lesson, Progress, Trained]:
    """Learn a texture, but for the fit of its network, which whoever runs this does; the GAN has none."""
    if architecture.in_graph:  # what is missing is said before training, not after
        import onnx  # noqa: F401
        import onnxruntime  # noqa: F401
    trace = preprocess(recording, preprocess_config)
    split = split_blocks(trace, split_method, split_seed)
    m = architecture.window
    if trace.block < 5 * m:
        raise ValueError(
            f"a block of {trace.block} samples is too short for windows of {m}, expected five times as long: "
            "use a longer --block or a shorter --window"
        )
    if key == "foten-plus":
        _check_that_a_frame_is_left(trace, m, config.max_order)
    prepared = prepare(trace, split)
    samples = prepared.samples.reshape(-1, 3)
    data = Data(samples, *prepared.targets(m), m)
    torch.manual_seed(config.seed)
    likelihood = level_errors = linear = tail_gain = None
    played: tuple[float | None, float | None] = (None, None)
    renderings: dict[str, list[float]] = {}
    if isinstance(architecture, FotenPlusArchitecture):
        parts = fit_linear_parts(architecture, data, prepared, config, on_stage)
        part, linear = _chosen(parts, prepared, config, on_stage)
        network, architecture = part.network, part.network.architecture
        data = _innovations(network, prepared)
        random = data if part.phase is None else _innovations(network, prepared, part.phase)
        trained = network.network.to(pick_device())
    else:
        if key == "ldhtd":
            data = taught(data, architecture.window, config, on_stage)
        trained = network = build(key, architecture).to(pick_device())
    if isinstance(network, Gan):
        trained = network = network.cpu()
        progress = fit_adversarial(network, m, prepared, config, on_epoch, checkpoint, resume)
    else:
        told = data
        if isinstance(network, Dftnet):
            trained, told = network.spectrum, spectra(data, prepared)
        elif architecture.n_ahead > 1:
            told = ahead(data, prepared, architecture.n_ahead)
        progress = yield Lesson(trained, told)
    if architecture.excited and not isinstance(network, FotenPlus):
        on_stage("fitting the excitation and settling its level in the closed loop")
        assert isinstance(architecture, TenArchitecture | PredictorArchitecture)
        network = Excited(network, architecture)
        level_errors, tail_gain, played, likelihood = _excited(network, data, prepared, config)
    lattice_mae = progress.epochs[0].validation_mae if isinstance(network, FotenPlus) else None
    if isinstance(network, FotenPlus):
        on_stage("fitting the excitation and settling its level in the closed loop")
        both = np.concatenate([random.train, random.validation])
        assert random.target is not None
        assert random.unit is not None
        correction = predict(trained, random, both) if part.phase is None else np.zeros(len(both))
        settled = _settled(network, correction, random, prepared, config)
        level_errors, tail_gain, played, renderings = settled
        architecture = network.architecture
        residual = random.target[both] - (correction if architecture.network_heard else 0.0)
        # Where rendering does not fade, as the judge counts it.
        n = data.validation
        heard = (trace.speed[n] >= FADE_SPEED) & (trace.force[n] >= FADE_FORCE)
        engine, where = engine_of(network), samples[n - 1, 1:]
        missed = residual[len(data.train) :] * random.unit[n]
        expected = Forecast(
            0 * missed, engine.sigma(where) * random.unit[n], engine.tail(where), engine.largest
        )
        _, nats = excitation_fit(expected, missed)
        likelihood = float(nats[heard].mean()) if heard.any() else None
    warm_start, condition = pick_warm_start(prepared, architecture.history)
    best = max((line for line in progress.epochs if line.best), key=lambda line: line.epoch)
    card: dict[str, Any] = {
        **card_of(recording, prepared, preprocess_config, texture_name, licence),
        "beyond_exponents": _beyond_exponents(trace, split, key),
        "warm_start": condition,
        "training": {
            **{name: value for name, value in asdict(config).items() if name not in UNUSED.get(key, ())},
            "versions": {"foten": foten.__version__, "torch": torch.__version__, "numpy": np.__version__},
            "device": next(network.parameters()).device.type,
        },
        "metrics": {
            "validation_loss": best.validation_loss,
            **_validated(network, architecture, data, best),
            "validation_mae_scaled_lattice": lattice_mae,
            "linear_part": linear,
            "validation_nll": likelihood,
            "renderings": renderings,
            "validation_lsd_db": played[0],
            "validation_level_error_db": played[1],
            "tail_gain_nat": tail_gain,
            "level_errors_db": level_errors,
            "recorded_peak_sd": recorded_peak(prepared),
            "best_epoch": best.epoch,
            "n_epochs": progress.epochs[-1].epoch,
        },
    }
    on_stage("proving the texture file")
    ends = targets(split.validation, trace.block, architecture.history)
    some = windows(samples, ends[:: max(1, len(ends) // 4096)], architecture.history)
    texture = export(network, key, architecture, prepared.scaling, some, warm_start, card)
    return Trained(texture, trace, split, progress, lattice_mae)


def _excited(
    network: Excited, data: Data, prepared: Prepared, config: TrainConfig
) -> tuple[list[float], float, tuple[float, float], float | None]:
    """Give a one-step network its excitation, that of foten-plus.

    Returns:
        What `fit_excitation` returns; the free run's log-spectral distance and level error on the validation blocks [dB]; the
        mean negative log-likelihood there, where a rendering does not fade [nat].
    """
    both, n = np.concatenate([data.train, data.validation]), data.validation
    residual = data.samples[both, 0] - predict(network.network, data, both)
    level_errors, tail_gain = fit_excitation(network, residual, data, prepared, config)
    played = free_run_distance(network, prepared, prepared.split.validation, config.seed)
    missed, trace = residual[len(data.train) :], prepared.trace
    heard = (trace.speed[n] >= FADE_SPEED) & (trace.force[n] >= FADE_FORCE)
    expected = TorchEngine(network).excitation.forecast(0 * missed, np.ones(len(n)), data.samples[n - 1, 1:3])
    _, nats = excitation_fit(expected, missed)
    return level_errors, tail_gain, played, float(nats[heard].mean()) if heard.any() else None


def _validated(
    network: nn.Module, architecture: TenArchitecture | GraphArchitecture, data: Data, best: Epoch
) -> dict[str, float | None]:
    """Return the errors on the validation blocks: one step, scaled; of a hop, and of spectra [dB], where there are such."""
    if architecture.of_noise:
        return {"validation_mae_scaled": None, "validation_spectrum_db": NAT_DB * best.validation_mae}
    if architecture.n_ahead == 1:
        return {"validation_mae_scaled": best.validation_mae}
    alone, n = network.network if isinstance(network, Excited) else network, data.validation
    first = float(np.abs(predict(alone, data, n) - data.samples[n, 0]).mean())
    return {"validation_mae_scaled": first, "validation_mae_scaled_hop": best.validation_mae}


def _settled(
    network: FotenPlus, correction: Array, random: Data, prepared: Prepared, config: TrainConfig
) -> tuple[list[float], float, tuple[float, float], dict[str, list[float]]]:
    """Give a network its excitation, and choose whether a rendering hears it.

    What decides is, as for tones, log-spectral distance times level error of the free run on the validation blocks. The network
    has to be nearer by 2 %: without it a rendered sample costs less than a hundredth (`architecture.multiply_adds`).

    Args:
        network: changed in place.
        correction: what the network adds at the training, then the validation indices, in innovations; zero where it adds
            nothing.
        random: what is left to chance without it.

    Returns:
        What `fit_excitation` returns; the free run's log-spectral distance and level error on the validation blocks [dB];
        both for every rendering tried.
    """
    both = np.concatenate([random.train, random.validation])
    assert random.target is not None
    tried = []
    for heard in (False, True) if correction.any() else (False,):
        network.architecture = replace(network.architecture, network_heard=heard)
        residual = random.target[both] - (correction if heard else 0.0)
        found = fit_excitation(network, residual, random, prepared, config)
        played = free_run_distance(network, prepared, prepared.split.validation, config.seed)
        tried.append((heard, found, played, copy.deepcopy(network.excitation.state_dict())))
    nearness = [played[0] * played[1] for _, _, played, _ in tried]
    best = len(tried) - 1 if nearness[-1] < NETWORK_IS_NEARER * nearness[0] else 0
    heard, (level_errors, tail_gain), played, excitation = tried[best]
    network.architecture = replace(network.architecture, network_heard=heard)
    network.excitation.load_state_dict(excitation)
    names = ("without network", "with network")
    return level_errors, tail_gain, played, {names[one]: list(p) for one, _, p, _ in tried}


def _check_that_a_frame_is_left(trace: Trace, m: int, max_order: int) -> None:
    """Check that a block holds a frame after its first fifth and after the longest history, for the level to be settled on."""
    rate = trace.rate_hz
    frame, history = FRAME_MS * rate / 1000, m + 1 + min(max_order, trace.block // 8)
    if trace.block - max(0.2 * trace.block, history) >= frame:
        return
    enough = max(frame / 0.8, (frame + m + 1) / (1 - 1 / 8))
    raise ValueError(
        f"a block of {1000 * trace.block / rate:g} ms holds no frame of {FRAME_MS:g} ms after its first {history} samples, and "
        f"the level could not be settled: use a --block of {math.ceil(1000 * enough / rate)} ms or more"
    )


def _chosen(
    parts: list[LinearPart], prepared: Prepared, config: TrainConfig, on_stage: Callable[[str], None]
) -> tuple[LinearPart, dict[str, Any]]:
    """Return the better of the linear parts, and what was tried.

    What decides is the product of two errors of the free run, heard without a network, on the validation blocks:
    log-spectral distance and level error. Tones that paint another spectrum are none of the surface's, whatever the level.
    """
    if len(parts) == 1:
        return parts[0], parts[0].found
    on_stage("listening to the free run with tones and without")
    for part in parts:
        random = _innovations(part.network, prepared, part.phase)
        assert random.target is not None
        residual = random.target[np.concatenate([random.train, random.validation])]
        fit_excitation(part.network, residual, random, prepared, config)
        lsd_db, level_error_db = free_run_distance(
            part.network, prepared, prepared.split.validation, config.seed
        )
        part.found["heard"] = {"lsd_db": lsd_db, "level_error_db": level_error_db}
    allowed = TONES_MAY_PAINT * parts[0].found["heard"]["lsd_db"]
    best = min(
        (part for part in parts if part is parts[0] or part.found["heard"]["lsd_db"] <= allowed),
        key=lambda part: part.found["heard"]["lsd_db"] * part.found["heard"]["level_error_db"],
    )
    rest = [part.found for part in parts if part is not best]
    return best, {**best.found, "rejected": rest}


def _innovations(network: FotenPlus, prepared: Prepared, phase: Array | None = None) -> Data:
    """Return what the network learns: to predict the lattice's innovations from levelled samples and past innovations.

    Given the phase of tones, those of what the tones leave.
    """
    engine, m = engine_of(network), network.architecture.history
    x, e, unit = engine.innovations(prepared.samples, phase)
    samples = np.concatenate([x[..., None], prepared.samples[..., 1:], e[..., None]], axis=2)
    return Data(
        samples.reshape(-1, 4), *prepared.targets(m), network.architecture.window, e.ravel(), unit.ravel()
    )


def _beyond_exponents(trace: Trace, split: Split, key: str) -> dict[str, float]:
    """Return the powers of speed and force that the level grows with, from the faster and the firmer half of the training blocks.

    Levels in frames, least squares over their logarithms; 0 where speed or force hardly varies, and for the paper's network,
    which clamps (Sec. VIII).
    """
    chosen = list(split.train)
    if key != "foten-plus" or trace.block < FRAME_MS * trace.rate_hz / 1000:
        return {"speed": 0.0, "force": 0.0}
    acceleration, speed, force = (
        trace.blocks(channel)[chosen] for channel in (trace.acceleration, trace.speed, trace.force)
    )
    levels = frame_levels(acceleration, trace.rate_hz, float(np.sqrt(np.square(acceleration).mean()))).ravel()
    speed, force = (frame_means(channel, trace.rate_hz).ravel() for channel in (speed, force))
    logs = np.log10(np.maximum(np.stack([speed, force]), [[FADE_SPEED], [FADE_FORCE]]))
    found = {}
    for row, name in enumerate(("speed", "force")):
        upper = logs[row] >= np.median(logs[row])
        design = np.stack([np.ones(upper.sum()), *logs[:, upper]], axis=1)
        varied = upper.sum() >= 20 and np.ptp(np.percentile(logs[row, upper], [10, 90])) >= math.log10(1.2)
        slope = np.linalg.lstsq(design, levels[upper], rcond=None)[0][1 + row] if varied else 0.0
        found[name] = float(np.clip(slope / 20, 0.0, 1.5))
    return found


def pick_warm_start(prepared: Prepared, m: int) -> tuple[Array, dict[str, Any]]:
    """Return a recorded training window near 45 mm/s and 0.8 N that is neither loud nor soft, scaled, (m, 3), and its condition.

    Of the hundredth of the training windows that is nearest (in units of the training standard deviations), it is the one
    whose last 20 ms have the median power: those ring on. What is rendered without excitation goes on from it, and so does the
    proof of the file; with excitation a stroke begins by chance (`State.begin`).

    Source: Sec. V-a. Differs from the paper: it synthesises the window without saying from what; ours is recorded, and the
    card says under what condition.
    """
    trace, scaling = prepared.trace, prepared.scaling
    ends, _ = prepared.targets(m)
    distance = np.hypot(
        (trace.speed[ends - 1] - WARM_START[0]) / scaling.sd[1],
        (trace.force[ends - 1] - WARM_START[1]) / scaling.sd[2],
    )
    near = ends[np.argsort(distance, kind="stable")[: max(1, len(ends) // WARM_START_NEAR)]]
    candidates = windows(prepared.samples.reshape(-1, 3), near, m)
    n_last = min(m, max(1, round(WARM_START_RINGS_MS * trace.rate_hz / 1000)))
    power = np.square(candidates[:, -n_last:, 0]).mean(axis=1)
    chosen = np.argsort(power, kind="stable")[(len(near) - 1) // 2]
    window, end = candidates[chosen], near[chosen]
    condition = {
        "asked": {"speed": WARM_START[0], "force": WARM_START[1]},
        "found": {"speed": float(trace.speed[end - 1]), "force": float(trace.force[end - 1])},
    }
    return window, condition
