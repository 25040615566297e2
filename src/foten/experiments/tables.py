"""Tables of results: methods by textures, beside the references and the paper's figures."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

import numpy as np

from foten.experiments.comparison import Row, as_in_paper, compared, rows_of
from foten.experiments.paper import PAPER
from foten.experiments.results import FIGURES, Results, label_of, name_of

FORMATS = ("md", "csv", "tex")


def table(results: Results, figure: str) -> list[list[str]]:
    """Return a table of one figure: its heading, then a row for each reference and method."""
    of = FIGURES[figure]
    textures, rows = rows_of(results, figure)
    _, p = compared(rows, textures, of.better)
    n_splits = max((len(values) for row in rows for values in row.values.values()), default=1)
    within = any(row.intervals for row in rows)
    spread = f"mean ± sd of {n_splits} splits" if n_splits > 1 else "one split"
    spread += " [95 % over its blocks]" if n_splits == 1 and within else ""
    known = as_in_paper(rows) if of.reported is not None else set()
    heading = [f"{of.name}, {spread}", *textures, "mean"]
    heading += ["p"] if p else []
    heading += ["paper's mean"] if known else []
    cells = [heading]
    for row in rows:
        means = row.means(textures)
        mean = f"{means.mean():.3f}" if np.isfinite(means).all() else "–"
        line = [row.name, *(_cell(row, texture, n_splits) for texture in textures), mean]
        if p:
            line.append(f"{p[row.name]:.3f}" if row.name in p else "")
        if known and of.reported is not None:
            attribute, digits = of.reported
            value = getattr(PAPER[row.model], attribute) if row.name in known else None
            line.append("" if value is None else f"{value:.{digits}f}")
        cells.append(line)
    return cells


def _cell(row: Row, texture: str, n_splits: int) -> str:
    values, interval = row.values.get(texture), row.intervals.get(texture)
    if values is None or not len(values):
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
            of = judged[head if excited or head != "free_run" else "free_run_deterministic"]
            interval = (of.get("intervals") or {}).get(key) or (None, None)
            row += [None if value is None else figure.factor * value for value in (of[key], *interval)]
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
        lines = [f"| {' | '.join(cell.replace('|', _BAR) for cell in row)} |" for row in cells]
        return "\n".join([lines[0], "|" + "---|" * len(cells[0]), *lines[1:]]) + "\n"
    rows = [" & ".join(_escaped(cell) for cell in row) + r" \\" for row in cells]
    columns = "l" + "r" * (len(cells[0]) - 1)
    body = "\n".join([rows[0], r"\midrule", *rows[1:]])
    return f"\\begin{{tabular}}{{{columns}}}\n\\toprule\n{body}\n\\bottomrule\n\\end{{tabular}}\n"


_BAR = r"\|"  # within a cell of Markdown
_LATEX = {
    **{character: "\\" + character for character in "&%_#${}"},
    "\\": r"\textbackslash{}",
    "^": r"\textasciicircum{}",
    "~": r"\textasciitilde{}",
    "±": r"$\pm$",
    "–": "--",
    "÷": r"$\div$",
}


def _escaped(cell: str) -> str:
    return "".join(_LATEX.get(character, character) for character in cell)
