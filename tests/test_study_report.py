"""The report of a study: what was asked comes out, a conservative test is said to be one, tables that people read are short."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from foten import __version__
from foten.reporting.table import minus
from foten_study.analysis import analyse
from foten_study.orders import orders
from foten_study.report import MAX_ROWS, texts_of, write_report
from foten_study.results import stars
from foten_study.store import Store
from foten_study.study_file import Stimulus, create
from foten_study.tasks.kind import Rated, Result
from foten_study.variance import Raters, null_rates


def database(path: Path, n: int, methods: int, textures: int, simulated: bool = True) -> Path:
    """Write a study whose raters prefer later methods."""
    stimuli = [Stimulus(t, m, f"t{t}", f"m{m}", f"{t}{m}" * 8, 0.0) for t in range(textures) for m in range(methods)]
    trials = orders(n, textures, methods, 7, 0, "balanced")
    create(path, "A study", "title = 1", path.parent, 7, stimuli, trials, simulated)
    means = np.full((methods, textures), 50.0) + 12.0 * np.arange(methods)[:, None] / max(1, methods - 1)
    ratings = Raters(means).draw(np.random.default_rng(3), n)
    with Store(path) as store:
        for i in range(n):
            number = store.join(f"C{i}")
            rated = {
                f"trial:{trial.number}": Rated({"similarity": float(ratings[i, trial.method, trial.texture])}, 4.0)
                for trial in store.trials(number)
            }
            store.take_steps(number, rated)
    return path


def results(path: Path, reference: str | None = None) -> Result:
    with Store(path) as store:
        return analyse(store, reference)[0]


def markdown(result: Result) -> str:
    return texts_of([result], [{"ratings": "", "textures": ""}])["report.md"]


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def asked(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a report of 6 participants, some of whom answered questions."""
    folder = tmp_path_factory.mktemp("asked")
    path = database(folder / "s.db", 6, 3, 2)
    private = [
        {"age": "20", "gender": "woman", "home": "<b>\nhere"},
        {"age": "30", "gender": "man"},
        {"age": "40", "gender": "woman"},
        {"age": "", "gender": "man"},
    ]
    with Store(path) as store:
        for i, one in enumerate(private):
            store.take_step(i + 1, "questions:start", answers={"remarks": f"fine, {i}"}, private=one)
    write_report([results(path)], folder / "r")
    return folder / "r"


def test_answers_come_out_by_participant(asked: Path) -> None:
    rows = table(asked / "answers.csv")
    assert list(rows[0]) == ["participant", "question", "answer", "at", "simulated"]
    assert [(row["participant"], row["answer"]) for row in rows] == [(str(i + 1), f"fine, {i}") for i in range(4)]
    assert rows[0]["at"].startswith("20")


def test_what_participants_say_of_themselves_comes_out_in_sum(asked: Path) -> None:
    rows = table(asked / "participants.csv")
    assert "participant" not in rows[0]
    (age,) = [row for row in rows if row["question"] == "age"]
    assert (age["n"], age["mean"], age["sd"], age["answer"]) == ("3", "30", "10", "")
    gender = [(row["n"], row["answer"], row["count"]) for row in rows if row["question"] == "gender"]
    assert sorted(gender) == [("4", "man", "2"), ("4", "woman", "2")]
    said = section((asked / "report.md").read_text(encoding="utf-8"), "Participants")
    assert "| age | 3 | 30 | 10 |  |  |" in said
    assert "| home | 1 |  |  |  |  |" in said  # what one person said is not published
    assert "fine, 0" not in (asked / "report.html").read_text(encoding="utf-8")


def test_too_few_ratings_and_another_reference_are_refused(tmp_path: Path) -> None:
    path = database(tmp_path / "s.db", 2, 2, 2)
    with pytest.raises(ValueError, match="answered everything: 2, of 2 who began; expected three"):
        results(path)
    with pytest.raises(ValueError, match="the reference is 'x', expected one of m0, m1"):
        results(path, "x")


def test_every_column_has_a_meaning_and_every_table_says_that_ratings_are_simulated(asked: Path) -> None:
    rows = table(asked / "ratings.csv")
    assert {row["software"] for row in rows} == {__version__}
    assert list(rows[0]) == [row["column"] for row in table(asked / "dictionary.csv")]
    files = {path.name for path in asked.glob("*.csv")} - {"dictionary.csv"}
    assert files == {"ratings.csv", "ratings-wide.csv", "pairs.csv", "answers.csv", "participants.csv"}
    for name in files:
        assert {row["simulated"] for row in table(asked / name)} == {"1"}, name


def test_those_of_people_do_not(tmp_path: Path) -> None:
    path = database(tmp_path / "s.db", 4, 2, 2, simulated=False)
    assert "## Participants" not in markdown(results(path))
    with Store(path) as store:
        store.take_step(1, "questions:end", answers={"remarks": "fine"}, private={"age": "30"})
    write_report([results(path)], tmp_path / "r")
    for file in (tmp_path / "r").glob("*.csv"):
        assert {row.get("simulated", "0") for row in table(file)} <= {"0"}, file.name
    assert "| age | 1 |\n" in (tmp_path / "r/report.md").read_text(encoding="utf-8")


