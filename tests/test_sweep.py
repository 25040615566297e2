"""Sweeps: a file says what is run, every run once, and what comes back becomes tables."""

from __future__ import annotations

import copy
import json
import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from conftest import TINY, experiment
from foten.cli.command_line import _status
from foten.datasets.hdf5 import write_recording
from foten.datasets.simulate import simulate
from foten.experiments.experiment import read_experiment
from foten.experiments.figures import figures
from foten.experiments.results import PAPER, read_results, rows_of, title_of
from foten.experiments.sweep import _kept, sweep
from foten.experiments.tables import each_run, findings, table, written


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the results of a sweep by the command, Ray in a process of its own."""
    folder = tmp_path_factory.mktemp("sweep")
    program = "from foten.cli import main; main()"
    command = [sys.executable, "-c", program, "sweep", str(experiment(folder)), "-o", str(folder / "results")]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "RAY_DEDUP_LOGS": "0"}
    for expected in ((4, 0), (0, 0)):  # the second time nothing is left to do
        done = subprocess.run(
            [*command, "--workers", "2", "--json"], capture_output=True, text=True, env=environment, check=False
        )
        assert done.returncode == 0, done.stderr
        document = json.loads(done.stdout)
        assert (document["n_done"], document["n_failed"]) == expected
        if expected[0]:
            assert "4/4" in done.stderr
            assert "min left" in done.stderr
    return folder / "results"


def test_every_run_is_one_file_named_by_what_it_depends_on(swept: Path) -> None:
    results = read_results(swept)
    assert len(results) == 4
    assert [one["run"]["method"] for one in results] == ["FNN [13]", "excited"] * 2
    assert all(one["run"]["train"]["epochs"] == 1 for one in results)
    assert all(one["run"]["train"]["loss"] == "mse" for one in results)  # the model's own recipe
    assert not list(swept.glob("*.part*"))
    same = read_experiment(experiment(swept.parent)).runs()
    names = {run.name(one["recording_sha256"], one["foten"]) for run, one in zip(same, results, strict=True)}
    assert names == {path.stem for path in swept.glob("*.json")}


def test_a_table_has_references_methods_and_the_papers_figure(swept: Path) -> None:
    results = read_results(swept)
    cells = table([one for one in results if one["run"]["method"] == "FNN [13]"], "mae")
    assert cells[0] == ["one-step MAE [sd], one split", "linear-cloth", "linear-twin", "mean", "paper's mean"]
    rows = {row[0]: row[1:] for row in cells[1:]}
    assert list(rows)[:2] == ["zero", "persistence"]
    assert rows["FNN [13]"][-1] == str(PAPER["fnn"].mae)
    errors = [one["evaluation"]["one_step"]["mae_scaled"] for one in results if one["run"]["method"] == "FNN [13]"]
    assert rows["FNN [13]"][:3] == [f"{errors[0]:.3f}", f"{errors[1]:.3f}", f"{np.mean(errors):.3f}"]
    assert float(rows["least possible"][0]) < float(rows["best AR"][0]) < float(rows["zero"][0])
    free = [row[0] for row in table(results, "lsd")]
    assert free[1:] == ["AR(20) with white noise", "ceiling", "FNN [13], without excitation", "excited"]
    assert any("best on the mean" in line for line in findings(results))


def test_tables_are_written_in_three_forms(swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _status(["tables", str(swept), "-o", str(tmp_path / "tables")]) == 0
    assert "| FNN [13] |" in capsys.readouterr().out
    assert {path.name for path in (tmp_path / "tables").iterdir()} == {
        *(f"{name}.{form}" for name in ("mae", "gfc", "lsd", "level") for form in ("md", "csv", "tex")),
        *("findings.md", "runs.csv"),
    }
    latex = (tmp_path / "tables" / "gfc.tex").read_text()
    assert r"GFC [\%]" in latex
    assert latex.count(r"\\") == len((tmp_path / "tables" / "gfc.csv").read_text().splitlines())


def test_each_run_is_a_row_with_intervals_over_blocks(swept: Path) -> None:
    results = read_results(swept)
    results[0]["evaluation"]["one_step"]["intervals"] = {"mae_scaled": [0.25, 0.75], "gfc": [0.5, 0.9]}
    heading, *rows = each_run(results)
    lines = [dict(zip(heading, row, strict=True)) for row in rows]
    assert [(one["method"], one["texture"]) for one in lines] == [
        (method, texture) for texture in ("linear-cloth", "linear-twin") for method in ("FNN [13]", "excited")
    ]
    assert (lines[0]["mae_low"], lines[0]["mae_high"], lines[0]["gfc_high"]) == ("0.25", "0.75", "90")
    assert lines[1]["mae_low"] == ""  # one test block
    assert [one["excitation"] for one in lines] == ["no", "yes"] * 2
    silent, excited = (results[k]["evaluation"] for k in (0, 1))
    assert float(lines[0]["lsd"]) == pytest.approx(silent["free_run_deterministic"]["lsd_db"], rel=1e-5)
    assert float(lines[1]["lsd"]) == pytest.approx(excited["free_run"]["lsd_db"], rel=1e-5)
    assert all(float(one["training_s"]) > 0 and one["epochs"] == "1" for one in lines)
    gan = copy.deepcopy(results[0])
    gan["evaluation"]["one_step"]["mae_scaled"] = None
    assert dict(zip(heading, each_run([gan])[1], strict=True))["mae"] == ""


def test_figures_are_drawn_from_the_results(swept: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _status(["figures", str(swept), "-o", str(tmp_path / "figures")]) == 0
    names = ["figure-4", "figure-6", "figure-7"]  # no grid, no Fig. 5
    made = [Path(line) for line in capsys.readouterr().out.splitlines()]
    assert [path.name for path in made] == [f"{name}.{form}" for name in names for form in ("png", "pdf")]
    assert all(path.stat().st_size > 5000 for path in made)
    signals = read_results(swept)[1]["signals"]
    assert len(signals["recorded"]) == len(signals["free_run"]) == 400
    assert 0.2 < np.std(signals["free_run"]) / np.std(signals["recorded"]) < 5


def test_windows_and_losses_are_drawn_where_there_is_a_grid(swept: Path) -> None:
    results = read_results(swept)
    assert not [name for name, _ in figures(results) if "figure-5" in name]
    other = copy.deepcopy(results[0])
    other["run"]["train"]["loss"] = "mae"
    drawn = dict(figures([results[0], other]))["figure-5-fnn"]
    assert [text.get_text() for text in drawn.axes[0].get_legend().get_texts()] == ["mae", "mse"]
    # Another method with another window is no grid.
    other["run"]["method"] = "other"
    assert not [name for name, _ in figures([results[0], other]) if "figure-5" in name]
    # Nor are its errors averaged with those of the grid beside it.
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
        for method in ("fnn-13", "excited")
        for rest in ("delta-0-4", "delta-1-6", "loss-huber-delta")
    }
    drawn = grids["figure-5-excited-delta-1-6"]
    assert {float(line.get_ydata()[0]) for line in drawn.axes[0].get_lines()[::2]} == {16.0}


def test_thresholds_are_drawn_over_each_textures_mean(swept: Path) -> None:
    results = [one for one in copy.deepcopy(read_results(swept)) if one["run"]["method"] == "FNN [13]"]
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


def test_figure_4_is_left_out_where_its_recording_is_not(swept: Path, tmp_path: Path) -> None:
    recording = simulate("linear-cloth", 8, seed=1)
    write_recording(recording, tmp_path / "a.h5")
    result = copy.deepcopy(read_results(swept)[0])
    result["run"] |= {"texture": "elsewhere/a.h5", "seconds": None}
    for folder, match in ((None, "no such file: elsewhere/a.h5"), (tmp_path, "")):
        said: list[str] = []
        names = [name for name, _ in figures([result], folder, said.append)]
        assert names == ["figure-4"] * (folder is not None) + ["figure-6", "figure-7"]
        assert match in " ".join(said)
        assert bool(said) == bool(match)
    write_recording(simulate("linear-cloth", 8, seed=2), tmp_path / "a.h5")
    said = []
    assert "figure-4" not in dict(figures([result], tmp_path, said.append))
    assert "is not what was learned from" in said[0]


def test_a_panel_is_of_one_recording(swept: Path) -> None:
    """A method that failed on the first split is not drawn over it: its second is another recording."""
    first = copy.deepcopy(read_results(swept)[0])
    second, other = copy.deepcopy(first), copy.deepcopy(first)
    second["run"]["split_seed"] = other["run"]["split_seed"] = 2
    other["run"]["method"] = "other"
    axes = dict(figures([first, second, other]))["figure-6"].axes[0]
    assert [label.get_text() for label in axes.get_yticklabels()] == ["recorded", "FNN [13]"]


def test_methods_of_like_names_have_files_of_their_own(swept: Path) -> None:
    grid = []
    for method in ("A+", "A-"):
        for loss in ("mae", "huber"):
            one = copy.deepcopy(read_results(swept)[0])
            one["run"] |= {"method": method, "cell": {"loss": loss}}
            one["run"]["train"]["loss"] = loss
            grid.append(one)
    names = [name for name, _ in figures(grid) if "figure-5" in name]
    assert names == ["figure-5-a-1", "figure-5-a-2"]


def test_blocks_without_a_free_run_have_tables(swept: Path, tmp_path: Path) -> None:
    """Blocks too short for a spectrum: all figures of the free run are missing, and what is not known is left empty."""
    results = copy.deepcopy(read_results(swept))
    for one in results:
        for run in ("free_run", "free_run_deterministic", "free_run_ar", "ceiling"):
            one["evaluation"][run] = dict.fromkeys(one["evaluation"][run])
    assert len(table(results, "mae")) > 2
    assert len(table(results, "lsd")) == 3
    assert [row[5] for row in each_run(results)[1:]] == [""] * 4


def test_what_falls_silent_runs_along_the_lower_edge(swept: Path) -> None:
    result = copy.deepcopy(read_results(swept)[0])
    n = len(result["signals"]["frequencies_hz"])
    result["signals"]["density"]["free_run"] = [1e-40] * n
    axes = dict(figures([result]))["figure-7"].axes[0]
    low, high = axes.get_ylim()
    drawn = axes.get_lines()[0].get_ydata()
    assert low < drawn.min()
    assert drawn.max() < low + 0.05 * (high - low)


def test_one_split_has_its_interval(swept: Path) -> None:
    results = copy.deepcopy(read_results(swept))
    results[0]["evaluation"]["one_step"] |= {"mae_scaled": 0.5, "intervals": {"mae_scaled": [0.25, 0.75]}}
    cells = table(results, "mae")
    assert cells[0][0] == "one-step MAE [sd], one split [95 % over its blocks]"
    assert next(row for row in cells if row[0] == "FNN [13]")[1] == "0.500 [0.250, 0.750]"


def test_splits_that_are_the_same_blocks_are_said(swept: Path) -> None:
    results = copy.deepcopy(read_results(swept))
    assert not any("same blocks" in line for line in findings(results))
    again = copy.deepcopy(results[0])
    again["run"]["split_seed"] = 2
    assert any("splits 1, 2 are the same blocks" in line for line in findings([*results, again]))


def test_a_sweep_names_what_it_has_anew_and_makes_again_what_is_damaged(swept: Path, tmp_path: Path) -> None:
    folder = tmp_path / "results"
    shutil.copytree(swept, folder)
    asked = read_experiment(experiment(tmp_path, TINY.replace("Two methods", "Renamed").replace('"excited"', '"E"')))
    said: list[str] = []
    assert sweep(asked, folder, say=said.append) == (0, 0)  # Ray is not even started
    results = read_results(folder)
    assert title_of(results) == "Renamed"
    assert [one["run"]["method"] for one in results] == ["FNN [13]", "E"] * 2
    figures_of = [one["evaluation"] for one in read_results(swept)]
    assert [one["evaluation"] for one in results] == figures_of
    path = sorted(folder.glob("*.json"))[0]
    path.write_text(path.read_text()[:-100])
    about = {"index": 0}
    lacking = read_results(swept)[0]
    del lacking["evaluation"]["split_sha256"]
    for text in (path.read_text(), json.dumps(lacking), "5", '{"evaluation": 5}'):
        path.write_text(text)
        assert not _kept(path, about, said.append)
        assert said[-1] == f"{path.name} is damaged, and is made again"
        with pytest.raises(ValueError, match=f"{path.name} is no result of foten sweep, or damaged"):
            read_results(folder)


def test_one_recording_under_two_names_is_refused(tmp_path: Path) -> None:
    recording = simulate("linear-cloth", 8, seed=1)
    for name in ("a.h5", "b.h5"):
        write_recording(recording, tmp_path / name)
    text = TINY.replace('"linear-cloth", "linear-twin"', '"a.h5", "b.h5"')
    with pytest.raises(ValueError, match=r"a\.h5 and .*b\.h5 are the same recording"):
        sweep(read_experiment(experiment(tmp_path, text)), tmp_path / "results")
    assert not list((tmp_path / "results").iterdir())


def test_an_address_where_nobody_listens_is_said_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.socket() as taken:  # bound and not listening: refused
        taken.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        command = ["sweep", str(experiment(tmp_path)), "-o", str(tmp_path / "results"), "--address", address]
        assert _status(command) == 2
    message = capsys.readouterr().err.strip().splitlines()[-1]
    assert f"no Ray cluster answers at {address}" in message
    assert "ray start --head" in message


def test_special_characters_are_markdowns_too() -> None:
    assert written([["a|b", "1"], ["c", "2"]], "md").splitlines()[0] == r"| a\|b | 1 |"
    latex = written([["h", "1"], [r"f $x_1$ {b} ^~\ ±", "2"]], "tex")
    assert r"f \$x\_1\$ \{b\} \textasciicircum{}\textasciitilde{}\textbackslash{} $\pm$ & 2" in latex


def test_special_characters_are_latexs() -> None:
    assert written([["a_b & 5 %", "1.0 ± 0.1"], ["–", ""]], "tex").splitlines()[2] == r"a\_b \& 5 \% & 1.0 $\pm$ 0.1 \\"


def test_results_that_a_table_would_mix_are_refused(swept: Path, tmp_path: Path) -> None:
    first, *_ = sorted(swept.glob("*.json"))
    for name in ("a.json", "b.json"):
        (tmp_path / name).write_text(first.read_text())
    with pytest.raises(ValueError, match=r"a\.json and b\.json are both of"):
        read_results(tmp_path)


def test_what_is_not_complete_is_said_and_not_compared(swept: Path) -> None:
    results = read_results(swept)
    lacking = [one for one in results if one["run"]["method"] != "excited" or one["run"]["texture"] != "linear-twin"]
    assert any("not compared, for want of textures or splits: excited" in line for line in findings(lacking))
    assert title_of(results) == "Two methods"


def test_the_papers_figure_is_of_the_one_row_without_excitation(swept: Path) -> None:
    results = read_results(swept)
    cells = table(results, "mae")
    assert cells[0][-1] == "paper's mean"
    assert {row[0]: row[-1] for row in cells[-2:]} == {"FNN [13]": str(PAPER["fnn"].mae), "excited": ""}
    alone = table([one for one in results if one["run"]["method"] == "excited"], "mae")
    assert alone[-1][-1] == str(PAPER["fnn"].mae)
    other = copy.deepcopy(results)
    for one in other:  # two settings of one model: neither is the paper's
        one["run"]["sizes"]["excitation"] = False
    assert "paper's mean" not in table(other, "mae")[0]


def test_a_method_without_one_step_has_a_row_and_the_papers_figure(swept: Path) -> None:
    """What foretells spectra has no one-step error; it is compared by its free run."""
    results = read_results(swept)
    copied = copy.deepcopy([one for one in results if one["run"]["method"] == "excited"])
    for one in copied:
        one["run"] |= {"method": "spectra", "model": "gan"}
        one["evaluation"]["one_step"] = dict.fromkeys(one["evaluation"]["one_step"])
    results += copied
    rows = {row[0]: row for row in table(results, "mae")}
    assert set(rows["spectra"][1:-1]) == {"–"}
    assert rows["spectra"][-1] == "0.298"
    assert {row[0] for row in table(results, "lsd")} >= {"spectra", "excited"}
    said = list(findings(results))
    assert "one-step MAE [sd]: there is none of spectra." in said
    assert not any("for want of" in one for one in said)


def test_versions_that_differ_are_said_and_packages_that_lack_are_not(swept: Path) -> None:
    """`ar` needs no PyTorch and names no version of it: that is no difference."""
    results = read_results(swept)
    without = json.loads(json.dumps(results))
    del without[0]["versions"]["torch"]
    assert not any("several versions" in line for line in findings(without))
    without[1]["versions"]["numpy"] = "0.1"
    assert any("several versions, of numpy 0.1, " in line for line in findings(without))


def test_a_folder_without_results_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert _status(["tables", str(tmp_path)]) == 2
    assert "there is no result of foten sweep" in capsys.readouterr().err
    some = b'{"run":{"method":1},"evaluation":{"one_step":2}}'
    for content in (b"{}", b"[]", b"\xff\xfe", b"{", some):
        (tmp_path / "x.json").write_bytes(content)
        assert _status(["tables", str(tmp_path)]) == 2
        assert "x.json is no result" in capsys.readouterr().err
    (tmp_path / "file").write_text("")
    command = ["sweep", str(experiment(tmp_path)), "-o", str(tmp_path / "file" / "x")]
    assert _status(command) == 2
    assert capsys.readouterr().err.strip().endswith("/file/x: not a directory")
    assert _status(["sweep", str(tmp_path), "-o", str(tmp_path / "y")]) == 2
    (tmp_path / "folder.toml").mkdir()
    assert _status(["sweep", str(tmp_path / "folder.toml"), "-o", str(tmp_path / "y")]) == 2
    assert "is a folder, expected a .toml file" in capsys.readouterr().err


def test_references_are_counted_once_for_each_split(swept: Path) -> None:
    _, rows = rows_of(read_results(swept), "mae")
    zero = next(row for row in rows if row.name == "zero")
    assert all(len(values) == 1 for values in zero.values.values())
