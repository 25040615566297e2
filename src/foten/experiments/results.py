"""The result files of a sweep: reading them, and the figures in them."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from foten.experiments.experiment import Run

Results = Sequence[Mapping[str, Any]]

_OF_A_RESULT = {
    "evaluation",
    "foten",
    "versions",
    "recording_sha256",
    "seconds",
    "signals",
    "n_epochs",
    "validation_mae_scaled",
}
_OF_AN_EVALUATION = {"one_step", "free_run", "references", "ceiling", "n_blocks", "split_sha256", "rate_hz"}


@dataclass(frozen=True)
class Figure:
    """A number in the result files.

    Attributes:
        name: in headings, with its unit.
        path: of keys in `evaluation`.
        reported: the attribute of `paper.Reported` to print beside it, and its digits; None for none.
        better: 1 where more is better, −1 where less is.
        factor: from the number in the file to the one in tables.
    """

    name: str
    path: str
    reported: tuple[str, int] | None
    better: int
    factor: float = 1.0


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
    results: list[dict[str, Any]] = []
    seen: dict[tuple[str, str, int], str] = {}
    digests: dict[str, str] = {}
    for path in sorted(folder.glob("*.json")):
        result, run = _read(path)
        cell = (run.label, name_of(run.texture), run.split_seed)
        if cell in seen:
            raise ValueError(
                f"{seen[cell]} and {path.name} are both of {cell[0]} on {cell[1]}, split {cell[2]}: are results of other "
                "settings or of an earlier version left in the folder? Move one away"
            )
        seen[cell] = path.name
        recorded = run.seconds is None
        if recorded and digests.setdefault(cell[1], result["recording_sha256"]) != result["recording_sha256"]:
            raise ValueError(f"two recordings are called {cell[1]}, which a table cannot tell apart")
        results.append(result)
    if not results:
        raise ValueError(f"there is no result of foten sweep in {folder}")
    return sorted(results, key=lambda result: result.get("index", 0))


def is_result(content: Any) -> bool:
    """Return whether the content of a JSON file is a result with all that tables and figures need."""
    return (
        isinstance(content, dict)
        and set(content) >= _OF_A_RESULT
        and isinstance(content["evaluation"], dict)
        and set(content["evaluation"]) >= _OF_AN_EVALUATION
    )


def _read(path: Path) -> tuple[dict[str, Any], Run]:
    try:
        result = json.loads(path.read_bytes())
        run = Run(**result["run"])
        complete = isinstance(run.texture, str) and is_result(result)
    except (ValueError, KeyError, TypeError, OSError):
        complete = False
    if not complete:
        raise ValueError(f"{path.name} is no result of foten sweep, or damaged")
    return result, run


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
