"""The run folder, the display and the settings of a training: the paper's recipe is the paper's, nonsense is refused."""

from __future__ import annotations

import errno
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from matplotlib.figure import Figure

from conftest import check_figures
from foten.models.foten.sizes import FotenSizes
from foten.models.trainable import check_used, recipe_of
from foten.training.checkpoint import Epoch
from foten.training.config import WindowConfig
from foten.training.run_folder import RunFolder, TrainingDisplay, _draw_curves


def epoch(number: int) -> Epoch:
    return Epoch(number, math.nan if number == 0 else 0.5, 1.0, 1.0, 0.1, best=number == 0)


def test_nothing_is_written_before_the_first_line(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "a.run")
    folder.open({"x": 1}, resume=False)
    assert not folder.path.exists()
    folder.log(epoch(0))
    assert json.loads((folder.path / "config.json").read_text()) == {"x": 1}
    with pytest.raises(ValueError, match="nothing to resume"):
        RunFolder(folder.path).open({"x": 1}, resume=True)
    folder.checkpoint.write_bytes(b"")
    with pytest.raises(ValueError, match="continue with --resume, or delete"):
        RunFolder(folder.path).open({"x": 1}, resume=False)
    with pytest.raises(ValueError, match="other settings"):
        RunFolder(folder.path).open({"x": 2}, resume=True)
    with pytest.raises(ValueError, match="is a file"):
        RunFolder(folder.checkpoint).open({"x": 1}, resume=False)


