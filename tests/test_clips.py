"""Exports: a clip's envelopes on signals whose answer is known, and each format held to its own rules by another reader."""

from __future__ import annotations

import ctypes
import json
import shutil
import struct
import subprocess
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io.wavfile

from conftest import exported
from foten.cli.command_line import _status
from foten.dsp import Array
from foten.dsp.resample import interpolate
from foten.export.ahap import write_ahap
from foten.export.android import write_android
from foten.export.c_header import identifier, write_c_header
from foten.export.clip import RATE_HZ, Clip, _followed, _reduced, clip_of, envelopes_of
from foten.export.haptic import write_haptic
from foten.export.hjif import write_hjif
from foten.export.samples import write_wav
from foten.models.texture_file import read_texture, write_texture
from foten.runtime.binding import ABI, c_flags
from foten.runtime.renderer import EXAMPLE, Renderer

ABOUT = {"foten": "0", "texture": "mesh", "stroke": "80 mm/s"}


def tone(hertz: float, seconds: float = 2.0, size: float = 0.8) -> Clip:
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return Clip(size * np.sin(2 * np.pi * hertz * t), RATE_HZ, 1.0, ABOUT)


@pytest.fixture(scope="module")
def mesh() -> Clip:
    """A stroke over a mesh, slow then fast."""
    speed = np.concatenate([np.full(2000, 30.0), np.linspace(30.0, 200.0, 2000)])
    rendered = Renderer(EXAMPLE, rate=RATE_HZ).render(speed, np.full(4000, 0.8))
    return clip_of(rendered.astype(float), RATE_HZ, ABOUT)


def test_a_clip_is_within_full_scale_and_says_what_that_is() -> None:
    clip = clip_of(np.array([0.0, -4.0, 2.0]), 8000.0, ABOUT)
    assert (clip.full_scale, clip.drive.tolist()) == (4.0, [0.0, -1.0, 0.5])
    assert clip_of(np.array([0.0, -4.0, 2.0]), 8000.0, ABOUT, 2.0).drive.tolist() == [0.0, -1.0, 1.0]
    silent = clip_of(np.zeros(8), 8000.0, ABOUT)
    assert silent.drive.tolist() == [0.0] * 8
    assert envelopes_of(silent).frequency[:, 1].tolist() == [0.0] * len(envelopes_of(silent).frequency)
    assert clip_of(np.ones(2), 8000.0, ABOUT).duration_s == 2 / 8000
    with pytest.raises(ValueError, match="expected two or more"):
        clip_of(np.zeros(1), 8000.0, ABOUT)
    with pytest.raises(ValueError, match="full scale is -1"):
        clip_of(np.zeros(8), 8000.0, ABOUT, -1.0)


@pytest.mark.parametrize("hertz", [60.0, 170.0, 400.0])
def test_the_envelopes_of_a_tone_are_its_level_and_its_frequency(hertz: float) -> None:
    envelopes = envelopes_of(tone(hertz))
    middle = np.linspace(0.3, 1.7, 50)
    np.testing.assert_allclose(envelopes.hertz(middle), hertz, atol=8.0)  # a bin of the transform has 7.8 Hz
    level = np.interp(middle, *envelopes.amplitude.T)
    # An RMS over 1 ms follows the halves of a slow tone up to its peak, and holds what it reached.
    assert 0.8 / 2**0.5 * 0.95 < level.mean() <= 0.81


def test_the_level_rises_at_once_holds_and_falls_within_the_release() -> None:
    """It is held for 1.5 ms, which are two steps, and falls by e in 0.1 s; an offset has no level."""
    t = np.arange(16_000) / RATE_HZ
    burst = 0.7 * np.sign(np.sin(2 * np.pi * 500 * t + 0.1)) * ((t >= 0.5) & (t < 1.0))
    amplitude = envelopes_of(Clip(0.2 + burst, RATE_HZ, 1.0, ABOUT)).amplitude
    np.testing.assert_allclose(np.interp([0.49, 0.501, 0.99], *amplitude.T), [0.0, 0.7, 0.7], atol=0.01)
    falling = np.array([0.0, 0.02, 0.05, 0.1])
    # The points that are left describe the curve to 1 %, and steps of 1 ms another.
    np.testing.assert_allclose(np.interp(1.002 + falling, *amplitude.T), 0.7 * np.exp(-falling / 0.1), rtol=0.02)


