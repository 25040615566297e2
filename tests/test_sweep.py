"""Sweeps: a file says what is run, every run once, and what comes back becomes tables."""

from __future__ import annotations

import copy
import csv
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, replace
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import false_discovery_control

from conftest import TINY, experiment
from foten.datasets.hdf5 import write_recording
from foten.dsp.inference import holm
from foten.models.texture_file import read_texture
from foten.reporting.table import Number
from foten.simulation.simulate import simulate
from foten.training.checkpoint import Checkpoint, Progress
from foten_lab import sweep as sweeping
from foten_lab.aggregate import PAPER, Row, compared, signed_rank
from foten_lab.experiment import Run, read_experiment, recording_of
from foten_lab.figures import figures, windows_and_losses
from foten_lab.method_tables import PAPERS, WARM_START, findings, ratios, summary, table, tables_of, warm_start
from foten_lab.provenance import platform_here, provenance_of
from foten_lab.results import by_recipe, chosen, read_records, read_results, records_of, runs_table, title_of
from foten_lab.sweep import _stoppable, lacking, planned, sweep
from test_cli import foten


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of a sweep by the command, Ray in a process of its own."""
    folder = tmp_path_factory.mktemp("sweep")
    program = "from foten.cli import main; main()"
    command = [sys.executable, "-c", program, "sweep", str(experiment(folder)), "-o", str(folder / "results")]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "RAY_DEDUP_LOGS": "0"}
    command += ["--workers", "2", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert (document["n_done"], document["n_failed"]) == (4, 0)
    assert "4/4" in done.stderr
    assert "min left" in done.stderr
    return folder / "results"


@pytest.fixture
def results(swept: Path) -> list[dict]:
    return read_results(swept)


@pytest.fixture
def records(swept: Path) -> list[dict]:
    return read_records(swept)


def test_a_sweep_of_long_runs_says_that_it_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan, _ = planned(read_experiment(experiment(tmp_path)), tmp_path)
    answers = iter([([], None), (["a"], None), (["b"], None)])
    stand_in = SimpleNamespace(
        wait=lambda refs, num_returns, timeout: next(answers),
        get=lambda ref: ({"failed": "no reason"}, b""),
        cluster_resources=lambda: {"CPU": 2.0},
        exceptions=SimpleNamespace(RayError=RuntimeError),
    )
    monkeypatch.setattr(sweeping, "ray", stand_in)
    lines: list[str] = []
    assert sweeping._collected(dict(zip("ab", plan, strict=False)), set(), lines.append) == (0, 2)
    assert lines[0] == "0/2 for 0 min, likely at FNN [13], linear-cloth, split 1; excited, linear-cloth, split 1"
    assert lines[1].startswith("1/2 FNN [13], linear-cloth, split 1: failed: no reason")


@pytest.mark.slow
def test_a_sweep_that_a_queue_ends_says_what_is_done(tmp_path: Path) -> None:
    """SIGTERM once a run is done: one line more, no trace of Ray's, the status of Ctrl-C, and no part of a file."""
    long = '{model = "foten", name = "long", train = {epochs = 10000}}'
    text = TINY.replace('{model = "fnn", name = "excited", sizes = {excitation = true}}', long)
    program = "from foten.cli import main; main()"
    command = [sys.executable, "-c", program, "sweep", str(experiment(tmp_path, text)), "-o", str(tmp_path / "results")]
    with subprocess.Popen([*command, "--workers", "1"], stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("1/4"):
                process.send_signal(signal.SIGTERM)
                break
        said = process.stderr.read().splitlines()
    assert process.returncode == 130
    assert said == ["stopped, 1 of 4 done; the same command goes on"]
    suffixes = sorted(path.suffix for path in (tmp_path / "results").iterdir())
    assert [suffix for suffix in suffixes if suffix not in (".checkpoint", ".part")] == [".foten", ".json"]


def test_a_run_that_was_stopped_goes_on_after_its_last_epoch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """To the same result, to the last bit, with the seconds of both; on another platform or device it begins anew."""
    text = TINY.replace("epochs = 1", "epochs = 3")
    plan, recordings = planned(read_experiment(experiment(tmp_path, text)), tmp_path)
    item = plan[0]
    run, recording = asdict(item.run), recordings[item.run.source]
    expected, texture = sweeping._guarded(run, recording, None)
    saved: list[int] = []
    save = Checkpoint.save

    def stopping(self: Checkpoint, name: str, parts: dict, progress: Progress) -> None:
        save(self, name, parts, progress)
        saved.append(progress.epochs[-1].epoch)
        if saved == [1, 2]:
            raise KeyboardInterrupt

    monkeypatch.setattr(Checkpoint, "save", stopping)
    with pytest.raises(KeyboardInterrupt):
        sweeping._guarded(run, recording, item.checkpoint)
    monkeypatch.setattr(Checkpoint, "elapsed_s", lambda _: 1000.0)
    result, again = sweeping._guarded(run, recording, item.checkpoint)
    assert saved == [1, 2, 3]
    assert again == texture
    assert result["seconds"].pop("training") == 1000.0
    expected.pop("seconds"), result.pop("seconds")
    assert result == expected
    assert [path.suffix for path in tmp_path.iterdir() if path.stem == item.path.stem] == [".checkpoint"]
    other = replace(provenance_of(item.run, recording.sha256()), platform={"kernel": "another"})
    for n, (name, here) in enumerate({"provenance_of": other, "device_name": "a GPU"}.items(), start=2):
        monkeypatch.setattr(sweeping, name, lambda *_, here=here: here)
        sweeping._guarded(run, recording, item.checkpoint)
        assert saved == [1, 2, 3] * n
    item.write(result, again)
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".foten", ".json", ".toml"]


