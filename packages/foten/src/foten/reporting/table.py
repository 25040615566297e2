"""Tables of names, words and numbers: as Markdown, CSV, LaTeX, HTML and aligned text."""

from __future__ import annotations

import csv
import html
import io
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from foten.atomic_write import atomic_write
from foten.dsp import Array

_LATEX = str.maketrans(
    {
        **{character: "\\" + character for character in "&%_#${}"},
        **{"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}"},
        **{"±": r"$\pm$", "–": "--", "÷": r"$\div$"},
    }
)


@dataclass(frozen=True)
class Heading:
    """Head of a column or of a row."""

    name: str
    unit: str = ""
    note: str = ""  # small print, in HTML alone
    key: str = ""  # identifier of a row, in HTML alone
    words: bool = False  # a column of words, set from the left
    highlighted: bool = False  # a row, in HTML alone

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Number:
    """Number as it is shown, or the reason why there is none."""

    value: float | None
    spec: str = ".3f"  # as of `format`
    error: float | None = None  # standard error of a mean
    unit: str = ""  # where it is not the column's or the row's
    best: bool = False  # bold in Markdown and LaTeX
    why: str = ""  # there is none
    interval: Sequence[float] = ()  # small print, in HTML alone
    bar: float | None = None  # length of a bar beside it, 0 to 1, in HTML alone

    def __str__(self) -> str:
        if self.value is None:
            return "–"
        error = "" if self.error is None else f" ± {self.error:{self.spec.lstrip('+')}}"
        return formatted(self.value, self.spec) + error + self.unit


Cell = str | Heading | Number


@dataclass(frozen=True)
class Table:
    """Columns and rows, with a title and notes above."""

    columns: tuple[Heading, ...]
    rows: tuple[tuple[Cell, ...], ...]
    title: str = ""
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, heads: Iterable[str | Heading], rows: Iterable[Sequence[Cell]]) -> Table:
        """Table of heads and rows; the first column is of words."""
        columns = (Heading(head, words=not k) if isinstance(head, str) else head for k, head in enumerate(heads))
        return cls(tuple(columns), tuple(map(tuple, rows)))

    def __post_init__(self) -> None:
        assert all(len(row) == len(self.columns) for row in self.rows), "a row has a cell for each column"

    def cells(self) -> list[list[str]]:
        """Text of all cells, the heads first."""
        return [[str(cell) for cell in row] for row in (self.columns, *self.rows)]

    def known(self) -> Table:
        """Table without the rows and columns of which no number is known."""
        table = replace(self, rows=tuple(row for row in self.rows if _any_known(row)))
        shown = [k for k in range(len(self.columns)) if k == 0 or _any_known([row[k] for row in table.rows])]
        rows = tuple(tuple(row[k] for k in shown) for row in table.rows)
        return replace(self, columns=tuple(self.columns[k] for k in shown), rows=rows)

    def missing(self) -> dict[str, list[str]]:
        """Reasons why numbers are missing, each with the names of the rows, columns and cells."""
        known, names = self.known(), dict[str, list[str]]()
        rows, columns = {_name(row[0]) for row in known.rows}, set(known.columns)
        for row in self.rows:
            for column, cell in zip(self.columns, row, strict=True):
                if isinstance(cell, Number) and cell.value is None:
                    name, head = _name(row[0]), column.name
                    lacking = name if name not in rows else head if column not in columns else f"{name} {head}"
                    if lacking not in names.setdefault(cell.why, []):
                        names[cell.why].append(lacking)
        return names

    def markdown(self) -> str:
        """Markdown, title and notes above; no line break beside a ±."""
        above = "".join(f"{text}\n\n" for text in [*([f"# {self.title}"] if self.title else []), *self.notes])
        lines = ["| " + " | ".join(row) + " |\n" for row in self._printed("**{}**", {ord("|"): r"\|"})]
        lines = [line.replace(" ± ", "\u00a0±\u00a0") for line in lines]
        return "".join([above, lines[0], "|" + "---|" * len(self.columns) + "\n", *lines[1:]])

    def csv(self) -> str:
        """CSV, without title and notes."""
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows(self.cells())
        return out.getvalue()

    def latex(self) -> str:
        """LaTeX with booktabs, title and notes above as comments."""
        head, *lines = (" & ".join(row) + r" \\" for row in self._printed(r"\textbf{{{}}}", _LATEX))
        above = [f"% {text}" for text in [*([self.title] if self.title else []), *self.notes]]
        begin = rf"\begin{{tabular}}{{l{'r' * (len(self.columns) - 1)}}}"
        return "\n".join([*above, begin, r"\toprule", head, r"\midrule", *lines, r"\bottomrule", r"\end{tabular}", ""])

    def _printed(self, bold: str, special: Mapping[int, str]) -> list[list[str]]:
        """Text of all cells with a form's special characters, the best in bold."""

        def text(cell: Cell) -> str:
            best = isinstance(cell, Number) and cell.best
            return (bold if best else "{}").format(str(cell).translate(special))

        return [[text(cell) for cell in row] for row in (self.columns, *self.rows)]

    def html(self, letter: str) -> str:
        """HTML: each number in full beside its rounding, each dash with a footnote, which the letter begins."""
        marks = {why: f"<sup>{letter}{k}</sup>" for k, why in enumerate(self.missing(), 1)}
        kinds = (' class="words"' * (column.words and k > 0) for k, column in enumerate(self.columns))
        heads = zip(kinds, self.columns, strict=True)
        head = "".join(f'<th scope="col"{kind}>{_html_name(column)}</th>' for kind, column in heads)
        body = "".join(_html_row(row, self.columns, marks) for row in self.rows)
        notes = " · ".join(f"{mark} {html.escape(why)}" for why, mark in marks.items())
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        return f'<div class="scroll">{table}</div>' + (f'<p class="notes">{notes}</p>' if notes else "")

    def text(self) -> list[str]:
        """Aligned lines for a terminal: words from the left, numbers and their heads from the right."""
        widths = [max(map(len, column)) for column in zip(*self.cells(), strict=True)]
        forms = [f"{'<' if column.words else '>'}{width}" for column, width in zip(self.columns, widths, strict=True)]
        rows = (map(format, row, forms) for row in self.cells())
        return [minus("  ".join(row).rstrip()) for row in rows]

    def write(self, path: Path, form: str = "") -> None:
        """Write it to a file, in one of the `FORMS`, by default that of its suffix."""
        with atomic_write(path) as part:
            part.write_text(FORMS[form or path.suffix[1:]](self), encoding="utf-8", newline="\n")


