"""The commands' contract, called as a user would."""

from __future__ import annotations

import dataclasses
import errno
import json
import pickle
from contextlib import AbstractContextManager, redirect_stderr, redirect_stdout
from importlib.metadata import EntryPoint
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.text import Text
from typer.main import get_command

from foten.atomic_write import atomic_write
from foten.cli import commands
from foten.cli.command_line import _status, app
from foten.cli.evaluate import network_summary, random_part_summary
from foten.cli.train import TrainOptions
from foten.console import JsonOption, options_from, print_result
from foten.datasets.hdf5 import load_recording, write_recording
from foten.models.foten_plus.config import WITHHELD
from foten.models.texture_file import read_texture, write_texture
from foten.models.trainable import TRAINABLE

FAST = ["--trim", "0", "--block", "500", "--epochs", "1", "--threads", "1", "--window", "12"]
TINY = [f"--set={size}" for size in ("n_hidden=6", "head_width=5", "n_components=2")]


def foten(*arguments: object, status: int = 0) -> tuple[str, str]:
    """What a command writes to stdout and to stderr."""
    with redirect_stdout(StringIO()) as out, redirect_stderr(StringIO()) as err:
        result = _status([str(argument) for argument in arguments])
    assert result == status, err.getvalue()
    return out.getvalue(), err.getvalue()


def test_options_keep_their_names_and_results_are_json(capsys: pytest.CaptureFixture[str]) -> None:
    @dataclasses.dataclass(frozen=True)
    class Shown:
        as_json: JsonOption = False

    assert options_from(Shown)(print).__annotations__ == {"as_json": JsonOption}
    print_result({"a": 1}, "", as_json=True)
    assert capsys.readouterr().out == '{\n "a": 1\n}\n'


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cli")


@pytest.fixture(scope="module")
def recording(folder: Path) -> Path:
    path = folder / "rec.h5"
    foten("simulate", "linear-twin", "--seconds", "8", "-o", path)
    return path


@pytest.fixture(scope="module")
def texture(folder: Path, recording: Path) -> Path:
    path = folder / "t.foten"
    foten("train", recording, "-o", path, *FAST, *TINY)
    return path


def refusal(*arguments: object) -> str:
    """The one line by which a command refuses; before it, nothing goes to stdout."""
    out, err = foten(*arguments, status=2)
    assert out == ""
    (line,) = (line for line in err.splitlines() if line.startswith("foten: "))
    return line


def test_train_writes_a_texture_and_a_run_folder(folder: Path, texture: Path) -> None:
    assert read_texture(texture).card["model"] == "foten-plus"
    run = folder / "t.run"
    assert {p.name for p in run.iterdir()} >= {"config.json", "log.csv", "split.json", "curves.png"}
    lines = (run / "log.csv").read_text().splitlines()
    assert [line.split(",")[0] for line in lines] == ["epoch", "0", "1"]
    split = json.loads((run / "split.json").read_text())
    assert split["sha256"] == read_texture(texture).card["split_sha256"]


def test_evaluate_prints_the_contracts_keys(texture: Path, recording: Path, tmp_path: Path) -> None:
    document = json.loads(foten("evaluate", texture, recording, "--json", "--report", tmp_path / "r")[0])
    assert (tmp_path / "r" / "report.html").exists()
    assert {"zero", "ar_best", "lattice", "bound", "bound_window"} <= set(document["references"])
    assert document["split"] == "regrouped"
    assert document["split_sha256"] == read_texture(texture).card["split_sha256"]
    assert document["seed"] == 0
    # The bound of the infinite past lies below that of a window, and no predictor below either but by chance.
    assert document["references"]["bound"]["mae_scaled"] < document["references"]["bound_window"]["mae_scaled"]
    assert document["references"]["ar"]["mae_scaled"] > 0.9 * document["references"]["bound"]["mae_scaled"]


