"""What is written is what was rendered, in formats that others read."""

from __future__ import annotations

import json
import struct
import wave
from pathlib import Path

import numpy as np
import pytest
from scipy.io import wavfile

from foten.runtime.live.sinks import AUDIBLE_PEAK, write_audible, write_rendered

ABOUT = {"texture": "dënim", "seed": 3}


def signal(n: int = 1000, rate: float = 1000.0) -> np.ndarray:
    return 3.7 * np.sin(2 * np.pi * 100 * np.arange(n) / rate)


def test_float_wav_keeps_units_and_says_so(tmp_path: Path) -> None:
    a = signal()
    write_rendered(tmp_path / "a.wav", a, a, a, 1000.0, ABOUT)
    rate, samples = wavfile.read(tmp_path / "a.wav")
    assert rate == 1000
    assert np.array_equal(samples, a.astype(np.float32))
    data = (tmp_path / "a.wav").read_bytes()
    assert struct.unpack("<I", data[4:8])[0] == len(data) - 8
    comment = data[data.index(b"ICMT") + 8 :].split(b"\0")[0]
    assert json.loads(comment)["unit"] == "m/s^2"


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