def test_each_burst_is_held_anew() -> None:
    """1.5 ms are two steps; then it falls by e in 0.1 s, from what the attack of 0.1 ms reached, within e^−10."""
    n = np.arange(1600)
    burst = np.sign(np.sin(2 * np.pi * 500 / RATE_HZ * n + 0.1)) * (n % 800 < 400)
    _, level = _followed(Clip(burst, RATE_HZ, 1.0, ABOUT))
    falling = np.exp(-np.maximum(0, np.arange(50) - 1) / 100)
    expected = np.concatenate([np.ones(50), falling])
    np.testing.assert_allclose(level[:200], np.tile(expected, 2), atol=1e-4)


def test_the_frequency_is_that_of_what_skin_feels() -> None:
    """Above 1 kHz a spectrum does not count."""
    clip = Clip(tone(200.0, size=0.3).drive + tone(3000.0, size=0.6).drive, RATE_HZ, 1.0, ABOUT)
    np.testing.assert_allclose(envelopes_of(clip).hertz(np.linspace(0.3, 1.7, 9)), 200.0, atol=20.0)  # leakage of 3 kHz


def test_a_wav_of_a_drive_at_full_scale_is_cut_and_does_not_wrap(tmp_path: Path) -> None:
    """Between the samples of a square wave the interpolated sound exceeds 1 by a tenth: wrapped, that is a click at −1."""
    clip = Clip(np.sign(np.sin(2 * np.pi * 100 * np.arange(4000) / RATE_HZ + 0.01)), RATE_HZ, 1.0, ABOUT)
    sound = interpolate(clip.drive, Fraction(6))
    assert np.abs(sound).max() > 1.05
    write_wav(clip, tmp_path / "a.wav")
    _, written = scipy.io.wavfile.read(tmp_path / "a.wav")
    np.testing.assert_allclose(written / 32767, np.clip(sound, -1, 1), atol=0.5 / 32767)  # half a step of 16 bits


def test_envelopes_are_no_denser_than_60_points_a_second(mesh: Clip) -> None:
    envelopes = envelopes_of(mesh)
    for points in (envelopes.amplitude, envelopes.frequency):
        assert 2 <= len(points) <= 60 * mesh.duration_s
        assert points[0, 0] == 0.0
        assert points[-1, 0] == pytest.approx(mesh.duration_s)
        assert (np.diff(points[:, 0]) > 0).all()
        assert points[:, 1].min() >= 0
        assert points[:, 1].max() <= 1


def test_what_is_reduced_stays_near_what_was_there() -> None:
    """A ramp needs two points, whatever it had."""
    t = np.arange(16000) / RATE_HZ
    clip = Clip(np.linspace(0.0, 0.9, 16000) * np.sign(np.sin(2 * np.pi * 500 * t + 0.1)), RATE_HZ, 1.0, ABOUT)
    amplitude = envelopes_of(clip).amplitude
    np.testing.assert_allclose(np.interp(t[100:], *amplitude.T), np.linspace(0.0, 0.9, 16000)[100:], atol=0.01)


def test_the_points_that_matter_least_go_first() -> None:
    """Oracle: Visvalingam and Whyatt's rule, every triangle measured anew at each step."""
    points = np.stack([np.arange(40.0), np.random.default_rng(0).standard_normal(40)], axis=1)
    expected = points
    while len(expected) > 12:
        before, here, after = expected[:-2], expected[1:-1], expected[2:]
        across, up = (here - before).T, (after - before).T
        expected = np.delete(expected, 1 + np.abs(across[0] * up[1] - up[0] * across[1]).argmin(), axis=0)
    np.testing.assert_array_equal(_reduced(points, 12), expected)


