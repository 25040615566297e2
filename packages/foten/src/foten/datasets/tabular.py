"""Tables of text (CSV, TSV, …) and Excel sheets, with a header or none, as columns; ValueError where one is damaged."""

import contextlib
import csv
import re
import zipfile
from collections.abc import Collection, Iterable, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from foten.datasets.columns import MAX_COLUMNS, Column, check_width, reading
from foten.datasets.isolated import Contents, contents_of
from foten.datasets.units import CLOCK, WORDS, is_unit
from foten.dsp import Array
from foten.recording.recording import counted
from foten.untrusted import brief, check_content, read_whole

COMMENTS = ("#", "%", "//")  # that a line of comment begins with
_DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
_NO_THOUSANDS = re.compile(r"[-+]?(?:0|\d{4,}|\d*(?=,\d{1,2}$)|\d*(?=,\d{4,}$)),\d+([eE][-+]?\d+)?")
_DECIMAL_POINT = re.compile(r"[-+]?\d*\.\d+([eE][-+]?\d+)?")
_STATED = re.compile(r"(?:^|; )(\w+) ?[:=] *([^;]*[^;\s])")
MAX_CELLS = 20_000_000  # of a workbook, blank ones among them
MAX_ROWS = 2_000_000  # of a sheet; a program of tables has 1,048,576
MAX_BLANK_LINES = 1_000_000  # more than there are other lines
DAY_S = 86400.0
_CLOCK = re.compile(
    r"(?:(?P<date>\d{4}-\d\d-\d\d|\d{1,2}[./]\d{1,2}[./]\d{4})[T ]\s*)?"
    r"(?P<first>\d+):(?P<second>[0-5]\d(?:[.,]\d+)?)(?::(?P<third>[0-5]\d(?:[.,]\d+)?))?"
    r"\s*(?P<half>[AaPp][Mm])?\s*(?P<zone>Z|[+-]\d\d:?\d\d)?"
)


