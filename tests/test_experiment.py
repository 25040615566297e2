"""Experiments in TOML files: what is run, what is refused, and what is measured of a texture file beside its evaluation."""

from __future__ import annotations

import copy
import dataclasses
import tomllib
from pathlib import Path

import numpy as np
import pytest

from conftest import TINY, check_figures, experiment, exported
from foten.datasets.hdf5 import write_recording
from foten.evaluate.evaluate import Judgement
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.simulation.simulate import simulate
from foten_lab.experiment import Experiment, Method, Run, experiment_path, read_experiment, recording_of
from foten_lab.figures import convergence, spectra, split, thresholds, waveforms, windows_and_losses
from foten_lab.onset import onset
from foten_lab.results import by_recipe, read_records
from foten_lab.run import _result
from foten_lab.stability import into, proven, render_streams, stability
from foten_lab.sweep import planned
from test_cli import foten

RESULTS = Path(__file__).parents[1] / "docs" / "results"


def test_ar_is_run_once_whatever_the_grid(tmp_path: Path) -> None:
    text = TINY.replace("[train]", '[grid]\nloss = ["mse", "mae"]\n[train]').replace("methods = [", 'methods = ["ar", ')
    assert [run.method for run in read_experiment(experiment(tmp_path, text)).runs()].count("ar") == 2


@pytest.mark.parametrize("name", ["table-1", "table-1-tuned", "table-2", "figure-5"])
def test_ours_are_read_and_as_large_as_they_say(name: str) -> None:
    n = {"table-1": 12 * 7, "table-1-tuned": 12 * 8, "table-2": 12 * 5, "figure-5": 3 * (18 + 5 + 2 + 1 + 3)}
    runs = read_experiment(experiment_path(name)).runs()
    assert len(runs) == n[name]
    paper = [run for run in runs if run.model == "foten" and name in ("table-1", "table-2")]
    assert all((r.train["batch"], r.train["epochs"], r.train["learning_rate"]) == (16, 100, 1e-3) for r in paper)
    assert {len(run.configuration) for run in runs} == {16}
    windows = {run.sizes["window"] for run in runs if run.model == "foten"}
    assert windows == ({5, 10, 15, 20, 25, 30} if name == "figure-5" else {20})


def test_what_is_tuned_has_the_recipe_that_was_best_on_validation(tmp_path: Path) -> None:
    """Chosen by the errors in recipes.csv, on textures that are in no table."""
    best = {name: next(iter(errors)) for name, errors in by_recipe(read_records(RESULTS / "recipes.csv")).items()}
    tried = read_experiment(experiment_path("recipes")).runs()
    chosen = {run.method: {**run.train, "seed": 0} for run in tried if run.recipe == best[run.method]}
    for key in ("steel-mesh-1", "jeans", "towel"):
        (tmp_path / f"{key}-350hz.h5").touch()
    names = ("table-1-tuned", "table-1-near", "table-1-350hz", "main-contact")
    by_name = {name: read_experiment(experiment_path(name), tmp_path).runs() for name in names}
    by_name["main-contact"] = [run for run in by_name["main-contact"] if run.model != "foten-plus"]  # by its default
    tuned = [run for runs in by_name.values() for run in runs]
    assert len(chosen) == 6
    for run in tuned:
        if run.model != "ar":
            longer = {"seed": 0} | ({"epochs": 24} if run.model == "fnn" else {})  # it takes a minute
            assert {**run.train, **longer} == chosen[run.method.removesuffix(" with excitation")], run.method
    assert not {Path(run.texture).stem.removesuffix("-350hz") for run in tuned} & {run.texture for run in tried}
    # Whose low-pass is ours.
    of_paper = [run for name, runs in by_name.items() for run in runs if name != "main-contact"]
    assert {str(run.preprocess) for run in of_paper} == {str(run.preprocess) for run in tried}


def test_a_grid_crosses_sizes_and_training(tmp_path: Path) -> None:
    text = TINY.replace("[train]", '[grid]\nwindow = [120, 144]\nloss = ["mse", "mae"]\n[train]')
    runs = read_experiment(experiment(tmp_path, text)).runs()
    assert len(runs) == 16
    assert {(run.sizes["window"], run.train["loss"]) for run in runs} == {
        (m, loss) for m in (120, 144) for loss in ("mse", "mae")
    }
    assert (runs[0].method, runs[0].label) == ("FNN [13]", "FNN [13] loss mse, window 120")


