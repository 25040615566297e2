"""The result files of a sweep: reading them, the figures in them, and the paper's to print beside these."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foten.experiments.experiment import Run

Results = Sequence[Mapping[str, Any]]

_OF_A_RESULT = {
    *("evaluation", "foten", "versions", "recording_sha256"),
    *("seconds", "signals", "n_epochs", "validation_mae_scaled"),
}
_OF_AN_EVALUATION = {"one_step", "free_run", "references", "ceiling", "n_blocks", "split_sha256", "rate_hz"}


@dataclass(frozen=True)
class Reported:
    """One method's figures as the paper prints them; None where it prints none.

    Source: Tables I to III; no unit is stated for its errors.
    """

    mae: float  # mean over its twelve textures
    gfc: float  # the same, in %
    gpu_ms: float | None = None  # of one inference
    cpu_ms: float | None = None
    epoch_s: float | None = None  # of one epoch of training


PAPER = {
    "ar": Reported(0.400, 86.28),
    "fnn": Reported(0.378, 87.83),
    "dstn": Reported(0.201, 90.33, 1.38, 1.89, 44.35),
    "ldhtd": Reported(0.178, 91.02, 1.13, 1.26, 27.45),
    "gan": Reported(0.298, 88.65, 1.72, 2.37, 85.71),
    "foten": Reported(0.149, 92.15, 0.96, 1.11, 10.26),
    "ten": Reported(0.318, 86.77, 0.87, 1.07, 8.92),
    "ten-mfcc": Reported(0.281, 90.28),
    "ten-wavelet": Reported(0.284, 86.18),
    "foten-d": Reported(0.193, 90.64, 1.16, 1.39, 14.81),
}


@dataclass(frozen=True)
class Figure:
    """A number in the result files."""

    name: str  # in headings, with its unit
    path: str  # of keys in `evaluation`
    reported: tuple[str, int] | None  # the attribute of `Reported` to print beside it, and its digits
    better: int  # 1 where more is better, −1 where less is
    factor: float = 1.0  # from the number in the file to the one in tables


FIGURES = {
    "mae": Figure("one-step MAE [sd]", "one_step.mae_scaled", ("mae", 3), -1),
    "gfc": Figure("one-step GFC [%]", "one_step.gfc", ("gfc", 2), 1, factor=100.0),
    "lsd": Figure("free-run log-spectral distance [dB]", "free_run.lsd_db", None, -1),
    "level": Figure("free-run level error [dB]", "free_run.level_error_db", None, -1),
}


def read_results(folder: Path) -> list[dict[str, Any]]:
    """Return the results in a folder, in the order of their experiment.

    Raises:
        ValueError: there is none, a file is no result, two are of one method on one texture and split, or two recordings have
            one name.
    """
    if not folder.is_dir():
        raise ValueError(f"there is no folder {folder}")
    results: list[dict[str, Any]] = []
    seen: dict[tuple[str, str, int], str] = {}
    digests: dict[str, str] = {}
    for path in sorted(folder.glob("*.json")):
        result = read_result(path)
        if result is None:
            raise ValueError(f"{path.name} is no result of foten sweep, or damaged")
        run = Run(**result["run"])
        texture, digest = name_of(run.texture), result["recording_sha256"]
        cell = run.label, texture, run.split_seed
        if cell in seen:
            raise ValueError(
                f"{seen[cell]} and {path.name} are both of {run.label} on {texture}, split {run.split_seed}: are results of "
                "other settings or of an earlier version left in the folder? Move one away"
            )
        seen[cell] = path.name
        if run.seconds is None and digests.setdefault(texture, digest) != digest:
            raise ValueError(f"two recordings are called {texture}, which a table cannot tell apart")
        results.append(result)
    if not results:
        raise ValueError(f"there is no result of foten sweep in {folder}")
    return sorted(results, key=lambda result: result.get("index", 0))


def read_result(path: Path) -> dict[str, Any] | None:
    """Return the result in a file, with all that tables and figures need; None where there is none, or it is damaged."""
    try:
        result = json.loads(path.read_bytes())
        complete = isinstance(Run(**result["run"]).texture, str) and isinstance(result["evaluation"], dict)
    except (ValueError, KeyError, TypeError, OSError):
        return None
    complete = complete and set(result) >= _OF_A_RESULT and set(result["evaluation"]) >= _OF_AN_EVALUATION
    return result if complete else None


def label_of(result: Mapping[str, Any]) -> str:
    """Return the name of a result's row in tables."""
    return Run(**result["run"]).label


def name_of(texture: str) -> str:
    """Return the name of a texture: of a recording, its file's without folder and suffix."""
    return Path(texture).stem


def experiments_of(results: Results) -> list[dict[str, str]]:
    """Return `title` and `note` of the experiments that the results are of."""
    distinct = {json.dumps(one.get("experiment", {"title": "", "note": ""}), sort_keys=True) for one in results}
    return [json.loads(one) for one in sorted(distinct)]


def title_of(results: Results) -> str:
    """Return the titles of the experiments that the results are of."""
    return "; ".join(about["title"] for about in experiments_of(results) if about["title"])
