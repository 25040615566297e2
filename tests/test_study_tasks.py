"""The kinds of questions of a study: plan, page as the server sees it, statistics, simulated people, report."""

from __future__ import annotations

import csv
import io
import json
import re
import time
import zipfile
from collections import Counter
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
pytest.importorskip("statsmodels")
from scipy import stats

from conftest import check_figures
from foten.studio.access import Admitted
from foten_study import choosing, study_server, variance
from foten_study.analysis import TooFewError, analyse, read_ratings
from foten_study.design import read_design
from foten_study.languages import read_language
from foten_study.loading import LSL_NAME as NAME
from foten_study.loading import Markers, load_study
from foten_study.orders import balance, orders
from foten_study.planning import simulate_study
from foten_study.rating_figures import figures_of
from foten_study.record import _contacts, bids, events_of, psych_ds
from foten_study.report import COLUMNS, write_data, write_report
from foten_study.statistics import ALPHA, anova
from foten_study.store import Store, Stroked
from foten_study.tasks import paired
from foten_study.tasks.abx import ABX
from foten_study.tasks.kind import Plan, Rated, Task
from foten_study.tasks.oddity import ODDITY
from foten_study.tasks.table import TASKS
from foten_study.tasks.threshold import (
    SILENT_DB,
    gain_db,
    level_search,
    noticeable_db,
    simulated_answers,
    threshold_raters,
    thresholds_of,
)
from foten_study.variance import raters_for
from test_study_commands import foten
from test_study_server import joined, served, server_of, study_file

COMPARING = ("paired", "abx", "oddity")
N_NULL = 1000
NULL_LIMITS = stats.binom.ppf([0.025, 0.975], N_NULL, ALPHA) / N_NULL  # 0.037 to 0.064


def task_file(
    folder: Path, kind: str, lines: str = "", n_methods: int = 3, n_textures: int = 2, **changes: str
) -> Path:
    path = study_file(folder, n_textures, n_methods, participants=12, practice="0", **changes)
    text = path.read_text(encoding="utf-8")
    if kind != "rating":
        text = re.sub("^(question|lowest|highest) = .*\n", "", text, flags=re.M)
    path.write_text(re.sub('^kind = "rating".*', f'kind = "{kind}"\n{lines}', text, flags=re.M), encoding="utf-8")
    return path


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def simulated(folder: Path, kind: str, lines: str = "", effect: float = 0.0, **options: Any) -> Store:
    study = load_study(task_file(folder, kind, lines, **options))
    store = study.open_store(folder / "s.db", simulated=True)
    simulate_study(store, study.design, 0.0, 3, effect=10.0 if kind == "rating" else effect)
    return store


# Plan


@pytest.mark.parametrize("kind", COMPARING)
def test_every_pair_is_shown_in_both_orders_as_often(kind: str) -> None:
    """Either method of a pair is the first as often as the other in the trials of a participant, up to one, and in practice."""
    for trials in orders(9, 6, 3, 5, 2, "balanced", TASKS[kind].order, repeats=2):
        counted = [trial for trial in trials if not trial.practice]
        shown = Counter((t.method, t.other) for t in counted)
        assert len(shown) == 6
        assert all(abs(shown[a, b] - shown[b, a]) <= 1 for a, b in shown)
        pairs = Counter((t.texture, frozenset((t.method, t.other))) for t in counted)
        assert set(pairs.values()) == {2}
        assert len(pairs) == 6 * 3


@pytest.mark.parametrize(("kind", "n_targets"), [("abx", 2), ("oddity", 3), ("threshold", 3)])
def test_who_counts_knows_no_more_of_what_is_right(kind: str, n_targets: int) -> None:
    """Someone who feels nothing and names what has been right least often so far, of this pair or texture, is right by chance."""
    right = n = 0
    for trials in orders(100, 2, 2, 8, 2, "balanced", TASKS[kind].order, repeats=20):
        seen: dict[Any, Counter[int]] = {}
        for trial in trials:
            counts = seen.setdefault((trial.texture, frozenset((trial.method, trial.other))), Counter())
            guess = min(range(n_targets), key=lambda target: counts[target])
            right, n = right + (guess == trial.target), n + 1
            counts[trial.target] += 1
    chance = 1 / n_targets
    assert right / n == pytest.approx(chance, abs=4 * np.sqrt(chance * (1 - chance) / n))