def read_delimited(path: Path) -> list[Column]:
    """Columns of a text table with any separator, decimal commas, lines before it, comments, and a second header of units."""
    lines = _decode(read_whole(path), path.name).splitlines()
    n_filled = sum(map(bool, map(str.strip, lines)))
    if not n_filled:
        raise ValueError(f"{path.name} is empty")
    if (n_blank := len(lines) - n_filled) > n_filled + MAX_BLANK_LINES:
        raise ValueError(f"{path.name} has {n_blank:,} blank lines and {n_filled:,} others: take the blank ones out")
    comments = {i: line.lstrip("#%/ \t") for i, line in enumerate(lines) if line.lstrip().startswith(COMMENTS)}
    lines = ["" if i in comments else line for i, line in enumerate(lines)]
    filled = [line for line in lines if line.strip()] or [""]
    sample = filled[len(filled) // 2]
    delimiter = next((mark for mark in "\t;," if mark in sample), None)
    for line in filled:
        if len(line) > MAX_COLUMNS:  # so that no line of a usual table is counted
            check_width(path.name, len(line.split(delimiter)))
    if delimiter is None:
        rows: list[list[Any]] = [comments.get(i, line).split() for i, line in enumerate(lines)]
    else:
        try:
            rows = list(csv.reader(lines, delimiter=delimiter))
            if len(rows) != len(lines):
                raise ValueError(f"{path.name}: a quotation mark opens and never closes; was the file cut off?")
            for i, comment in comments.items():  # each by itself: a quotation mark in it opens nothing
                rows[i] = next(csv.reader([comment], delimiter=delimiter))
        except csv.Error as error:
            raise ValueError(f"{path.name} is not a table ({brief(error)})") from None
    if delimiter != "," or any('"' in line for line in filled):  # where commas separate, a decimal one is quoted
        data = [row for i, row in enumerate(rows) if i not in comments and any(row)]
        if _has_decimal_commas(data, quoted=delimiter == ","):
            rows = [[cell.replace(",", ".") for cell in row] for row in rows]
    return _table(rows, path.name, comments.keys())


def _has_decimal_commas(rows: list[list[str]], quoted: bool) -> bool:
    """Whether numbers have a decimal comma: in the middle row, or in any where none has a point.

    Quoted ones beside commas that separate count only where no number has a point and some cannot be thousands: `"1,440"` can.
    """

    def has(decimal: re.Pattern[str], mark: str, among: Iterable[list[str]]) -> bool:
        return any(decimal.fullmatch(cell.strip()) for row in among for cell in row if mark in cell)

    anywhere = has(_DECIMAL_COMMA, ",", rows) and not has(_DECIMAL_POINT, ".", rows)
    if quoted:
        return anywhere and has(_NO_THOUSANDS, ",", rows)
    return anywhere or has(_DECIMAL_COMMA, ",", rows[len(rows) // 2 :][:1])


def excel_contents(path: Path) -> Contents:
    """Columns of an .xlsx workbook, as `contents_of` them; with several filled sheets each name begins with `SHEET.`."""
    import openpyxl

    with reading(path, ".xlsx workbook"), zipfile.ZipFile(path) as archive:
        check_content(path, sum(part.file_size for part in archive.infolist()))  # no more of a part is ever inflated
    sheets: list[tuple[str, list[list[Any]]]] = []
    n_cells = 0
    with (
        reading(path, ".xlsx workbook"),
        contextlib.closing(openpyxl.load_workbook(path, read_only=True, data_only=True)) as book,
    ):
        for sheet in book.worksheets:
            sheet.reset_dimensions()  # some writers state a wrong extent; trusting it loses rows
            rows: list[list[Any]] = []
            for row in sheet.iter_rows(values_only=True):
                rows.append(list(row))
                n_cells += len(row)
                if len(rows) > MAX_ROWS or n_cells > MAX_CELLS:
                    beyond = f"{MAX_ROWS:,} rows or {MAX_CELLS:,} cells; save it as .csv"
                    raise ValueError(f"{path.name}, sheet {sheet.title} has more than {beyond}")
            if any(cell is not None for row in rows for cell in row):
                sheets.append((sheet.title, rows))
    if not sheets:
        raise ValueError(f"{path.name} has no filled cell")
    columns: list[Column] = []
    for title, rows in sheets:
        where, prefix = (path.name, "") if len(sheets) == 1 else (f"{path.name}, sheet {title}", f"{title}.")
        width = max(map(_width, rows))
        check_width(where, width)
        of_sheet = _table([[*row[:width], *[None] * (width - len(row))] for row in rows], where)
        columns += [replace(column, name=f"{prefix}{column.name}") for column in of_sheet]
    return contents_of(columns)


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
    return next((n for n in range(len(row), 0, -1) if not _is_blank(row[n - 1])), 0)


def _is_blank(cell: Any) -> bool:
    return cell is None or (isinstance(cell, str) and not cell.strip())


def _is_number(cell: Any) -> bool:
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        float(cell)
        return not isinstance(cell, bool)
    return False


def _table(rows: list[list[Any]], where: str, comments: Collection[int] = ()) -> list[Column]:
    """Columns below the header of a table; rows in `comments`, from 0, may name columns but hold no data."""
    while rows and (len(rows) - 1 in comments or not _width(rows[-1])):
        rows.pop()
    numbers = [row for i, row in enumerate(rows) if i not in comments and any(map(_is_number, row))]
    if not numbers:
        raise ValueError(f"{where} has no row of numbers")
    typical = numbers[len(numbers) // 2]
    width = len(typical)
    numeric = [k for k, cell in enumerate(typical) if _is_number(cell)]

    def fits(row: list[Any]) -> bool:
        cells = [row[k] for k in numeric] if len(row) == width else []
        return any(map(_is_number, cells)) and all(_is_number(cell) or _is_blank(cell) for cell in cells)

    start = next((i for i, row in enumerate(rows) if i not in comments and fits(row)), 0)
    has_numbers = [any(map(_is_number, row)) for row in rows[:start]]
    worded = [i for i in range(start) if len(rows[i]) == width and _width(rows[i]) and not has_numbers[i]]
    # A comment below a header is no header; above a table without one it is.
    worded = [i for i in worded if i not in comments] or worded
    # A row of numbers below the header is data even where it does not fit: skipping an overflow would shift the table.
    after_words = worded[-1] + 1 if worded else 0
    skipped = [i for i in range(after_words, start) if i not in comments and has_numbers[i]]
    if worded:
        start = min([start, *skipped])
    else:
        for i in skipped:
            among = [_is_number(cell) for cell in rows[i]]
            # What stands above a table without a header begins with a word: `Sample rate, 10000`.
            if len(among) == width and (among[0] or sum(among) > width / 2):
                raise ValueError(f"{where}, row {i + 1} holds numbers and words: is it a header, or data? Correct it")
    data = [i for i in range(start, len(rows)) if i not in comments]
    for i in data:
        if not _width(rows[i]):
            rows[i] = [None] * width  # a blank line among the data is a row that is missing, not no row
        elif len(rows[i]) != width:
            cells = counted(len(rows[i]), "cell")
            raise ValueError(f"{where}, row {i + 1} has {cells}, expected {width}; was the file cut off?")
    names, units, preamble = _named(rows, worded, start, width, comments)
    row_numbers = [i + 1 for i in data]
    return [
        _column(Column(name, unit=unit, preamble=preamble, row_numbers=row_numbers), cells)
        for name, unit, cells in zip(names, units, zip(*(rows[i] for i in data), strict=True), strict=True)
    ]


def _named(
    rows: list[list[Any]], worded: list[int], start: int, width: int, comments: Collection[int]
) -> tuple[list[str], list[str], str]:
    """Names and units of columns from the rows of words above the data, and the lines above these."""
    names, units = [str(k) for k in range(width)], [""] * width
    heads = [rows[i] for i in worded[-2:] if all(between in comments for between in range(i + 1, worded[-1]))]
    if len(heads) == 2 and _are_units(list(map(_words, heads[1]))):
        units = [_words(cell).strip("[]() ") for cell in heads[1]]
        heads.pop()
    if heads:
        names = [_words(cell) or str(k) for k, cell in enumerate(heads[-1])]
    above = (
        " ".join(filter(None, map(_words, row)))
        for row in rows[: worded[-len(heads) - (units != [""] * width)] if heads else start]
    )
    return names, units, "; ".join(filter(None, above))


def stated_above(preamble: str) -> dict[str, str]:
    """Texture and tool, where lines above a table state them: `Surface: walnut board`, `Tool: steel ball`."""
    stated = {key.lower(): text for key, text in _STATED.findall(preamble)}
    found = {key: next((stated[w] for w in words.split() if w in stated), "") for key, words in WORDS["fields"].items()}
    return {field: text for field, text in found.items() if text}


def _are_units(words: list[str]) -> bool:
    """Whether a second row of words are units: more than half of them are known, or all are in brackets."""
    filled = [word for word in words if word not in ("", "-", "[]", "()", "[-]")]
    known = sum(map(is_unit, filled))
    bracketed = all(word[0] in "[(" and word[-1] in "])" for word in filled)
    return bool(filled) and (2 * known > len(filled) or bracketed)


def _words(cell: Any) -> str:
    return "" if cell is None else " ".join(str(cell).split())


def _column(empty: Column, cells: Sequence[Any]) -> Column:
    """Column with the numbers in its cells, or with a fault."""
    n = _width(cells)
    with contextlib.suppress(TypeError, ValueError, OverflowError):  # most columns have no blank cell
        return replace(empty, samples=np.array(cells[:n], dtype=np.float64), n_blank=len(cells) - n)
    numbers = [float("nan") if _is_blank(cell) else cell for cell in cells[:n]]
    try:
        return replace(empty, samples=np.array(numbers, dtype=np.float64), n_blank=len(cells) - n)
    except (TypeError, ValueError, OverflowError):
        seconds = clock_seconds(["" if cell is None else str(cell) for cell in cells[:n]])
        if seconds is not None:
            return replace(empty, samples=seconds, unit=CLOCK, n_blank=len(cells) - n)
        bad = next((i for i, cell in enumerate(numbers) if not _is_number(cell)), 0)
        fault = f"row {empty.row_numbers[bad]} is {str(cells[bad])[:60]!r}, expected a number"
        return replace(empty, n_blank=n, fault=fault)


def clock_seconds(texts: Sequence[str]) -> Array | None:
    """Seconds from the first of some times of a clock, shape (n,), NaN where one is blank; None where they are something else.

    Three fields are hours, minutes and seconds; two, hours and minutes beside a date or AM and PM, else minutes and seconds.
    Without a date the clock may pass midnight once a day. A time zone, and a date not written as `2026-05-01`, whose day and
    month cannot be told apart, have to be the same throughout.
    """
    seconds, days = np.full(len(texts), np.nan), np.zeros(len(texts))
    dates, zones = set[str | None](), set[str | None]()
    for i, text in enumerate(texts):
        match = _CLOCK.fullmatch(text.strip())
        if match is None:
            if text.strip():
                return None
            continue
        fields = [float(field.replace(",", ".")) for field in match.group("first", "second", "third") if field]
        if match["half"]:
            if not 1 <= fields[0] <= 12:
                return None
            fields[0] = fields[0] % 12 + 12 * (match["half"][0] in "Pp")
        if len(fields) == 2 and (match["date"] or match["half"]):
            fields.append(0.0)
        seconds[i] = sum(field * 60**power for power, field in enumerate(reversed(fields)))
        dates.add(match["date"])
        zones.add(match["zone"])
        if match["date"]:
            try:
                days[i] = date.fromisoformat(match["date"]).toordinal()
            except ValueError:
                days[i] = np.nan
    known = np.flatnonzero(~np.isnan(seconds))
    if not known.size or len(zones) > 1:
        return None
    of_day = seconds[known]
    if dates == {None}:
        days[known] = np.cumsum(np.diff(of_day, prepend=of_day[0]) < -0.5 * DAY_S)
    elif len(dates) == 1:
        days[known] = 0.0
    if np.isnan(days[known]).any() or (None in dates and len(dates) > 1):
        return None
    return seconds - of_day[0] + DAY_S * (days - days[known[0]])
