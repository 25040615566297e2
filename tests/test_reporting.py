"""Tables in every form, and figures that are the same bytes each time."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from foten.reporting.figure import LEGEND_LINE_PT, add_legend, new_figure, write_figure
from foten.reporting.table import Heading, Number, Table, mean_number, minus, signed

COLUMNS = (Heading("model", words=True), Heading("error", "sd", note="lower is better"), Heading("LSD", "dB"))
TABLE = Table(
    COLUMNS,
    (
        (
            Heading("ours", key="ours", note="a & b"),
            Number(0.1234, error=0.01, best=True, bar=0.5),
            Number(-1.25, "+.1f"),
        ),
        ("theirs", Number(0.5, interval=(0.4, 0.6)), Number(None, why="too <short>")),
        ("silent", Number(None, why="none"), Number(None, why="none")),
    ),
    "Errors",
    ("8 s alone.",),
)


def test_every_form_has_the_same_numbers() -> None:
    assert TABLE.cells() == [
        ["model", "error [sd]", "LSD [dB]"],
        ["ours", "0.123 ± 0.010", "-1.2"],
        ["theirs", "0.500", "–"],
        ["silent", "–", "–"],
    ]
    assert list(csv.reader(io.StringIO(TABLE.csv()))) == TABLE.cells()
    assert TABLE.markdown().splitlines() == [
        *("# Errors", "", "8 s alone.", ""),
        *("| model | error [sd] | LSD [dB] |", "|---|---|---|"),
        "| ours | **0.123\u00a0±\u00a00.010** | -1.2 |",
        *("| theirs | 0.500 | – |", "| silent | – | – |"),
    ]
    latex = TABLE.latex().splitlines()
    assert latex[:3] == ["% Errors", "% 8 s alone.", r"\begin{tabular}{lrr}"]
    assert r"ours & \textbf{0.123 $\pm$ 0.010} & -1.2 \\" in latex
    assert TABLE.known().text() == [
        "model      error [sd]  LSD [dB]",
        "ours    0.123 ± 0.010      −1.2",
        "theirs          0.500         –",
    ]
    assert TABLE.missing() == {"too <short>": ["theirs LSD"], "none": ["silent"]}


def test_a_page_has_numbers_in_full_and_a_footnote_for_each_dash() -> None:
    text = TABLE.html("a")
    assert '<tr id="ours"><th scope="row">ours<small>a &amp; b</small></th>' in text
    assert '<data value="0.1234">0.123 ± 0.010</data><span' in text
    assert '<data value="-1.25">−1.2</data>' in text
    assert '<data value="0.5">0.500</data><small>0.400 … 0.600</small>' in text
    assert '<abbr title="too &lt;short&gt;">–</abbr><sup>a1</sup>' in text
    assert "<sup>a1</sup> too &lt;short&gt; · <sup>a2</sup> none</p>" in text
    assert "width:4.00em" in text


def test_what_lacks_in_all_rows_is_named_once() -> None:
    rows = [(name, Number(1.0), Number(None, why="no noise")) for name in ("x", "y")]
    table = Table.of(("", "error", "LSD"), rows)
    assert table.missing() == {"no noise": ["LSD"]}
    assert table.known().cells() == [["", "error"], ["x", "1.000"], ["y", "1.000"]]
    assert Table.of(("", "p", "n"), [("a", "", "1")]).known().cells() == [["", "n"], ["a", "1"]]


def test_special_characters_are_those_of_the_form() -> None:
    table = Table.of(("a|b", "5 %"), [(r"f $x_1$ {b} ^~\ ±", "–")])
    assert table.markdown().startswith(r"| a\|b | 5 % |")
    assert r"f \$x\_1\$ \{b\} \textasciicircum{}\textasciitilde{}\textbackslash{} $\pm$ & --" in table.latex()
    assert r"a|b & 5 \% \\" in table.latex()


def test_a_mean_over_groups_has_the_standard_error_of_the_groups_means() -> None:
    """Beside NumPy's: two groups whose means scatter by 1/√2 and 0."""
    number = mean_number([np.array([1.0, 2.0]), np.array([4.0, 4.0])], 2)
    assert (number.value, number.error) == (pytest.approx(2.75), pytest.approx(0.5 / 2))
    assert str(number) == "2.75 ± 0.25"
    assert mean_number([np.array([1.0, 2.0]), np.array([4.0])], 2).error is None
    assert str(mean_number([], 2)) == "–"


def test_signs_are_true_minus_signs_and_none_stands_before_zero() -> None:
    assert [signed(value, 1) for value in (0.25, -0.25, -0.04)] == ["+0.2", "−0.2", "0.0"]
    assert str(Number(-0.04, ".1f")) == "0.0"
    assert minus("foten-2 -1.5 to -0.5, a-b") == "foten-2 −1.5 to −0.5, a-b"


@pytest.mark.parametrize("suffix", ["png", "pdf"])
def test_the_same_figure_is_the_same_bytes(tmp_path: Path, suffix: str) -> None:
    for name in "ab":
        figure, panels = new_figure(3, 2, nrows=2)
        panels[0].plot([0, 1], label="x", lw=0.5)
        add_legend(panels[0])
        assert [line.get_linewidth() for line in panels[0].get_legend().get_lines()] == [LEGEND_LINE_PT]
        write_figure(figure, tmp_path / f"{name}.{suffix}", dpi=50)
    first, second = (tmp_path / f"{name}.{suffix}" for name in "ab")
    assert first.read_bytes() == second.read_bytes()
    assert {path.name for path in tmp_path.iterdir()} == {first.name, second.name}
    if suffix == "png":
        with Image.open(first) as image:
            assert (image.size, image.mode) == ((150, 100), "RGBA")
            assert "Software" not in image.info
