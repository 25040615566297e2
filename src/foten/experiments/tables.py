"""Tables of results, methods by textures beside the references and the paper's figures, and what they say in sentences."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Sequence

import numpy as np

from foten.experiments.results import (
    FIGURES,
    PAPER,
    Results,
    Row,
    as_in_paper,
    compared,
    complete,
    experiments_of,
    label_of,
    name_of,
    rows_of,
)

FORMATS = ("md", "csv", "tex")
_LATEX = str.maketrans(
    {
        **{character: "\\" + character for character in "&%_#${}"},
        **{"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}"},
        **{"±": r"$\pm$", "–": "--", "÷": r"$\div$"},
    }
)


def table(results: Results, figure: str) -> list[list[str]]:
    """Return a table of one figure: its heading, then a row for each reference and method."""
    shown = FIGURES[figure]
    textures, rows = rows_of(results, figure)
    _, p = compared(rows, textures, shown.better)
    n_splits = max((len(values) for row in rows for values in row.values.values()), default=1)
    spread = f"mean ± sd of {n_splits} splits" if n_splits > 1 else "one split"
    if n_splits == 1 and any(row.intervals for row in rows):
        spread += " [95 % over its blocks]"
    reported: dict[str, str] = {}
    if shown.reported is not None:
        attribute, digits = shown.reported
        models = {row.name: row.model for row in rows}
        reported = {name: f"{getattr(PAPER[models[name]], attribute):.{digits}f}" for name in as_in_paper(rows)}
    heading = [f"{shown.name}, {spread}", *textures, "mean", *(["p"] if p else [])]
    cells = [heading + (["paper's mean"] if reported else [])]
    for row in rows:
        means = row.means(textures)
        mean = f"{means.mean():.3f}" if np.isfinite(means).all() else "–"
        line = [row.name, *(_cell(row, texture, n_splits) for texture in textures), mean]
        if p:
            line.append(f"{p[row.name]:.3f}" if row.name in p else "")
        if reported:
            line.append(reported.get(row.name, ""))
        cells.append(line)
    return cells


def _cell(row: Row, texture: str, n_splits: int) -> str:
    values, interval = row.values.get(texture), row.intervals.get(texture)
    if values is None:
        return "–"
    if n_splits == 1 and interval is not None:
        return f"{values[0]:.3f} [{interval[0]:.3f}, {interval[1]:.3f}]"
    fewer = f" ({len(values)} of {n_splits})" if len(values) < n_splits else ""
    if len(values) == 1:
        return f"{values[0]:.3f}{fewer}"
    return f"{values.mean():.3f} ± {values.std(ddof=1):.3f}{fewer}"


def each_run(results: Results) -> list[list[str]]:
    """Return a row for each run, for a statistics program: each figure in a column, with its 95 % interval over test blocks.

    Intervals are empty where fewer than four blocks were judged. The free run of a model without excitation is the
    deterministic one, and `excitation` says so.
    """
    heading = ["method", "model", "texture", "split", "test_blocks", "excitation"]
    heading += [f"{name}{end}" for name in FIGURES for end in ("", "_low", "_high")]
    heading += ["validation_mae", "epochs", "training_s", "evaluation_s"]
    rows = [heading]
    for one in results:
        run, judged = one["run"], one["evaluation"]
        excited = judged["free_run"]["lsd_db"] is not None
        row = [label_of(one), run["model"], name_of(run["texture"]), run["split_seed"], judged["n_blocks"]]
        silent = judged["free_run_deterministic"]["lsd_db"] is None
        row.append("yes" if excited else None if silent else "no")
        for figure in FIGURES.values():
            head, _, key = figure.path.rpartition(".")
            scores = judged[head if excited or head != "free_run" else "free_run_deterministic"]
            interval = (scores.get("intervals") or {}).get(key) or (None, None)
            row += [None if value is None else figure.factor * value for value in (scores[key], *interval)]
        seconds = (one["seconds"][stage] for stage in ("training", "evaluation"))
        row += [one["validation_mae_scaled"], one["n_epochs"], *seconds]
        rows.append(["" if value is None else f"{value:.6g}" if type(value) is float else str(value) for value in row])
    return rows


def written(cells: Sequence[Sequence[str]], form: str) -> str:
    """Return a table as Markdown, CSV or LaTeX."""
    if form == "csv":
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows(cells)
        return out.getvalue()
    if form == "md":
        lines = ["| " + " | ".join(cell.replace("|", r"\|") for cell in row) + " |" for row in cells]
        return "\n".join([lines[0], "|" + "---|" * len(cells[0]), *lines[1:]]) + "\n"
    rows = [" & ".join(cell.translate(_LATEX) for cell in row) + r" \\" for row in cells]
    columns = "l" + "r" * (len(cells[0]) - 1)
    body = "\n".join([rows[0], r"\midrule", *rows[1:]])
    return f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{body}\n\\bottomrule\n\\end{{tabular}}\n"


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
    for (texture, *_), same in seeds.items():
        numbers = ", ".join(map(str, sorted(same)))
        if len(same) > 1:
            yield f"{texture} is short: splits {numbers} are the same blocks, and differ by training alone."


def _best_method(results: Results, figure: str) -> Iterator[str]:
    judged_by = FIGURES[figure]
    textures, rows = rows_of(results, figure)
    methods = [row for row in rows if row.model]
    without = [row.name for row in methods if not row.values]
    if without:
        yield f"{judged_by.name}: there is none of {', '.join(without)}."
    lacking = [row.name for row in methods if row.values and row not in complete(rows, textures)]
    if lacking:
        yield f"{judged_by.name}: not compared, for want of textures or splits: {', '.join(lacking)}."
    best, p = compared(rows, textures, judged_by.better)
    if best:
        chance = ", ".join(other for other, value in p.items() if value >= 0.05)
        differ = (
            f"; the difference may be chance for {chance}" if chance else "; all others differ (p < 0.05)" if p else ""
        )
        yield f"{judged_by.name}: {best} is best on the mean{differ}."


def _order(results: Results) -> Iterator[str]:
    textures, rows = rows_of(results, "mae")
    known = as_in_paper(rows)
    ours = {row.model: float(row.means(textures).mean()) for row in complete(rows, textures) if row.name in known}
    if len(ours) > 1:
        here, there = sorted(ours, key=ours.__getitem__), sorted(ours, key=lambda model: PAPER[model].mae)
        same = "the same order" if here == there else "another order"
        yield (
            f"By one-step error, best first: {', '.join(here)} here; {', '.join(there)} in the paper, whose regime and unit "
            f"are not stated: {same}."
        )