def test_listeners_are_asked_where_they_are_asked_for(
    texture: Path, recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under a long stroke of a simulated truth, beside two true ones; here with next to no training and a short one."""
    monkeypatch.setattr("foten.evaluate.listener_network.N_STEPS", 2)
    monkeypatch.setattr("foten.cli.simulator_reference.LONG_S", 46.0)
    printed, said = foten("evaluate", texture, recording, "--json", "--listener")
    assert "listener 1 of 3" in said
    scores = json.loads(printed)["listener"]
    for key in ("listener_auc", "listener_auc_waveform", "listener_auc_person"):
        assert 0 <= scores[key] <= 1
        assert 0 <= scores[f"{key}_control"] <= 1
    assert scores["listener_control_of"] == "other realisations of the same stroke"
    assert 40 < scores["listener_s"] < 46
    assert "Listener" not in foten("evaluate", texture, recording)[0]


def test_a_foreign_recording_is_scored_on_all_of_its_blocks(texture: Path, folder: Path) -> None:
    other = folder / "other.h5"
    foten("simulate", "linear-twin", "--seconds", "4", "--seed", "5", "-o", other)
    document = json.loads(foten("evaluate", texture, other, "--json")[0])
    assert document["split"] == "foreign"
    assert document["split_sha256"] is None
    assert document["n_blocks"] == 7  # 4 s less the low-pass's delay, in blocks of 0.5 s
    assert document["references"]["ar"]["mae_scaled"] is None
    assert "references.ar" in document["reasons"]
    document = json.loads(foten("evaluate", texture, other, "--json", "--trim", "0", "--block", "600")[0])
    assert (document["n_blocks"], document["block"]) == (6, 600)


def test_ctrl_c_in_a_teacher_says_how_to_go_on(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """There is no texture before there is a student."""
    from foten.training.checkpoint import Checkpoint

    save, out = Checkpoint.save, tmp_path / "o.foten"

    def stopping(self: Checkpoint, *state: Any) -> None:
        save(self, *state)
        raise KeyboardInterrupt

    command = ["train", str(recording), "-o", str(out), "--model", "ldhtd", "--epochs", "1", "--threads", "1"]
    with monkeypatch.context() as patch:
        patch.setattr(Checkpoint, "save", stopping)
        assert "next: the same command with --resume" in foten(*command, status=130)[1]
    assert not out.exists()
    assert "next: foten evaluate" in foten(*command, "--resume")[0]


def test_ctrl_c_in_the_first_epoch_leaves_the_playable_file(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """While the network is validated for the first time: there is no best epoch to keep, and no run folder yet."""
    from foten.models.foten_plus import fit  # noqa: F401  (it takes the name: loaded later, it would keep the stand-in)

    def interrupted(*_: object) -> tuple[float, float]:
        raise KeyboardInterrupt

    monkeypatch.setattr("foten.models.foten_plus.network.scored", interrupted)
    out = tmp_path / "p.foten"
    shown = foten("train", recording, "-o", out, *FAST, *TINY, status=130)[1].splitlines()
    assert f"wrote {out}: playable already; training will replace it" in shown
    assert shown[-1] == "foten: interrupted"
    assert [path.name for path in tmp_path.iterdir()] == ["p.foten"]
    foten("render", out, "--speed", "100", "--force", "1", "--seconds", "0.2", "-o", tmp_path / "s.wav")
    early = "its training has not ended: this is an early texture"
    assert f"unfinished    {early}\n" in foten("info", out)[0]
    printed, shown = foten("evaluate", out, recording, "--report", tmp_path / "r")
    assert f"p.foten: {early}" in shown.splitlines()
    assert printed.startswith("Its training has not ended: ")
    assert "<p class=headline>Its training has not ended: " in (tmp_path / "r" / "report.html").read_text()


def test_a_finished_texture_says_nothing_of_its_training_and_one_trained_range(
    texture: Path, recording: Path, tmp_path: Path
) -> None:
    """One texture was for 0.07 to 330.4, 0–330 and 5 to 329 mm/s."""
    said = foten("info", texture)[0]
    low, high = read_texture(texture).trained_range("speed")
    words = f"{float(f'{round(low):.2g}'):g} to {float(f'{round(high):.2g}'):g} mm/s and "
    assert f"trained range {words}" in said
    assert "unfinished" not in said
    assert "not ended" not in "".join(foten("evaluate", texture, recording, "--report", tmp_path))
    assert f"<dt>trained range</dt><dd>{words}" in (tmp_path / "report.html").read_text()
    foten("export", texture, "-o", tmp_path / "t.h")
    assert f"Hz, for {words}" in (tmp_path / "t.h").read_text()


def test_a_disk_that_fills_up_while_training_costs_no_more_than_the_run_folder(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From the first checkpoint on nothing can be written into the run folder: a line each for checkpoint, log and the rest."""
    from foten.training import checkpoint
    from foten.training import run_folder as run

    def full(path: Path, *_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    def write(path: Path) -> AbstractContextManager[Path]:
        if path.name == "checkpoint.pt":
            monkeypatch.setattr(run, "_write_log", full)
            full(path)
        return atomic_write(path)

    monkeypatch.setattr(checkpoint, "atomic_write", write)
    out, folder = tmp_path / "d.foten", tmp_path / "d.run"
    said = foten("train", recording, "-o", out, *FAST, *TINY, "--epochs", "3")[1]
    shown = [line for line in said.splitlines() if "no space left" in line]
    why = "no space left on device; the training"
    assert shown == [
        f"{folder / 'log.csv'}: {why} continues without its log",
        f"{folder / 'checkpoint.pt'}: {why} went on without its checkpoint",
        f"{folder / 'log.csv'}: no space left on device; the run folder is not complete",
    ]
    assert read_texture(out).card["metrics"]["n_epochs"] == 3


def test_settings_change_the_network(recording: Path, texture: Path, tmp_path: Path) -> None:
    out = tmp_path / "p.foten"
    settings = ["d_model=8", "n_layers=1", "head=[16,8]", "bins=half"]
    its = ["--model", "foten", *(f"--set={setting}" for setting in settings)]
    foten("train", recording, "-o", out, *FAST, *its)
    sizes = read_texture(out).card["sizes"]
    assert (sizes["d_model"], sizes["head"], sizes["bins"]) == (8, [16, 8], "half")
    sizes = read_texture(texture).card["sizes"]
    assert (sizes["n_hidden"], sizes["head_width"], sizes["n_components"]) == (6, 5, 2)


def test_render_writes_each_output(texture: Path, tmp_path: Path) -> None:
    outputs = [tmp_path / f"o.{suffix}" for suffix in ("wav", "csv", "npz", "png")]
    constants = ["--speed", "100", "--force", "1", "--seconds", "0.5", "--audible", str(tmp_path / "a.wav")]
    foten("render", texture, *constants, *(word for path in outputs for word in ("-o", path)))
    assert {*tmp_path.iterdir()} == {*outputs, tmp_path / "a.wav"}


@pytest.mark.parametrize(
    ("mae_scaled", "share", "words"),
    [
        (0.95, 1.0, "improves one-step predictions by 5.0 %"),
        (0.95, 0.35, "improves one-step predictions by 5.0 %, with its mean scaled to 35 %"),
        (1.0, 0.0, "does not correct one-step predictions: no gain on the validation blocks exceeded chance"),
        (0.9999, 1.0, "does not improve one-step predictions"),
    ],
)
def test_what_the_network_is_for_is_said_plainly(texture: Path, mae_scaled: float, share: float, words: str) -> None:
    card = read_texture(texture).card
    metrics = {**card["metrics"], "validation_mae_scaled_lattice": 1.0, "validation_mae_scaled": mae_scaled}
    metrics["mean_share"] = share
    assert network_summary({**card, "metrics": metrics}) == words


def test_what_a_rendering_draws_from_is_said() -> None:
    def summary(recorded: bool, along_path: bool = False, **card: Any) -> str:
        sizes = {"recorded": recorded, "along_path": along_path}
        return random_part_summary(
            {"sizes": sizes, "rate_hz": 2500.0, "training": {"recorded_innovations": "auto"}, **card}
        )

    assert summary(False) == "Gaussian noise"
    assert summary(True) == "recorded innovations, as they were"
    assert "the speed of the hand" in summary(True, True)
    assert summary(False, microphone=True) == "Gaussian noise; " + WITHHELD
    assert summary(False, microphone=True, rate_hz=2000.0) == "Gaussian noise"
    assert summary(False, microphone=True, training={"recorded_innovations": "never"}) == "Gaussian noise"


def test_nothing_is_learned_from_a_recording_without_a_stroke_but_with_anyway(recording: Path, tmp_path: Path) -> None:
    """It was trained on with exit status 0, and without a word."""
    raw = load_recording(recording)
    slow = dataclasses.replace(raw["speed"], samples=raw["speed"].samples * 1e-3)
    path, table = tmp_path / "slow.h5", tmp_path / "slow.csv"
    write_recording(dataclasses.replace(raw, channels={**raw.channels, "speed": slow}), path)
    said = refusal("train", path, "-o", tmp_path / "t.foten", *FAST)
    assert "nothing sensible can be learned: speed never exceeds" in said
    assert not (tmp_path / "t.foten").exists()
    assert "record again: speed never exceeds" in foten("inspect", path, status=1)[0]
    table.write_text("t,acceleration,speed,force\n" + "".join(f"{i / 1000},{i % 7},80,0\n" for i in range(2000)))
    assert "force never exceeds 0 N" in foten("import", table, "-o", tmp_path / "a.h5", status=2)[1]
    assert not (tmp_path / "a.h5").exists()
    foten("import", table, "-o", tmp_path / "a.h5", "--anyway")
    table.write_text("t,acceleration,speed,force\n" + "".join(f"{i / 1000},{i % 7},-80,1\n" for i in range(2000)))
    assert "speed" in foten("import", table, "-o", tmp_path / "b.h5", status=2)[1]
    assert not (tmp_path / "b.h5").exists()


def test_every_training_says_the_problems_of_its_recording(recording: Path, tmp_path: Path) -> None:
    raw = load_recording(recording)
    grams = dataclasses.replace(raw["force"], samples=raw["force"].samples / 9.80665e-3)
    path = tmp_path / "grams.h5"
    write_recording(dataclasses.replace(raw, channels={**raw.channels, "force": grams}), path)
    for model in ("ar", "foten-plus"):
        options = ["--epochs", "0"] * (model != "ar")
        cut = ["--trim", "0", "--block", "500", "--force-units", "--anyway"]
        assert "problem: force" in foten("train", path, "-o", tmp_path / "t.foten", "--model", model, *cut, *options)[1]


def test_the_windows_in_the_help_are_those_of_the_models() -> None:
    text = TrainOptions.__dataclass_fields__["window"].default.show_default
    said = {key: int(n) for keys, _, n in (p.partition(": ") for p in text.split("; ")) for key in keys.split(", ")}
    assert said == {key: model.sizes().window for key, model in TRAINABLE.items() if key != "ar"}


def test_initial_weights_are_those_that_are_asked_for(recording: Path, tmp_path: Path) -> None:
    train = ["train", str(recording), "-o", str(tmp_path / "t.foten"), "--model", "foten", *FAST, "--epochs", "0"]
    weights = {}
    for given in ([], ["--initial-weights", "glorot"]):
        foten(*train, *given)
        texture = read_texture(tmp_path / "t.foten")
        assert texture.card["training"]["initial_weights"] == (given or ["", "uniform"])[1]
        weights[len(given)] = texture.tensors
    assert any((weights[0][name] != other).any() for name, other in weights[2].items() if name.endswith("weight"))
    assert "'he', expected one of" in foten(*train, "--initial-weights", "he", status=2)[1]


def test_credit_goes_from_the_command_to_every_conversion(recording: Path, tmp_path: Path) -> None:
    path, site = str(tmp_path / "t.foten"), tmp_path / "site"
    named = ["--author", "A. Maker", "--source", "Attic tapes", "--doi", "10.5555/12345", "--photo", "B. Lens */"]
    named += ["--licence", "CC-BY-4.0"]
    foten("train", recording, "-o", path, *FAST, "--epochs", "0", *named)
    line = "A. Maker, Attic tapes, doi 10.5555/12345, photo: B. Lens */, CC-BY-4.0"
    assert f"credit        {line}" in foten("info", path)[0]
    constants = ["--speed", "80", "--force", "1", "--seconds", "0.3"]
    for name in ("clip.wav", "clip.ahap", "clip.haptic", "clip.hjif", "clip.json", "texture.h"):
        foten("export", path, *(() if name.endswith(".h") else constants), "-o", tmp_path / name)
        assert "A. Maker" in (tmp_path / name).read_bytes().decode("latin-1"), name
    assert (tmp_path / "texture.h").read_text().split("#ifndef")[0].count("*/") == 1  # that a name cannot end
    foten("export", path, "--to", "web", "-o", site)
    assert read_texture(site / "textures" / "t.foten").credit == line
    texture = read_texture(Path(path))
    with pytest.raises(ValueError, match="'authors' in the card is"):
        write_texture(dataclasses.replace(texture, card={**texture.card, "authors": ["A"]}), tmp_path / "bad.foten")


def test_render_says_what_became_of_samples_outside_the_range(texture: Path, tmp_path: Path) -> None:
    """A range that begins at almost nothing fades below 2 mm/s all the same; what follows a law fades only near rest."""
    texture_ = read_texture(texture)
    held, path = tmp_path / "held.foten", str(tmp_path / "o.csv")
    entries = {"trained_range": {"speed": [0.0026, 150.0], "force": [0.3, 1.5]}}
    entries["extrapolation_exponents"] = {"speed": 0.0, "force": 0.0}
    write_texture(dataclasses.replace(texture_, card={**texture_.card, **entries}), held)
    for speed, messages in (
        (
            "1",
            "speed was below 2 mm/s or force below 0.3 N for 100.0 % of the time; the vibration fades there, to silence at rest",
        ),
        ("200", "speed was above the trained 150 mm/s for 100.0 % of the time; the level was held there"),
    ):
        constants = ["--speed", speed, "--force", "1", "--seconds", "0.2"]
        assert foten("render", held, *constants, "-o", path)[0].splitlines()[2:] == [messages]
    assert "renderings fade below 2 mm/s or 0.3 N" in foten("info", held)[0]
    card = {**texture_.card, **entries, "extrapolation_exponents": {"speed": 0.0, "force": 0.5}}
    write_texture(dataclasses.replace(texture_, card=card), held)
    said = foten("render", held, "--speed", "100", "--force", "0.2", "--seconds", "0.2", "-o", path)[0]
    assert said.splitlines()[2:] == [
        "speed was below 2 mm/s or force below 0.3 N for 100.0 % of the time; the level falls there, and fades "
        "below 2 mm/s or 0.1 N, to silence at rest"
    ]


TRAIN = ("train", "{rec}", "-o", "{out}.foten", *FAST)
FOTEN = (*TRAIN, "--model", "foten")
SEEDS = ("--noise-seed", "1", "--stroke-seed", "2", "--seed", "3")
RENDER = ("render", "{tex}", "-o", "{out}.wav", "--speed", "1", "--force", "1")


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (
            ["train", "{rec}", "-o", "{out}.foten", "--trim", "2000", "--block", "2000"],
            "--rate 1000 --trim 0 --block 500",
        ),
        ([*TRAIN, "--rate", "5000"], "never upsampled"),
        ([*TRAIN, "--model", "fotan"], "expected one of foten-plus, foten, ten"),
        ([*TRAIN, "--recipe", "mine"], "expected one of default, paper"),
        (["train", "{rec}", "-o", "{out}.pt"], "written as .foten"),
        (["train", "{rec}", "-o", "{out}/t.foten"], "there is no folder"),
        (["train", "{missing}", "-o", "{out}.foten"], "no such file"),
        ([*TRAIN, "--resume"], "nothing to resume"),
        ([*TRAIN, "--set", "bogus=1"], "has no size 'bogus'"),
        ([*TRAIN, "--trim", "nan"], "trim_ms is nan"),
        ([*FOTEN, "--loss", "mae", "--delta", "1"], "delta is the threshold of the huber loss, and the loss is mae"),
        ([*FOTEN, "--set", "excitation_width=8"], "excitation_width is for an excitation, and there is none"),
        ([*FOTEN, "--set", "n_hidden=8"], "foten has no size 'n_hidden'"),
        ([*TRAIN, "--window", "101"], "five times as long"),
        ([*TRAIN, "--window", "100000"], "window is 100000, expected 512 at most"),
        ([*TRAIN, "--window", "9" * 400], "expected 512 at most"),
        ([*TRAIN, "--seed", "-1"], "greater than or equal to 0"),
        ([*TRAIN, "--rate", "700.5"], "ask for 1000 Hz"),
        (["train", "{rec}"], "Missing option"),
        (["render", "{tex}", "-o", "{out}.mp3"], "expected .wav"),
        (["render", "{tex}", "-o", "{out}.wav"], "expected one of --stroke, --recording, or --speed"),
        (["render", "{tex}", "-o", "{out}.wav", "--speed", "1"], "--speed with --force and --seconds"),
        ([*RENDER, "--seconds", "nan"], "expected a finite number"),
        ([*RENDER, "--seconds", "1e9"], "at most 3600"),
        ([*RENDER, "--stroke", "{stroke}"], "expected one of --stroke"),
        (["render", "{tex}", "-o", "{out}.wav", "--stroke", "{stroke}"], "speed and force of a stroke are magnitudes"),
        ([*RENDER, "--seconds", "1", "--pressure", "1,2"], "--pressure is for the columns of --stroke"),
        (["play", "{tex}", "--to", "null", "--pressure", "1,2"], "--pressure is for the columns of --stroke"),
        (["play", "{tex}", "--to", "null", "--stroke", "{stroke}", "--pressure", "1"], "--pressure is '1', expected"),
        ([*RENDER, "--seconds", "1", "--audible", "{out}.wav"], "two outputs have the same name"),
        ([*RENDER, "--seconds", "1", "--audible", "{out}.mp3"], "sound is written as .wav"),
        ([*RENDER, "--seconds", "1", "-o", "{out}/x.csv"], "there is no folder"),
        (["render", "{pickle}", *RENDER[2:], "--seconds", "1"], "pickle"),
        (["info", "{rec}"], "this is HDF5, as recordings are, expected a texture file"),
        (["info", "{missing}"], "no such file"),
        (["simulate", "towel", "-o", "{out}.csv"], "written as .h5"),
        (["simulate", "towel", "-o", "{out}/x.h5"], "there is no folder"),
        (["evaluate", "{tex}", "{rec}", "--trim", "0"], "--trim and --block are for others"),
        (["evaluate", "{tex}", "{tex}"], "foten import"),
        (["evaluate", "{tex}", "{missing}", "--report", "{tex}"], "is a file, expected a folder"),
        (["nonsense"], "No such command"),
        ([*TRAIN, "--split", "contiguous", "--split-seed", "3"], "--split-seed is for the regrouped split"),
        ([*TRAIN, "--model", "ar", "--epochs", "0"], "--epochs is for networks"),
        ([*RENDER, "--seconds", "1", "--deterministic", "--seed", "3"], "--seed sets the excitation"),
        ([*TRAIN, "--doi", "https://doi.org/10.1/x"], "expected 10.NUMBER/NAME, without https"),
        (["simulate", "towel", "-o", "{out}", "--capture", "--stroke-seed", "0"], "--stroke-seed is for recordings"),
        (["simulate", "towel", "-o", "{out}.h5", *SEEDS], "--seed has no effect beside --noise-seed"),
        (["import", "{stroke}", "-o", "{out}.h5", "--pressure", "1,2"], "--pressure is for use with --pen"),
        (["import", "{stroke}", "-o", "{out}.h5", "--normal", "up"], "--normal is 'up', expected x,y,z"),
        (["export", "{tex}", "--to", "c", "--seed", "3", "-o", "{out}.h"], "c holds the texture itself"),
        (["tables", "{out}", "--digits", "3"], "--digits is for runs.csv"),
        (["study", "power", "{out}.toml", "--methods", "3"], "--methods is in the study file"),
    ],
)
def test_bad_input_is_one_line_and_writes_nothing(
    arguments: list[str], match: str, texture: Path, recording: Path, tmp_path: Path
) -> None:
    (tmp_path / "p.foten").write_bytes(pickle.dumps({"a": 1}))
    (tmp_path / "s.csv").write_text("t,speed,force\n0,1,1\n1,-3,1\n")
    before = set(tmp_path.iterdir())
    names = {
        "rec": recording,
        "tex": texture,
        "out": tmp_path / "out",
        "missing": tmp_path / "missing.h5",
        "pickle": tmp_path / "p.foten",
        "stroke": tmp_path / "s.csv",
    }
    assert match in refusal(*(word.format(**names) for word in arguments))
    assert set(tmp_path.iterdir()) == before