def test_a_sweep_deletes_what_a_stop_left_behind(tmp_path: Path) -> None:
    done, waiting = tmp_path / "done.json", tmp_path / "waiting.json"
    old, new = (tmp_path / f".{name}.checkpoint.1-2.part" for name in ("old", "new"))
    for path in (done.with_suffix(".checkpoint"), waiting.with_suffix(".checkpoint"), old, new):
        path.write_bytes(b"")
    os.utime(old, (0, 0))
    sweeping._clean(tmp_path, [done])
    assert {path.name for path in tmp_path.iterdir()} == {"waiting.checkpoint", new.name}


def test_a_signal_as_ray_starts_is_not_lost() -> None:
    """What its handler raises is: Python swallows it in what runs at a fork, and Ray's own handler exits."""

    def swallowed() -> None:
        with suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)

    def exits() -> None:
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(15))
        signal.raise_signal(signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    for start in (swallowed, exits):
        with pytest.raises(KeyboardInterrupt):
            _stoppable(start)
    signal.signal(signal.SIGTERM, before)
    with pytest.raises(SystemExit):
        _stoppable(lambda: sys.exit(1))
    _stoppable(lambda: None)


def test_every_run_is_one_result_beside_its_texture_named_by_what_it_depends_on(
    results: list[dict], swept: Path
) -> None:
    assert len(results) == 4
    assert [one["run"]["method"] for one in results] == ["FNN [13]", "excited"] * 2
    assert all(one["run"]["train"]["epochs"] == 1 for one in results)
    assert all(one["run"]["train"]["loss"] == "mse" for one in results)  # the model's own recipe
    assert not list(swept.glob("*.part*"))
    same = read_experiment(experiment(swept.parent)).runs()
    names = {provenance_of(run, result["recording_sha256"]).name for run, result in zip(same, results, strict=True)}
    assert names == {path.stem for path in swept.glob("*.json")} == {path.stem for path in swept.glob("*.foten")}
    for path in swept.glob("*.json"):
        digest = json.loads(path.read_bytes())["evaluation"]["texture_sha256"]
        assert read_texture(path.with_suffix(".foten")).sha256() == digest


def test_a_summary_has_references_methods_and_the_papers_figure(records: list[dict]) -> None:
    fnn = [one for one in records if one["method"] == "FNN [13]"]
    cells = summary(fnn).cells()
    # Two textures have no p, and a column without a cell is left out.
    assert cells[0] == ["", "MAE [sd]", PAPERS, "GFC [%]", "LSD [dB]", "level error [dB]", "training [s]"]
    assert "unit not stated" in PAPERS
    rows = {row[0]: dict(zip(cells[0], row, strict=True)) for row in cells[1:]}
    assert list(rows)[:2] == ["zero", "persistence"]
    shown = rows["FNN [13], without excitation"]
    errors = [one["one_step.mae_scaled"] for one in fnn]
    assert (shown["MAE [sd]"], shown[PAPERS]) == (f"{np.mean(errors):.3f}", str(PAPER["fnn"]))
    assert shown["LSD [dB]"] == f"{np.mean([one['free_run_deterministic.lsd_db'] for one in fnn]):.2f}"
    assert float(shown["training [s]"]) >= 0
    assert float(rows["least possible"]["MAE [sd]"]) < float(rows["best AR"]["MAE [sd]"])
    assert rows["ceiling"]["MAE [sd]"] == ""


def test_a_table_has_textures_by_references_and_methods(records: list[dict]) -> None:
    cells = table(records, "mae").cells()
    assert cells[0] == [
        *("one-step MAE [sd]", "zero", "persistence", "AR(20)", "AR(20) by speed and force", "best AR"),
        *("least possible", "FNN [13], without excitation", "excited"),
    ]
    assert [row[0] for row in cells[1:]] == ["linear-cloth", "linear-twin", "mean"]
    errors = [one["one_step.mae_scaled"] for one in records if one["method"] == "FNN [13]"]
    assert [row[7] for row in cells[1:]] == [f"{errors[0]:.3f}", f"{errors[1]:.3f}", f"{np.mean(errors):.3f}"]
    free = ["AR(20) with white noise", "ceiling", "FNN [13], without excitation", "excited"]
    assert table(records, "lsd").cells()[0][1:] == free
    assert any("best on the mean of 2 trained methods" in line for line in findings(records))


def test_findings_say_who_is_compared_and_what_a_linear_predictor_has(records: list[dict]) -> None:
    for one, error in zip(records, (0.5, 0.2, 0.7, 0.4), strict=True):  # FNN and excited on each texture
        one |= {"one_step.mae_scaled": error, "references.ar_best.mae_scaled": 0.25}

    def said(some: list[dict]) -> str:
        return next(line for line in findings(some) if line.startswith("one-step MAE"))

    best = "one-step MAE [sd]: excited is best on the mean of 2 trained methods, with 0.300."
    beside = "A linear predictor, best AR, has 0.250: better are none."
    assert said(records) == f"{best} {beside}"
    for one in records:
        one["references.ar_best.mae_scaled"] = 0.45
    alone = "has 0.450: better are excited; the textures are too few to say that it is no chance."
    assert said(records).endswith(alone)
    del records[0]["references.ar_best.mae_scaled"], records[1]["references.ar_best.mae_scaled"]
    assert said(records) == best  # not of all textures


def test_what_is_better_than_a_linear_predictor_on_the_mean_may_be_chance(records: list[dict]) -> None:
    """By signed ranks of eight textures: what is better on all differs, what is better on seven of them need not."""
    errors = {"FNN [13]": [0.4] * 8, "excited": [0.49] * 7 + [0.60], "alike": [0.49] * 7 + [0.60]}
    many = []
    for method, of_method in errors.items():
        for k, error in enumerate(of_method):
            scores = {"one_step.mae_scaled": error + 0.001 * k, "references.ar_best.mae_scaled": 0.5 + 0.002 * k}
            many.append({**records[0], "method": method, "texture": f"t{k}", "recording_sha256": f"{k}", **scores})
    line = next(line for line in findings(many) if line.startswith("one-step MAE"))
    assert "on the mean of 2 trained methods" in line  # two of equal errors on each texture are counted once
    names = list(errors)
    assert line.endswith(f"better are {', '.join(names[:1])}.")
    many[15]["one_step.mae_scaled"] = many[23]["one_step.mae_scaled"] = 0.54
    line = next(line for line in findings(many) if line.startswith("one-step MAE"))
    assert line.endswith(f"better are {', '.join(names[:2])}; that may be chance for {names[1]}.")


def test_methods_of_equal_figures_are_one_hypothesis() -> None:
    """Holm's correction of one: twice as strict a one would come of counting a method and its copy."""
    textures = [f"t{k}" for k in range(8)]
    first, other, copy_ = (
        Row(name, "fnn", {t: np.array([level + 0.01 * k]) for k, t in enumerate(textures)})
        for name, level in (("first", 0.0), ("other", 0.5), ("copy", 0.5))
    )
    alone = signed_rank(first, [other], textures)
    assert alone == {"other": pytest.approx(2 / 2**8)}  # all eight of one sign, two-sided
    assert signed_rank(first, [other, copy_], textures) == {**alone, "copy": alone["other"]}
    assert signed_rank(first, [other], textures[:5]) == {}


def test_note_and_platform_stand_once_in_the_csv_of_an_experiment(records: list[dict], tmp_path: Path) -> None:
    """Of 350 letters in each row they were more than half of a file."""
    both = [one | {"experiment": name, "note": f"Of {name}."} for name in ("first", "second") for one in records]
    both += [one | {"experiment": "third", "note": ""} for one in records]
    both[-1] = both[-1] | {"platform": "another"}
    runs_table(both).write(tmp_path / "runs.csv")
    text = (tmp_path / "runs.csv").read_text()
    assert (text.count("Of "), text.count(both[0]["platform"]), text.count("another")) == (2, 3, 1)
    for key in ("note", "platform"):
        assert [one[key] for one in read_records(tmp_path / "runs.csv")] == [one[key] for one in both]


def test_a_table_says_what_was_reduced_and_what_a_figure_is_blind_to(records: list[dict]) -> None:
    noted = [one | {"note": "8 s, one epoch."} for one in records]
    for name, of in tables_of(noted).items():
        first, *others = of.notes
        assert (of.title, first) == ("Two methods", "8 s, one epoch.")
        assert ["blind to" in other for other in others] == [True] * (name in ("summary", "gfc", "warm-start"))


def test_the_warm_starts_columns_are_errors_per_cent_and_decibels(records: list[dict]) -> None:
    same = [one | {path: 2.0 for _, path, *_ in WARM_START} for one in records]
    row = warm_start(same).cells()[1]
    assert [cell.split()[0] for cell in row[-7:-1]] == ["2.000", "2.000", "2.000", "200.0", "200.0", "2.0"]


def test_tables_are_written_in_three_forms(swept: Path, tmp_path: Path) -> None:
    assert "| excited |" in foten("tables", swept, "-o", tmp_path / "tables")[0]
    names = product(("summary", "warm-start", "mae", "gfc", "lsd", "level"), ("md", "csv", "tex"))
    written = {path.name for path in (tmp_path / "tables").iterdir()}
    assert written == {"findings.md", "runs.csv", *(f"{name}.{form}" for name, form in names)}
    # What was written of the runs is what the same tables are made of; with fewer digits it is smaller, and whole numbers whole.
    foten("tables", tmp_path / "tables" / "runs.csv", "-o", tmp_path / "again")
    for path in (tmp_path / "tables").glob("*.md"):
        assert (tmp_path / "again" / path.name).read_text() == path.read_text()
    foten("tables", swept, "-o", tmp_path / "short", "--digits", "3")
    exact, short = read_records(swept), read_records(tmp_path / "short" / "runs.csv")
    numbers = [(one.get(key), value) for one, other in zip(exact, short, strict=True) for key, value in other.items()]
    numbers = [(one, value) for one, value in numbers if type(one) is float and one]
    assert all(value == (one if one.is_integer() else float(f"{one:.3g}")) for one, value in numbers)
    assert any(value != one for one, value in numbers)
    with_mark = "\ufeff" + (tmp_path / "short" / "runs.csv").read_text()  # as a spreadsheet writes
    (tmp_path / "marked.csv").write_text(with_mark)
    assert read_records(tmp_path / "marked.csv") == short


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        (lambda rows: [["a", "b"], ["1", "2"]], "other.csv is no runs.csv of foten tables"),
        (lambda rows: [*rows[:-1], rows[-1][:5]], "other.csv, row 5: it has not as many cells as row 1 has names"),
        (lambda rows: [rows[0], [*rows[1], "1"], *rows[2:]], "other.csv, row 2: it has not as many cells"),
        (lambda rows: with_cell(rows, "epochs", "0,5"), "other.csv, row 3: epochs is '0,5', expected a number"),
        (
            lambda rows: with_cell(rows, "epochs", "-1e12"),
            "other.csv, row 3: epochs is '-1e12', expected a number below",
        ),
        (
            lambda rows: [rows[0], *([rows[1][0], f"m{i}", *rows[1][2:]] for i in range(2001))],
            "there are 2001 runs, expected 2000",
        ),
        (lambda rows: with_cell(rows, "split", ""), "on linear-cloth has no split: is this the whole runs.csv"),
        (
            lambda rows: [[cell for k, cell in enumerate(row) if rows[0][k] != "rate_hz"] for row in rows],
            "has no rate_hz",
        ),
        (lambda rows: [["\udcff"], *rows], "other.csv is no CSV file in UTF-8"),
    ],
)
def test_what_is_no_table_of_runs_is_refused_in_one_line(
    swept: Path, tmp_path: Path, changed: Callable[..., list[list[str]]], message: str
) -> None:
    runs_table(read_records(swept)).write(tmp_path / "runs.csv")
    with (tmp_path / "runs.csv").open(newline="") as file:
        rows = list(csv.reader(file))
    with (tmp_path / "other.csv").open("w", newline="", errors="surrogateescape") as file:
        csv.writer(file).writerows(changed(rows))
    said = foten("tables", tmp_path / "other.csv", status=2)[1].strip()
    assert message in said
    assert "\n" not in said


