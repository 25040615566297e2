"""A run of an experiment: train, judge, and the content of its result file."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path
from typing import Any

from foten.cli.simulator_reference import reference_for, validation_listener
from foten.dsp import Array
from foten.dsp.distance import scored_bins, segment_length, welch
from foten.evaluate.evaluate import Judgement, evaluate
from foten.evaluate.report.signals import shown_run, typical_block
from foten.evaluate.warm_start import SHOWN_MS, over_time
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.models.trainable import TRAINABLE, train, trainable_sizes
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.training.checkpoint import Checkpoint
from foten.training.job import TrainingJob
from foten.training.loop import Monitor
from foten_lab.experiment import MEASURES, OF_FIRST_SPLIT, Run


def execute(
    run: Run, recording: Recording, checkpoint: Path | None = None, about: Mapping[str, Any] | None = None
) -> tuple[dict[str, Any], Texture]:
    """Result and texture of a run: its settings, its figures on the test blocks, and the seconds of both stages.

    Args:
        checkpoint: file that the training goes on from where there is one, and writes after each epoch.
        about: what has to be the same to go on from it, beside the settings.
    """
    started, earlier = time.perf_counter(), None
    sizes, preprocess = trainable_sizes(run.model, run.sizes), PreprocessConfig(**run.preprocess)
    config = type(TRAINABLE[run.model].recipes["default"])(**run.train)
    if checkpoint is not None:
        earlier = Checkpoint.going_on(checkpoint, config, about or {})
    job = TrainingJob(recording, run.model, sizes, config, preprocess, split_seed=run.split_seed)
    trained = train(job, Monitor(checkpoint=earlier))
    if trained.progress.interrupted:
        raise KeyboardInterrupt
    seconds = time.perf_counter() - started if earlier is None else earlier.elapsed_s()
    return _result(run, recording, trained.texture, seconds), trained.texture


def _result(run: Run, recording: Recording, texture: Texture, seconds: float) -> dict[str, Any]:
    started = time.perf_counter()
    listener = "listener" in run.measures
    judgement = evaluate(texture, recording, reference_for(recording, texture, listener=listener), listener=listener)
    document, metrics = judgement.document, texture.card["metrics"]
    return {
        "run": asdict(run),
        "versions": texture.card["training"]["versions"],
        "recording_sha256": document["recording_sha256"],
        "seconds": {"training": seconds, "evaluation": time.perf_counter() - started},
        "n_epochs": metrics.get("n_epochs"),
        "validation_mae_scaled": metrics["validation_mae_scaled"],
        "file_bytes": len(texture.to_bytes()),
        "random_part": _random_part(texture),
        "measures": _measures(run.measures, texture, recording),
        "evaluation": document,
        "signals": _signals(judgement),
    }


def _random_part(texture: Texture) -> str | None:
    """What a rendering of foten-plus draws from; None of other models."""
    if not isinstance(texture.sizes, FotenPlusSizes):
        return None
    return "recorded" if texture.sizes.recorded else "noise"


def _measures(names: Sequence[str], texture: Texture, recording: Recording) -> dict[str, Any]:
    """Measures of a texture file by name, but for the listener, which is the evaluation's."""
    # Imported by name, so that a run does not depend on the source of a measure that it does not take.
    measures = {name: getattr(import_module(MEASURES[name]), name)(texture) for name in names if name in OF_FIRST_SPLIT}
    if "validation_listener" in names:
        measures["validation_listener"] = validation_listener(texture, recording)
    return measures


def _signals(judgement: Judgement) -> dict[str, Any] | None:
    """From the warm start: 400 ms of a typical test block, error and level over time; spectra of what is scored."""
    if shown_run(judgement) is None:
        return None
    trace, block, runs = judgement.trace, typical_block(judgement), judgement.from_warm_start["stored"]
    recorded, *_ = trace.picked(judgement.blocks)
    errors, levels_db = over_time(recorded, runs, trace.rate_hz)
    n_shown, n_segment = round(SHOWN_MS * trace.rate_hz / 1000), segment_length(trace.block)
    frequencies, density = welch(recorded[..., judgement.scored], trace.rate_hz, n_segment)
    _, of_run = welch(runs[..., judgement.scored], trace.rate_hz, n_segment)
    bins = scored_bins(frequencies, trace.rate_hz)
    return {
        "recorded": _rounded(recorded[block, :n_shown]),
        "free_run": _rounded(runs[0, block, :n_shown]),
        "error_to_silence": _rounded(errors),
        "level_db": _rounded(levels_db),
        "frequencies_hz": _rounded(frequencies[bins]),
        "density": {
            "recorded": _rounded(density.mean(axis=0)[bins]),
            "free_run": _rounded(of_run.mean(axis=(0, 1))[bins]),
        },
    }


def _rounded(values: Array) -> list[float]:
    """Numbers with the five digits that a figure needs."""
    return [float(f"{value:.5g}") for value in values]
