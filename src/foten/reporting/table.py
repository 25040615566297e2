"""A table: columns with units, rows of names, words and numbers; as Markdown, CSV, LaTeX, HTML and aligned text."""

from __future__ import annotations

import csv
import html
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from foten.atomic_write import atomic_write
from foten.dsp import Array

MAX_COLUMNS, MAX_ROWS = 8, 12  # of a table that people read, a row of means not counted; the rest is CSV
_LATEX = str.maketrans(
    {
        **{character: "\\" + character for character in "&%_#${}"},
        **{"\\": r"\textbackslash{}", "^": r"\textasciicircum{}", "~": r"\textasciitilde{}"},
        **{"±": r"$\pm$", "–": "--", "÷": r"$\div$"},
    }
)


@dataclass(frozen=True)
class Column:
    """The head of a column."""

    name: str
    unit: str = ""
    note: str = ""  # small print, in HTML alone
    words: bool = False  # set from the left, as names are

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Label:
    """The first cell of a row."""

    name: str
    unit: str = ""
    note: str = ""  # small print, in HTML alone
    key: str = ""  # identifier, in HTML alone
    highlighted: bool = False  # likewise

    def __str__(self) -> str:
        return f"{self.name} [{self.unit}]" if self.unit else self.name


@dataclass(frozen=True)
class Number:
    """A number as it is shown, or why there is none."""

    value: float | None
    spec: str = ".3f"  # as of `format`
    error: float | None = None  # standard error of a mean
    interval: Sequence[float] = ()  # small print, in HTML alone
    interval_spec: str = ""  # by default as the value's
    unit: str = ""  # where it is not the column's or the row's
    best: bool = False  # bold in Markdown and LaTeX
    why: str = ""  # there is none

    def __str__(self) -> str:
        if self.value is None:
            return "–"
        return formatted(self.value, self.spec) + (
            self.unit if self.error is None else f" ± {self.error:{self.spec.lstrip('+')}}{self.unit}"
        )


@dataclass(frozen=True)
class Bar:
    """A bar beside a number, in HTML alone."""

    share: float  # of the column's width, 0 to 1


Cell = str | Label | Number | Bar