def test_a_disk_that_fills_up_costs_the_log_and_not_the_training(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first line is refused, when nothing is lost; of the later ones one note is made."""

    def full(path: Path, epochs: list[Epoch]) -> None:
        raise OSError(errno.ENOSPC, "No space left on device", str(path))

    notes: list[str] = []
    folder, refused = (RunFolder(tmp_path / name, notes.append) for name in ("a.run", "b.run"))
    folder.open({}, resume=False)
    folder.log(epoch(0))
    before = (folder.path / "log.csv").read_text()
    monkeypatch.setattr("foten.training.run_folder._write_log", full)
    folder.log(epoch(1))
    folder.log(epoch(2))
    assert notes == [f"{folder.path / 'log.csv'}: no space left on device; the training continues without its log"]
    assert (folder.path / "log.csv").read_text() == before
    with pytest.raises(OSError, match="No space left"):
        refused.log(epoch(0))


def test_a_teacher_is_in_the_log_until_its_student_begins(tmp_path: Path) -> None:
    folder, display = RunFolder(tmp_path / "a.run"), TrainingDisplay(2)
    folder.open({}, resume=False)
    shown = []
    for stage in ("training the teacher, hapinf", "training the student, ldhtd"):
        display.stage(stage)
        for number in range(2):
            folder.log(epoch(number))
            display.show(epoch(number))
        shown.append(display._bar.tasks[0].description)
        assert len((folder.path / "log.csv").read_text().splitlines()) == 3
    assert shown == ["training the teacher, hapinf", "training the student, ldhtd"]
    display.stage("fitting the excitation")
    display.show(epoch(1))
    assert display._bar.tasks[0].description == "training the network"


def test_the_curves_are_as_they_were_looked_at(tmp_path: Path) -> None:
    """On a logarithmic axis where the loss falls to less than a third; of spectra, without a linear part, on a linear one."""
    drawn: list[Any] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Figure, "savefig", lambda figure, part, **options: drawn.append(figure) or part.touch())
        for ratio, mae in ((0.5, 0.4), (0.9, None)):
            epochs = [Epoch(k, ratio**k, 1.1 * ratio**k, 0.5 * ratio**k, 0.1, best=True) for k in range(5)]
            texture, progress = SimpleNamespace(predicts_samples=bool(mae)), SimpleNamespace(epochs=epochs)
            trained: Any = SimpleNamespace(progress=progress, texture=texture, linear_mae=mae)
            _draw_curves(tmp_path / "curves.png", trained)
    check_figures(dict(zip(("curves", "curves-of-spectra"), drawn, strict=True)))


def test_what_is_not_a_terminal_sees_a_line_for_each_stage_and_epoch(capsys: pytest.CaptureFixture[str]) -> None:
    with TrainingDisplay(2) as display:
        display.stage("fitting level and lattice")
        for number in range(3):
            display.show(epoch(number))
        display.note("a note that is longer than any terminal is wide, " * 5)
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == ""
    assert len(lines) == 5
    assert lines[0] == "fitting level and lattice …"
    assert lines[1].startswith("epoch   0/2 ")
    assert lines[1].endswith("error 1.0000 sd    0.1 s  best")


def test_the_papers_recipe_is_the_papers() -> None:
    paper = recipe_of("foten", "paper")
    assert isinstance(paper, WindowConfig)
    assert (paper.epochs, paper.patience, paper.batch, paper.learning_rate) == (100, 10, 16, 1e-3)
    assert (paper.loss, paper.delta, paper.schedule) == ("huber", 1.6, "constant")
    assert (paper.weight_decay, paper.clip_norm, paper.dropout) == (0.0, 0.0, 0.2)
    assert (paper.initial_weights, paper.adam_epsilon) == ("glorot", 1e-7)  # Keras' defaults
    assert paper.trial_epochs > paper.epochs  # none
    named = {"window": 20, "d_model": 32, "n_heads": 4, "n_layers": 3, "d_feedforward": 128, "head": (256, 64)}
    assert FotenSizes() == FotenSizes(**named)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"loss": "l2"}, "expected one of huber, mse, mae"),
        ({"schedule": "step"}, "one_cycle"),
        ({"optimiser": "sgd"}, "expected one of muon, adamw"),
        ({"initial_weights": "he"}, "expected one of uniform, glorot"),
        ({"adam_epsilon": 0.0}, "adam_epsilon is 0.0, expected more than 0"),
        ({"batch": 0}, "batch is 0"),
        ({"epochs": -1}, "epochs is -1"),
        ({"dropout": 1.0}, "dropout is 1.0"),
        ({"learning_rate": 0.0}, "learning_rate is 0.0, expected more than 0"),
        ({"batch": 2.5}, "batch is 2.5, expected a whole number"),
        ({"epochs": True}, "epochs is True, expected a whole number"),
        ({"seed": "1"}, "seed is '1', expected a whole number"),
        ({"tones": "no"}, "tones is 'no', expected true or false"),
        ({"delta": float("inf")}, "delta is inf, expected a finite number"),
    ],
)
def test_what_cannot_be_is_refused(change: dict[str, object], match: str) -> None:
    model = "foten-plus" if "tones" in change else "foten"
    with pytest.raises(ValueError, match=match):
        recipe_of(model, **change)


@pytest.mark.parametrize("model", ["foten-plus", "gan"])
def test_the_papers_recipe_is_refused_where_nothing_of_it_would_be_left(model: str) -> None:
    with pytest.raises(ValueError, match=f"of networks that are trained on windows, and {model} is not"):
        recipe_of(model, "paper")
    assert recipe_of("dstn", "paper").batch == 16


def test_settings_that_mean_nothing_to_a_model_are_refused() -> None:
    check_used("foten", ["loss", "dropout"])
    check_used("gan", ["epochs", "batch", "learning_rate"])
    with pytest.raises(ValueError, match="delta is the threshold of the huber loss, and the loss is mae"):
        check_used("foten", ["delta"], "mae")
    check_used("foten", ["delta"], "huber")
    with pytest.raises(ValueError, match="clip-norm means nothing to gan"):
        check_used("gan", ["epochs", "clip_norm"])
    with pytest.raises(ValueError, match="max-order means nothing to foten"):
        check_used("foten", ["max_order"])
    with pytest.raises(ValueError, match="dropout means nothing to ar"):
        recipe_of("ar", dropout=0.1)