def test_intervals_hold_what_the_task_says() -> None:
    for kind in ("abx", "oddity"):
        for trial in orders(1, 3, 3, 1, 0, "random", TASKS[kind].order)[0]:
            shown = TASKS[kind].surfaces(trial)
            assert len(shown) == 3
            if kind == "abx":
                assert shown[2] == shown[trial.target]
                assert shown[0] != shown[1]
            else:
                odd = shown[trial.target]
                assert [method for method in shown if method != odd] == 2 * [trial.method]
                assert odd == trial.other


def test_thresholds_are_asked_in_rounds_that_each_hold_all() -> None:
    order = TASKS["threshold"].order
    for trials in orders(3, 2, 3, 1, 0, "balanced", order, repeats=12):
        rounds = np.array([(t.texture, t.method) for t in trials]).reshape(12, 6, 2)
        assert all(len(set(map(tuple, one))) == 6 for one in rounds.tolist())
    first = balance(orders(6, 2, 3, 1, 0, "balanced", order, repeats=9), 2, 3, order)["method first"]
    assert first == (108, 108)


@pytest.mark.parametrize(
    ("kind", "lines", "why"),
    [
        ("rating", "repeats = 2", r"\[task\] has 'repeats', which rating does not know, expected some of question"),
        ("oddity", "answers = 9", r"\[task\] has 'answers', which oddity does not know"),
        ("guess", "", "task: kind is 'guess', expected rating, paired, abx, oddity or threshold"),
        ("paired", "repeats = 101", "repeats is 101, expected 1 to 100"),
        ("threshold", "answers = 3", "answers is 3, expected 8 to 200"),
        ("threshold", "low_db = -3.0", "low_db is -3, expected -90 to -4"),
        ("threshold", 'measures = "pitch"', "measures is 'pitch', expected detection or difference"),
        ("abx", 'feedback = "loud"', "feedback is 'loud', expected none, practice or all"),
    ],
)
def test_a_task_that_cannot_be_is_refused(tmp_path: Path, kind: str, lines: str, why: str) -> None:
    with pytest.raises(ValueError, match=why):
        read_design(task_file(tmp_path, kind, lines))


def test_scales_belong_to_ratings_and_have_names_of_their_own(tmp_path: Path) -> None:
    scale = '[[scales]]\nkey = "rough"\nquestion = "How rough?"\nlowest = "smooth"\nhighest = "rough"\n'
    path = task_file(tmp_path, "paired")
    path.write_text(path.read_text(encoding="utf-8") + scale, encoding="utf-8")
    with pytest.raises(ValueError, match=r"there are \[\[scales\]\], and the task is paired"):
        read_design(path)
    path = task_file(tmp_path, "rating")
    path.write_text(path.read_text(encoding="utf-8") + 2 * scale, encoding="utf-8")
    with pytest.raises(ValueError, match="two scales with one key"):
        read_design(path)


def test_one_method_is_enough_for_a_threshold_alone(tmp_path: Path) -> None:
    assert read_design(task_file(tmp_path, "threshold", n_methods=1))[0].n_trials == 2 * 25
    with pytest.raises(ValueError, match="has 1 method, expected two or more"):
        read_design(task_file(tmp_path, "oddity", n_methods=1))


@pytest.mark.parametrize("kind", TASKS)
def test_a_task_of_the_table_is_whole(kind: str) -> None:
    """Its surfaces, answers, words, columns and script are there, and its settings those of a study file."""
    task = TASKS[kind]
    for trials in orders(3, 2, 3, 1, 2, "balanced", task.order, repeats=2):
        for trial in trials:
            surfaces = task.surfaces(trial)
            assert len(surfaces) == max(1, len(task.intervals))
            assert set(surfaces) <= {trial.method, trial.other}
            assert 0 <= trial.target < max(1, task.order.n_targets)
    assert set(task.choices) <= set(task.intervals)
    assert task.order.n_targets in (0, len(task.choices))
    assert (Path(study_server.PAGES) / f"{task.form}.js").is_file()
    assert task.question(Task(kind)) in read_language().words
    assert set(task.columns) <= {name for name, *_ in COLUMNS["ratings"]}
    assert set(task.settings) <= {one.name for one in fields(Task)}
    assert all(line.format_map(dict.fromkeys(("question", "lowest", "highest"), "''")) for line in task.new_lines)