def test_each_of_several_grids_is_run_for_itself(tmp_path: Path) -> None:
    grids = '[[grid]]\nwindow = [120, 144]\nloss = ["mse", "mae"]\n[[grid]]\nlearning_rate = [1e-4]\n[train]'
    runs = read_experiment(experiment(tmp_path, TINY.replace("[train]", grids))).runs()
    assert [run.cell for run in runs if run.method == "excited"] == [
        {"window": 120, "loss": "mse"},
        {"window": 120, "loss": "mae"},
        {"window": 144, "loss": "mse"},
        {"window": 144, "loss": "mae"},
        {"learning_rate": 1e-4},
    ] * (len(runs) // 10)
    for wrong, match in (("grid = [5]", "a grid is 5, expected"), ("[[grid]]\nwindows = [5]", "unknown key 'windows'")):
        with pytest.raises(ValueError, match=match):
            read_experiment(experiment(tmp_path, TINY.replace("[train]", f"{wrong}\n[train]")))


def test_a_setting_that_a_method_does_not_use_is_no_grid(tmp_path: Path) -> None:
    text = TINY.replace("[train]", '[grid]\nloss = ["mse", "mae"]\n[train]')
    gan = text.replace('{model = "fnn", name = "FNN [13]"}', '"gan"').replace("block_ms = 1000", "")
    with pytest.raises(ValueError, match="method 'gan': loss means nothing to gan"):
        read_experiment(experiment(tmp_path, gan)).runs()
    ar = 'title = "x"\nmethods = ["ar"]\ntextures = ["towel"]\n'
    for more, match in (
        ("[train]\nepoch = 1", "unknown key 'epoch'"),
        ("[grid]\nepochs = [1]", "a grid is of settings of networks, and the file has none"),
    ):
        with pytest.raises(ValueError, match=match):
            read_experiment(experiment(tmp_path, ar + more))


def test_recipes_are_runs_of_their_own_and_may_name_a_recipe(tmp_path: Path) -> None:
    recipes = '"FNN [13]", recipes = {published = {recipe = "paper", epochs = 3}, ours = {learning_rate = 2e-3}}}'
    runs = read_experiment(experiment(tmp_path, TINY.replace('"FNN [13]"}', recipes))).runs()
    fnn = {run.recipe: run.train for run in runs if run.method == "FNN [13]"}
    assert set(fnn) == {"published", "ours"}
    assert (fnn["published"]["batch"], fnn["published"]["epochs"]) == (16, 3)
    assert (fnn["ours"]["batch"], fnn["ours"]["epochs"], fnn["ours"]["learning_rate"]) == (128, 1, 2e-3)
    assert all(run.label == "FNN [13]" for run in runs if run.recipe)
    assert len(runs) == 6


def test_the_files_recipes_are_those_of_each_method_that_has_none_of_its_own(tmp_path: Path) -> None:
    shared = "[recipes]\nslow = {learning_rate = 1e-4}\nfast = {learning_rate = 1e-2}\n[train]"
    own = TINY.replace('"FNN [13]"}', '"FNN [13]", recipes = {own = {learning_rate = 2e-3}}}, "ar"')
    runs = read_experiment(experiment(tmp_path, own.replace("[train]", shared))).runs()
    found = {(run.method, run.recipe): run.train.get("learning_rate") for run in runs}
    expected = {("FNN [13]", "own"): 2e-3, ("excited", "slow"): 1e-4, ("excited", "fast"): 1e-2, ("ar", ""): None}
    assert found == expected
    wrong = own.replace("[train]", "[recipes]\na = {epoch = 1}\n[train]")
    with pytest.raises(ValueError, match="unknown key 'epoch' in recipe 'a' of the file"):
        read_experiment(experiment(tmp_path, wrong))


def test_every_texture_and_split_has_a_hand_of_its_own(tmp_path: Path) -> None:
    """Under one hand the test blocks of all textures would have the same speeds: no replicates."""
    text = TINY.replace("seconds = 8", "seconds = 8\nsplit_seeds = [1, 2]")
    runs = read_experiment(experiment(tmp_path, text)).runs()
    speeds = {run.source: recording_of(run)["speed"].samples for run in runs}
    assert len(speeds) == 4
    correlations = np.corrcoef(np.stack(list(speeds.values())))
    assert np.abs(correlations[np.triu_indices(4, 1)]).max() < 0.9


def test_the_papers_recipe_has_the_papers_filter_whatever_names_it(tmp_path: Path) -> None:
    """25 Hz in training (Sec. III-c): of a method, of one of its recipes, of the whole file; another where that is asked for."""

    def lowpass_hz(text: str) -> dict[str, float]:
        runs = read_experiment(experiment(tmp_path, text)).runs()
        return {run.recipe or run.method: run.preprocess["lowpass_hz"] for run in runs}

    of_method = TINY.replace('"FNN [13]"}', '"FNN [13]", recipe = "paper"}')
    assert lowpass_hz(of_method) == {"FNN [13]": 25.0, "excited": 20.0}
    recipes = TINY.replace('"FNN [13]"}', '"FNN [13]", recipes = {published = {recipe = "paper"}, ours = {}}}')
    assert lowpass_hz(recipes) == {"published": 25.0, "ours": 20.0, "excited": 20.0}
    of_file = TINY.replace("[train]", 'recipe = "paper"\n[train]')
    assert set(lowpass_hz(of_file).values()) == {25.0}
    other = of_file.replace("[preprocess]", "[preprocess]\nlowpass_hz = 30.0")
    assert set(lowpass_hz(other).values()) == {30.0}


def test_the_papers_recipe_is_refused_of_what_it_is_not_for(tmp_path: Path) -> None:
    text = TINY.replace('{model = "fnn", name = "FNN [13]"}', '{model = "gan", recipe = "paper"}')
    with pytest.raises(ValueError, match="method 'gan': the paper's recipe"):
        read_experiment(experiment(tmp_path, text)).runs()


def test_a_method_may_have_fewer_splits_and_measures_of_the_first(tmp_path: Path) -> None:
    text = TINY.replace("[train]", "split_seeds = [2, 3]\n[train]").replace(
        '"FNN [13]"}', '"FNN [13]", split_seeds = [3]}, {model = "foten-plus", measures = ["stability", "listener"]}'
    )
    runs = read_experiment(experiment(tmp_path, text)).runs()
    assert {run.split_seed for run in runs if run.method == "FNN [13]"} == {3}
    measured = {(run.split_seed, run.measures) for run in runs if run.model == "foten-plus"}
    assert measured == {(2, ("stability", "listener")), (3, ("listener",))}


def test_recordings_are_where_it_is_said(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    write_recording(simulate("linear-cloth", 8), tmp_path / "elsewhere" / "a.h5")
    path = experiment(tmp_path, TINY.replace('"linear-twin"', '"a.h5"'))
    with pytest.raises(ValueError, match=r"there is no recording a\.h5 in .*: give its folder by --recordings"):
        read_experiment(path)
    assert str(tmp_path / "elsewhere" / "a.h5") in read_experiment(path, tmp_path / "elsewhere").textures


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('"FNN [13]"}', '"FNN [13]", beside = "DSTN"}', "'FNN [13]' stands beside 'DSTN', which is no method"),
        ('"FNN [13]"}', '"FNN [13]", recipes = {a = {epoch = 1}}}', "unknown key 'epoch' in recipe 'a' of a method"),
        ('"FNN [13]"}', '"FNN [13]", recipes = {a = {recipe = "x"}}}', "unknown recipe 'x'"),
        ('"FNN [13]"}', '"FNN [13]", measures = ["onse"]}', "unknown key 'onse' in 'measures' of a method"),
        ('"FNN [13]"}', '"FNN [13]", split_seeds = [9]}', "its split_seeds are not all among the experiment's"),
        ("seconds = 8", "seconds = ", "this is not TOML"),
        ("seconds = 8", "second = 8", "unknown key 'second' in the file, expected 'seconds'?"),
        ("seconds = 8", "seconds = '8'", "'seconds' of the file is '8', expected a number"),
        ("seconds = 8", "seconds = true", "'seconds' of the file is True, expected a number"),
        ("seconds = 8", "seconds = nan", "holds a number that is not finite"),
        ("seconds = 8", "seconds = 0", "0 s asked for, expected 1 to 3600"),
        ('"linear-twin"', '"silk"', "unknown texture 'silk'"),
        ('name = "excited"', 'name = "FNN [13]"', "two methods have the same name"),
        ('"fnn", name = "e', '"fn", name = "e', "unknown model 'fn'"),
        ("excitation = true", "excited = true", "method 'excited': fnn has no size 'excited'"),
        ("epochs = 1", "epoch = 1", "unknown key 'epoch' in 'train' of the file, expected 'epochs'?"),
        ("epochs = 1", "epochs = -1", "epochs is -1, expected 0 or more"),
        ("[train]", "split_seeds = [1, 1]\n[train]", "split_seeds is [1, 1], expected a list of whole numbers, each"),
        ("[train]", f"split_seeds = {[*range(501)]}\n[train]", "it has more than 2000 runs"),
        ("[train]", "[grid]\nepoch = [1]\n[train]", "unknown key 'epoch' in [grid], expected 'epochs'?"),
        ('"FNN [13]"}', '"FNN [13]"}, {model = "ar", train = {epochs = 3}}', "'ar' is fitted without a recipe"),
        ("sizes = {excitation = true}", "sizes = 5", "'sizes' of a method is 5, expected a table"),
        ('"linear-twin"', '"linear-cloth"', "two textures have the same name"),
        ("[train]", "[grid]\nloss = 'mse'\n[train]", "'loss' in the grid is 'mse', expected a list"),
    ],
)
def test_what_is_wrong_in_a_file_is_said_in_one_line(tmp_path: Path, old: str, new: str, match: str) -> None:
    assert old in TINY
    path = experiment(tmp_path, TINY.replace(old, new, 1))
    message = foten("sweep", path, "-o", tmp_path / "results", "--dry-run", status=2)[1].strip()
    assert message.startswith(f"foten: {path.name}: ")
    assert match in message
    assert "\n" not in message
    assert not (tmp_path / "results").exists()


