"""What is written is what was rendered, in formats that others read."""

from __future__ import annotations

import json
import struct
import wave
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from conftest import check_figures
from foten.runtime.live.sinks import AUDIBLE_PEAK, picture, write_audible, write_rendered

ABOUT = {"texture": "dënim", "seed": 3}


def signal(n: int = 1000, rate: float = 1000.0) -> np.ndarray:
    return 3.7 * np.sin(2 * np.pi * 100 * np.arange(n) / rate)


def test_formats_agree_and_keep_units(tmp_path: Path) -> None:
    a, speed, force = signal(), np.linspace(20.0, 150.0, 1000), np.linspace(0.5, 1.5, 1000)
    for suffix in ("wav", "csv", "npz", "png"):
        write_rendered(tmp_path / f"a.{suffix}", a, speed, force, 1000.0, ABOUT)
    rate, samples = wavfile.read(tmp_path / "a.wav")
    assert rate == 1000
    assert np.array_equal(samples, a.astype(np.float32))
    data = (tmp_path / "a.wav").read_bytes()
    assert struct.unpack("<I", data[4:8])[0] == len(data) - 8
    comment = data[data.index(b"ICMT") + 8 :].split(b"\0")[0]
    assert json.loads(comment)["unit"] == "m/s^2"
    assert (tmp_path / "a.csv").read_text().startswith("t [s],acceleration [m/s^2],speed [mm/s],force [N]\n0,")
    written = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(written[:, 1:], np.stack([a, speed, force], axis=1), rtol=1e-8, atol=1e-8)  # nine digits
    with np.load(tmp_path / "a.npz", allow_pickle=False) as stored:
        np.testing.assert_array_equal([stored[name] for name in ("acceleration", "speed", "force")], [a, speed, force])
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    check_figures({"rendered": picture(a, speed, force, 1000.0, ABOUT)})


def test_audible_sound_keeps_the_tone(tmp_path: Path) -> None:
    """A 100 Hz tone at 1 kHz is a 100 Hz tone at 48 kHz, its peak at 0.7 of full scale."""
    gain = write_audible(tmp_path / "s.wav", signal(), 1000.0)
    with wave.open(str(tmp_path / "s.wav")) as file:
        assert (file.getframerate(), file.getsampwidth(), file.getnchannels()) == (48000, 2, 1)
        pcm = np.frombuffer(file.readframes(-1), "<i2") / 32767
    expected = gain * 3.7 * np.sin(2 * np.pi * 100 * np.arange(48000) / 48000)
    # Away from the ends, where the interpolator looks past the signal: 16 bits and the sinc's window.
    assert np.abs(pcm - expected)[2000:-2000].max() < 2e-4
    assert np.abs(pcm).max() == pytest.approx(AUDIBLE_PEAK, rel=1e-3)


@pytest.mark.parametrize(
    ("rate", "tone", "highest"), [(1000.0, 100.0, 500.0), (10_000.0, 100.0, 1000.0), (10_000.0, 3000.0, 3000.0)]
)
def test_a_spectrogram_covers_the_time_of_its_axes(rate: float, tone: float, highest: float) -> None:
    """And the frequencies that have power; its first and last columns show the tone, as all do."""
    n = round(rate) + 1
    a = np.cos(2 * np.pi * tone * np.arange(n) / rate)  # whole periods of a cosine: mirrored at its ends it goes on
    _, axes, *_ = picture(a, a, a, rate, ABOUT).axes
    (image,) = axes.images
    left, right, low, high = image.get_extent()
    assert left <= axes.get_xlim()[0] < axes.get_xlim()[1] <= right
    assert axes.get_ylim() == (0, pytest.approx(highest, abs=35))
    assert ("99.9 %" in axes.get_ylabel()) == (highest < rate / 2)
    cells = np.asarray(image.get_array())
    loudest = low + (cells.argmax(axis=0) + 0.5) * (high - low) / len(cells)
    np.testing.assert_allclose(loudest, tone, atol=(high - low) / len(cells))
    np.testing.assert_allclose(cells.max(axis=0), 0, atol=0.1)  # dB re loudest


def test_silence_is_written_as_silence(tmp_path: Path) -> None:
    assert write_audible(tmp_path / "z.wav", np.zeros(100), 1000.0) == 1.0
    for suffix in ("wav", "csv", "npz", "png"):
        write_rendered(tmp_path / f"z.{suffix}", np.zeros(100), np.zeros(100), np.zeros(100), 1000.0, ABOUT)
        assert (tmp_path / f"z.{suffix}").stat().st_size > 0


def test_same_arrays_same_bytes(tmp_path: Path) -> None:
    a = signal()
    for suffix in ("wav", "csv", "npz", "png"):
        for name in ("a", "b"):
            write_rendered(tmp_path / f"{name}.{suffix}", a, a, a, 1000.0, ABOUT)
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_a_failed_write_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at most 48000 Hz"):
        write_audible(tmp_path / "a.wav", signal(), 96_000.0)
    with pytest.raises(ValueError, match=r"expected \.wav, \.csv, \.npz or \.png"):
        write_rendered(tmp_path / "a.flac", signal(), signal(), signal(), 1000.0, ABOUT)
    assert not list(tmp_path.iterdir())