FORMS: dict[str, Callable[[Table], str]] = {"md": Table.markdown, "csv": Table.csv, "tex": Table.latex}


def mean_number(groups: Sequence[Array], digits: int, best: bool = False) -> Number:
    """Mean over groups (n,) of their means, ± its standard error where each has several values; a dash without groups."""
    if not groups:
        return Number(None)
    error = None
    if min(group.size for group in groups) > 1:
        error = float(np.sqrt(sum(group.var(ddof=1) / group.size for group in groups))) / len(groups)
    return Number(float(np.mean([group.mean() for group in groups])), f".{digits}f", error, best=best)


def formatted(value: float, spec: str) -> str:
    """Text of a number; where it rounds to zero without a sign."""
    text = format(value, spec)
    return text if text.strip("+-0.,") else text.lstrip("+-")


def minus(text: str) -> str:
    """Text with true minus signs before its numbers; hyphens within words stay."""
    return re.sub(r"(?<!\w)-(?=\d)", "−", text)


def signed(value: float, digits: int) -> str:
    """Text of a number with its sign, a true minus, and none where it rounds to zero."""
    return minus(formatted(value, f"+.{digits}f"))


def _any_known(cells: Sequence[Cell]) -> bool:
    """Whether any number of some cells is known, or any cell not empty where none is a number."""
    numbers = [cell.value for cell in cells if isinstance(cell, Number)]
    return any(value is not None for value in numbers) if numbers else any(cell != "" for cell in cells)


def _name(cell: Cell) -> str:
    return cell.name if isinstance(cell, Heading) else str(cell)


def _html_name(head: Heading) -> str:
    unit = f" <i>[{html.escape(head.unit)}]</i>" if head.unit else ""
    return html.escape(head.name) + unit + (f"<small>{html.escape(head.note)}</small>" if head.note else "")


def _html_row(row: Sequence[Cell], columns: Sequence[Heading], marks: Mapping[str, str]) -> str:
    head = row[0] if isinstance(row[0], Heading) else Heading(str(row[0]))
    attributes = (f' id="{head.key}"' if head.key else "") + (' class="own"' if head.highlighted else "")
    cells = (_html_cell(cell, column.words, marks) for cell, column in zip(row[1:], columns[1:], strict=True))
    return f'<tr{attributes}><th scope="row">{_html_name(head)}</th>{"".join(cells)}</tr>'


def _html_cell(cell: Cell, words: bool, marks: Mapping[str, str]) -> str:
    if not isinstance(cell, Number):
        return f'<td class="{"words" if words else "n"}">{html.escape(str(cell))}</td>'
    if cell.value is None:
        return f'<td class="n none"><abbr title="{html.escape(cell.why)}">–</abbr>{marks[cell.why]}</td>'
    bar = "" if cell.bar is None else f'<span class="bar" style="width:{8 * cell.bar:.2f}em"></span>'
    ends = " … ".join(minus(formatted(end, cell.spec)) for end in cell.interval)
    small = f"<small>{ends}{cell.unit}</small>" if ends else ""
    return f'<td class="n"><data value="{cell.value!r}">{minus(str(cell))}</data>{bar}{small}</td>'
