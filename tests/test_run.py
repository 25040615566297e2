"""The run folder and the display of a training."""

from __future__ import annotations

import errno
import json
import math
from pathlib import Path

import pytest

from foten.training.loop import Epoch
from foten.training.run_folder import RunFolder, TrainingDisplay


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
