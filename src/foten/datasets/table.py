"""Tables of text (CSV, TSV, …) and Excel sheets, with a header or none, as columns."""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from foten.datasets.columns import Column

_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_UNIT_WORD = re.compile(r"[\[(]?(s|ms|us|µs|ns|m/s\^?2|m/s²|m/s\*\*2|g|mg|mm/s\^?2|mm/s²|mm/s|cm/s|m/s|mm|cm|m|um|µm|N|mN|gf|V|mV)?[\])]?")


def read_delimited(path: Path) -> list[Column]:
    """Return the columns of a text table; the separator and the decimal comma are found, not asked.

    Lines before the table, lines that begin with # or %, and a second header row that holds only units are understood.

    Raises:
        ValueError: empty, not text, rows of different widths.
    """
    raw = path.read_bytes()
    if not raw.strip():
        raise ValueError(f"{path.name} is empty")
    lines = _decode(raw, path.name).splitlines()
    numbered = [(i, line) for i, line in enumerate(lines, start=1) if line.strip()]
    sample = numbered[len(numbered) // 2][1]
    delimiter = next((mark for mark in "\t;," if mark in sample), None)
    if delimiter is None:
        rows: list[list[Any]] = [line.lstrip("#% ").split() for _, line in numbered]
    else:
        rows = [list(row) for row in csv.reader((line for _, line in numbered), delimiter=delimiter)]
        if len(rows) != len(numbered):
            raise ValueError(f"{path.name}: a quotation mark opens and never closes; was the file cut off?")
        for (_, line), row in zip(numbered, rows, strict=True):
            if line[:1] in "#%":
                row[0] = row[0].lstrip("#% ")
    if delimiter != "," and any(_DECIMAL_COMMA.fullmatch(cell.strip()) for cell in rows[len(rows) // 2]):
        rows = [[cell.replace(",", ".") for cell in row] for row in rows]
    return _table(rows, [i for i, _ in numbered], path.name)


def read_excel(path: Path) -> list[Column]:
    """Return the columns of an .xlsx workbook; with several filled sheets each name begins with `SHEET.`.

    Raises:
        ValueError: empty, damaged, or the old .xls format.
    """
    import zipfile

    import openpyxl
    from openpyxl.utils.exceptions import InvalidFileException

    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    sheets: list[tuple[str, list[list[Any]]]] = []
    try:
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        try:
            for sheet in book.worksheets:
                sheet.reset_dimensions()  # some writers state a wrong extent; trusting it loses rows
                rows = [list(row) for row in sheet.iter_rows(values_only=True)]
                if any(cell is not None for row in rows for cell in row):
                    sheets.append((sheet.title, rows))
        finally:
            book.close()
    except (zipfile.BadZipFile, InvalidFileException, KeyError, EOFError, SyntaxError, zipfile.error) as error:
        raise ValueError(f"{path.name} is truncated or is not an .xlsx workbook ({error})") from None
    if not sheets:
        raise ValueError(f"{path.name} has no filled cell")
    columns: list[Column] = []
    for title, rows in sheets:
        where = path.name if len(sheets) == 1 else f"{path.name}, sheet {title}"
        width = max(_width(row) for row in rows)
        kept = [(i, [*row[:width], *[None] * (width - len(row))]) for i, row in enumerate(rows, start=1)]
        first = next(k for k, (_, row) in enumerate(kept) if _width(row))
        found = _table([row for _, row in kept[first:]], [i for i, _ in kept[first:]], where)
        if len(sheets) > 1:
            found = [
                Column(f"{title}.{c.name}", c.samples, c.rate_hz, c.unit, c.n_blank, c.fault) for c in found
            ]
        columns += found
    return columns


def _decode(raw: bytes, name: str) -> str:
    if raw[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return raw.decode("utf-16", errors="replace")
    if b"\0" in raw[:4096]:
        raise ValueError(f"{name} is not text; is its extension right?")
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        return raw.decode("latin-1")  # what spreadsheets wrote before UTF-8: µ and ² survive


def _width(row: Sequence[Any]) -> int:
    return max((i + 1 for i, cell in enumerate(row) if not _is_blank(cell)), default=0)


def _is_blank(cell: Any) -> bool:
    return cell is None or (isinstance(cell, str) and not cell.strip())


def _is_number(cell: Any) -> bool:
    if isinstance(cell, bool) or cell is None:
        return False
    try:
        float(cell)
    except (TypeError, ValueError):
        return False
    return True


def _table(rows: list[list[Any]], row_numbers: list[int], where: str) -> list[Column]:
    """Return the columns below the header of a table; `row_numbers` are those of the file, for messages."""
    last = next((row for row in reversed(rows) if any(_is_number(cell) for cell in row)), None)
    middle = rows[len(rows) // 2]
    if last is None:
        raise ValueError(f"{where} has no row of numbers")
    typical = middle if any(_is_number(cell) for cell in middle) else last
    width = len(typical)
    numeric = [k for k, cell in enumerate(typical) if _is_number(cell)]
    start = next(
        (
            i
            for i, row in enumerate(rows)
            if len(row) == width
            and any(_is_number(row[k]) for k in numeric)
            and all(_is_number(row[k]) or _is_blank(row[k]) for k in numeric)
        ),
        None,
    )
    if start is None:
        raise ValueError(f"{where} has no row of numbers")
    for number, row in zip(row_numbers[start:], rows[start:], strict=True):
        if len(row) != width:
            raise ValueError(
                f"{where}, row {number} has {len(row)} cells, expected {width}; was the file cut off?"
            )
    names, units = [str(k) for k in range(width)], [""] * width
    heads = [row for row in rows[max(0, start - 2) : start] if len(row) == width and not any(map(_is_number, row))]
    if len(heads) == 2 and any(map(_words, heads[1])) and all(_UNIT_WORD.fullmatch(w) for w in map(_words, heads[1])):
        units = [_words(cell).strip("[]()") for cell in heads[1]]
        heads.pop()
    if heads:
        names = [_words(cell) or str(k) for k, cell in enumerate(heads[-1])]
    return [
        _column(name, unit, [row[k] for row in rows[start:]], row_numbers[start:], where)
        for k, (name, unit) in enumerate(zip(names, units, strict=True))
    ]


def _words(cell: Any) -> str:
    return "" if cell is None else " ".join(str(cell).split())


def _column(name: str, unit: str, cells: list[Any], row_numbers: list[int], where: str) -> Column:
    n = len(cells)
    while n and _is_blank(cells[n - 1]):
        n -= 1
    cells, n_blank = cells[:n], len(cells) - n
    numbers = [float("nan") if _is_blank(cell) else cell for cell in cells]
    try:
        return Column(name, np.array(numbers, dtype=np.float64), unit=unit, n_blank=n_blank)
    except (TypeError, ValueError):
        bad = next(i for i, cell in enumerate(numbers) if not _is_number(cell))
        fault = f"row {row_numbers[bad]} is {str(cells[bad])!r}, expected a number"
        return Column(name, np.zeros(0), unit=unit, n_blank=n, fault=fault)