# Trials


@pytest.mark.parametrize("kind", COMPARING)
def test_a_choice_is_stored_with_the_contact_of_each_surface(tmp_path: Path, kind: str) -> None:
    server = server_of(task_file(tmp_path, kind, min_seconds="0.001"))
    n = 2 if kind == "paired" else 3
    with joined(server) as page:
        page.to_trial()
        step = page.step
        assert (step["task"], len(step["intervals"]), step["scales"]) == (kind, n, [])
        assert step["real_side"] == ("right" if kind == "paired" else "none")
        for interval in range(n):
            if interval:
                page.say(do="side", side="virtual", interval=interval)
                assert page.until("step")["step"]["interval"] == interval
            page.stroke()
            if interval == n - 2:
                assert page.done(values={"choice": 1})["refused"] == "Stroke each surface first."
        assert "choice is 3, expected 0 to" in page.done(values={"choice": 3})["refused"]
        assert "choice is 0.5" in page.done(values={"choice": 0.5})["refused"]
        assert "expected choice" in page.done(values={"similarity": 3})["refused"]
        page.done(values={"choice": 1}, seconds=2.0)
        assert page.step["id"] != step["id"]
    (row,) = server.store.ratings()
    assert (row["scale"], row["rating"], row["switches"]) == ("choice", 1.0, n - 1)
    assert row["other"] is not None
    assert all(row["measured"][f"contact_s_{i + 1}"] == pytest.approx(0.09, abs=0.02) for i in range(n))
    assert [part.interval for part in server.store.parts(1, 1) if len(part.events)] == list(range(n))


def test_surfaces_of_one_trial_sound_as_their_methods_do(tmp_path: Path) -> None:
    """What is rendered for an interval is the method that the order says, at its gain."""
    server = server_of(task_file(tmp_path, "oddity"))
    opened: list[bytes] = []
    with joined(server) as page:
        page.to_trial()
        session = server.sessions[1]
        page.stroke_until_it_sounds()
        until = time.monotonic() + 10
        while session.strokes.sound.contact is None and time.monotonic() < until:  # its first block may be sooner
            time.sleep(0.01)
        assert session.strokes.sound.contact is not None
        original = session.strokes.sound.contact.open

        def watched(texture: bytes, *others: Any) -> None:
            opened.append(texture)
            original(texture, *others)

        session.strokes.sound.contact.open = watched  # type: ignore[method-assign]
        for interval in (1, 2):
            page.say(do="side", side="virtual", interval=interval)
            page.until("step")
            until = time.monotonic() + 10
            # The page is told before the surface is put under the pen.
            while len(opened) < interval and time.monotonic() < until:
                time.sleep(0.01)
        trial = server.store.trials(1)[0]
    expected = [server.study.bytes_of[trial.texture, method] for method in TASKS["oddity"].surfaces(trial)[1:]]
    assert opened == expected


def test_several_scales_are_stored_each_and_all_are_needed(tmp_path: Path) -> None:
    path = task_file(tmp_path, "rating")
    scales = "".join(
        f'[[scales]]\nkey = "{key}"\nquestion = "How {key}?"\nlowest = "not"\nhighest = "very"\n'
        for key in ("rough", "hard")
    )
    path.write_text(path.read_text(encoding="utf-8") + scales, encoding="utf-8")
    server = server_of(path)
    with joined(server) as page:
        page.to_trial()
        assert [scale["key"] for scale in page.step["scales"]] == ["rough", "hard"]
        assert "expected rough, hard" in page.done(values={"rough": 3})["refused"]
        page.done(values={"rough": 30, "hard": 70.5})
    rows = server.store.ratings()
    assert [(row["scale"], row["rating"]) for row in rows] == [("rough", 30.0), ("hard", 70.5)]
    with pytest.raises(ValueError, match="a rating on each of rough, hard: which one"):
        server.store.correct(1, 1, 50.0, "why")
    server.store.correct(1, 1, 50.0, "a slip", "hard")
    assert {row["scale"]: row["rating"] for row in server.store.ratings()} == {"rough": 30.0, "hard": 50.0}


