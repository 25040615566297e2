"""Text tables and Excel sheets: no row lost, no separator asked; times of a clock as seconds."""

import zipfile
from datetime import datetime, time, timedelta

import numpy as np
import openpyxl
import pytest

from foten.datasets.isolated import isolated_columns
from foten.datasets.tabular import clock_seconds, read_delimited


def _columns(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return {column.name: column.samples.tolist() for column in read_delimited(path)}


@pytest.mark.parametrize(
    "text",
    [
        "time,force\n0,1.5\n1,2.5\n2,3.5\n",
        "time\tforce\n0\t1.5\n1\t2.5\n2\t3.5\n",
        "time;force\n0;1,5\n1;2,5\n2;3,5\n",  # decimal comma
        'time,force\n"0,0","1,5"\n"1,0","2,5"\n"2,0","3,5"\n',  # and commas between, so the numbers are quoted
        "time force\n0 1.5\n1 2.5\n2 3.5\n",
        "# captured on a rig\n# time, force\n0, 1.5\n1, 2.5\n2, 3.5\n",  # as numpy.savetxt writes
        "Rig,7\nSample rate,10000\n\ntime,force\n0,1.5\n1,2.5\n2,3.5\n",  # lines before the table
        '"time","force"\r\n0,1.5\r\n1,2.5\r\n2,3.5\r\n\r\n',
        "\ufefftime,force\n0,1.5\n1,2.5\n2,3.5",
    ],
)
def test_the_same_table_in_many_spellings(tmp_path, text):
    assert _columns(tmp_path / "a.csv", text) == {"time": [0, 1, 2], "force": [1.5, 2.5, 3.5]}


def test_quoted_thousands_are_no_decimals(tmp_path):
    """`"1,440"` became 1.44 without a word."""
    path = tmp_path / "a.csv"
    path.write_text('time,force\n0,"1,440"\n1,"2,440"\n2,"3,440"\n')
    force = read_delimited(path)[1]
    assert force.fault == "row 2 is '1,440', expected a number"
    path.write_text('time,force\n0.5,"1,44"\n1.5,"2,44"\n')  # a point elsewhere: which one is the mark?
    assert "expected a number" in read_delimited(path)[1].fault


def test_other_encodings(tmp_path):
    text = "t;Kraft µ²\n0;1\n1;2\n"
    assert _columns(tmp_path / "a.csv", text, "latin-1") == {"t": [0, 1], "Kraft µ²": [1, 2]}
    assert _columns(tmp_path / "b.txt", text.replace(";", "\t"), "utf-16") == {"t": [0, 1], "Kraft µ²": [1, 2]}


def test_without_a_header_the_first_row_is_kept(tmp_path):
    assert _columns(tmp_path / "a.csv", "5,6\n7,8\n9,10\n") == {"0": [5, 7, 9], "1": [6, 8, 10]}
    assert _columns(tmp_path / "b.csv", "5\n7\n9\n") == {"0": [5, 7, 9]}


def test_a_row_of_units_below_the_header(tmp_path):
    (tmp_path / "a.csv").write_text("time,acc,force\n[ms],[g],[N]\n0,1,2\n1,2,3\n")
    assert [(c.name, c.unit, c.samples[0]) for c in read_delimited(tmp_path / "a.csv")] == [
        ("time", "ms", 0),
        ("acc", "g", 1),
        ("force", "N", 2),
    ]


@pytest.mark.parametrize(
    "text",
    [
        'time,force\n# Marke gesetzt\n0,1.5\n# 1,2,3,4\n1,2.5\n  // 7,7\n% Ende\n# "Ende\n',
        'time;force\n0;1,5\n# Marke, "links; rechts\n1;2,5\n# 9;9\n// Ende\n% Ende\n',
        "time force\n# 1\n# 2 3\n0 1.5\n% x\n1 2.5\n// Ende",
    ],
)
def test_comments_anywhere_are_passed_over(tmp_path, text):
    assert _columns(tmp_path / "a.csv", text) == {"time": [0, 1], "force": [1.5, 2.5]}


def test_comments_shift_no_row_number(tmp_path):
    (tmp_path / "a.csv").write_text("# rig\na,b\n1,1\n# Marke\n2,oops\n\n# Ende\n3,3\n\n# Ende\n")
    a, b = read_delimited(tmp_path / "a.csv")
    assert a.samples[[0, 1, 3]].tolist() == [1, 2, 3]
    assert (a.n_rows, a.row_of(1), a.row_of(2), a.row_of(3)) == (4, " (row 5)", " (row 6)", " (row 8)")
    assert b.fault == "row 5 is 'oops', expected a number"
    (tmp_path / "a.csv").write_text("a,b\n1,1\n# Marke\n2,2\n3\n")
    with pytest.raises(ValueError, match="row 5 has 1 cell, expected 2"):
        read_delimited(tmp_path / "a.csv")


def test_a_comment_between_header_and_units_names_nothing(tmp_path):
    (tmp_path / "a.csv").write_text("time,acc\n# left, right\n[ms],[g]\n# one, two\n0,1\n1,2\n")
    assert [(c.name, c.unit, c.samples.tolist()) for c in read_delimited(tmp_path / "a.csv")] == [
        ("time", "ms", [0, 1]),
        ("acc", "g", [1, 2]),
    ]


def test_a_decimal_comma_is_seen_beside_whole_numbers(tmp_path):
    """The line amid the others holds none: tables of a few rows are written by hand."""
    assert _columns(tmp_path / "a.csv", "t;v\n0;0,5\n1;80\n2;40,5\n") == {"t": [0, 1, 2], "v": [0.5, 80, 40.5]}
    (tmp_path / "b.csv").write_text("t;v\n0;1,234\n1;80\n2;40.5\n")  # thousands, or decimals?
    assert read_delimited(tmp_path / "b.csv")[1].fault == "row 2 is '1,234', expected a number"


def test_blanks_within_are_nan_and_blanks_after_the_end_are_counted(tmp_path):
    (tmp_path / "a.csv").write_text("a,b\n1,1\n2,\n3,3\n4,\n5,\n")
    a, b = read_delimited(tmp_path / "a.csv")
    assert a.samples.tolist() == [1, 2, 3, 4, 5]
    assert b.samples[[0, 2]].tolist() == [1, 3]
    assert (b.samples[1] != b.samples[1], b.samples.size, b.n_blank, b.n_rows) == (True, 3, 2, 5)


def test_a_blank_line_among_numbers_is_a_missing_row(tmp_path):
    a = _columns(tmp_path / "a.csv", "a\n1\n\n3\n\n\n")["a"]
    assert (a[0], a[1] != a[1], a[2], len(a)) == (1, True, 3, 3)


@pytest.mark.parametrize("units", ["", "s,N,,m/s\n"])
def test_a_word_in_the_first_row_of_data_loses_no_row(tmp_path, units):
    rows = "0.000000,OVL,0.0,1.0\n0.000100,OVL,0.5,1.5\n0.000200,2,1,2\n0.000300,3,2,3\n0.000400,4,2,3\n"
    (tmp_path / "a.csv").write_text("t,force,b,c\n" + units + rows)
    t, force, b, _ = read_delimited(tmp_path / "a.csv")
    assert t.samples.tolist() == [0, 0.0001, 0.0002, 0.0003, 0.0004]
    assert (b.name, b.samples.tolist()) == ("b", [0, 0.5, 1, 2, 2])
    assert force.fault == f"row {3 if units else 2} is 'OVL', expected a number"


def test_a_word_in_the_first_row_without_a_header_is_refused(tmp_path):
    (tmp_path / "a.csv").write_text("0.0,OVL,0,1\n0.1,2,1,2\n0.2,3,2,3\n")
    with pytest.raises(ValueError, match=r"row 1 holds numbers and words: is it a header, or data"):
        read_delimited(tmp_path / "a.csv")


@pytest.mark.parametrize("top", ["# fs 1000\n", "Rate 1000\n", "x force\n# offset 3\n"])
def test_numbers_above_a_table_are_not_data(tmp_path, top):
    columns = list(_columns(tmp_path / "a.txt", top + "0 1.5\n1 2.5\n2 3.5\n").values())
    assert columns == [[0, 1, 2], [1.5, 2.5, 3.5]]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b" \n\n", "is empty"),
        (b"\xff\xfe", "is empty"),  # the mark of UTF-16 alone
        (b"a,b\n", "no row of numbers"),
        (b"a,b\n1,2\n3,4\n5", r"row 4 has 1 cell, expected 2; was the file cut off"),
        (b"\x89HDF\x00\x00\x00", "is not text"),
        (b'a,b\n1,"2\n3,4\n', "quotation mark"),
    ],
)
def test_bad_tables_are_refused(tmp_path, content, message):
    (tmp_path / "bad.csv").write_bytes(content)
    with pytest.raises(ValueError, match=message):
        read_delimited(tmp_path / "bad.csv")