def with_cell(rows: list[list[str]], name: str, text: str) -> list[list[str]]:
    """A table with another cell in its second row."""
    rows[2][rows[0].index(name)] = text
    return rows


def test_a_figure_is_rounded_once(records: list[dict], tmp_path: Path) -> None:
    """0.43749996 is 0.437 in a table; rounded to six digits before, 0.4375, it would be 0.438."""
    for one in records:
        one["one_step.mae_scaled"] = 0.43749996
    runs_table(records).write(tmp_path / "runs.csv")
    assert table(read_records(tmp_path / "runs.csv"), "mae") == table(records, "mae")
    assert {row[-1] for row in table(records, "mae").cells()[1:]} == {"0.437"}
    assert f"{float(f'{0.43749996:.6g}'):.3f}" == "0.438"


def test_the_recipe_that_is_best_on_validation_is_shown(records: list[dict]) -> None:
    """Two recipes of a method: which is shown hangs on the validation errors alone, on the mean of what both have."""
    published = [one | {"recipe": "published"} for one in records if one["method"] == "FNN [13]"]
    ours = [one | {"recipe": "ours", "one_step.mae_scaled": 9.0} for one in copy.deepcopy(published)]
    for one, error in zip(ours, (0.9, 1.2), strict=True):
        one["validation.mae_scaled"] = error * one["validation.mae_scaled"]
    both = [*published, *ours, *(one for one in records if one["method"] != "FNN [13]")]
    errors = by_recipe(both)["FNN [13]"]
    assert set(errors) == {"published", "ours"}
    best = next(iter(errors))
    assert errors[best] == min(errors.values())
    shown = chosen(both)
    assert {one["recipe"] for one in shown} == {best, ""}
    assert len(shown) == 4
    assert any(f"FNN [13] is shown by the recipe '{best}'" in line for line in findings(both))
    for one in ours:
        one["validation.mae_scaled"] = 0.0
    assert {one["recipe"] for one in chosen(both)} == {"ours", ""}
    for one in both:  # models of spectra have another validation error
        one["validation.mae_scaled"], one["validation.spectrum_db"] = None, 1.0 + (one["recipe"] == "ours")
    assert {one["recipe"] for one in chosen(both)} == {"published", ""}