def test_runs_are_listed_without_running(tmp_path: Path) -> None:
    listed = foten("sweep", experiment(tmp_path), "-o", tmp_path / "results", "--dry-run")[0]
    assert listed.splitlines()[0] == "FNN [13], linear-cloth, split 1"
    for name in ("no-such", "no/such"):
        assert "table-1-tuned" in foten("sweep", name, "-o", tmp_path / "results", status=2)[1]


def test_a_part_of_an_experiment_keeps_its_place_in_the_whole(tmp_path: Path) -> None:
    path = experiment(tmp_path)
    part = ["sweep", str(path), "-o", str(tmp_path / "results"), "--dry-run", "--only"]
    lines = foten(*part, "linear-twin", "--only", "FNN [13]")[0].splitlines()
    assert lines == [
        f"{run}, split 1" for run in ("FNN [13], linear-cloth", "FNN [13], linear-twin", "excited, linear-twin")
    ]
    plan, recordings = planned(read_experiment(path), tmp_path, ["excited, linear-twin"])
    assert [item.about["index"] for item in plan] == [3]
    assert len(recordings) == 1
    message = "--only 'towel' is in no line of --dry-run, such as 'FNN [13], linear-cloth, split 1'"
    assert message in foten(*part, "towel", status=2)[1]