def test_the_level_follows_the_answers_also_after_a_restart(tmp_path: Path) -> None:
    path = task_file(tmp_path, "threshold", "answers = 8", n_methods=1, n_textures=1)
    levels: list[float] = []
    for _ in range(2):  # the server begins again in the middle
        server = server_of(path)
        code = {} if not server.sessions else {"code": server.sessions[1].code}
        with joined(server, **code) as page:
            page.to_trial()
            for _ in range(4):
                n = page.step["n"]
                trial = server.store.trials(1)[n - 1]
                page.done(values={"choice": trial.target})
        rows = server.store.ratings()
        levels = [row["measured"]["level_db"] for row in rows]
        server.store.close()
    for k, level in enumerate(levels):
        answered = [(earlier, True) for earlier in levels[:k]]
        assert level == level_search(Task("threshold", answers=8), answered).stimulus()
    assert len(levels) == 8
    assert levels[-1] < levels[0]  # who is always right is asked at lower levels


def test_feedback_says_what_would_have_been_right(tmp_path: Path) -> None:
    server = server_of(task_file(tmp_path, "oddity", 'feedback = "all"'))
    with joined(server) as page:
        page.to_trial()
        trial = server.store.trials(1)[0]
        page.say(do="done", step=page.step["id"], values={"choice": (trial.target + 1) % 3})
        assert page.until("feedback")["feedback"] == {"right": False, "was": "123"[trial.target]}


def test_a_surface_of_detection_is_silent_but_the_target_and_one_of_a_difference_is_louder() -> None:
    detection, difference = Task("threshold"), Task("threshold", measures="difference")
    assert (gain_db(detection, -20.0, True), gain_db(detection, -20.0, False)) == (-20.0, SILENT_DB)
    assert gain_db(difference, -20.0, False) == 0.0
    assert gain_db(difference, 0.0, True) == pytest.approx(20 * np.log10(2))
    assert noticeable_db(-11.7) == pytest.approx(2.0, abs=0.02)


def test_a_choice_is_corrected_by_its_name(tmp_path: Path) -> None:
    path = task_file(tmp_path, "oddity")
    with load_study(path).open_store(tmp_path / "s.db") as store:
        store.take_step(store.join("ALONE"), "trial:1", (1, Rated({"choice": 1.0})))
    common = ("correct", tmp_path / "s.db", "--participant", 1, "--trial", 1, "--reason", "a slip")
    assert "the task is oddity, expected --choice 1, 2, 3" in foten(*common, "--rating", 2, ok=False)
    assert "--choice is 'B', expected one of 1, 2, 3" in foten(*common, "--choice", "B", ok=False)
    assert "trial 1: the answer is now 3" in foten(*common, "--choice", 3)
    with Store(tmp_path / "s.db") as store:
        assert [row["rating"] for row in store.ratings()] == [2.0]


def test_who_is_forgotten_is_so_with_the_devices_too(tmp_path: Path) -> None:
    database = tmp_path / "s.db"
    with load_study(task_file(tmp_path, "abx")).open_store(database) as store:
        for code in ("ALONE", "OTHER"):
            store.join(code)
    devices = database.with_suffix(".access") / "devices.json"
    devices.parent.mkdir(mode=0o700)
    admitted = Admitted(devices)
    for code in ("ALONE", "OTHER"):
        admitted.put(f"{code} stroke", "secret")
    foten("forget", database, "--participant", 1, "--yes")
    assert list(json.loads(devices.read_text(encoding="utf-8"))) == ["OTHER stroke"]


@pytest.mark.parametrize(
    ("kind", "option"), [("rating", "--effect"), ("abx", "--difference"), ("threshold", "--difference")]
)
def test_an_effect_of_another_task_is_not_ignored(tmp_path: Path, kind: str, option: str) -> None:
    path = task_file(tmp_path, kind)
    assert option in foten("simulate", path, "-o", tmp_path / "s.db", option, 2, ok=False)
    assert option in foten("power", path, option, 2, ok=False)
    assert not (tmp_path / "s.db").exists()


# Statistics


def test_thresholds_of_simulated_people_are_found() -> None:
    """Bias within 1 dB and a spread of about 3 dB with 25 answers, as `dsp.adaptive` has them."""
    true = np.linspace(-45.0, -15.0, 40)
    errors = thresholds_of(Task("threshold"), true, np.random.default_rng(1)) - true
    assert abs(errors.mean()) < 1.2
    assert errors.std() < 4.0