def _workbook(path, **sheets):
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, rows in sheets.items():
        sheet = book.create_sheet(title)
        for row in rows:
            sheet.append(row)
    book.save(path)


def test_an_excel_sheet_with_a_header(tmp_path):
    _workbook(tmp_path / "a.xlsx", data=[["time", "force"], [0, 1.5], [1, 2.5], [2, None]], empty=[])
    time, force = isolated_columns(".xlsx", tmp_path / "a.xlsx")
    assert (time.name, time.samples.tolist()) == ("time", [0, 1, 2])
    assert (force.name, force.samples.tolist(), force.n_blank) == ("force", [1.5, 2.5], 1)


def test_several_sheets_name_their_columns(tmp_path):
    _workbook(tmp_path / "a.xlsx", fast=[["a"], [1], [2], [3]], slow=[["f"], [4], [5]])
    assert [(c.name, c.samples.size) for c in isolated_columns(".xlsx", tmp_path / "a.xlsx")] == [
        ("fast.a", 3),
        ("slow.f", 2),
    ]


@pytest.mark.parametrize("cell", ["\x1b[31m", "9" * 5000 + "x", "1e400"])
def test_a_hostile_cell_is_a_fault_or_infinite(tmp_path, cell):
    (tmp_path / "a.csv").write_text(f"a,b\n1,2\n3,{cell}\n5,6\n")
    column = read_delimited(tmp_path / "a.csv")[1]
    assert column.fault or np.isinf(column.samples).any()


