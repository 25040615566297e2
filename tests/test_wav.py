"""WAV files: every sample width has the same full scale."""

import struct

import numpy as np
import pytest
from scipy.io import wavfile

from foten.datasets.binary import read_wav
from foten.datasets.units import FULL_SCALE


@pytest.mark.parametrize("kind", [np.uint8, np.int16, np.int32])
def test_integers_are_fractions_of_full_scale(tmp_path, kind):
    info = np.iinfo(kind)
    middle = 128 if kind is np.uint8 else 0
    samples = np.array([middle, info.min, middle + (int(info.max) + 1 - middle) // 2], dtype=kind)
    wavfile.write(tmp_path / "a.wav", 48_000, samples)
    (column,) = read_wav(tmp_path / "a.wav")
    assert column.samples.tolist() == [0, -1, 0.5]
    assert (column.rate_hz, column.unit) == (48_000, FULL_SCALE)


def test_24_bit(tmp_path):
    data = b"".join(int(value).to_bytes(3, "little", signed=True) for value in (0, -(2**23), 2**22))
    form = struct.pack("<4sIHHIIHH", b"fmt ", 16, 1, 1, 8000, 24_000, 3, 24)
    body = b"WAVE" + form + struct.pack("<4sI", b"data", len(data)) + data + b"\0" * (len(data) % 2)
    (tmp_path / "a.wav").write_bytes(b"RIFF" + struct.pack("<I", len(body)) + body)
    (column,) = read_wav(tmp_path / "a.wav")
    assert column.samples.tolist() == [0, -1, 0.5]


def test_floats_stay_and_tracks_are_numbered(tmp_path):
    samples = np.array([[0.5, -3.0], [1.5, 12.0]], dtype=np.float32)
    wavfile.write(tmp_path / "a.wav", 10_000, samples)
    first, second = read_wav(tmp_path / "a.wav")
    assert (first.name, first.unit, second.name) == ("0", "", "1")
    assert second.samples.tolist() == [-3, 12]


def test_truncated_and_foreign_files_are_refused(tmp_path):
    wavfile.write(tmp_path / "a.wav", 8000, np.zeros(1000, dtype=np.int16))
    data = (tmp_path / "a.wav").read_bytes()
    for name, content in {"cut": data[:-500], "text": b"force\n1\n2\n" * 9, "none": b""}.items():
        (tmp_path / f"{name}.wav").write_bytes(content)
        with pytest.raises(ValueError, match=f"{name}.wav is (truncated|empty)"):
            read_wav(tmp_path / f"{name}.wav")
