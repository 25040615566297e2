"""`foten play`, `bench` and `doctor`, called as a user would."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import exported
from foten.cli.command_line import _status
from foten.runtime import bench
from foten.runtime.actuator import ActuatorProfile, write_profile
from foten.runtime.live import play as playing
from foten.runtime.live.live import LiveStatistics
from foten.runtime.live.play import Played
from foten.runtime.renderer import Renderer
from test_cli import foten


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("live") / "t.foten"
    path.write_bytes(exported("foten-plus").to_bytes())
    return path


def only_line(*arguments: object) -> str:
    """The line of a command that is refused."""
    out, err = foten(*arguments, status=2)
    assert out == ""
    (line,) = err.splitlines()
    assert line.startswith("foten: ")
    return line


def test_play_counts_and_says_what_lies_between(file: Path) -> None:
    result = json.loads(foten("play", file, "--to", "null", "--seconds", "0.3", "--lead-ms", "50", "--json")[0])
    assert result["n_samples"] >= 0.3 * 8000  # 8 kHz of a texture of 1 kHz
    assert result["n_refused"] == result["n_saturated"] == 0
    assert result["delays_ms"]["rendered ahead"] == 50
    assert 0 < result["block_p50_ms"] <= result["block_p99_ms"] <= result["block_largest_ms"]
    assert result["block_ms"] == 2
    out, err = foten("play", file, "--to", "null", "--seconds", "0.1")
    assert "p50" in out
    assert "10.0 ms rendered ahead" in out
    assert "Ctrl-C" in err


def wav(path: Path) -> tuple[np.ndarray, dict[str, Any]]:
    """A WAV's float samples, and its comment."""
    data = path.read_bytes()
    at = data.index(b"data") + 8
    comment = data[data.index(b"ICMT") + 8 :].split(b"\0")[0]
    return np.frombuffer(data[at : at + int.from_bytes(data[at - 4 : at], "little")], dtype="<f4"), json.loads(comment)


def test_play_and_render_make_the_same_of_a_stroke(file: Path, tmp_path: Path) -> None:
    stroke = tmp_path / "s.csv"
    stroke.write_text("t,speed,force\n" + "".join(f"{0.01 * k},{0 if k < 50 else 90},{0.8}\n" for k in range(100)))
    both = [str(file), "--stroke", str(stroke), "--seed", "5"]
    played, rendered = tmp_path / "played.wav", tmp_path / "rendered.wav"
    foten("play", *both, "--to", played, "--seconds", "0.99", "--rate", "1000")
    foten("render", *both, "-o", rendered)
    (one, about), (other, expected) = wav(played), wav(rendered)
    np.testing.assert_array_equal(one, other)
    assert about == expected
    assert {"foten", "texture_sha256", "stroke", "seed"} <= about.keys()


def test_a_file_says_what_its_numbers_are(file: Path, tmp_path: Path) -> None:
    path, coil = tmp_path / "drive.wav", tmp_path / "coil.json"
    profile = ActuatorProfile("coil", resonance_hz=70.0, gain=2.0, unit="A")
    write_profile(profile, coil)
    foten("play", file, "--to", path, "--seconds", "0.1", "--actuator", coil)
    about = wav(path)[1]
    assert about["unit"] == "A"
    assert ActuatorProfile(**about["actuator"]) == profile


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        (["--to", "loudspeaker"], "expected sound, null"),
        (["--to", "null", "--speed", "80"], "--speed with --force"),
        (["--to", "null", "--speed", "-1", "--force", "1"], "speed"),
        (["--to", "a.wav", "--seconds", "inf"], "--seconds is inf"),
        (["--to", "a.wav", "--lead-ms", "5"], "--lead-ms is for live output"),
        (["--to", "none/a.wav"], "there is no folder none"),
    ],
)
def test_what_cannot_be_played_is_one_line(file: Path, arguments: list[str], expected: str) -> None:
    assert expected in only_line("play", file, "--seconds", "0.1", *arguments)


