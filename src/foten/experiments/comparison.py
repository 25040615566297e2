"""Figures of runs as rows over textures, beside references and the paper's, and which differences are significant."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from foten.dsp import Array

Record = Mapping[str, Any]
"""A run, its names, settings and figures by their paths: what tables are of, and a row of `runs.csv`."""
Records = Sequence[Record]


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
    """A number of a run."""

    name: str  # in headings, with its unit
    path: str  # its key in a record
    digits: int  # behind the point, of means
    better: int  # 1 where more is better, −1 where less is
    linear: str  # the linear predictor among the references, that a method is to beat
    factor: float = 1.0  # from the number in the file to the one in tables


PERSISTENCE, BEST_LINEAR, LINEAR_RUN = "persistence", "best AR", "AR(20) with white noise"
FIGURES = {
    "mae": Figure("one-step MAE [sd]", "one_step.mae_scaled", 3, -1, BEST_LINEAR),
    "gfc": Figure("one-step GFC [%]", "one_step.gfc", 1, 1, BEST_LINEAR, factor=100.0),
    "lsd": Figure("free-run log-spectral distance [dB]", "free_run.lsd_db", 2, -1, LINEAR_RUN),
    "level": Figure("free-run level error [dB]", "free_run.level_error_db", 2, -1, LINEAR_RUN),
}
REFERENCES = {
    "zero": "references.zero",
    PERSISTENCE: "references.persistence",
    "AR(20)": "references.ar",
    "AR(20) by speed and force": "references.ar_scheduled",
    BEST_LINEAR: "references.ar_best",
    "least possible": "references.bound",
}
FREE_RUN_REFERENCES = {LINEAR_RUN: "free_run_ar", "ceiling": "ceiling"}
WITHOUT = ", without excitation"
"""What is added to a method's name, in tables and figures, where its free run has no excitation."""


@dataclass(frozen=True)
class Row:
    """One method or reference over textures."""

    name: str  # in tables
    model: str  # key, "" for a reference
    values: Mapping[str, Array]  # by texture, one for each split that has one, shape (n_splits,)
    excited: bool = False  # whether it has the random excitation, on which no one-step figure depends

    def means(self, textures: Sequence[str]) -> Array:
        """Mean over splits for each texture, NaN where there is none, shape (n_textures,)."""
        return np.array([self.values[t].mean() if len(self.values.get(t, ())) else math.nan for t in textures])


def rows_of(records: Records, figure: str) -> tuple[list[str], list[Row]]:
    """Textures, and a row for each reference and each method, references first."""
    textures = list(dict.fromkeys(record["texture"] for record in records))
    head, _, key = FIGURES[figure].path.rpartition(".")
    factor = FIGURES[figure].factor

    def row(name: str, model: str, where: str, of: Iterable[Record], excited: bool = False) -> Row:
        values: dict[str, list[float]] = {}
        for record in of:
            value = record.get(f"{where}.{key}")
            if value is not None:
                values.setdefault(record["texture"], []).append(factor * value)
        return Row(name, model, {texture: np.array(splits) for texture, splits in values.items()}, excited)

    # A reference is the same whatever was trained beside it: once for each recording and split.
    names = ("texture", "recording_sha256", "split", "rate_hz")
    distinct = {tuple(record[name] for name in names): record for record in records}
    references = FREE_RUN_REFERENCES if head == "free_run" else REFERENCES
    rows = [row(name, "", where, distinct.values()) for name, where in references.items()]
    rows = [reference for reference in rows if reference.values]
    for name in dict.fromkeys(record["method"] for record in records):
        runs = [record for record in records if record["method"] == name]
        model, excitation = runs[-1]["model"], {record["excitation"] for record in runs}
        if "no" in excitation and "yes" not in excitation:
            where = "free_run_deterministic" if head == "free_run" else head
            rows.append(row(name + WITHOUT, model, where, runs))
        else:
            rows.append(row(name, model, head, runs, "yes" in excitation))
    return textures, rows


def holm(p: Sequence[float]) -> list[float]:
    """P-values corrected for multiple comparisons, after Holm (1979), in their order."""
    order = np.argsort(p, kind="stable")
    corrected = np.empty(len(p))
    corrected[order] = np.maximum.accumulate(np.arange(len(p), 0, -1) * np.asarray(p)[order]).clip(max=1.0)
    return corrected.tolist()


def complete(rows: Sequence[Row], textures: Sequence[str]) -> list[Row]:
    """Methods that have as many splits of each texture as any has."""
    methods = [row for row in rows if row.model]
    n_splits = {texture: max(len(row.values.get(texture, ())) for row in methods) for texture in textures}
    return [row for row in methods if all(len(row.values.get(t, ())) == n_splits[t] > 0 for t in textures)]


def compared(rows: Sequence[Row], textures: Sequence[str], better: int) -> tuple[str, dict[str, float]]:
    """Method that is best on the mean of the textures, and p-values of the others' differences from it.

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
    p = [float(wilcoxon(difference).pvalue) if difference.any() else 1.0 for difference in differences]
    return best.name, dict(zip((row.name for row in others), holm(p), strict=True))


def as_in_paper(rows: Sequence[Row]) -> set[str]:
    """Names of the methods that the paper has a figure of.

    A model with several settings is left out: none of them is the paper's. With and without excitation count as one, because
    their one-step figures are the same.
    """
    names = set()
    for model in PAPER:
        with_model = [row for row in rows if row.model == model]
        without = [row for row in with_model if not row.excited]
        if len(with_model) == 1 or len(without) == 1:
            names.add((without or with_model)[0].name)
    return names