P_VALUES = {"paired": paired.p_values, "abx": ABX.p_values, "oddity": ODDITY.p_values}


def null_rate(kind: str, monkeypatch: pytest.MonkeyPatch, n_studies: int = N_NULL) -> float:
    """Share of null studies of 16 people in which the overall test of a task finds something; of a single pair where d′ is
    tested, since the smallest adjusted p of several is conservative.
    """
    rng = np.random.default_rng(7)
    if kind in COMPARING:
        n_methods, per_pair = (3, 6) if kind == "paired" else (2, 12)
        # People with preferences of their own, and none that they share.
        monkeypatch.setattr(
            paired, "people_of", lambda plan, rng, n: paired.SPREAD * rng.standard_normal((n, plan.methods))
        )
        plan = Plan(Task(kind), n_methods, 1, 0.0)
        return float(np.mean([P_VALUES[kind](plan, rng, 16, per_pair)[0] < ALPHA for _ in range(n_studies)]))
    if kind == "rating":
        y = raters_for(2, 1, 0.0).draw(rng, 16, n_studies)
        return float((anova(y)[0]["p_corrected"] < ALPHA).mean())
    task = Task("threshold", answers=8)
    people = rng.normal(-30.0, 5.0, (n_studies, 10, 1)) + rng.normal(0.0, 1.0, (n_studies, 10, 2))
    y = thresholds_of(task, people, rng)[..., None]
    return float((anova(y)[0]["p_corrected"] < ALPHA).mean())