def test_without_the_package_it_names_the_extra(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    extra = re.search(r"foten\[(\w+)\]", only_line("play", file, "--seconds", "0.1"))
    project = tomllib.loads((Path(__file__).parents[1] / "packages/foten/pyproject.toml").read_text())["project"]
    assert extra is not None
    assert extra[1] in project["optional-dependencies"]


def test_ctrl_c_ends_it_and_prints_the_counts(file: Path) -> None:
    program = "import sys; from foten.cli import main; sys.exit(main())"
    child = subprocess.Popen(
        [sys.executable, "-c", program, "play", str(file), "--to", "null"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell ignores it for what it starts in the background, and what is ignored stays so.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    assert child.stderr is not None
    assert "Ctrl-C stops it" in child.stderr.readline()
    child.send_signal(signal.SIGINT)
    out, _ = child.communicate(timeout=30)
    assert child.returncode == 130
    assert "under-runs" in out


def test_what_went_wrong_is_printed_with_what_helps(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counted = Renderer(file).counted() | {"n": 800, "n_refused": 3, "n_lost": 4}
    statistics = LiveStatistics(n_underruns=5, n_lacking=60)

    def played(*_: Any) -> Played:
        return Played(statistics, {}, counted, n_cut=0, n_device_underruns=7, n_late=8, interrupted=False)

    monkeypatch.setattr(playing, "play", played)
    out, err = foten("play", file, "--to", "null", "--lead-ms", "20")
    ring, card, late = out.splitlines()[-3:]
    assert "ran empty 5 times, 60 samples of silence; a longer --lead-ms than 20" in ring
    assert "too late 7 times" in card
    assert "--lead-ms" not in card
    assert "8 blocks" in late
    assert "not a number 3 times" in err
    assert "in place of 4 samples" in err


def test_bench_times_each_instruction_set(file: Path) -> None:
    result = json.loads(foten("bench", file, "-n", "1000", "--json")[0])
    assert result[-1]["isa"] == "portable"
    assert all(0 < one["p50_us"] <= one["p99_us"] <= one["largest_us"] for one in result)
    out = foten("bench", file, "-n", "1000")[0]
    assert "contacts a core" in out
    assert "portable" in out


def test_bench_times_no_instruction_set_in_the_place_of_another(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What this processor has not was timed in full with what it has."""
    programs = []

    def run(command: list[str], **options: Any) -> Any:
        programs.append(usual(command, **options))
        return programs[-1]

    usual = subprocess.run
    monkeypatch.setattr(bench.subprocess, "run", run)
    result = [times.isa for times in bench.time_all(file, 1000)]
    assert len(programs) == len(bench.INSTRUCTION_SETS) > len(result) > 0
    assert [one for one in bench.INSTRUCTION_SETS if one in result] == result
    assert sum(bool(done.stdout) for done in programs) == len(result)


def test_a_program_that_ends_gives_one_line(file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    errors = {-signal.SIGSEGV: "", 3: "", 1: "Traceback\n  x\nValueError: no more"}
    ended = [subprocess.CompletedProcess("foten", status, "", error) for status, error in errors.items()]
    signalled, *others = map(bench.reason, ended)
    assert "Segmentation fault" in signalled
    assert others == ["ended with status 3", "no more"]
    monkeypatch.setattr(bench.subprocess, "run", lambda *_, **__: ended[-1])
    assert only_line("bench", file).endswith(": no more")
    assert "no more" in foten("doctor", status=1)[0]


def test_doctor_says_what_is_here(capsys: pytest.CaptureFixture[str]) -> None:
    """Its exit status is of this machine: 0, or 1 where something is missing or slow."""
    assert _status(["doctor", "--json"]) in (0, 1)
    result = {check["name"]: check for check in json.loads(capsys.readouterr().out)}
    assert result["kernel"]["fine"] is True
    assert "instruction set" in result["kernel"]["result"]
    assert {"first sample", "timer", "sound", "NI-DAQ", "training"} <= set(result)


def test_an_example_is_there_to_be_played(tmp_path: Path) -> None:
    assert "e.wav, 0.2 s at 8000 Hz" in foten("play", "--to", tmp_path / "e.wav", "--seconds", "0.2")[0]
    assert (tmp_path / "e.wav").stat().st_size > 1000