@dataclass(frozen=True)
class Table:
    """Columns and rows, with a title and notes above."""

    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    title: str = ""
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, heading: Iterable[str | Column], rows: Iterable[Sequence[Cell]]) -> Table:
        """Table of a heading and rows; the first column is of words."""
        columns = [
            Column(head, words=not index) if isinstance(head, str) else head for index, head in enumerate(heading)
        ]
        return cls(tuple(columns), tuple(map(tuple, rows)))

    def __post_init__(self) -> None:
        assert all(len(row) == len(self.columns) for row in self.rows), "a row has as many cells as the heading"

    def cells(self) -> list[list[str]]:
        """Text of all cells, the heading first, without bars."""
        table = self.without_bars()
        return [[str(column) for column in table.columns], *([str(cell) for cell in row] for row in table.rows)]

    def without_bars(self) -> Table:
        """The same without columns of bars."""
        return self._with(k for k in range(len(self.columns)) if not any(isinstance(row[k], Bar) for row in self.rows))

    def without_empty_columns(self) -> Table:
        """The same without columns that have no cell."""
        return self._with(k for k in range(len(self.columns)) if k == 0 or any(row[k] != "" for row in self.rows))

    def known(self) -> Table:
        """The same without bars, and without the rows and columns of which no number is known."""
        table = replace(self.without_bars(), rows=tuple(row for row in self.without_bars().rows if _any_known(row)))
        columns = range(len(table.columns))
        return table._with(k for k in columns if k == 0 or _any_known([row[k] for row in table.rows]))

    def _with(self, columns: Iterable[int]) -> Table:
        shown = list(columns)
        rows = tuple(tuple(row[k] for k in shown) for row in self.rows)
        return replace(self, columns=tuple(self.columns[k] for k in shown), rows=rows)

    def missing(self) -> dict[str, list[str]]:
        """Reasons why numbers are missing, each with the names of the rows, columns and cells."""
        known, names = self.known(), dict[str, list[str]]()
        rows, columns = {_name(row[0]) for row in known.rows}, {str(column) for column in known.columns}
        for row in self.rows:
            for column, cell in zip(self.columns, row, strict=True):
                if isinstance(cell, Number) and cell.value is None:
                    name, head = _name(row[0]), column.name
                    lacking = name if name not in rows else head if str(column) not in columns else f"{name} {head}"
                    if lacking not in names.setdefault(cell.why, []):
                        names[cell.why].append(lacking)
        return names

    def check_readable(self, name: str) -> None:
        """Check that people can read it.

        Raises:
            ValueError: it has more columns or rows.
        """
        n_rows = sum(str(row[0]) != "mean" for row in self.rows)
        if len(self.columns) > MAX_COLUMNS or n_rows > MAX_ROWS:
            size = f"{len(self.columns)} columns and {n_rows} rows"
            raise ValueError(f"{name}: {size}, expected {MAX_COLUMNS} and {MAX_ROWS} at most")

    def markdown(self) -> str:
        """Markdown, title and notes above."""
        rows = [[cell.replace("|", r"\|") for cell in row] for row in self._emphasized("**{}**")]
        lines = ["| " + " | ".join(row) + " |" for row in rows]
        above = "".join(f"{text}\n\n" for text in [*([f"# {self.title}"] if self.title else []), *self.notes])
        return above + "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:]]) + "\n"

    def _emphasized(self, form: str, special: Mapping[int, str] | None = None) -> list[list[str]]:
        """Text of all cells with special characters replaced, the best in a form."""
        cells = [[cell.translate(special or {}) for cell in row] for row in self.cells()]
        for texts, row in zip(cells[1:], self.without_bars().rows, strict=True):
            for k, cell in enumerate(row):
                if isinstance(cell, Number) and cell.best:
                    texts[k] = form.format(texts[k])
        return cells

    def csv(self) -> str:
        """CSV, without title and notes."""
        out = io.StringIO()
        csv.writer(out, lineterminator="\n").writerows(self.cells())
        return out.getvalue()

    def latex(self) -> str:
        """LaTeX with booktabs, title and notes above as comments."""
        heading, *lines = (" & ".join(row) + r" \\" for row in self._emphasized(r"\textbf{{{}}}", _LATEX))
        body = "\n".join([heading, r"\midrule", *lines])
        above = "".join(f"% {text}\n" for text in [*([self.title] if self.title else []), *self.notes])
        columns = "l" + "r" * (len(self.cells()[0]) - 1)
        return f"{above}\\begin{{tabular}}{{{columns}}}\n\\toprule\n{body}\n\\bottomrule\n\\end{{tabular}}\n"

    def html(self, letter: str) -> str:
        """HTML: each number in full beside its rounding, each dash with a footnote, which the letter begins."""
        reasons = list(self.missing())
        head = "".join(f'<th scope="col">{_html_name(column)}</th>' for column in self.columns)
        body = "".join(_html_row(row, self.columns, letter, reasons) for row in self.rows)
        items = (f"<sup>{letter}{k}</sup> {html.escape(why)}" for k, why in enumerate(reasons, 1))
        notes = f'<p class="notes">{" · ".join(items)}</p>' if reasons else ""
        table = f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        return f'<div class="scroll">{table}</div>{notes}'

    def text(self) -> list[str]:
        """Aligned lines for a terminal: words from the left, numbers and their headings from the right."""
        cells = self.cells()
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        words = [column.words for column in self.without_bars().columns]
        aligned = (
            [
                cell.ljust(width) if left else cell.rjust(width)
                for cell, width, left in zip(row, widths, words, strict=True)
            ]
            for row in cells
        )
        return [minus("  ".join(row).rstrip()) for row in aligned]

    def write(self, path: Path, form: str = "") -> None:
        """Write it to a file, in one of the `FORMS`, by default that of its suffix."""
        with atomic_write(path) as part:
            part.write_text(FORMS[form or path.suffix[1:]](self), encoding="utf-8", newline="\n")


