"""What the results of a sweep say, in sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator

from foten.experiments.comparison import as_in_paper, compared, complete, rows_of
from foten.experiments.paper import PAPER
from foten.experiments.results import FIGURES, Results, experiments_of, name_of


def findings(results: Results) -> Iterator[str]:
    """Yield what was reduced, which method is best in each figure, and whether the order is the paper's."""
    yield from dict.fromkeys(about["note"] for about in experiments_of(results) if about["note"])
    yield from _several_versions(results)
    yield from _same_blocks(results)
    for figure in FIGURES:
        yield from _best_method(results, figure)
    yield from _order(results)


def _several_versions(results: Results) -> Iterator[str]:
    versions: dict[str, set[str]] = {}
    for one in results:
        for package, version in {"foten": one["foten"], **one["versions"]}.items():
            versions.setdefault(package, set()).add(version)
    several = [f"{package} {', '.join(sorted(of))}" for package, of in versions.items() if len(of) > 1]
    if several:
        yield f"The results were made with several versions, of {'; '.join(several)}: run them again with one."


def _same_blocks(results: Results) -> Iterator[str]:
    """Yield which splits of a recording have the same test blocks: they differ only by training."""
    seeds: dict[tuple[str, str, str], set[int]] = {}
    for one in results:
        key = (name_of(one["run"]["texture"]), one["recording_sha256"], one["evaluation"]["split_sha256"])
        seeds.setdefault(key, set()).add(one["run"]["split_seed"])
    for (texture, _, _), same in seeds.items():
        if len(same) > 1:
            numbers = ", ".join(map(str, sorted(same)))
            yield f"{texture} is short: splits {numbers} are the same blocks, and differ by training alone."


def _best_method(results: Results, figure: str) -> Iterator[str]:
    of = FIGURES[figure]
    textures, rows = rows_of(results, figure)
    methods = [row for row in rows if row.model]
    without = [row.name for row in methods if not row.values]
    if without:
        yield f"{of.name}: there is none of {', '.join(without)}."
    lacking = [row.name for row in methods if row.values and row not in complete(rows, textures)]
    if lacking:
        yield f"{of.name}: not compared, for want of textures or splits: {', '.join(lacking)}."
    best, p = compared(rows, textures, of.better)
    if best:
        chance = [other for other, value in p.items() if value >= 0.05]
        differ = "; all others differ (p < 0.05)" if p else ""
        if chance:
            differ = f"; the difference may be chance for {', '.join(chance)}"
        yield f"{of.name}: {best} is best on the mean{differ}."


def _order(results: Results) -> Iterator[str]:
    textures, rows = rows_of(results, "mae")
    known = as_in_paper(rows)
    ours = {row.model: float(row.means(textures).mean()) for row in complete(rows, textures) if row.name in known}
    if len(ours) > 1 and all(math.isfinite(value) for value in ours.values()):
        here = sorted(ours, key=lambda model: ours[model])
        there = sorted(ours, key=lambda model: PAPER[model].mae or math.inf)
        same = "the same order" if here == there else "another order"
        yield (
            f"By one-step error, best first: {', '.join(here)} here; {', '.join(there)} in the paper, whose regime and unit "
            f"are not stated: {same}."
        )
