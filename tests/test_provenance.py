"""Results know their code: its version, what is run again, and what is not put into one table."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import foten
from conftest import TINY, experiment
from foten.cli.command_line import _status
from foten_lab import sweep as sweeping
from foten_lab.experiment import read_experiment
from foten_lab.provenance import SOURCES, code_here, platform_here
from foten_lab.results import check_alike, joined, mixture, read_records, read_results, records_of, runs_table
from foten_lab.sweep import lacking, planned


@pytest.fixture
def checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A repository that the package lies in."""
    for folder in SOURCES.values():
        (tmp_path / folder).mkdir(parents=True)
        (tmp_path / folder / "__init__.py").write_text("SIZE = 1\n")
    for command in (["init", "--quiet"], ["add", "."], ["commit", "--quiet", "--message", "A version"]):
        subprocess.run(["git", "-C", tmp_path, "-c", "user.name=a", "-c", "user.email=a@b", *command], check=True)
    monkeypatch.setattr(foten, "__file__", str(tmp_path / SOURCES["foten"] / "foten" / "__init__.py"))
    code_here.cache_clear()
    yield tmp_path
    code_here.cache_clear()


def code() -> str:
    code_here.cache_clear()
    return code_here()


def test_the_code_of_a_result_is_what_git_says_of_its_folders(checkout: Path) -> None:
    command = ["git", "-C", checkout, "rev-parse", *(f"HEAD:{folder}" for folder in SOURCES.values())]
    trees = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    committed = code()
    assert committed == ", ".join(f"{name} {tree[:12]}" for name, tree in zip(SOURCES, trees, strict=True))
    (checkout / "README.md").write_text("Not of a result.")
    assert code() == committed
    codes = {committed}
    for name, text in (("__init__.py", "SIZE = 2\n"), ("__init__.py", "SIZE = 3\n"), ("other.py", "SIZE = 2\n")):
        (checkout / SOURCES["native"] / name).write_text(text)
        assert code().startswith(f"{committed}, modified ")
        codes.add(code())
    assert len(codes) == 4  # a sweep in a changed checkout does not go on as if nothing had changed since


