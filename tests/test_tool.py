"""Another tool: a known filter is found, and a texture gets exactly it; two simulated tools on other surfaces."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from foten.cli.command_line import _status
from foten.dsp.distance import welch
from foten.dsp.speed_force_table import log_force
from foten.editing.describe import rendered
from foten.editing.edit import knots_of
from foten.editing.tool import Transfer, fitted_transfer, read_transfer, transferred, write_transfer
from foten.models.texture_file import Texture, read_texture
from foten.recording.trace import Trace
from foten.runtime.renderer import EXAMPLE, Renderer

FOLDER = EXAMPLE.parent
HZ = tuple(20.0 * 2 ** (np.arange(28) / 6))
TILT = Transfer("a", "b", HZ, tuple(np.linspace(6.0, -12.0, 28).tolist()), (0.5,) * 28, 100.0, 0.7)


def noise(seconds: float, seed: int, gain: float = 1.0, power: float = 0.0) -> Trace:
    """White noise under a hand that varies speed and force, as loud as gain · v^power."""
    n = round(1000 * seconds)
    t = np.arange(n) / 1000
    speed, force = 100 * 1.8 ** np.sin(0.5 * t), 1.0 * 1.8 ** np.sin(1.1 * t)
    x = np.random.default_rng(seed).standard_normal(n)
    return Trace(gain * (speed / 100) ** power * x, speed, force, 1000.0, 2000)


def test_a_known_filter_and_power_are_found() -> None:
    first = noise(120.0, 1)
    second = noise(120.0, 2, power=0.3)
    b, a = [0.5, 0.5], [1.0]  # |H|² = cos²(πf/1000)
    second = replace(second, acceleration=lfilter(b, a, second.acceleration))
    transfer = fitted_transfer([first], [second], ("pen a", "pen b"))
    expected = 20 * np.log10(np.cos(np.pi * np.array(transfer.hz) / 1000))
    assert (np.abs(np.array(transfer.gain_db) - expected)[np.array(transfer.hz) < 400] < 0.8).all()
    assert transfer.speed_exponent == pytest.approx(0.3, abs=0.08)
    assert transfer.force_exponent == pytest.approx(0.0, abs=0.08)
    within = np.abs(np.array(transfer.gain_db) - expected) < 3 * np.array(transfer.gain_sd_db) + 0.1
    assert within.mean() > 0.9  # it says how well it is known
    assert (transfer.first, transfer.second) == ("pen a", "pen b")


def test_the_same_tool_is_no_filter() -> None:
    transfer = fitted_transfer([noise(120.0, 1)], [noise(120.0, 2)])
    assert np.abs(transfer.gain_db).max() < 1.0
    assert max(abs(transfer.speed_exponent), abs(transfer.force_exponent)) < 0.08


@pytest.mark.parametrize("name", ["towel", "jeans", "artificial-grass", "steel-mesh-1"])
@pytest.mark.parametrize(("speed", "force"), [(60.0, 0.5), (150.0, 1.5)])
def test_a_texture_gets_the_filter(name: str, speed: float, force: float) -> None:
    """The ratio of rendered spectra is the filter, to 1.5 dB in octaves where there is power."""
    texture = read_texture(FOLDER / f"{name}.foten")
    before, after = (rendered(one, speed, force, 40.0) for one in (texture, transferred(texture, TILT)))
    (hz, p), (_, q) = (welch(x, 1000.0, 256) for x in (before, after))
    errors = []
    for low in (25.0, 50.0, 100.0, 200.0):
        inside = (hz >= low) & (hz < 2 * low) & (p > 1e-3 * p.max())
        if inside.any():
            expected = (p * TILT.gain(hz))[inside].sum()
            errors.append(10 * np.log10(q[inside].sum() / expected))
    assert np.abs(errors).max() < 1.5
    assert np.abs(errors).mean() < 0.8


def test_powers_of_a_tool_are_added(textures_level: tuple[Texture, Texture]) -> None:
    texture, other = textures_level
    levels = [20 * np.log10(rendered(one, v, 0.7, 20.0).std()) for one in (texture, other) for v in (70.0, 140.0)]
    assert (levels[3] - levels[2]) - (levels[1] - levels[0]) == pytest.approx(0.3 * 6.02, abs=0.15)
    assert rendered(other, 100.0, 0.7, 10.0).std() == pytest.approx(rendered(texture, 100.0, 0.7, 10.0).std(), rel=0.03)


@pytest.fixture(scope="module")
def textures_level() -> tuple[Texture, Texture]:
    texture = read_texture(FOLDER / "towel.foten")
    flat = Transfer("a", "b", HZ, (0.0,) * 28, (0.5,) * 28, 100.0, 0.7, speed_exponent=0.3)
    return texture, transferred(texture, flat)


def test_it_costs_what_it_cost_and_is_proved() -> None:
    texture = read_texture(FOLDER / "jeans.foten")
    other = transferred(texture, TILT)
    assert other.sizes == texture.sizes
    assert other.card["tool"] == "b"
    assert other.evidence == "for the tool b, by a filter and a level"
    Renderer(other).render(np.linspace(0, 900, 3000), np.full(3000, 1.0))  # which replays the proof


def test_knots_of_a_table_are_speeds_and_forces() -> None:
    knots = knots_of({"a.speed_knots": np.array([10.0, 20.0]), "a.force_knots": log_force(np.array([0.5, 1.0]))}, "a.")
    np.testing.assert_allclose(knots, [[10, 0.5], [10, 1], [20, 0.5], [20, 1]])


def test_a_tool_is_written_and_read(tmp_path: Path) -> None:
    write_transfer(TILT, tmp_path / "b.json")
    assert read_transfer(tmp_path / "b.json") == TILT


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"format": "other"}, "is not a tool of 'foten tool measure', expected 'format': 'foten-tool'"),
        ({"version": 2}, "has version 2, expected 1"),
        ({"hz": [1.0]}, "the filter has 1 frequencies"),
        ({"gain_db": [99.0] * 28}, "a gain of the tool is beyond 60 dB"),
        ({"hz": list(HZ[::-1])}, "do not rise"),
        ({"gain_db": ["x"] * 28}, "no finite number"),
        ({"extra": 1}, "is no tool"),
        ({"speed_mm_s": 0.0}, "is not above 0.001"),
    ],
)
def test_a_bad_tool_is_refused_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, object], message: str
) -> None:
    path = tmp_path / "b.json"
    write_transfer(TILT, path)
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    assert _status(["tool", "apply", str(FOLDER / "towel.foten"), str(path), "-o", str(tmp_path / "t.foten")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "t.foten").exists()


def test_tools_that_were_never_alike_are_refused() -> None:
    slow = replace(noise(20.0, 1), speed=np.full(20_000, 20.0))
    with pytest.raises(ValueError, match="never at one speed and force for a second"):
        fitted_transfer([slow], [noise(20.0, 2)])
    with pytest.raises(ValueError, match="2 recordings of one tool and 1 of the other"):
        fitted_transfer([slow, slow], [slow])


def test_the_commands(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    files = [str(tmp_path / f"{name}.h5") for name in ("a", "b")]
    for seed, file in enumerate(files):
        assert _status(["simulate", "linear-cloth", "--seconds", "24", "--seed", str(seed), "-o", file]) == 0
    path = str(tmp_path / "b.json")
    assert _status(["tool", "measure", *files, "-o", path]) == 0
    assert "gain [dB]" in capsys.readouterr().out
    assert np.abs(read_transfer(Path(path)).gain_db).max() < 3  # the same surface and tool
    sds = read_transfer(Path(path)).gain_sd_db
    assert _status(["tool", "measure", *files, *reversed(files), "-o", path]) == 0  # on two surfaces, turned round
    assert np.abs(read_transfer(Path(path)).gain_db).max() < 1e-3
    assert np.mean(read_transfer(Path(path)).gain_sd_db) < 1.2 * np.mean(sds)
    assert _status(["tool", "measure", *files, files[0], "-o", path]) == 2
    assert "3 recordings, expected pairs" in capsys.readouterr().err
    outputs = [str(tmp_path / name) for name in ("plain.npz", "other.npz")]
    stroke = ["--speed", "80", "--force", "0.8", "--seconds", "1"]
    assert _status(["render", str(FOLDER / "towel.foten"), *stroke, "-o", outputs[0]]) == 0
    write_transfer(TILT, Path(path))
    assert _status(["render", str(FOLDER / "towel.foten"), "--tool", path, *stroke, "-o", outputs[1]]) == 0
    assert _status(["tool", "apply", str(FOLDER / "towel.foten"), path, "-o", str(tmp_path / "t.foten")]) == 0
    whole = Renderer(tmp_path / "t.foten", seed=0).render(80.0, 0.8, 1000)
    arrays = [np.load(output) for output in outputs]
    name = next(key for key in arrays[0] if arrays[0][key].size == 1000 and "accel" in key)
    np.testing.assert_allclose(arrays[1][name], whole, rtol=1e-6)
    assert not np.allclose(arrays[0][name], whole)