def check_ahap(document: dict[str, Any], seconds: float) -> None:
    """Raise AssertionError where a pattern breaks the rules of Core Haptics."""
    assert document["Version"] == 1.0
    events = [one["Event"] for one in document["Pattern"] if "Event" in one]
    curves = [one["ParameterCurve"] for one in document["Pattern"] if "ParameterCurve" in one]
    assert len(events) + len(curves) == len(document["Pattern"])
    ends = 0.0
    for event in events:
        assert event["EventType"] == "HapticContinuous"
        assert event["Time"] == pytest.approx(ends)
        assert 0 < event["EventDuration"] <= 30
        ends = event["Time"] + event["EventDuration"]
    assert ends == pytest.approx(seconds)
    for name, low in (("HapticIntensityControl", 0.0), ("HapticSharpnessControl", -1.0)):
        mine = [curve for curve in curves if curve["ParameterID"] == name]
        assert mine[0]["Time"] == 0.0
        last = None
        for curve in mine:
            points = curve["ParameterCurveControlPoints"]
            assert 2 <= len(points) <= 16
            assert points[0]["Time"] == 0.0  # they count from their curve's time
            assert all(a["Time"] < b["Time"] for a, b in pairwise(points))
            assert all(low <= point["ParameterValue"] <= 1 for point in points)
            if last is not None:
                assert curve["Time"] == pytest.approx(last[0], abs=1e-5)
                assert points[0]["ParameterValue"] == last[1]  # each begins where the one before ends
            last = curve["Time"] + points[-1]["Time"], points[-1]["ParameterValue"]
        assert last is not None
        assert last[0] == pytest.approx(seconds, abs=1e-4)


@pytest.mark.parametrize("seconds", [0.5, 2.0, 70.0])
def test_ahap_keeps_to_the_rules_of_core_haptics(tmp_path: Path, seconds: float) -> None:
    rng = np.random.default_rng(0)
    clip = Clip(0.3 * rng.standard_normal(round(seconds * RATE_HZ)).clip(-3, 3), RATE_HZ, 1.0, ABOUT)
    write_ahap(clip, tmp_path / "a.ahap")
    check_ahap(json.loads((tmp_path / "a.ahap").read_text()), seconds)


def test_haptic_keeps_to_its_specification(tmp_path: Path, mesh: Clip) -> None:
    write_haptic(mesh, tmp_path / "a.haptic")
    document = json.loads((tmp_path / "a.haptic").read_text())
    assert document["version"] == {"major": 1, "minor": 0, "patch": 0}
    assert isinstance(document["metadata"], dict)
    envelopes = document["signals"]["continuous"]["envelopes"]
    amplitude, frequency = envelopes["amplitude"], envelopes["frequency"]
    assert len(amplitude) >= 2
    assert amplitude[-1]["time"] == pytest.approx(mesh.duration_s, abs=1e-5)
    assert frequency[-1]["time"] <= amplitude[-1]["time"]
    for name, points in (("amplitude", amplitude), ("frequency", frequency)):
        times = [point["time"] for point in points]
        assert times == sorted(times)
        assert times[0] >= 0
        assert all(set(point) == {"time", name} and 0 <= point[name] <= 1 for point in points)


FILE = "version profile level date description timescale avatars perceptions syncs"
PERCEPTION = "id avatar_id description perception_modality unit_exponent perception_unit_exponent reference_devices"
CHANNEL = "id description gain mixing_coefficient body_part_mask frequency_sampling sample_count bands"