def test_every_experiment_that_comes_with_foten_is_listed(tmp_path: Path) -> None:
    lines = dict(line.split(maxsplit=1) for line in foten("sweep", "--list")[0].splitlines())
    files = {path.stem: path for path in experiment_path("table-1").parent.glob("*.toml")}
    assert set(lines) == set(files)
    for name, path in files.items():
        for recording in tomllib.loads(path.read_text(encoding="utf-8"))["textures"]:
            if recording.endswith(".h5"):
                (tmp_path / recording).touch()
        assert read_experiment(path, tmp_path).title == lines[name]
    for lacking in (["sweep"], ["sweep", "table-2"]):
        assert "--list shows" in foten(*lacking, status=2)[1]


@pytest.fixture(scope="module")
def texture() -> Texture:
    texture = exported("foten-plus", FotenPlusSizes(order=20))
    metrics = {**texture.card["metrics"], "recorded_peak_sd": 4.0}
    return dataclasses.replace(texture, card={**texture.card, "metrics": metrics})


def test_a_texture_is_bounded_and_forgets(texture: Texture, monkeypatch: pytest.MonkeyPatch) -> None:
    paths: list[np.ndarray] = []
    watched = "foten_lab.stability.render_streams"
    monkeypatch.setattr(watched, lambda *of, **more: [paths.append(of[2]), render_streams(*of, **more)][1])
    figures = stability(texture, minutes=0.5, n_attack=12_000)
    ranges = [texture.trained_range(name) for name in ("speed", "force")]
    middle = (np.mean(ranges, axis=1) - texture.scaling.mean[1:]) / texture.scaling.sd[1:]
    np.testing.assert_allclose(paths[0][0, -1, :2], middle, rtol=1e-6)
    assert figures["n_samples"] == 30_000
    assert 1 < figures["max_sd"] < np.inf
    assert 0 < figures["attack_later_max_sd"] <= figures["attack_bound_sd"]
    assert 0 < figures["forgets_s"] < 12
    assert figures["attack_after_db"] < 0.5
    np.testing.assert_allclose(into(np.array([[1.0, 2.0, 3.0]]), 10.0, 20.0), [[10.0, 15.0, 20.0]])


