"""The demo goes through everything."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from foten.cli.command_line import _status


def test_the_demo_makes_everything_it_names(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "demo"
    assert _status(["demo", "-o", str(folder), "--seconds", "24", "--epochs", "1", "--json"]) == 0
    paths = json.loads(capsys.readouterr().out)
    assert set(paths) == {"recording", "texture", "report", "vibration", "picture", "sound", "pictures"}
    for path in paths.values():
        assert Path(path).exists()
    figures = json.loads((folder / "report" / "evaluation.json").read_text())
    assert figures["one_step"]["mae_scaled"] < figures["references"]["zero"]["mae_scaled"]
    assert figures["free_run"]["lsd_db"] < figures["free_run_deterministic"]["lsd_db"]
