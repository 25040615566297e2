"""Results know their code: whose source counts, what is run again, and what is not put into one table."""

from __future__ import annotations

import copy
import json
from pathlib import Path
from typing import Any

import pytest

import foten
from conftest import TINY, experiment
from foten.cli.command_line import _status
from foten.experiments import sweep as sweeping
from foten.experiments.experiment import read_experiment
from foten.experiments.provenance import KERNEL, Provenance, closure, platform_here, provenance_of, sources_of
from foten.experiments.results import check_alike, joined, mixture, read_records, read_results, records_of, runs_table
from foten.experiments.sweep import lacking, planned
from foten.models.trainable import TRAINABLE

ROOT = Path(foten.__file__).parent
PACKAGE = {
    "__init__": "",
    "run": "from package.dispatch import fit\n",
    "dispatch": "from package import filters\ndef fit(model):\n    if model == 'a':\n        import package.models.a\n"
    "    else:\n        import package.models.b\n",
    "filters": "import typing\nif typing.TYPE_CHECKING:\n    import package.drawing\nelse:\n    import package.values\n"
    "def resample():\n    import package.rates\n",
    "models/__init__": "",
    "models/a": "import package.lattice\n",
    "models/b": "import package.network\n",
    **dict.fromkeys(("drawing", "values", "rates", "lattice", "network"), "SIZE = 1\n"),
}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A package whose runs load one of two models when they are asked to."""
    for name, text in PACKAGE.items():
        path = tmp_path / "package" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return tmp_path / "package"


def test_a_closure_has_what_a_run_imports_and_no_other_model(root: Path) -> None:
    modules = closure(["package.run", "package.models.a"], root, others={"package.models.b"})
    names = ("", ".run", ".dispatch", ".filters", ".values", ".rates", ".models", ".models.a", ".lattice")
    assert set(modules) == {f"package{name}" for name in names}  # not what type checkers alone see
    both = closure(["package.run"], root)
    assert {"package.models.a", "package.models.b", "package.network"} <= set(both)
    assert modules["package.models"] == root / "models" / "__init__.py"


def test_what_is_imported_at_once_counts_whoever_it_belongs_to(root: Path) -> None:
    (root / "dispatch.py").write_text("from package.models import a, b\n")
    assert "package.network" in closure(["package.run"], root, others={"package.models.b"})


def test_a_run_depends_on_its_measures_and_not_on_rest() -> None:
    sources = sources_of("foten", ())
    assert {"foten", "foten.experiments.run", "foten.models.foten.network", "foten.dsp.filters"} <= set(sources)
    assert [name.partition(".")[0] for name in sources if name.startswith(KERNEL)] == [
        "kernel/libfoten",
        "kernel/libfoten_training",
    ]
    rest = {"foten.experiments.stability", "foten.evaluate.listener_network"}
    rest |= {"foten.experiments.sweep", "foten.experiments.method_tables", "foten.reporting.table", "foten.study.store"}
    assert not rest & set(sources)
    assert set(sources_of("foten", ("stability",))) - set(sources) == {"foten.experiments.stability"}
    assert "foten.evaluate.listener_network" in sources_of("foten", ("listener",))
    for model in TRAINABLE:
        assert "foten.evaluate.listener_network" not in sources_of(model, ())


def test_a_run_reads_no_file_of_the_package_but_sources_and_the_kernel() -> None:
    """A module that names a file beside it would be one more dependency; this one lists experiments."""
    sources = sources_of("foten-plus", ("stability", "onset", "listener"))
    modules = closure((name for name in sources if not name.startswith(KERNEL)), ROOT)
    reading = {name for name, path in modules.items() if "__file__" in path.read_text(encoding="utf-8")}
    assert reading == {"foten.experiments.experiment"}


def test_a_source_within_the_closure_changes_the_digest_and_one_outside_does_not(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    run = read_experiment(experiment(tmp_path)).runs()[0]
    changed: set[Path] = set()
    read = Path.read_bytes
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b"\n# changed" * (path in changed))

    def provenance() -> Provenance:
        sources_of.cache_clear()
        return provenance_of(run, "0" * 64)

    before = provenance()
    changed.add(ROOT / "experiments" / "method_tables.py")
    assert provenance() == before
    changed.add(ROOT / "dsp" / "filters.py")
    after = provenance()
    assert (after.code != before.code, after.name) == (True, before.name)
    assert after.differences(before.to_json()) == ["code (foten.dsp.filters)"]
    sources_of.cache_clear()


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


OTHER = {"code": "0", "sources": {"foten.dsp.filters": "0"}}


def test_a_sweep_goes_on_with_what_is_alike_in_all_and_says_why_the_rest_is_run_again(folder: Path) -> None:
    plan, _ = planned(read_experiment(folder.parent / "experiment.toml"), folder)
    lines: list[str] = []
    assert lacking(plan, folder, [platform_here()], lines.append) == []
    assert lines == []
    sources = {**plan[0].provenance.sources, "foten.dsp.filters": "0"}
    changed(plan[0].path, sources=sources)
    changed(plan[2].path, sources=sources)
    abacus = {**plan[1].provenance.platform, "kernel": "abacus"}
    changed(plan[1].path, platform=abacus)
    assert lacking(plan, folder, [platform_here()], lines.append) == plan[:3]
    assert lines == [
        "FNN [13], linear-cloth, split 1 and 1 more: run again, as the result is of other code (foten.dsp.filters)",
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


@pytest.mark.parametrize(("other", "what"), [(OTHER, "code (foten.dsp.filters)"), ({"platform": {}}, "platform")])
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
    # What was written of them is refused too, for one model and the same measures have one digest.
    assert _status(["tables", str(tables / "runs.csv")]) == 2
    assert "allow it by --mixed" in capsys.readouterr().err
    assert len(results) == 4


def test_runs_of_two_models_have_different_digests_and_are_alike(folder: Path) -> None:
    """Modules that both import are compared, and of a `runs.csv` the digests of one model; documents of before have none."""
    records = records_of(read_results(folder))
    other = copy.deepcopy(records[0]) | {"model": "foten", "method": "FoTEN", "code": "other"}
    other["sources"] = {"foten.of_another_model": "1"}
    check_alike([*records, other])
    other["sources"]["foten.dsp.filters"] = "2"
    with pytest.raises(ValueError, match=r"'FNN .*' and 'FoTEN .*' differ in code \(foten\.dsp\.filters\)"):
        check_alike([*records, other])
    path = folder.parent / "runs.csv"
    runs_table([*records, other]).write(path)
    again = read_records(path)
    assert len(joined([again])) == 5
    with pytest.raises(ValueError, match=r"differ in code \(of fnn\)"):
        joined([[*again[:3], {**again[3], "code": "3"}]])
    both = [*again, *({**one, "code": "3"} for one in again[2:])]
    assert mixture(both) == "runs of other code than most of their model: fnn 2 of 6, foten 1 of 2"
    assert mixture(both[::-1]) == "runs of other code than most of their model: foten 1 of 2, fnn 2 of 6"
    with pytest.raises(ValueError, match=r"FNN .* on .*, split 1, is there of two recordings"):
        joined([again, [{**again[0], "recording_sha256": "of a new simulator"}]])
    unknown = [{**record, "code": "", "platform": ""} for record in again]
    assert len(joined([unknown])) == 5
    with pytest.raises(ValueError, match="differ in code"):
        joined([unknown[:2], again[2:]])