def test_a_cell_that_no_parser_takes_is_a_sentence(tmp_path):
    (tmp_path / "a.csv").write_text(f"a,b\n1,2\n3,{'a' * 200_000}\n5,6\n")
    with pytest.raises(ValueError, match=r"a.csv is not a table \(field larger than field limit"):
        read_delimited(tmp_path / "a.csv")


def test_a_sheet_that_says_it_is_larger_than_memory_is_refused(tmp_path):
    book = openpyxl.Workbook()
    book.active.append([1.0, 2.0])
    book.active["A3"] = 3
    book.save(tmp_path / "a.xlsx")
    with zipfile.ZipFile(tmp_path / "a.xlsx") as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    sheet = parts["xl/worksheets/sheet1.xml"]
    for name, wrong in {
        "rows.xlsx": sheet.replace(b'r="3"', b'r="99999999999"').replace(b'r="A3"', b'r="A99999999999"'),
        "digits.xlsx": sheet.replace(b"<v>3</v>", b"<v>" + b"9" * 400 + b"</v>"),
    }.items():
        with zipfile.ZipFile(tmp_path / name, "w") as archive:
            for part, data in (parts | {"xl/worksheets/sheet1.xml": wrong}).items():
                archive.writestr(part, data)
    with pytest.raises(ValueError, match=r"rows.xlsx, sheet Sheet has more than 2,000,000 rows or"):
        isolated_columns(".xlsx", tmp_path / "rows.xlsx")
    assert isolated_columns(".xlsx", tmp_path / "digits.xlsx")[0].fault.endswith("expected a number")


@pytest.mark.parametrize(
    ("texts", "seconds"),
    [
        (["00:01.5", "00:02.25"], [0, 0.75]),
        (["1:00:00.5", "", "1:00:01"], [0, np.nan, 0.5]),
        (["2026-05-01 12:00", "2026-05-01 12:01"], [0, 60]),  # hours and minutes
        (["11:59 am", "12:00 PM"], [0, 60]),
        (["12:00:00+02:00", "12:00:01+02:00"], [0, 1]),
        (["23:59:59.5", "00:00:00.25", "00:00:01"], [0, 0.75, 1.5]),  # past midnight
        (["11:59:59 AM", "12:00:00 PM", "1:00:00 pm"], [0, 1, 3601]),
        (["2026-02-28T23:59:59Z", "2026-03-01T00:00:01Z"], [0, 2]),
        (["1.5.2026 12:00:00,125", "1.5.2026 12:00:00,250"], [0, 0.125]),
        ([str(time(12, 0, 0, 500)), str(time(12, 0, 1))], [0, 0.9995]),  # as a workbook's cells
        ([str(datetime(2026, 5, 1, 12, 0, 0, 500)), str(datetime(2026, 5, 1, 12, 0, 1))], [0, 0.9995]),
        ([str(timedelta(seconds=1)), str(timedelta(seconds=2.5))], [0, 1.5]),
    ],
)
def test_times_count_from_the_first(texts: list[str], seconds: list[float]) -> None:
    np.testing.assert_allclose(clock_seconds(texts), seconds, atol=1e-9)


@pytest.mark.parametrize(
    "texts",
    [
        ["12:00", "noon"],
        ["", ""],
        ["1.5.2026 12:00:00", "2.5.2026 12:00:00"],
        ["1.5", "2"],
        ["12:61:00", "12:62:00"],
        ["13:00:00 PM", "13:00:01 PM"],
        ["2026-02-30 12:00:00", "2026-02-31 12:00:00"],
        ["2026-05-01 12:00:00", "12:00:01"],
        ["2026-10-25T02:59:59+02:00", "2026-10-25T02:00:00+01:00"],
    ],
)
def test_what_is_no_clock_stays_what_it_is(texts: list[str]) -> None:
    assert clock_seconds(texts) is None