def test_the_proven_bound_grows_with_the_level(texture: Texture) -> None:
    tensors = {**texture.tensors, "lattice.level.sigma_max": 2 * texture.tensors["lattice.level.sigma_max"]}
    assert proven(dataclasses.replace(texture, tensors=tensors)) == pytest.approx(2 * proven(texture))
    assert proven(exported("foten")) is None


def test_a_first_stroke_is_as_a_settled_one(texture: Texture) -> None:
    figures = onset(texture, n_strokes=12, n_streams=6)
    # 72 windows of 40 ms: what ten settled ones reach at most, and half as much again.
    for name in ("level_db", "spectrum_db"):
        for start in ("0_ms", "100_ms"):
            assert abs(figures[name][start]) < 1.5 * figures[name]["settled"] + 0.2
    excess = figures["click_share"] - figures["settled_share"]
    assert abs(excess) < 4 * figures["click_standard_error"]


@pytest.mark.parametrize("measures", [(), ("stability", "onset", "listener", "validation_listener")])
def test_what_a_file_names_is_measured(
    texture: Texture, monkeypatch: pytest.MonkeyPatch, measures: tuple[str, ...]
) -> None:
    """The listener by the evaluation, the others beside it."""
    recording = simulate("linear-hum", 4)
    judgement = Judgement({"recording_sha256": ""}, None, (), slice(None), {}, {})  # type: ignore[arg-type]
    called: list[str] = []
    monkeypatch.setattr("foten_lab.run.reference_for", lambda *_, listener: called.extend(["listener"] * listener))
    monkeypatch.setattr("foten_lab.run.evaluate", lambda *_, listener: called.append(str(listener)) or judgement)
    for name in ("stability.stability", "onset.onset", "run.validation_listener"):
        monkeypatch.setattr(f"foten_lab.{name}", lambda *_, name=name: name)
    run = next(iter(Experiment("t", ("linear-hum",), (Method("foten", measures=measures),)).runs()))
    texture = dataclasses.replace(texture, card={**texture.card, "training": {"versions": {}}})
    measured = _result(run, recording, texture, 0.0)["measures"]
    assert {name.split(".")[1] for name in measured.values()} == set(measured) == {*measures} - {"listener"}
    assert called == (["listener", "True"] if measures else ["False"])


def test_the_papers_figures_are_as_they_were_looked_at(tmp_path: Path) -> None:
    """Of made-up results of two methods on four textures; on the first, of 100 ms, one falls silent after half."""
    text = TINY.replace('"linear-twin"', '"linear-twin", "linear-hum", "towel"')
    results = []
    for k, run in enumerate(read_experiment(experiment(tmp_path, text)).runs()):
        t = np.arange(400 if k > 1 else 100)
        wave, decay, gain = (np.sin(t / (5 + k)), np.exp(-t[:40] / 10), np.where((t < 50) | (k > 0), 1.0, 1e-3))
        signals = {"recorded": wave, "free_run": gain * wave[::-1], "frequencies_hz": 10.0 * t[:40]}
        signals |= {"error_to_silence": 1 + k / 10 - decay, "level_db": -k * (1 - decay)}
        signals |= {"density": {"recorded": decay, "free_run": gain[-1] ** 2 * (1 + k) * decay[::-1]}}
        warm = {"ceiling": {"mae_scaled": 1.4}, "silence_mae_scaled": 1.0}
        evaluation = {"rate_hz": 1000.0, "free_run": {"lsd_db": 1.0}, "warm_start": warm}
        evaluation |= {"one_step": {"mae_scaled": 0.3 + 0.1 * k}}
        result = {"run": dataclasses.asdict(run), "evaluation": evaluation, "signals": signals}
        results.append(result | {"validation_mae_scaled": 0.4 + 0.05 * k})
    of_delta = copy.deepcopy(results)
    for result in of_delta:
        result["run"]["train"]["delta"] = 0.4
        result["evaluation"]["one_step"]["mae_scaled"] **= 2
    losses = {"huber": np.array([1.0, 1.1]), "mae": np.array([0.8, 1.2])}
    errors = {(name, loss, m): losses[loss] / m for name in "abcd" for loss in losses for m in (10, 20)}
    recorded = {"recording_sha256": recording_of(Run(**results[0]["run"])).sha256()}
    figures = {"split": split(results[0] | recorded), "thresholds": thresholds([*results, *of_delta])}
    figures |= {"windows": windows_and_losses(errors, {("b", 20): [0.03, 0.05]})}
    figures |= {draw.__name__: draw(results) for draw in (waveforms, convergence, spectra)}
    check_figures({f"experiment-{name}": figure for name, figure in figures.items()})