def synthesized(document: dict[str, Any]) -> Array:
    """Output of the reference synthesizer for a file, at its own rate, once its members are checked."""
    assert set(FILE.split()) == set(document)
    assert document["version"] == "2023"
    assert document["level"] in (1, 2)
    (perception,) = document["perceptions"]
    assert {*PERCEPTION.split(), "effect_library", "channels"} == set(perception)
    # A vibration in time: "Vibrotactile Texture", "Stiffness" and "Friction" count along the surface.
    assert perception["perception_modality"] == "Vibrotactile"
    assert (perception["unit_exponent"], perception["perception_unit_exponent"]) == (-3, 0)  # the reader's defaults
    assert perception["avatar_id"] in [avatar["id"] for avatar in document["avatars"]]
    (channel,) = perception["channels"]
    assert set(CHANNEL.split()) <= set(channel)
    (band,) = channel["bands"]
    assert isinstance(band["lower_frequency_limit"], int)
    assert 0 <= band["lower_frequency_limit"] <= band["upper_frequency_limit"]
    (effect,) = band["effects"]
    assert effect["effect_type"] == "Basis"
    assert effect["position"] == 0
    frames = effect["keyframes"]
    at = np.array([frame["relative_position"] for frame in frames])
    assert (np.diff(at) > 0).all()
    assert all(isinstance(frame["relative_position"], int) for frame in frames)
    amplitude = np.array([frame["amplitude_modulation"] for frame in frames])
    assert np.abs(amplitude).max() <= 1
    n = channel["sample_count"]
    if band["band_type"] == "Curve":
        assert document["profile"] == "Main"
        assert band["curve_type"] == "Linear"
        assert len(frames) >= 3
        assert document["timescale"] <= 48_000
        return np.interp(np.arange(at[-1]), at, amplitude)  # the last sample is never rendered
    assert band["band_type"] == "VectorialWave"
    assert document["profile"] == "Simple Parametric"
    assert document["timescale"] == 1000
    assert effect["base_signal"] == "Sine"
    ms = 1000 * np.arange(n) / channel["frequency_sampling"]
    hertz = np.interp(ms, at, [frame["frequency_modulation"] for frame in frames])
    return np.interp(ms, at, amplitude) * np.sin(2 * np.pi * np.cumsum(hertz) / channel["frequency_sampling"])


def test_hjif_as_a_curve_is_the_waveform(tmp_path: Path, mesh: Clip) -> None:
    write_hjif(mesh, tmp_path / "a.hjif")
    rendered = synthesized(json.loads((tmp_path / "a.hjif").read_text()))
    np.testing.assert_allclose(rendered, mesh.drive, atol=1e-6)  # six digits are written


def test_hjif_of_one_sample_has_the_keyframes_that_a_curve_needs(tmp_path: Path) -> None:
    write_hjif(Clip(np.array([0.5, -0.5]), RATE_HZ, 1.0, ABOUT), tmp_path / "a.hjif")
    assert synthesized(json.loads((tmp_path / "a.hjif").read_text())).tolist() == [0.5, -0.5]


@pytest.mark.parametrize(("hertz", "error"), [(200.0, 0.3), (500.0, 0.01)])
def test_parametric_hjif_is_a_tone_of_the_level_and_the_frequency(tmp_path: Path, hertz: float, error: float) -> None:
    """An RMS over 1 ms, half a period of 500 Hz, is a tone's own; of a slower one it follows the halves up to the peak."""
    clip = tone(hertz, size=0.5)
    write_hjif(clip, tmp_path / "a.hjif", parametric=True)
    rendered = synthesized(json.loads((tmp_path / "a.hjif").read_text()))[4000:12000]
    assert np.abs(np.fft.rfft(rendered)).argmax() == pytest.approx(hertz, abs=8)  # bins of 1 Hz
    assert np.sqrt(np.square(rendered).mean()) == pytest.approx(0.5 / 2**0.5, rel=error)
    grows = np.sign(clip.drive) * np.linspace(0.1, 1.0, clip.drive.size)  # a square, whose RMS is its peak
    write_hjif(Clip(grows, RATE_HZ, 1.0, ABOUT), tmp_path / "a.hjif", parametric=True)
    peaks = np.abs(synthesized(json.loads((tmp_path / "a.hjif").read_text()))).reshape(4, -1).max(axis=1)
    np.testing.assert_allclose(peaks, [0.46, 0.78, 1, 1], atol=0.02)  # √2 of the RMS, at most 1