def test_brief_runs_give_the_same_tables(records: list[dict], tmp_path: Path) -> None:
    for one in records:
        one["beside"] = "FNN [13]" if one["method"] == "excited" else ""
        one["listener.listener_auc"], one["stability.n_attack"] = 0.625, 1_000_008.0
        one["references.bound.mae_m_s2"] = 0.5
    runs_table(records).write(tmp_path / "whole.csv")
    assert {one["stability.n_attack"] for one in read_records(tmp_path / "whole.csv")} == {1_000_008}  # whole it stays
    foten("tables", tmp_path / "whole.csv", "-o", tmp_path / "out", "--brief")
    heading = (tmp_path / "out" / "runs.csv").read_text().splitlines()[0].split(",")
    assert "stability.n_attack" in heading  # of which there is a table
    assert "references.bound.mae_m_s2" in heading  # for the distance above the bound
    assert not [key for key in heading if key.startswith("free_run.gfc")]
    again = read_records(tmp_path / "out" / "runs.csv")
    assert tables_of(again) == tables_of(read_records(tmp_path / "whole.csv"))
    assert {one["listener.listener_auc"] for one in again} == {0.625}
    without = [one for one in records if one["method"] != "excited"]  # a part of a sweep: no run has an excitation yet
    runs_table(without).write(tmp_path / "part.csv")
    assert [one["method"] for one in read_records(tmp_path / "part.csv")] == ["FNN [13]"] * 2
    foten("tables", tmp_path / "out" / "runs.csv", "-o", tmp_path / "again")


