"""One run of an experiment: train, judge, and what its result file holds."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from typing import Any

import foten
from foten.baselines.sizes import trainable_sizes
from foten.evaluate.evaluate import Judgement, evaluate
from foten.evaluate.report.signals import N_WAVEFORM, densities, scored_runs, shown_run, typical_block
from foten.experiments.experiment import Run
from foten.experiments.onset import onset
from foten.experiments.stability import stability
from foten.experiments.truth import truth_for, validation_listener
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.recording.trace import Trace
from foten.training.config import TrainConfig
from foten.training.job import TrainingJob
from foten.training.pipeline import train


def execute(run: Run, recording: Recording) -> dict[str, Any]:
    """Return the result of one run: its settings, its figures on the test blocks, and the seconds of both stages."""
    started = time.perf_counter()
    trained = train(_job(run, recording))
    if trained.progress.interrupted:
        raise KeyboardInterrupt
    return _judged(run, recording, trained.texture, time.perf_counter() - started)


def failure(error: Exception) -> dict[str, Any]:
    """Return the result of a run that failed: the first line of its error."""
    lines = str(error).splitlines() or [""]
    return {"failed": f"{type(error).__name__}: {lines[0]}"}


def _job(run: Run, recording: Recording) -> TrainingJob:
    sizes, preprocess = trainable_sizes(run.model, run.sizes), PreprocessConfig(**run.preprocess)
    return TrainingJob(recording, run.model, sizes, TrainConfig(**run.train), preprocess, split_seed=run.split_seed)


def _judged(run: Run, recording: Recording, texture: Texture, seconds: float) -> dict[str, Any]:
    started = time.perf_counter()
    listener = "listener" in run.measures
    judgement = evaluate(texture, recording, truth_for(recording, texture, listener=listener), listener=listener)
    document, metrics = judgement.document, texture.card["metrics"]
    return {
        "run": asdict(run),
        "foten": foten.__version__,
        "versions": texture.card["training"]["versions"],
        "recording_sha256": document["recording_sha256"],
        "seconds": {"training": seconds, "evaluation": time.perf_counter() - started},
        "n_epochs": metrics.get("n_epochs"),
        "validation_mae_scaled": metrics["validation_mae_scaled"],
        "file_bytes": len(texture.to_bytes()),
        "network_in_loop": texture.sizes.network_in_loop if isinstance(texture.sizes, FotenPlusSizes) else None,
        "measures": _measures(run.measures, texture, recording, judgement.trace),
        "evaluation": document,
        "signals": _signals(judgement),
    }


def _measures(names: Sequence[str], texture: Texture, recording: Recording, trace: Trace) -> dict[str, Any]:
    """Return what a texture file is measured for beside its evaluation, by measure."""
    measures: dict[str, Callable[[], dict[str, Any]]] = {
        "stability": lambda: stability(texture),
        "onset": lambda: onset(texture),
        "validation_listener": lambda: validation_listener(texture, recording),
    }
    return {name: measures[name]() for name in names if name in measures}  # the listener is the evaluation's


def _signals(judgement: Judgement) -> dict[str, Any] | None:
    """Return what figures are drawn from: 400 samples of a typical test block, and the spectra of all of them."""
    shown = shown_run(judgement)
    if shown is None:
        return None
    block, runs = typical_block(judgement), scored_runs(judgement)
    frequencies, density = densities(judgement)
    return {
        "recorded": _rounded(runs["recorded"][0, block, :N_WAVEFORM]),
        "free_run": _rounded(runs[shown][0, block, :N_WAVEFORM]),
        "frequencies_hz": _rounded(frequencies),
        "density": {"recorded": _rounded(density["recorded"]), "free_run": _rounded(density[shown])},
    }


def _rounded(values: Any) -> list[float]:
    """Return numbers with the five digits that a figure needs."""
    return [float(f"{value:.5g}") for value in values]