def test_a_stroke_of_any_table_is_rendered_and_doubts_are_said(texture: Path, tmp_path: Path) -> None:
    """Semicolons, decimal commas and units give the bytes of the plain table; a size of another unit is said, once."""
    tables = {
        "a": "t,speed,force\n0,50,1\n0.5,80.5,1\n",
        "b": "t [ms];speed [m/s];force\n0;0,05;1\n500;0,0805;1\n# Ende\n",
        "c": "t,speed,force\n0,0.05,1\n0.5,0.0805,1\n",
    }
    messages = {}
    for name, text in tables.items():
        (tmp_path / f"{name}.txt").write_text(text)
        arguments = ["render", str(texture), "--stroke", str(tmp_path / f"{name}.txt")]
        messages[name] = foten(*arguments, "-o", tmp_path / f"{name}.csv")[1]
    doubt = "speed peaks at 0.0805, expected mm/s up to about 350; was it given in m/s? It is taken as mm/s\n"
    assert messages == {"a": "", "b": "", "c": doubt}
    outputs = [argument for suffix in ("csv", "npz") for argument in ("-o", str(tmp_path / f"c.{suffix}"))]
    foten(*arguments, "--unit", "speed=m/s", *outputs)
    assert json.loads(str(np.load(tmp_path / "c.npz")["about"]))["stroke"] == "c.txt, unit speed=m/s"
    a, b, c = (np.loadtxt(tmp_path / f"{name}.csv", delimiter=",", skiprows=1) for name in "abc")
    np.testing.assert_allclose(b, a, rtol=1e-4)  # m/s times 1000 is mm/s but for rounding, which the loop carries on
    np.testing.assert_allclose(c, a, rtol=1e-4)
    foten("render", texture, "--speed", "80", "--unit", "speed=m/s", "-o", tmp_path / "d.csv", status=2)
    for command, output in (("render", "-o"), ("play", "--to")):
        constants = ["--speed", "0.08", "--force", "1", "--seconds", "0.2"]
        said = foten(command, texture, *constants, output, tmp_path / "e.wav")[1]
        assert said.startswith("speed peaks at 0.08, expected mm/s")