@pytest.mark.slow
@pytest.mark.parametrize("kind", TASKS)
def test_null_studies_find_something_in_one_of_twenty(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rate = null_rate(kind, monkeypatch)
    print(f"{kind}: {100 * rate:.1f} % of {N_NULL} null studies")
    assert NULL_LIMITS[0] <= rate <= NULL_LIMITS[1]


@pytest.mark.parametrize(("kind", "weak", "strong"), [("paired", 0.55, 0.8), ("abx", 0.5, 2.0), ("oddity", 0.5, 2.0)])
def test_power_grows_with_the_effect_and_with_people(kind: str, weak: float, strong: float) -> None:
    weakly, strongly = (Plan(Task(kind), 3, 1, effect) for effect in (weak, strong))
    few, many = (choosing.power(P_VALUES[kind], strongly, n, 6, 40, 0)["pair"] for n in (4, 21))
    assert choosing.power(P_VALUES[kind], weakly, 21, 6, 40, 0)["pair"] < many
    assert few < many
    assert many > 0.8


# Reports


@pytest.mark.parametrize("kind", TASKS)
def test_a_report_says_what_simulated_people_were_given(tmp_path: Path, kind: str) -> None:
    effects = {"paired": 0.85, "abx": 2.5, "oddity": 2.5, "threshold": 8.0}
    lines = "answers = 10" if kind == "threshold" else "repeats = 3" * (kind in ("abx", "oddity"))
    with simulated(tmp_path, kind, lines, effects.get(kind, 0.0), n_methods=2 + (kind == "paired")) as store:
        (result,) = analyse(store)
        every = read_ratings(store)
    check_figures({f"study-{kind}-{name}": figure for name, (figure, _) in figures_of(result).items() if kind != "abx"})
    write_report([result], tmp_path / "r")
    page = (tmp_path / "r" / "report.html").read_text(encoding="utf-8")
    assert page.count("<svg") == 2
    document = json.loads((tmp_path / "r" / "results.json").read_text(encoding="utf-8"))
    assert document["task"] == kind
    of_kind = document["results"][result.ratings.key]
    assert of_kind == result.document
    rows = rows_of(tmp_path / "r" / "ratings.csv")
    assert len(rows) == len(every[0].rows)
    names = list(rows[0])
    known = [row["column"] for row in rows_of(tmp_path / "r" / "dictionary.csv")]
    assert known[: len(names)] == names
    if kind == "threshold":
        thresholds = rows_of(tmp_path / "r" / "thresholds.csv")
        assert len(thresholds) == 12 * 2 * 2
        assert thresholds[0].keys() <= {*known}
    if kind == "paired":
        best = max(of_kind["strengths"]["methods"], key=lambda row: row["log_odds"])
        assert best["method"] == result.ratings.methods[-1]
        assert of_kind["strengths"]["overall"]["p"] < ALPHA
        chosen = [row["chosen"] == best["method"] for row in rows if best["method"] in (row["method"], row["other"])]
        assert np.mean(chosen) == pytest.approx(0.85, abs=0.1)
    elif kind in ("abx", "oddity"):
        (pair,) = of_kind["sensitivity"]
        assert pair["share"] == pytest.approx(np.mean([float(row["right"]) for row in rows]))
        assert pair["ci95_low"] < 2.5 < (pair["ci95_high"] or np.inf)
        assert pair["p"] < ALPHA
    elif kind == "threshold":
        means = [row["mean"] for row in of_kind["means"] if row["texture"] is None]
        assert means[0] - means[1] == pytest.approx(8.0, abs=3.0)
        assert {row["level_db"] != "" for row in rows} == {True}


def test_a_pilot_of_one_has_its_tables(tmp_path: Path) -> None:
    with load_study(task_file(tmp_path, "abx")).open_store(tmp_path / "s.db") as store:
        with pytest.raises(ValueError, match="holds no answers yet"):
            read_ratings(store)
        store.take_step(store.join("ALONE"), "trial:1", (1, Rated({"choice": 1.0}, 2.0, 2)))
        with pytest.raises(TooFewError, match="participants who have answered everything: 0, of 1 who began"):
            analyse(store)
        write_data(read_ratings(store), tmp_path / "r")
    assert (tmp_path / "r" / "ratings.csv").read_text(encoding="utf-8").count("\n") == 2
    assert not (tmp_path / "r" / "report.html").exists()


def test_stars_are_by_the_correction_that_is_asked_for(tmp_path: Path) -> None:
    with simulated(tmp_path, "threshold", "answers = 8", n_textures=1, n_methods=2) as store:
        assert analyse(store, None, "holm")[0].document["correction"] == "holm"


def threshold_study(folder: Path, true_db: float, lines: str = "answers = 20", **options: Any) -> Store:
    """Answers of three people of a known threshold."""
    study = load_study(task_file(folder, "threshold", lines, **options))
    store, rng = study.open_store(folder / "s.db"), np.random.default_rng(2)
    for i in range(3):
        number = store.join(f"PERS{'ABC'[i]}")
        tracks: dict[tuple[int, int], Any] = {}
        for trial in store.trials(number):
            track = trial.texture, trial.method
            if track not in tracks:
                tracks[track] = iter(simulated_answers(study.design.task, true_db, rng))
            level, right = next(tracks[track])
            log = {"level_db": level, "volume_db": -6.0}
            rated = Rated({"choice": float(trial.target if right else (trial.target + 1) % 3)}, 2.0, 2, log)
            store.take_step(number, f"trial:{trial.number}", (trial.number, rated))
    return store


def test_a_threshold_beyond_the_levels_is_said_to_be_a_bound(tmp_path: Path) -> None:
    for true_db, low, high in ((15.0, 10, 12), (-30.0, 0, 0)):  # of 12
        (folder := tmp_path / f"{low}").mkdir()
        with threshold_study(folder, true_db, n_methods=2) as store:
            (result,) = analyse(store)
        n_missed = sum(not one["reached"] for one in result.ratings.thresholds)
        assert low <= n_missed <= high
        said = [caution for caution in result.cautions if "are not reached" in caution]
        assert [one.split(",")[0] for one in said] == [f"{n_missed} of 12 thresholds are not reached"] * bool(n_missed)


def test_the_volume_of_a_page_is_part_of_a_threshold_of_detection_alone(tmp_path: Path) -> None:
    for measures, expected in (("detection", -36.0), ("difference", -30.0)):
        (folder := tmp_path / measures).mkdir()
        with threshold_study(folder, -30.0, f'measures = "{measures}"\nanswers = 60') as store:
            mean = np.mean([one["threshold_db"] for one in read_ratings(store)[0].thresholds])
        assert mean == pytest.approx(expected, abs=2.0)


def test_of_one_method_textures_are_compared_and_said_to_be(tmp_path: Path) -> None:
    with threshold_study(tmp_path, -30.0, n_methods=1, n_textures=3) as store:
        (result,) = analyse(store)
        write_report([result], tmp_path / "r")
        with pytest.raises(ValueError, match="there is no other method to compare it with"):
            analyse(store, "ar")
    text = (tmp_path / "r" / "report.md").read_text(encoding="utf-8")
    assert "ratings" not in text.replace("ratings.png", "").lower()
    assert "method" not in text.replace("the one method", "")
    assert "gave an effect of texture" in text
    assert "| artificial-grass |" in text
    assert {row["name"] for row in result.document["anova_one_way"]} == {"texture"}


def test_power_of_thresholds_is_that_of_simulated_searches() -> None:
    """Against studies of the same people that are simulated and analysed whole."""
    task, rng = Task("threshold", answers=12), np.random.default_rng(4)
    modelled = variance.power(threshold_raters(task, 2, 1, 4.0, 0), 12, 2000, 0)["pair"]
    shared = rng.normal(-30.0, 5.0, (60, 12, 1))
    true = shared + rng.normal(0.0, 1.0, (60, 12, 2)) - [0.0, 4.0]
    whole = float((anova(thresholds_of(task, true, rng)[..., None])[0]["p_corrected"] < ALPHA).mean())
    assert whole == pytest.approx(modelled, abs=0.2)


def test_strokes_are_those_of_one_surface(tmp_path: Path) -> None:
    events = np.array([[0.5 * k, 0.0, 0.5, 0.01 * k] for k in range(20)])
    with load_study(task_file(tmp_path, "abx")).open_store(tmp_path / "s.db") as store:
        store.join("ALONE")
        store.add_strokes(1, 1, [Stroked(0, events), Stroked(2, events + np.array([0, 1, 0, 5]))])
    common = ("strokes", tmp_path / "s.db", "--participant", 1, "--trial", 1, "-o", tmp_path / "s.csv")
    assert "surfaces 1, 3 were stroked in that trial: which one? --surface 1" in foten(*common, ok=False)
    said = foten(*common, "--surface", 3)
    assert "20 events" in said
    assert "--pressure" not in said  # nothing was answered yet that the tablet's curve is kept with
    assert "no stroke of participant 1 in trial 1 on surface 2" in foten(*common, "--surface", 2, ok=False)
    with Store(tmp_path / "s.db") as store:
        tablet = {"newtons": 0.15, "steepness": 3.0}
        store.take_step(1, "trial:1", (1, Rated({"choice": 0.0}, log=tablet)))
    assert f"--stroke {tmp_path / 's.csv'} --pressure 0.15,3\n" in foten(*common, "--surface", 3)


# For the record


def test_the_record_holds_every_answer_and_says_what_columns_mean(tmp_path: Path) -> None:
    """Psych-DS's rules: names of files, `variableMeasured` of all columns, the fields that a description needs."""
    with simulated(tmp_path, "oddity", effect=1.0, n_methods=2) as store:
        store.take_step(1, "questions:end", answers={"remarks": "fine"}, private={"age": "thirty and a day"})
        texts = psych_ds(store)
        n = len(store.ratings())
    description = json.loads(texts["dataset_description.json"])
    assert {"@context", "@type", "name", "description", "variableMeasured"} <= description.keys()
    assert (description["@context"], description["@type"]) == ("https://schema.org", "Dataset")
    variables = {one["name"] for one in description["variableMeasured"]}
    assert all(one["@type"] == "PropertyValue" and one["description"] for one in description["variableMeasured"])
    data = {name: text for name, text in texts.items() if name.startswith("data/")}
    assert len(data) == 3
    for name, text in data.items():
        assert re.fullmatch(r"data/([a-z]+-[a-zA-Z0-9]+)(_[a-z]+-[a-zA-Z0-9]+)*_data\.csv", name)
        assert set(next(csv.reader(text.splitlines()))) <= variables
    (ratings,) = [text for name, text in data.items() if "description" not in name]
    assert ratings.count("\n") == n + 1
    assert not any("thirty and a day" in text for text in texts.values())  # which one person alone said of themselves


def test_events_say_when_each_trial_was_shown_stroked_and_answered(tmp_path: Path) -> None:
    server = server_of(task_file(tmp_path, "paired"))
    with joined(server) as page:
        page.to_trial()
        begin = time.time()
        start = time.monotonic()
        for surface in range(2):
            if surface:
                page.say(do="side", side="virtual", interval=1)
                page.until("step")
            down = time.monotonic()
            for k in range(31):
                event = [0.8 * k, 0.0, 0.5 * (k < 30), time.monotonic() - start]
                page.socket.send_bytes(np.array(event, dtype="<f8").tobytes())
                time.sleep(max(0.0, down + 0.01 * (k + 1) - time.monotonic()))
        page.done(values={"choice": 0})
        took = time.time() - begin
    events = [event for event in events_of(server.store, 1) if event["trial"] == 1]
    moments = [event for event in events if event["trial_type"] != "switch"]
    assert [event["trial_type"] for event in moments] == ["trial", "contact", "contact", "answer"]
    trial, first, second, answer = moments
    assert (first["surface"], second["surface"]) == ("A", "B")
    assert [event["surface"] for event in events if event["trial_type"] == "switch"] == ["B"]
    assert {event["method"] for event in events} | {event["other"] for event in events} <= set(server.design.methods)
    assert first["duration"] == pytest.approx(0.3, abs=0.1)
    assert answer["value"] == "A"
    assert trial["onset"] == 0.0
    assert answer["onset"] == pytest.approx(trial["duration"])
    assert 0.6 <= trial["duration"] <= took + 1.0
    assert first["onset"] < answer["onset"]
    texts = bids(server.store)
    assert texts["participants.tsv"] == "participant_id\nsub-1\n"
    header = texts["sub-1/beh/sub-1_task-paired_events.tsv"].splitlines()[0].split("\t")
    assert header[:3] == ["onset", "duration", "trial_type"]
    assert set(header[2:]) == json.loads(texts["task-paired_events.json"]).keys()


def test_a_page_that_is_loaded_again_has_another_clock(tmp_path: Path) -> None:
    def part(begin: float, at_s: float) -> Stroked:
        events = np.array([[k, 0.0, 0.5 * (k < 9), begin + 0.01 * k] for k in range(10)])
        return Stroked(0, events, at_s=at_s)

    contacts = _contacts([part(600.0, 1000.2), part(1.0, 1003.2)])  # stored 0.11 s after its last event, each
    assert [contact[0] for contact in contacts] == pytest.approx([1000.11, 1003.11])
    assert [contact[1] for contact in contacts] == pytest.approx([0.09, 0.09])


def test_the_operator_downloads_what_there_is_and_a_participant_does_not(tmp_path: Path) -> None:
    server = server_of(task_file(tmp_path, "abx"))
    with served(server) as client:
        assert client.get("/data.zip").status_code == 404
        client.get("/operator", params={"key": server.operator_key})
        assert "no answers yet" in client.get("/data.zip").text
        server.store.take_step(server.store.join("ALONE"), "trial:1", (1, Rated({"choice": 1.0}, 2.0, 2)))
        archive = zipfile.ZipFile(io.BytesIO(client.get("/data.zip").content))
    assert {name.split("/")[0] for name in archive.namelist()} == {"psych-ds", "bids"}


def test_markers_name_trials_contacts_and_answers_and_no_method(tmp_path: Path) -> None:
    server, sent = server_of(task_file(tmp_path, "abx")), list[dict[str, Any]]()

    class Recorder:
        def send(self, event: str, **about: Any) -> None:
            sent.append({"event": event, **about})

    server.study.markers = Recorder()  # type: ignore[assignment]
    with joined(server) as page:
        page.to_trial()
        page.stroke()
        page.socket.send_bytes(np.array([9.0, 0.0, 0.0, 0.1], dtype="<f8").tobytes())
        page.done(values={"choice": 1})
    of_trial = [marker["event"] for marker in sent if marker["trial"] == 1]
    assert of_trial == ["trial", "contact", "lift", "answer"]
    assert not any(repr(method) in str(sent) for method in server.design.methods)


def test_markers_reach_a_recorder() -> None:
    pylsl = pytest.importorskip("pylsl")
    markers = Markers("A study")
    streams = pylsl.resolve_byprop("name", NAME, timeout=5)
    inlet = pylsl.StreamInlet(streams[0])
    inlet.open_stream(timeout=5)
    markers.send("trial", participant=1, trial=2)
    sample, _ = inlet.pull_sample(timeout=5)
    assert json.loads(sample[0]) == {"event": "trial", "participant": 1, "trial": 2}