def cautioned(result: Result) -> set[str]:
    return {one.split(":")[0] for one in result.cautions if "it is conservative" in one}


def test_a_conservative_correction_is_cautioned_by_its_rate(tmp_path: Path) -> None:
    """Oracle: 2,000 null studies of this size gave method 4.45 %, texture 2.65 % and interaction 0.25 %; 1000 have a standard
    error of 0.65 %, 0.5 % and 0.2 %, of which three are allowed.
    """
    result = results(database(tmp_path / "s.db", 21, 4, 12))
    assert {"texture", "method × texture"} <= cautioned(result)
    rates = result.document["null_rates"]
    assert rates["method"] == pytest.approx(0.0445, abs=0.02)
    assert rates["texture"] == pytest.approx(0.0265, abs=0.015)
    assert rates["method × texture"] == pytest.approx(0.0025, abs=0.006)
    (said,) = [one for one in result.cautions if one.startswith("texture:")]
    percent = f"{100 * rates['texture']:.1f} %"
    assert f"in null studies of this size Greenhouse and Geisser's correction errs in {percent} at α = 0.05" in said


def test_two_methods_have_nothing_to_correct(tmp_path: Path) -> None:
    assert "method" not in cautioned(results(database(tmp_path / "s.db", 21, 2, 12)))
    assert null_rates(21, 2, 1)["method"] == pytest.approx(0.05, abs=0.021)  # three standard errors of 1000 studies


def section(report: str, title: str) -> str:
    """The part of a report in Markdown under a heading."""
    return report.split(f"## {title}\n")[1].split("\n## ")[0]


def test_tables_hold_the_numbers_and_are_short(tmp_path: Path) -> None:
    result = results(database(tmp_path / "s.db", 14, 4, 3))
    write_report([result], tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert page.count("<details>") == 3  # 18 tests: a table for each texture
    assert page.count("<svg") == 2
    report = (tmp_path / "report.md").read_text(encoding="utf-8")
    assert max(part.count("\n| ") - 1 for part in report.split("\n## ")) == MAX_ROWS
    assert result.document["correction"] == "bonferroni"  # as in the paper
    first = result.document["wilcoxon"][0]
    signed = section(report, "Wilcoxon's signed-rank tests, averaged across textures")
    assert "| pair | W | p | p Holm | rank-biserial |" in signed
    assert f"| {' − '.join(first['pair'])} | {first['w']:.2f} |" in signed
    assert f"| {minus(format(first['rank_biserial'], '.3f'))} |" in signed
    assert f"| {result.document['reliability']['icc_mean']:.3f} |" in section(report, "Reliability")
    with_others = result.document["reliability"]["with_others"]
    shown = section(report, "Each participant's correlation with the others")
    lowest, highest = (choose(with_others, key=lambda number: with_others[number]) for choose in (min, max))
    assert "The lowest 12 of 14; results.json has all." in shown
    assert shown.index(f"| {lowest} | {with_others[lowest]:.3f} |") == shown.index("| ", shown.index("---|\n"))
    assert f"| {highest} |" not in shown
    assert report.count("| 95 % CI, not adjusted |") == 4  # pairs overall, and of three textures
    assert json.loads((tmp_path / "results.json").read_text(encoding="utf-8"))["results"] == {
        "similarity": result.document
    }


def test_few_tests_within_textures_are_one_table_and_many_show_the_lowest_p(tmp_path: Path) -> None:
    report = markdown(results(database(tmp_path / "few.db", 5, 3, 4)))
    within = section(report, "Tests within textures")
    assert within.count("\n| ") - 1 == 12
    assert "| t3 | m1 − m2 |" in within
    report = markdown(results(database(tmp_path / "many.db", 5, 6, 2)))
    assert report.count("The 12 lowest p of 15 pairs; pairs.csv has all.") == 3
    assert max(part.count("\n| ") - 1 for part in report.split("\n## ")) == MAX_ROWS


def test_stars_are_those_of_figure_9() -> None:
    assert [stars(p) for p in (None, 0.05, 0.049, 0.009, 0.0009)] == ["", "", "*", "**", "***"]


@pytest.mark.parametrize(
    ("methods", "textures", "reference", "expected"),
    [
        (3, 2, None, "each texture, paired t-tests of all 3 pairs of methods, Holm-corrected for 3: of 2 textures, "),
        (3, 2, "m2", "each texture, paired t-tests of the 2 other methods against m2, Bonferroni-corrected for 2: "),
        (3, 1, None, "the one texture, paired t-tests of all 3 pairs of methods, Bonferroni-corrected for 3: "),
        (2, 2, None, "each texture, paired t-tests of m0 and m1: of 2 textures, m0 above m1 on "),
        (2, 1, None, "the one texture, paired t-test of m0 and m1: m0 below m1."),
    ],
)
def test_sentences_name_the_family(
    tmp_path: Path, methods: int, textures: int, reference: str | None, expected: str
) -> None:
    result = results(database(tmp_path / "s.db", 8, methods, textures), reference)
    assert any(one.startswith(f"Within {expected}") for one in result.sentences)
    text = " ".join(result.sentences)
    assert "The highest mean is that of m" in text
    if textures == 1:
        assert f"methods on 1 texture ({8 * methods} ratings)" in text
        assert "textures" not in text
        assert "across textures" not in markdown(result)
