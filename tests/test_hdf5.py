"""Our recording file: what is written comes back, and what is not ours is refused in one sentence."""

import h5py
import numpy as np
import pytest

from foten.datasets.hdf5 import load_recording, write_recording
from foten.recording.recording import Channel, Recording


def _recording() -> Recording:
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.008, 0.012, 50))
    return Recording(
        {
            "acceleration_x": Channel(rng.standard_normal(1000), 10_000.0),
            "force": Channel(np.arange(100) / 8, 1000.0),
            "position_x": Channel(rng.standard_normal(50), 100.0, times),
        },
        texture="denim",
        tool="steel ball, 3 mm",
        sensors="ADXL356",
        notes="µ and ² survive",
        simulation={"key": "jeans", "seed": 3},
        history=("force was converted from gf to N", "two gaps were filled"),
        microphone=True,
    )


def test_a_recording_comes_back_exactly(tmp_path):
    recording = _recording()
    write_recording(recording, tmp_path / "a.h5")
    back = load_recording(tmp_path / "a.h5")
    assert back.sha256() == recording.sha256()  # samples, rates and times, to the last bit
    for key in ("texture", "tool", "sensors", "notes", "simulation", "history", "microphone"):
        assert getattr(back, key) == getattr(recording, key)
    assert back["force"].times_s is None


def test_the_same_recording_gives_the_same_bytes_and_a_failed_write_leaves_them(tmp_path, monkeypatch):
    for name in ("a.h5", "b.h5"):
        write_recording(_recording(), tmp_path / name)
    before = (tmp_path / "a.h5").read_bytes()
    assert before == (tmp_path / "b.h5").read_bytes()

    def full(*_: object, **__: object) -> None:
        raise OSError("no space left on device")

    monkeypatch.setattr("foten.datasets.hdf5._store", full)
    with pytest.raises(OSError, match="no space"):
        write_recording(_recording(), tmp_path / "a.h5")
    assert (tmp_path / "a.h5").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.h5", "b.h5"]


def test_a_file_as_matlab_writes_it_is_read(tmp_path):
    # h5create makes n×1 datasets, h5writeatt fixed-length text and arrays of one number.
    with h5py.File(tmp_path / "m.h5", "w") as file:
        file.attrs["format"] = np.bytes_("foten-recording")
        file.attrs["version"] = np.array([1.0])
        dataset = file.create_dataset("channels/speed", data=np.linspace(0, 90, 200)[None, :])
        dataset.attrs["rate_hz"], dataset.attrs["unit"] = np.array([500.0]), np.bytes_("mm/s")
    channel = load_recording(tmp_path / "m.h5")["speed"]
    assert channel.rate_hz == 500
    np.testing.assert_array_equal(channel.samples, np.linspace(0, 90, 200))


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda f: f.attrs.__delitem__("format"), "not a foten recording.*foten import"),
        (lambda f: f.attrs.__setitem__("version", 2), "version 2, expected 1"),
        (lambda f: f.__delitem__("channels"), "no channel"),
        (lambda f: f.move("channels/force", "channels/pressure"), "pressure: unknown, expected one of"),
        (lambda f: f["channels/force"].attrs.__setitem__("unit", "gf"), "unit is 'gf', expected 'N'"),
        (lambda f: f["channels/force"].attrs.__delitem__("rate_hz"), "rate_hz is missing"),
        (lambda f: f["channels/force"].attrs.__setitem__("rate_hz", -1.0), "rate_hz is missing or is not a pos"),
        (lambda f: f["channels/force"].__setitem__(7, np.nan), "force: 1 sample NaN.*first is sample 7"),
        (lambda f: f["times_s/position_x"].__setitem__(5, 0.0), "does not increase at sample 5"),
        (lambda f: f.attrs.__setitem__("simulation", "{"), "simulation is not a JSON object"),
        (lambda f: f.create_dataset("channels/speed", data=np.zeros((4, 4))), "unit is ''"),
        (lambda f: f["channels/force"].__setitem__(7, 1e30), "force: sample 7 is 1e.30, expected below 1e.12"),
        (lambda f: f["channels/force"].attrs.__setitem__("rate_hz", 1e-3), "Hz, 1e.05 s, expected 100 s at most"),
        (lambda f: f["times_s/position_x"].__setitem__(..., 1e9 + np.arange(50)), "starts at 1e.09 s, expected 7200"),
        (lambda f: f["channels/force"].attrs.__setitem__("rate_hz", 1e12), "the rate is 1e.12 Hz"),
        (lambda f: f["times_s/position_x"].__setitem__(49, 1e9), "the rate right, or was the time given in ms"),
        (lambda f: f.attrs.__setitem__("simulation", "[" * 50_000), "simulation is not a JSON object"),
        (lambda f: f.attrs.__setitem__("simulation", '{"seed": 1e999}'), "simulation is not a JSON object"),
    ],
)
def test_what_is_wrong_in_a_file_is_named(tmp_path, spoil, message):
    write_recording(_recording(), tmp_path / "bad.h5")
    with h5py.File(tmp_path / "bad.h5", "r+") as file:
        spoil(file)
    with pytest.raises(ValueError, match=message):
        load_recording(tmp_path / "bad.h5")


def test_truncated_foreign_and_missing_files_are_refused(tmp_path):
    write_recording(_recording(), tmp_path / "a.h5")
    data = (tmp_path / "a.h5").read_bytes()
    (tmp_path / "cut.h5").write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match=r"cut.h5 is truncated"):
        load_recording(tmp_path / "cut.h5")
    (tmp_path / "text.h5").write_text("time,force\n0,1\n")
    with pytest.raises(ValueError, match="not an HDF5 file"):
        load_recording(tmp_path / "text.h5")
    (tmp_path / "none.h5").touch()
    with pytest.raises(ValueError, match="empty"):
        load_recording(tmp_path / "none.h5")
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_recording(tmp_path / "absent.h5")
    (tmp_path / "denim.csv").write_text("0\n")
    with pytest.raises(ValueError, match=r"first run: foten import .*denim.csv -o denim.h5"):
        load_recording(tmp_path / "denim.csv")
    (tmp_path / "bath towel (2).csv").write_text("0\n")
    with pytest.raises(ValueError, match=r"first run: foten import '.*towel \(2\).csv' -o 'bath towel \(2\).h5'"):
        load_recording(tmp_path / "bath towel (2).csv")  # which a shell could not read


def test_a_text_that_hdf5_cannot_hold_is_refused(tmp_path):
    recording = Recording({"force": Channel(np.ones(10), 100.0)}, notes="x" * 70_000)
    with pytest.raises(ValueError, match="notes has 70,000 bytes, expected 60,000 at most"):
        write_recording(recording, tmp_path / "a.h5")
    assert list(tmp_path.iterdir()) == []


def test_texts_are_printable(tmp_path):
    recording = Recording({"force": Channel(np.ones(10), 100.0)}, texture="a\x1b[31m", notes="two\nlines")
    write_recording(recording, tmp_path / "a.h5")
    back = load_recording(tmp_path / "a.h5")
    assert (back.texture, back.notes) == ("a?[31m", "two\nlines")