@pytest.mark.parametrize("seconds", [0.005, 0.02, 0.0399, 0.05, 1.2345])
def test_android_takes_points_that_are_20_ms_to_1_s_apart(tmp_path: Path, seconds: float) -> None:
    """What every phone with envelopes guarantees; the durations add up to the clip's, but for one shorter than 20 ms."""
    write_android(tone(200.0, seconds), tmp_path / "a.json")
    document = json.loads((tmp_path / "a.json").read_text())
    durations = [point["duration_ms"] for point in document["envelope"]]
    assert all(isinstance(duration, int) and 20 <= duration <= 1000 for duration in durations)
    assert sum(durations) == pytest.approx(max(20, 1000 * seconds), abs=1)
    assert all(0 <= point["amplitude"] <= 1 and 30 <= point["frequency_hz"] <= 600 for point in document["envelope"])
    amplitudes, timings_ms = document["waveform"]["amplitudes"], document["waveform"]["timings_ms"]
    assert sum(timings_ms) == pytest.approx(1000 * seconds, abs=10)
    assert timings_ms == [10] * len(amplitudes)
    assert all(isinstance(amplitude, int) and 0 <= amplitude <= 255 for amplitude in amplitudes)


def test_androids_points_keep_the_envelopes_shape(tmp_path: Path, mesh: Clip) -> None:
    write_android(mesh, tmp_path / "a.json")
    envelope = json.loads((tmp_path / "a.json").read_text())["envelope"]
    times = np.cumsum([point["duration_ms"] for point in envelope]) / 1000
    envelopes = envelopes_of(mesh)
    at = np.arange(0.05, mesh.duration_s - 0.05, 0.001)
    level = np.interp(at, times, [point["amplitude"] for point in envelope])
    expected = np.interp(at, *envelopes.amplitude.T)
    # What 50 points a second leave out is how the level moves within 20 ms.
    assert level.mean() == pytest.approx(expected.mean(), rel=0.01)
    assert np.corrcoef(level, expected)[0, 1] > 0.9
    hertz = np.interp(at, times, [point["frequency_hz"] for point in envelope])
    np.testing.assert_allclose(hertz.mean(), envelopes.hertz(at).mean(), rtol=0.01)