def test_ratios_are_of_the_same_texture_and_split(records: list[dict]) -> None:
    for one in records:
        one["beside"] = "FNN [13]" if one["method"] == "excited" else ""
    for k, factor in ((1, 2.0), (3, 4.0)):
        records[k]["one_step.mae_scaled"] = factor * records[k - 1]["one_step.mae_scaled"]
    for k, one in enumerate(records):
        one["validation_listener.area"] = 0.9 - 0.1 * (k % 2) * (1 + k // 2)
    heading, row = ratios(records).cells()
    line = dict(zip(heading, row, strict=True))
    assert (line[""], line["beside"], line["pairs"]) == ("excited", "FNN [13]", "2")
    assert line["test: one step"] == "3.000 ± 1.000"  # sd of 2 and 4 over √2
    assert line["validation: listener"] == "-0.150 ± 0.050"  # of 0.1 and 0.2
    assert line["test: LSD"] == "–"  # one has no excitation


def test_parts_of_a_sweep_are_one(swept: Path, records: list[dict], tmp_path: Path) -> None:
    foten("tables", swept, "-o", tmp_path / "whole")
    other = [one | {"experiment": "Another"} for one in records]
    for name, some in (("first", records[:2]), ("second", records[1:]), ("other", other)):  # the second run is in both
        runs_table(some).write(tmp_path / f"{name}.csv")
    parts = [str(tmp_path / f"{name}.csv") for name in ("first", "second")]
    foten("tables", *parts, "-o", tmp_path / "joined")

    def known(name: str) -> list[dict]:  # columns stand in another order where a run has others
        rows = read_records(tmp_path / name / "runs.csv")
        return [{key: value for key, value in row.items() if value is not None} for row in rows]

    assert known("joined") == known("whole")
    assert (tmp_path / "joined/summary.md").read_text() == (tmp_path / "whole/summary.md").read_text()
    said = foten("tables", parts[0], tmp_path / "other.csv", status=2)[1]
    assert "'Another', expected those of one experiment" in said


def test_figures_are_drawn_from_the_results(swept: Path, tmp_path: Path) -> None:
    printed = foten("figures", swept, "-o", tmp_path / "figures")[0]
    names = ["figure-4", "figure-6", "figure-6-convergence", "figure-7"]  # no grid, no Fig. 5
    made = [Path(line) for line in printed.splitlines()]
    assert [path.name for path in made] == [f"{name}.{form}" for name in names for form in ("png", "pdf")]
    assert all(path.stat().st_size > 5000 for path in made)
    signals = read_results(swept)[1]["signals"]
    assert len(signals["recorded"]) == len(signals["free_run"]) == 400
    assert 0.2 < np.std(signals["free_run"]) / np.std(signals["recorded"]) < 5


def test_windows_and_losses_are_drawn_where_there_is_a_grid(results: list[dict]) -> None:
    assert not [name for name, _ in figures(results) if "figure-5" in name]
    other = copy.deepcopy(results[0])
    other["run"]["train"]["loss"] = "mae"
    drawn = dict(figures([results[0], other]))["figure-5-fnn"]
    assert [text.get_text() for text in drawn.axes[0].get_legend().get_texts()] == ["mae", "mse"]
    errors = {("jeans", "mae", m): np.array([0.3, 0.4]) for m in (10, 20)}
    (axes,) = (axes for axes in windows_and_losses(errors, {("jeans", 20): [0.35, 0.28, 0.31]}).axes if axes.lines)
    assert axes.lines[0].get_xydata().tolist() == [[20, 0.28], [20, 0.35]]
    assert axes.lines[0].get_label() == "3 seeds"
    # The errors of a grid are not averaged with those of the grid beside it.
    grid = []
    for method, factor in (("FNN [13]", 1.0), ("excited", 10.0)):
        for delta in (0.4, 1.6):
            for loss in ("mae", "huber"):
                one = copy.deepcopy(results[0])
                one["run"] |= {"method": method, "cell": {"delta": delta, "loss": loss}}
                one["run"]["train"] |= {"loss": loss, "delta": delta}
                one["evaluation"]["one_step"]["mae_scaled"] = factor * delta
                grid.append(one)
    grids = {name: figure for name, figure in figures(grid) if "figure-5" in name}
    assert set(grids) == {
        f"figure-5-{method}-{rest}"
        for method in ("1-fnn-13", "2-excited")
        for rest in ("delta-0-4", "delta-1-6", "loss-huber-delta")
    }
    drawn = grids["figure-5-2-excited-delta-1-6"]
    assert {float(line.get_ydata()[0]) for line in drawn.axes[0].get_lines()[::2]} == {16.0}


def test_thresholds_are_drawn_over_each_textures_mean(results: list[dict]) -> None:
    results = [one for one in results if one["run"]["method"] == "FNN [13]"]
    others = copy.deepcopy(results)
    for one in (*results, *others):
        one["run"]["train"]["loss"] = "huber"
    for one in others:
        one["run"]["train"]["delta"] = 0.4
        one["evaluation"]["one_step"]["mae_scaled"] *= 3
    drawn = dict(figures([*results, *others]))["figure-5-fnn-delta"]
    mean = drawn.axes[0].get_lines()[-1]
    np.testing.assert_allclose(mean.get_xdata(), [0.4, 1.6])
    np.testing.assert_allclose(mean.get_ydata(), [1.5, 0.5])
    np.testing.assert_allclose(drawn.axes[1].get_lines()[-1].get_ydata(), 1)
    # A run of the grid of windows and losses stands in the figure of thresholds, where all else is the same.
    for one in results:
        one["run"]["cell"] = {"window": 144, "loss": "huber"}
    for one in others:
        one["run"]["cell"] = {"delta": 0.4}
    assert {name for name, _ in figures([*results, *others]) if "figure-5" in name} == {"figure-5-fnn-delta"}


def test_figure_4_is_left_out_where_its_recording_is_not(results: list[dict], tmp_path: Path) -> None:
    result = results[0]
    write_recording(recording_of(Run(**result["run"])), tmp_path / "a.h5")
    result["run"] |= {"texture": "elsewhere/a.h5", "seconds": None}
    for folder, match in ((None, "no such file: elsewhere/a.h5"), (tmp_path, "")):
        said: list[str] = []
        names = [name for name, _ in figures([result], folder, said.append)]
        assert names == ["figure-4"] * (folder is not None) + ["figure-6", "figure-6-convergence", "figure-7"]
        assert match in " ".join(said)
        assert bool(said) == bool(match)
    write_recording(simulate("linear-cloth", 8, seed=2), tmp_path / "a.h5")
    said = []
    assert "figure-4" not in dict(figures([result], tmp_path, said.append))
    assert "is not what was learned from" in said[0]


def test_a_panel_is_of_one_recording(results: list[dict]) -> None:
    """A method that failed on the first split is not drawn over it: its second is another recording."""
    first = results[0]
    second, other = copy.deepcopy(first), copy.deepcopy(first)
    second["run"]["split_seed"] = other["run"]["split_seed"] = 2
    other["run"]["method"] = "other"
    axes = dict(figures([first, second, other]))["figure-6"].axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["FNN [13],\nwithout excitation"]


def test_what_falls_silent_runs_along_the_lower_edge_and_is_said(results: list[dict]) -> None:
    result, other = results[0::2]  # one method, two textures
    for one in (result, other):
        for name, power in (("recorded", 1.0), ("free_run", 1.0)):
            one["signals"]["density"][name] = [power] * len(one["signals"]["frequencies_hz"])
    result["signals"]["density"]["free_run"] = [1e-4] * len(result["signals"]["frequencies_hz"])
    name = "FNN [13], without excitation"

    def legend(*results: dict) -> str:
        return dict(figures(results))["figure-7"].legends[0].get_texts()[0].get_text()

    assert legend(other) == name
    assert legend(result) == f"{name}: falls silent, 40 dB or more below the recording"
    assert legend(result, other) == f"{name}: falls silent on 1 of 2 textures, 40 dB or more below the recording"
    axes = dict(figures([result]))["figure-7"].axes[0]
    low, high = axes.get_ylim()
    drawn = axes.get_lines()[0].get_ydata()
    assert low < drawn.min()
    assert drawn.max() < low + 0.05 * (high - low)


def test_waveforms_have_a_scale_and_say_where_one_is_silent(results: list[dict]) -> None:
    result = results[0]
    recorded = 3.0 * np.sin(np.arange(400))
    for factor, words in ((0.9, []), (0.01, ["silent: 40 dB below"])):
        result["signals"] |= {"recorded": recorded.tolist(), "free_run": (factor * recorded).tolist()}
        axes = dict(figures([result]))["figure-6"].axes[0]
        assert [text.get_text() for text in axes.texts] == [*words, "3 m/s²"]
        bar = axes.get_lines()[-1].get_ydata()
        assert bar[1] - bar[0] == 3  # in the unit of the recorded one, drawn as it is
        np.testing.assert_array_equal(axes.get_lines()[0].get_ydata(), recorded)
        np.testing.assert_array_equal(axes.get_lines()[1].get_ydata(), factor * recorded)
        assert axes.get_lines()[2].get_xdata() == [100, 100]  # ms, at 1 kHz 100 samples


def test_the_papers_network_has_waveforms_of_its_own_among_others(results: list[dict]) -> None:
    assert "figure-6-foten" not in dict(figures(results))
    for result in results[::2]:
        result["run"] |= {"model": "foten", "method": "FoTEN"}
    drawn = dict(figures(results))
    alone, among = drawn["figure-6-foten"], drawn["figure-6"]
    assert alone.get_supxlabel() == "time [ms]; grey: recorded, in colour: FoTEN, without excitation"
    one, both = ([x for x in of.axes[0].get_lines() if len(x.get_xdata()) > 2] for of in (alone, among))
    assert (len(one), len(both)) == (2, 4)  # a run over the recording, and of both methods
    assert one[1].get_color() in {line.get_color() for line in both[1::2]}


def test_an_error_over_time_is_that_of_silence_where_a_run_is_silent(results: list[dict]) -> None:
    """Of two textures the mean, by the middle of each 10 ms."""
    for result, errors in zip(results, ([1.0] * 40, [0.5] * 40), strict=False):
        result["signals"] |= {"error_to_silence": errors, "level_db": [-300.0] * 40}
        warm = result["evaluation"]["warm_start"]
        warm["ceiling"]["mae_scaled"] = 1.5 * warm["silence_mae_scaled"]
        result["run"]["method"] = "one method"
        result["evaluation"]["free_run"]["lsd_db"] = None
    errors, levels = dict(figures(results[:2]))["figure-6-convergence"].axes
    line, silence, ceiling, _ = errors.get_lines()
    assert (line.get_label(), set(line.get_ydata())) == ("one method, without excitation", {0.75})
    np.testing.assert_allclose(line.get_xdata(), 10 * np.arange(40) + 5)
    assert (silence.get_ydata()[0], ceiling.get_ydata()[0]) == (1.0, pytest.approx(1.5))
    assert set(levels.get_lines()[0].get_ydata()) == {-60.0}  # silence is drawn along the lower edge


def test_a_sweep_names_what_it_has_anew_and_makes_again_what_is_damaged(swept: Path, tmp_path: Path) -> None:
    folder = tmp_path / "results"
    shutil.copytree(swept, folder)
    renamed = read_experiment(experiment(tmp_path, TINY.replace("Two methods", "Renamed").replace('"excited"', '"E"')))
    assert sweep(renamed, folder) == (0, 0)  # Ray is not even started
    results = read_results(folder)
    assert title_of(records_of(results)) == "Renamed"
    assert [result["run"]["method"] for result in results] == ["FNN [13]", "E"] * 2
    assert [result["evaluation"] for result in results] == [result["evaluation"] for result in read_results(swept)]
    plan, _ = planned(renamed, folder)
    path, whole = plan[0].path, plan[0].path.read_text()
    without_split = json.loads(whole)
    del without_split["evaluation"]["split_sha256"]
    without_index = {name: value for name, value in json.loads(whole).items() if name != "index"}
    infinite, lists = json.loads(whole) | {"index": float("inf")}, json.loads(whole)
    lists["provenance"]["code"] = ["x"]
    odd = map(json.dumps, (without_split, without_index, infinite, lists))
    for text in (whole[:-100], "5", '{"evaluation": 5}', *odd):
        path.write_text(text)
        lines: list[str] = []
        assert lacking(plan, folder, [platform_here()], lines.append) == plan[:1]
        assert lines == [f"FNN [13], linear-cloth, split 1: run again, as {path.name} is damaged"]
        with pytest.raises(ValueError, match=f"{path.name} is no result of foten sweep, or damaged"):
            read_results(folder)
    path.write_text(whole.replace(json.loads(whole)["provenance"]["code"], "0" * 16))
    assert len(read_records(folder)) == 4
    with pytest.raises(ValueError, match="run the sweep again, or allow it by --mixed"):
        read_results(folder)


def test_the_same_run_under_two_names_is_refused(tmp_path: Path) -> None:
    recording = simulate("linear-cloth", 8, seed=1)
    for name in ("a.h5", "b.h5"):
        write_recording(recording, tmp_path / name)
    names = r"'FNN \[13\]' on .*a\.h5 and 'FNN \[13\]' on .*b\.h5"
    twice = '"FNN [13]"}, {model = "fnn", name = "again"}'
    for old, new, match in (
        ('"linear-cloth", "linear-twin"', '"a.h5", "b.h5"', names),
        ('"FNN [13]"}', twice, r"'FNN .*' on linear-cloth and 'again' on"),
    ):
        with pytest.raises(ValueError, match=f"{match}.* are the same run: leave one of them out"):
            planned(read_experiment(experiment(tmp_path, TINY.replace(old, new))), tmp_path / "results")


def test_an_address_where_nobody_listens_is_said_at_once(tmp_path: Path) -> None:
    with socket.socket() as taken:  # bound and not listening: refused
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        command = ["sweep", str(experiment(tmp_path)), "-o", str(tmp_path / "results"), "--address", address]
        message = foten(*command, status=2)[1].strip().splitlines()[-1]
    assert f"no Ray cluster answers at {address}" in message
    assert "ray start --head" in message


def test_results_that_a_table_would_mix_are_refused(swept: Path, tmp_path: Path) -> None:
    first, *_ = sorted(swept.glob("*.json"))
    for name in ("a.json", "b.json"):
        (tmp_path / name).write_text(first.read_text())
    with pytest.raises(ValueError, match=r"a\.json and b\.json are both of"):
        read_results(tmp_path)


def test_what_is_not_complete_is_said_and_not_compared(records: list[dict]) -> None:
    lacking = [one for one in records if one["method"] != "excited" or one["texture"] != "linear-twin"]
    assert any("not compared, for want of textures or splits: excited" in line for line in findings(lacking))
    assert title_of(records) == "Two methods"


def papers(records: list[dict]) -> dict[str, str]:
    """The paper's figure of each method in the summary, empty where it has none."""
    heading, *rows = summary(records).cells()
    lines = [dict(zip(heading, row, strict=True)) for row in rows]
    return {line[""].removesuffix(", without excitation"): line.get(PAPERS, "") for line in lines}


def test_the_papers_figure_is_of_the_one_row_without_excitation(records: list[dict]) -> None:
    reported = papers(records)
    assert (reported["FNN [13]"], reported["excited"]) == (str(PAPER["fnn"]), "")
    assert papers([one for one in records if one["method"] == "excited"])["excited"] == str(PAPER["fnn"])
    for one in records:  # two settings of one model: neither is the paper's
        one["excitation"] = "no"
    assert {papers(records)[name] for name in ("FNN [13]", "excited")} == {""}


def test_a_method_without_one_step_has_a_row_and_the_papers_figure(results: list[dict]) -> None:
    """A model of spectra has no one-step error; it is compared by its free run."""
    copied = copy.deepcopy([one for one in results if one["run"]["method"] == "excited"])
    for one in copied:
        one["run"] |= {"method": "spectra", "model": "gan"}
        one["evaluation"]["one_step"] = dict.fromkeys(one["evaluation"]["one_step"])
    records = records_of([*results, *copied])
    rows = {row[0]: row for row in summary(records).cells()}
    assert rows["spectra"][1:4] == ["–", "0.298", "–"]
    assert float(rows["spectra"][4]) > 0
    lines = [line for line in findings(records) if line.startswith("one-step MAE [sd]: ")]
    assert lines[0] == "one-step MAE [sd]: there is none of spectra."
    assert not any("for want of" in line for line in lines)


def test_a_folder_without_results_is_said(tmp_path: Path) -> None:
    assert "there is no result of foten sweep" in foten("tables", tmp_path, status=2)[1]
    some = b'{"run":{"method":1},"evaluation":{"one_step":2}}'
    for content in (b"{}", b"[]", b"\xff\xfe", b"{", some):
        (tmp_path / "x.json").write_bytes(content)
        assert "x.json is no result" in foten("tables", tmp_path, status=2)[1]


def test_holm_is_at_least_as_strict_as_the_false_discovery_rate_and_never_above_bonferroni() -> None:
    """By hand for three; beside SciPy's Benjamini–Hochberg, which is always more lenient."""
    assert holm(np.array([0.01, 0.04, 0.03])) == pytest.approx([0.03, 0.06, 0.06])
    p = np.random.default_rng(0).uniform(size=9)
    corrected = holm(p)
    assert (corrected >= false_discovery_control(p) - 1e-12).all()
    assert (corrected <= np.minimum(1, 9 * p) + 1e-12).all()


def test_methods_that_are_equal_as_shown_are_both_the_best(records: list[dict]) -> None:
    """With and without excitation one network has one one-step error; their free runs differ."""
    rows = summary(records).rows
    best = {str(name): [isinstance(cell, Number) and cell.best for cell in cells] for name, *cells in rows}
    assert best["FNN [13], without excitation"][0] is best["excited"][0] is True
    assert (best["FNN [13], without excitation"][3], best["excited"][3]) == (False, True)
    assert not any(best["least possible"])


def test_what_is_never_better_differs_and_what_is_the_same_does_not() -> None:
    textures = [f"T{i}" for i in range(12)]
    rng = np.random.default_rng(1)
    base = rng.uniform(0.2, 0.6, 12)
    values = {"best": base, "same": base + rng.normal(0, 0.01, 12) + 0.001, "worse": base + 0.1}
    rows = [Row(name, "m", dict(zip(textures, v[:, None], strict=True))) for name, v in values.items()]
    best, p = compared(rows, textures, -1)
    assert best == "best"
    assert p["worse"] < 0.01
    assert p["same"] > 0.05
    assert compared(rows, textures[:5], -1)[1] == {}