def test_a_rendering_says_how_far_it_is_and_ends_with_ctrl_c(
    texture: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from foten.runtime.renderer import Renderer

    arguments = ["render", str(texture), "--speed", "80", "--force", "1", "--seconds", "2.5"]
    foten(*arguments, "-o", tmp_path / "a.wav")
    monkeypatch.setattr("foten.cli.render.SAY_EVERY_S", 0.0)
    said = foten(*arguments, "-o", tmp_path / "b.wav")[1].splitlines()
    assert said == [f"rendered {second} of 2 s" for second in range(3)]
    assert (tmp_path / "a.wav").read_bytes() == (tmp_path / "b.wav").read_bytes()
    render = Renderer.render

    def interrupted(renderer: Renderer, speed: Any, force: Any) -> Any:
        if renderer.stats.n >= 1000:
            raise KeyboardInterrupt
        return render(renderer, speed, force)

    monkeypatch.setattr(Renderer, "render", interrupted)
    foten(*arguments, "-o", tmp_path / "c.wav", "-o", tmp_path / "c.csv", status=130)
    assert {path.name for path in tmp_path.iterdir()} == {"a.wav", "b.wav"}


def test_a_rendered_table_is_imported_with_its_units(texture: Path, tmp_path: Path) -> None:
    table, back = tmp_path / "s.csv", tmp_path / "s.h5"
    foten("render", texture, "--speed", "80", "--force", "1", "--seconds", "1", "-o", table)
    assert "no unit" not in foten("import", table, "-o", back)[1]
    recording = load_recording(back)
    assert {name: channel.rate_hz for name, channel in recording.channels.items()} == {
        name: 1000 for name in ("acceleration", "speed", "force")
    }
    written = np.loadtxt(table, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(recording["acceleration"].samples, written[:, 1])
    before = back.read_bytes()
    (tmp_path / "same.h5").symlink_to(back)
    said = refusal("import", back, "-o", tmp_path / "same.h5")
    assert "same.h5 is a file to import, which it would replace: give another name" in said
    assert back.read_bytes() == before
    np.testing.assert_allclose(recording["speed"].samples, 80, rtol=1e-6)
    np.testing.assert_allclose(recording["force"].samples, 1, rtol=1e-6)


def test_help_is_printed_as_it_is_written() -> None:
    """Rich takes a word in square brackets for a style and drops it: a default in words is `show_default`."""
    for name, command in get_command(app).commands.items():  # type: ignore[attr-defined]
        for text in (command.help, *(parameter.help for parameter in command.params)):
            assert Text.from_markup(text).plain == text, name
        foten(name, "--help")


def test_commands_of_other_packages_are_found_by_their_entry_points(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(commands, "others", dict)
    line = "foten: study is in the package foten-study: pip install './packages/foten' './packages/foten-study'"
    assert refusal("study", "new", "x.toml") == line
    assert "study" not in foten("--help")[0]
    found = [
        EntryPoint(name, "foten.cli.machine:doctor", commands.GROUP) for name in ("study", "imagine words", "more")
    ]
    monkeypatch.setattr(commands, "others", lambda: {entry.name: entry for entry in found})
    monkeypatch.setattr(commands, "COMMANDS", {"info": commands.COMMANDS["info"]})
    assert "-I" in foten("study", "--c-flags")[0]
    listed = foten("--help")[0]
    assert " more " in listed
    assert "imagine" not in listed
    assert "No such command 'imagine words'" in refusal("imagine words")


def test_the_demo_makes_everything_it_names(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    paths = json.loads(foten("demo", "-o", folder, "--seconds", "16", "--epochs", "1", "--json")[0])
    assert set(paths) == {"recording", "texture", "report", "vibration", "picture", "sound", "pictures"}
    for path in paths.values():
        assert Path(path).exists()
    figures = json.loads((folder / "report" / "evaluation.json").read_text())
    assert figures["one_step"]["mae_scaled"] < figures["references"]["zero"]["mae_scaled"]
    assert figures["free_run"]["lsd_db"] < figures["free_run_deterministic"]["lsd_db"]