@pytest.mark.parametrize(
    ("name", "expected"),
    [("steel-mesh 1", "steel_mesh_1"), ("3 mm", "texture_3_mm"), ("Größe", "gr_e"), ("", "texture")],
)
def test_a_name_becomes_one_of_c(name: str, expected: str) -> None:
    assert identifier(name) == expected


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
def test_a_header_compiles_and_reproduces_the_golden_windows(tmp_path: Path) -> None:
    """Loading is the proof; a byte of the tensors that is another one is refused."""
    name = write_c_header(read_texture(EXAMPLE), tmp_path / "mesh.h")
    assert name == "steel_mesh_1_foten"
    program = """
#include "foten.h"
#include "mesh.h"
#include <stdio.h>
int main(void) {
    foten_model *model;
    char why[256];
    if (foten_model_load(steel_mesh_1_foten, steel_mesh_1_foten_size, &model, why, sizeof why) != FOTEN_OK) return puts(why), 1;
    printf("%s %g\\n", foten_model_info(model).texture, foten_model_info(model).rate_hz);
    foten_model_free(model);
    return 0;
}
"""
    (tmp_path / "main.c").write_text(program)
    command = ["cc", "-std=c11", "-Wall", "-Wextra", "-Werror", "main.c", *c_flags().split(), "-o", "main"]
    subprocess.run(command, cwd=tmp_path, check=True)
    ran = subprocess.run(["./main"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert ran.stdout == "steel-mesh-1 1000\n"
    assert (tmp_path / "mesh.h").read_text().count(",") > EXAMPLE.stat().st_size * 0.95


def ran(*arguments: str | Path) -> int:
    return _status(["export", str(EXAMPLE), *map(str, arguments)])


def comment(path: Path) -> dict[str, Any]:
    """Comment of a WAV file, once the sizes of its chunks add up."""
    data = path.read_bytes()
    assert data[:4] == b"RIFF"
    assert struct.unpack("<I", data[4:8])[0] == len(data) - 8
    at, chunks = 12, {}
    while at < len(data):
        size = struct.unpack("<I", data[at + 4 : at + 8])[0]
        chunks[data[at : at + 4]] = data[at + 8 : at + 8 + size]
        at += 8 + size + size % 2
    assert at == len(data)
    assert chunks[b"LIST"][:8] == b"INFOICMT"
    document: dict[str, Any] = json.loads(chunks[b"LIST"][12:].rstrip(b"\0"))
    return document


@pytest.mark.parametrize("name", ["a.wav", "a.csv", "a.npz", "a.ahap", "a.haptic", "a.hjif", "b.hjif", "a.json"])
def test_a_stroke_is_exported_by_the_name_of_the_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    """Each says what its format keeps; the samples are those that `foten render` has at that rate."""
    stroke = tmp_path / "s.csv"
    stroke.write_text("t,x,y,pressure\n0,0,0,0.5\n0.5,40,0,0.5\n1.0,90,0,0.4\n")
    assert ran("--stroke", stroke, "-o", tmp_path / name, *["--to", "hjif-parametric"] * (name == "b.hjif")) == 0
    out = capsys.readouterr().out
    assert "1 s, full scale (1) is " in out
    assert "keep" in out or "kept" in out
    if name == "a.wav":
        rate, samples = scipy.io.wavfile.read(tmp_path / name)
        assert (rate, samples.dtype, samples.size) == (48_000, np.int16, 48_000)
        assert 32_000 < np.abs(samples).max() <= 32_767
        about = comment(tmp_path / name)
        assert (about["unit"], about["texture"], about["seed"]) == ("m/s^2", "steel-mesh-1", 0)
        assert f"full scale (1) is {about['full_scale']:.3g} m/s²" in out
    elif name == "a.csv":
        table = np.loadtxt(tmp_path / name, delimiter=",", skiprows=1)
        assert table.shape == (8000, 2)
        assert np.abs(table[:, 1]).max() == pytest.approx(1.0)
    elif name == "a.npz":
        with np.load(tmp_path / name) as held:
            assert held["drive"].shape == (8000,)
            assert json.loads(str(held["about"]))["texture"] == "steel-mesh-1"
    elif name == "a.ahap":
        check_ahap(json.loads((tmp_path / name).read_text()), 1.0)


STROKE = ("--speed", "80", "--force", "0.8", "--seconds", "0.5")


def test_a_wav_of_a_relative_texture_says_what_1_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    texture = read_texture(EXAMPLE)
    card = {**texture.card, "units": {**texture.card["units"], "acceleration": "relative"}}
    write_texture(type(texture)(card, texture.tensors), tmp_path / "t.foten")
    path = tmp_path / "a.wav"
    assert _status(["export", str(tmp_path / "t.foten"), *STROKE, "-o", str(path)]) == 0
    about = comment(path)
    assert about["unit"] == "relative"
    assert f"full scale (1) is {about['full_scale']:.3g} times the recording's RMS" in capsys.readouterr().out


def test_onnx_is_checked_and_predicts_what_the_kernel_does(tmp_path: Path) -> None:
    """Another reader: ONNX's own checker, and ONNX Runtime on the golden windows of a network that is the whole model."""
    onnx = pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    texture = exported("foten")
    (tmp_path / "t.foten").write_bytes(texture.to_bytes())
    assert _status(["export", str(tmp_path / "t.foten"), "-o", str(tmp_path / "t.onnx")]) == 0
    model = onnx.load(tmp_path / "t.onnx")
    onnx.checker.check_model(model, full_check=True)
    card = json.loads({prop.key: prop.value for prop in model.metadata_props}["foten"])
    assert card["model"] == "foten"
    session = runtime.InferenceSession(str(tmp_path / "t.onnx"))
    windows = texture.tensors["golden.windows"].astype(np.float32)
    (predicted,) = session.run(None, {session.get_inputs()[0].name: windows})
    np.testing.assert_allclose(predicted, texture.tensors["golden.one_step"], atol=1e-5)


def test_a_site_is_the_page_with_the_texture_and_without_a_server(tmp_path: Path) -> None:
    assert ran("--to", "web", "-o", tmp_path / "site") == 0
    site = tmp_path / "site"
    assert {"index.html", "studio.js", "worklet.js", "foten.mjs", "foten.wasm"} <= {p.name for p in site.iterdir()}
    listed = json.loads((site / "textures.json").read_text())
    assert listed["server"] is False
    (one,) = listed["textures"]
    assert (site / "textures" / one["file"]).read_bytes() == EXAMPLE.read_bytes()


def test_a_site_has_as_many_textures_as_are_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Two methods of one texture, which the page compares, and another texture."""
    mesh, other = read_texture(EXAMPLE), exported("foten")
    paths = [tmp_path / f"{name}.foten" for name in ("mesh", "mesh-foten", "towel")]
    for path, texture, name in zip(paths, (mesh, other, mesh), ("steel-mesh-1", "steel-mesh-1", "towel"), strict=True):
        write_texture(type(texture)({**texture.card, "texture": name}, texture.tensors), path)
    site = tmp_path / "new" / "site"  # with the folder above it
    assert _status(["export", *map(str, paths), "--to", "web", "-o", str(site)]) == 0
    assert "3 textures" in capsys.readouterr().out
    listed = json.loads((site / "textures.json").read_text())["textures"]
    assert [(one["file"], one["name"], one["method"]) for one in listed] == [
        ("mesh.foten", "steel-mesh-1", "foten-plus"),
        ("mesh-foten.foten", "steel-mesh-1", "foten"),
        ("towel.foten", "towel", "foten-plus"),
    ]
    for path in paths:
        assert (site / "textures" / path.name).read_bytes() == path.read_bytes()


def test_a_site_without_a_name_has_the_textures_that_come_along(tmp_path: Path) -> None:
    assert _status(["export", "--to", "web", "-o", str(tmp_path / "site")]) == 0
    listed = json.loads((tmp_path / "site" / "textures.json").read_text())["textures"]
    assert [one["file"] for one in listed] == sorted(path.name for path in EXAMPLE.parent.glob("*.foten"))


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (["-o", "x.mp3"], "the name x.mp3 gives no known format, expected --to wav"),
        ([str(EXAMPLE), "-o", "x.ahap"], "ahap takes one texture file, got 2"),
        ([str(EXAMPLE), "--to", "unity", "-o", "x"], "unity takes one texture file, got 2"),
        (["--to", "haps", "-o", "x"], "--to haps gives no known format"),
        (["--to", "web", "--speed", "80", "-o", "site"], "web holds the texture itself: leave out the stroke"),
        (["--speed", "80", "-o", "x.ahap"], "expected one of --stroke"),
        (["-o", "nowhere/x.ahap"], "there is no folder nowhere"),
        (["--full-scale", "-2", "-o", "x.ahap"], "full scale is -2, expected a positive number of m/s²"),
    ],
)
def test_what_cannot_be_exported_is_said_in_a_line(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    match: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert ran(*arguments) == 2
    error = capsys.readouterr().err
    assert match in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_unity_package_holds_the_texture_its_binding_and_the_library(tmp_path: Path) -> None:
    folder = tmp_path / "FotenUnity"
    assert _status(["export", str(EXAMPLE), "--to", "unity", "-o", str(folder)]) == 0
    package = json.loads((folder / "package.json").read_text())
    assert package["name"] == "org.foten.steel-mesh-1"
    assert (folder / "Runtime/Resources/Foten/steel_mesh_1.bytes").read_bytes() == EXAMPLE.read_bytes()
    assert 'textureName = "steel_mesh_1"' in (folder / "Runtime/FotenSource.cs").read_text()
    (plugin,) = (folder / "Runtime/Plugins").iterdir()
    assert ctypes.CDLL(str(plugin)).foten_abi() == ABI
    assert "TEXTURE" not in "".join(path.read_text() for path in folder.rglob("*.md"))