FORMS: dict[str, Callable[[Table], str]] = {"md": Table.markdown, "csv": Table.csv, "tex": Table.latex}


def mean_number(groups: Sequence[Array], digits: int, best: bool = False) -> Number:
    """Mean over groups of their means, ± its standard error where each group has several values; a dash without groups.

    Args:
        groups: values of each, as the splits of a texture, shape (n,) each.
    """
    if not groups:
        return Number(None)
    error = None
    if min(group.size for group in groups) > 1:
        error = float(np.sqrt(sum(group.var(ddof=1) / group.size for group in groups))) / len(groups)
    return Number(float(np.mean([group.mean() for group in groups])), f".{digits}f", error, best=best)


def formatted(value: float, spec: str) -> str:
    """Text of a number; a sign that the format asks for is left out where it rounds to zero."""
    text = format(value, spec)
    return text.lstrip("+-") if spec.startswith("+") and not float(text) else text


def minus(text: str) -> str:
    """Text of numbers with true minus signs: those before a digit, and not within a word."""
    return "".join(
        "−"
        if character == "-" and text[k + 1 : k + 2].isdigit() and not text[max(0, k - 1) : k].isalnum()
        else character
        for k, character in enumerate(text)
    )


def signed(value: float, digits: int) -> str:
    """Text of a number with its sign, a true minus, and none where it rounds to zero."""
    return minus(formatted(value, f"+.{digits}f"))


def _any_known(cells: Sequence[Cell]) -> bool:
    """Whether any number of some cells is known; of cells without numbers whether any is not empty."""
    numbers = [cell.value for cell in cells if isinstance(cell, Number)]
    return any(value is not None for value in numbers) if numbers else any(cell != "" for cell in cells)


def _name(cell: Cell) -> str:
    return cell.name if isinstance(cell, Label) else str(cell)


def _html_name(head: Label | Column) -> str:
    unit = f" <i>[{html.escape(head.unit)}]</i>" if head.unit else ""
    return html.escape(head.name) + unit + (f"<small>{html.escape(head.note)}</small>" if head.note else "")


def _html_row(row: Sequence[Cell], columns: Sequence[Column], letter: str, reasons: Sequence[str]) -> str:
    first, *others = row
    label = first if isinstance(first, Label) else Label(str(first))
    attributes = (f' id="{label.key}"' if label.key else "") + (' class="own"' if label.highlighted else "")
    cells = "".join(_html_cell(cell, column, letter, reasons) for cell, column in zip(others, columns[1:], strict=True))
    return f'<tr{attributes}><th scope="row">{_html_name(label)}</th>{cells}</tr>'


def _html_cell(cell: Cell, column: Column, letter: str, reasons: Sequence[str]) -> str:
    if isinstance(cell, Bar):
        return f'<td class="bars"><span class="bar" style="width:{100 * cell.share:.1f}%"></span></td>'
    if not isinstance(cell, Number):
        return f'<td class="{"words" if column.words else "n"}">{html.escape(str(cell))}</td>'
    if cell.value is None:
        mark = f"{letter}{reasons.index(cell.why) + 1}"
        return f'<td class="n none"><abbr title="{html.escape(cell.why)}">–</abbr><sup>{mark}</sup></td>'
    ends = " … ".join(minus(formatted(end, cell.interval_spec or cell.spec)) for end in cell.interval)
    small = f"<small>{ends}{cell.unit}</small>" if ends else ""
    return f'<td class="n"><data value="{cell.value!r}">{minus(str(cell))}</data>{small}</td>'
