"""Methods and references as rows over textures, and which differences between methods are significant."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from foten.dsp import Array
from foten.experiments.results import FIGURES, PAPER, Results, label_of, name_of

REFERENCES = {
    "zero": "references.zero",
    "persistence": "references.persistence",
    "AR(20)": "references.ar",
    "AR(20) by speed and force": "references.ar_scheduled",
    "best AR": "references.ar_best",
    "least possible": "references.bound",
}
FREE_RUN_REFERENCES = {"AR(20) with white noise": "free_run_ar", "ceiling": "ceiling"}


@dataclass(frozen=True)
class Row:
    """One method or reference over textures."""

    name: str  # in tables
    model: str  # key, "" for a reference
    values: Mapping[str, Array]  # by texture, one for each split that has one, shape (n_splits,)
    # By texture, 95 % over test blocks, of its first split.
    intervals: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    excited: bool = False  # whether it has the random excitation, on which no one-step figure depends

    def means(self, textures: Sequence[str]) -> Array:
        """Return the mean over splits for each texture, NaN where there is none, shape (n_textures,)."""
        return np.array([self.values[t].mean() if len(self.values.get(t, ())) else math.nan for t in textures])


def rows_of(results: Results, figure: str) -> tuple[list[str], list[Row]]:
    """Return the textures, and a row for each reference and each method, references first."""
    textures = list(dict.fromkeys(name_of(one["run"]["texture"]) for one in results))
    head, _, key = FIGURES[figure].path.rpartition(".")
    factor = FIGURES[figure].factor

    def row(name: str, model: str, where: str, of: Iterable[Mapping[str, Any]], excited: bool = False) -> Row:
        values: dict[str, list[float]] = {}
        intervals: dict[str, tuple[float, float]] = {}
        for one in of:
            texture = name_of(one["run"]["texture"])
            value = _at(one["evaluation"], f"{where}.{key}")
            interval = _at(one["evaluation"], f"{where}.intervals.{key}")
            if value is not None:
                values.setdefault(texture, []).append(factor * value)
            if interval is not None:
                intervals.setdefault(texture, (factor * interval[0], factor * interval[1]))
        return Row(name, model, {texture: np.array(of) for texture, of in values.items()}, intervals, excited)

    # A reference is the same whatever was trained beside it: once for each recording, split and preprocessing.
    distinct = {
        (one["recording_sha256"], one["run"]["split_seed"], json.dumps(one["run"]["preprocess"])): one
        for one in results
    }
    references = FREE_RUN_REFERENCES if head == "free_run" else REFERENCES
    rows = [row(name, "", where, distinct.values()) for name, where in references.items()]
    rows = [one for one in rows if one.values]
    for name in dict.fromkeys(map(label_of, results)):
        of = [one for one in results if label_of(one) == name]
        model, excited = of[-1]["run"]["model"], of[0]["run"]["sizes"].get("excitation", False)
        method = row(name, model, head, of, excited)
        if not method.values and head == "free_run":
            method = row(f"{name}, without excitation", model, "free_run_deterministic", of)
        rows.append(method)
    return textures, rows


def _at(document: Any, path: str) -> Any:
    """Return the value at a path of keys, None where there is none."""
    for key in path.split("."):
        document = document.get(key) if isinstance(document, Mapping) else None
    return document


def holm(p: Sequence[float]) -> list[float]:
    """Return p-values corrected for multiple comparisons, after Holm (1979), in the order given."""
    order = np.argsort(p, kind="stable")
    corrected = np.empty(len(p))
    corrected[order] = np.maximum.accumulate(np.arange(len(p), 0, -1) * np.asarray(p)[order]).clip(max=1.0)
    return corrected.tolist()


def complete(rows: Sequence[Row], textures: Sequence[str]) -> list[Row]:
    """Return the methods that have as many splits of each texture as any has."""
    methods = [row for row in rows if row.model]
    most = {texture: max(len(row.values.get(texture, ())) for row in methods) for texture in textures}
    return [row for row in methods if all(len(row.values.get(t, ())) == most[t] > 0 for t in textures)]


def compared(rows: Sequence[Row], textures: Sequence[str], better: int) -> tuple[str, dict[str, float]]:
    """Return the method that is best on the mean of the textures, and p-values of the others' differences from it.

    Methods that lack a split of a texture are left out: another split of a simulated texture is another recording.
    Wilcoxon's signed-rank test over the textures (means of splits), two-sided, Holm-corrected. Empty with fewer than six
    textures, where no p can be below 0.05.
    """
    from scipy.stats import wilcoxon

    methods = complete(rows, textures)
    if not methods:
        return "", {}
    best = max(methods, key=lambda row: better * float(row.means(textures).mean()))
    others = [row for row in methods if row is not best]
    if len(textures) < 6 or not others:
        return best.name, {}
    differences = [row.means(textures) - best.means(textures) for row in others]
    p = [float(wilcoxon(one).pvalue) if one.any() else 1.0 for one in differences]
    return best.name, dict(zip((row.name for row in others), holm(p), strict=True))


def as_in_paper(rows: Sequence[Row]) -> set[str]:
    """Return the names of the methods that the paper has a figure of.

    A model with several settings is left out: none of them is the paper's. With and without excitation count as one, because
    their one-step figures are the same.
    """
    names = set()
    for model in PAPER:
        of = [row for row in rows if row.model == model]
        plain = [row for row in of if not row.excited]
        if len(of) == 1 or len(plain) == 1:
            names.add((plain or of)[0].name)
    return names