def test_what_is_installed_has_a_version_and_no_checkout(checkout: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Within another repository too, as in an environment that lies in one; and where there is no git."""
    expected = f"{foten.__version__}, no checkout"
    (checkout / "site" / "foten").mkdir(parents=True)
    monkeypatch.setattr(foten, "__file__", str(checkout / "site" / "foten" / "__init__.py"))
    assert code() == expected
    monkeypatch.setattr(foten, "__file__", str(checkout / SOURCES["foten"] / "foten" / "__init__.py"))
    assert code() != expected
    monkeypatch.setenv("PATH", "")
    assert code() == expected


@pytest.fixture(scope="module")
def result() -> dict[str, Any]:
    """A result file's content, as far as tables read it."""
    figures = dict.fromkeys(("mae_scaled", "gfc", "lsd_db", "level_error_db"), 0.5)
    runs = ("one_step", "free_run", "free_run_deterministic", "free_run_ar", "ceiling")
    evaluation = {**{name: figures for name in runs}, "references": {"zero": figures}, "rate_hz": 1000.0}
    evaluation |= {"n_blocks": 2, "split_sha256": "ab"}
    seconds = {"training": 1.0, "evaluation": 1.0}
    empty = {"signals": None, "n_epochs": 1, "measures": {}, "random_part": None, "file_bytes": 1}
    return {"evaluation": evaluation, "seconds": seconds, **empty}


@pytest.fixture
def folder(tmp_path: Path, result: dict[str, Any]) -> Path:
    """Results of all runs of an experiment, as this code would make them here."""
    plan, _ = planned(read_experiment(experiment(tmp_path)), tmp_path / "results")
    (tmp_path / "results").mkdir()
    for item in plan:
        provenance = item.provenance.to_json()
        item.write({**result, "recording_sha256": item.provenance.data, "provenance": provenance})
    return tmp_path / "results"


def changed(path: Path, **provenance: Any) -> None:
    content = json.loads(path.read_text())
    content["provenance"] |= provenance
    path.write_text(json.dumps(content))


OTHER = {"code": "foten 0, foten-study 0, foten-lab 0, native 0"}


def test_a_sweep_goes_on_with_what_is_alike_in_all_and_says_why_the_rest_is_run_again(folder: Path) -> None:
    plan, _ = planned(read_experiment(folder.parent / "experiment.toml"), folder)
    lines: list[str] = []
    assert lacking(plan, folder, [platform_here()], lines.append) == []
    assert lines == []
    changed(plan[0].path, **OTHER)
    changed(plan[2].path, **OTHER)
    abacus = {**plan[1].provenance.platform, "kernel": "abacus"}
    changed(plan[1].path, platform=abacus)
    assert lacking(plan, folder, [platform_here()], lines.append) == plan[:3]
    assert lines == [
        "FNN [13], linear-cloth, split 1 and 1 more: run again, as the result is of other code",
        "excited, linear-cloth, split 1: run again, as the result is of other platform (kernel)",
    ]
    # On a cluster a result of the platform of any node may stay.
    assert lacking(plan, folder, [platform_here(), abacus], lines.append) == [plan[0], plan[2]]
    assert lacking(plan, folder, [abacus], lines.append) == [plan[0], *plan[2:]]
    # A sweep that goes on elsewhere may keep those of any platform; other code is run again all the same.
    assert lacking(plan, folder, None, lines.append) == [plan[0], plan[2]]


def test_on_a_cluster_the_platforms_are_those_of_its_nodes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Not that of this machine, and not whatever is found."""
    asked: list[Any] = []
    monkeypatch.setattr(sweeping, "_start_ray", lambda *options: asked.append(options))
    monkeypatch.setattr(sweeping, "_cluster_platforms", lambda: [{**platform_here(), "processor": "of a node"}])
    monkeypatch.setattr(sweeping.ray, "put", lambda recording: recording)
    monkeypatch.setattr(sweeping, "_collected", lambda pending, done, say: (len(pending), 0))
    monkeypatch.setattr(sweeping.ray, "remote", lambda **options: lambda task: Remote())
    read = read_experiment(folder.parent / "experiment.toml")
    assert sweeping.sweep(read, folder) == (0, 0)
    changed(next(folder.glob("*.json")), platform={**platform_here(), "kernel": "abacus"})
    assert sweeping.sweep(read, folder, mixed=True) == (0, 0)
    assert sweeping.sweep(read, folder, address="head:6379") == (4, 0)
    assert asked == [(None, "head:6379", 0.0)]
    for path in folder.iterdir():
        changed(path, platform={**platform_here(), "processor": "of a node"})
    assert sweeping.sweep(read, folder, address="head:6379") == (0, 0)


class Remote:
    """A task of Ray's that nobody executes."""

    def remote(self, *arguments: Any) -> object:
        return object()


@pytest.mark.parametrize(
    ("old", "new", "what"), [("epochs = 1", "epochs = 2", "configuration"), ("= 8", "= 9", "data")]
)
def test_a_result_of_other_data_or_settings_stays_until_the_new_one_is_there(
    folder: Path, result: dict[str, Any], old: str, new: str, what: str
) -> None:
    before = set(folder.iterdir())
    plan, _ = planned(read_experiment(experiment(folder.parent, TINY.replace(old, new))), folder)
    lines: list[str] = []
    waiting = lacking(plan, folder, [platform_here()], lines.append)
    assert lines == [f"FNN [13], linear-cloth, split 1 and 3 more: run again, as the result is of other {what}"]
    assert {item.replaces for item in waiting} == before == set(folder.iterdir())
    for item in waiting:
        item.write({**result, "recording_sha256": item.provenance.data, "provenance": item.provenance.to_json()})
    assert set(folder.iterdir()) == {item.path for item in plan}
    assert len(read_results(folder)) == 4
    another = TINY.replace("Two methods", "Another").replace("= 8", "= 10")
    plan, _ = planned(read_experiment(experiment(folder.parent, another)), folder)
    waiting = lacking(plan, folder, [platform_here()], lines.append)
    assert [item.replaces for item in waiting] == [None] * 4  # what is of another experiment is not deleted


@pytest.mark.parametrize(("other", "what"), [(OTHER, "code"), ({"platform": {}}, "platform")])
def test_results_of_different_code_or_platform_are_mixed_only_when_allowed(
    folder: Path, capsys: pytest.CaptureFixture[str], other: dict[str, Any], what: str
) -> None:
    results = read_results(folder)
    changed(sorted(folder.glob("*.json"))[0], **other)
    for command in (["tables", str(folder)], ["figures", str(folder), "-o", str(folder.parent / "figures")]):
        assert _status(command) == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert f" differ in {what}: run the sweep again, or allow it by --mixed" in line
        assert line.count("split 1'") == 2  # names both
    tables = folder.parent / "tables"
    assert _status(["tables", str(folder), "--mixed", "-o", str(tables)]) == 0
    assert f"differ in {what}." in (tables / "findings.md").read_text()
    capsys.readouterr()
    assert _status(["tables", str(tables / "runs.csv")]) == 2
    assert "allow it by --mixed" in capsys.readouterr().err
    assert len(results) == 4


def test_runs_of_before_are_compared_with_those_of_their_model(folder: Path) -> None:
    """Whose digests are of what one model and its measures import; a version is of all, and documents of before have none."""
    records = records_of(read_results(folder))
    foten_run = {**records[0], "model": "foten", "method": "FoTEN"}
    with pytest.raises(ValueError, match=r"'FNN .*' and 'FoTEN .*' differ in code: run the sweep again"):
        check_alike([*records, {**foten_run, **OTHER}])
    before = [record | {"code": "0123456789abcdef"} for record in records]
    other = {**foten_run, "code": "fedcba9876543210"}
    check_alike([*before, other])
    with pytest.raises(ValueError, match=r"differ in code \(of fnn\)"):
        check_alike([*before[:3], records[3]])
    path = folder.parent / "runs.csv"
    runs_table([*before, other]).write(path)
    again = read_records(path)
    assert len(joined([again])) == 5
    with pytest.raises(ValueError, match=r"differ in code \(of fnn\)"):
        joined([[*again[:3], {**again[3], "code": "3" * 16}]])
    both = [*again, *({**one, "code": "3" * 16} for one in again[2:])]
    assert mixture(both) == "runs of other code than most of their model: fnn 2 of 6, foten 1 of 2"
    assert mixture(both[::-1]) == "runs of other code than most of their model: foten 1 of 2, fnn 2 of 6"
    with pytest.raises(ValueError, match=r"FNN .* on .*, split 1, is there of two recordings"):
        joined([again, [{**again[0], "recording_sha256": "of a new simulator"}]])
    unknown = [{**record, "code": "", "platform": ""} for record in again]
    assert len(joined([unknown])) == 5
    with pytest.raises(ValueError, match="differ in code"):
        joined([unknown[:2], again[2:]])
