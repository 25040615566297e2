"""Aggregates of runs: figures by texture, means over textures with standard errors, paired ratios, signed ranks."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from operator import truediv

import numpy as np

from foten.dsp import Array
from foten.dsp.inference import holm, standard_error
from foten.reporting.table import Number, mean_number
from foten_lab.results import BEST_LINEAR, FIGURES, LINEAR_RUN, WITHOUT, Record, Records

PAPER = {
    **{"ar": 0.400, "fnn": 0.378, "dstn": 0.201, "ldhtd": 0.178, "gan": 0.298, "foten": 0.149},
    **{"ten": 0.318, "ten-mfcc": 0.281, "ten-wavelet": 0.284, "foten-d": 0.193},
}
"""The paper's errors, means over its twelve textures; Tables I and II."""
REFERENCES = {
    "zero": "references.zero",
    "persistence": "references.persistence",
    "AR(20)": "references.ar",
    "AR(20) by speed and force": "references.ar_scheduled",
    BEST_LINEAR: "references.ar_best",
    "least possible": "references.bound",
}
FREE_RUN_REFERENCES = {LINEAR_RUN: "free_run_ar", "ceiling": "ceiling"}

Place = tuple[str, float]
"""Texture and split of a run."""


def by_texture(records: Iterable[Record], over: str, under: str = "", factor: float = 1.0) -> dict[str, Array]:
    """A figure, or a ratio of two, by texture: a number for each run that has it."""
    groups: dict[str, list[float]] = {}
    for record in records:
        number, divisor = record.get(over), record.get(under) if under else 1.0
        if number is not None and divisor is not None:
            groups.setdefault(record["texture"], []).append(factor * number / divisor)
    return {texture: np.array(splits) for texture, splits in groups.items()}


def mean_of(records: Records, over: str, under: str = "", digits: int = 3) -> Number:
    """Mean over textures ± its standard error, which is that of splits; a dash where there is none."""
    return mean_number([*by_texture(records, over, under).values()], digits)


def over_textures(records: Records, over: str, under: str = "", spec: str = ".3f") -> Number:
    """Mean over textures ± its standard error, which is that of textures."""
    means = np.array([splits.mean() for splits in by_texture(records, over, under).values()])
    return Number(float(means.mean()), spec, standard_error(means)) if means.size else Number(None)


def by_place(records: Records) -> dict[str, dict[Place, Record]]:
    """Runs of each method by texture and split."""
    methods: dict[str, dict[Place, Record]] = {}
    for record in records:
        methods.setdefault(record["method"], {})[record["texture"], record["split"]] = record
    return methods


def paired(
    runs: Mapping[Place, Record],
    others: Mapping[Place, Record],
    path: str,
    compare: Callable[[float, float], float] = truediv,
) -> list[Record]:
    """A figure of runs over that of others in the same places, as records of `texture` and `ratio`."""
    pairs = {place: (runs[place].get(path), others[place].get(path)) for place in runs if place in others}
    return [{"texture": place[0], "ratio": compare(a, b)} for place, (a, b) in pairs.items() if a is not None and b]


@dataclass(frozen=True)
class Row:
    """One method or reference over textures."""

    name: str  # in tables
    model: str  # key, "" for a reference
    values: Mapping[str, Array]  # by texture, one for each split that has one, shape (n_splits,)
    excited: bool = False  # whether it has the random excitation

    def means(self, textures: Sequence[str]) -> Array:
        """Mean over splits for each texture, NaN where there is none, shape (n_textures,)."""
        return np.array([self.values[t].mean() if len(self.values.get(t, ())) else math.nan for t in textures])


def rows_of(records: Records, figure: str) -> tuple[list[str], list[Row]]:
    """Textures, and a row for each reference and each method, references first."""
    textures = list(dict.fromkeys(record["texture"] for record in records))
    head, _, key = FIGURES[figure].path.rpartition(".")

    def row(name: str, model: str, where: str, runs: Iterable[Record], excited: bool = False) -> Row:
        return Row(name, model, by_texture(runs, f"{where}.{key}", factor=FIGURES[figure].factor), excited)

    # A reference is the same whatever was trained beside it: once for each recording and split. Not by the recording's hash, as
    # the same simulation differs in its last digits between instruction sets.
    distinct = {tuple(record[name] for name in ("texture", "split", "rate_hz")): record for record in records}
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


def complete(rows: Sequence[Row], textures: Sequence[str]) -> list[Row]:
    """Methods that have as many splits of each texture as any has."""
    methods = [row for row in rows if row.model]
    n_splits = {texture: max(len(row.values.get(texture, ())) for row in methods) for texture in textures}
    return [row for row in methods if all(len(row.values.get(t, ())) == n_splits[t] > 0 for t in textures)]


def compared(rows: Sequence[Row], textures: Sequence[str], better: int) -> tuple[str, dict[str, float]]:
    """Method that is best on the mean of the textures, and p-values of the others' differences from it.

    Of methods with all splits, as `signed_rank` has them.
    """
    methods = complete(rows, textures)
    if not methods:
        return "", {}
    best = max(methods, key=lambda row: better * float(row.means(textures).mean()))
    return best.name, signed_rank(best, [row for row in methods if row is not best], textures)


def signed_rank(first: Row, others: Sequence[Row], textures: Sequence[str]) -> dict[str, float]:
    """P-values of the differences from a row by name: Wilcoxon's signed-rank test over textures, two-sided, Holm-corrected.

    Textures are replicates where each has another hand, as in sweeps since the simulator's hands are drawn by texture; of earlier
    ones p is too small. Methods of equal figures are one. Empty with fewer than six textures, where no p can be below 0.05.
    """
    from scipy.stats import wilcoxon

    differences = {row.name: tuple(row.means(textures) - first.means(textures)) for row in others}
    if len(textures) < 6 or not others:
        return {}
    distinct = list(dict.fromkeys(differences.values()))
    p = holm(np.array([float(wilcoxon(difference).pvalue) if any(difference) else 1.0 for difference in distinct]))
    of = dict(zip(distinct, p.tolist(), strict=True))
    return {name: of[difference] for name, difference in differences.items()}


def as_in_paper(rows: Sequence[Row]) -> set[str]:
    """Names of the methods that the paper has a figure of: models with one setting, with and without excitation counted once."""
    names = set()
    for model in PAPER:
        with_model = [row for row in rows if row.model == model]
        without = [row for row in with_model if not row.excited]
        if len(with_model) == 1 or len(without) == 1:
            names.add((without or with_model)[0].name)
    return names
