"""The Cluster Haptic Texture Dataset, on small folders of its shape: no real file was at hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from foten.cli.command_line import _status
from foten.datasets.cluster import cluster_surfaces, read_cluster
from foten.datasets.hdf5 import load_recording
from foten.recording.preprocess import PreprocessConfig, fitting_cut, preprocess

TONE_HZ, SENSOR_HZ, SECONDS = 137.0, 6000.0, 5.0


def write_clip(folder: Path, surface: int, direction: int, speed: int, force_mn: int, repeat: int = 0) -> None:
    """A clip of a tone that the program asked for 8670 times a second, and the sensor measured 6000 times."""
    name = f"{surface}_{direction}_{speed}_{force_mn}_{repeat}.csv"
    rng = np.random.default_rng([surface, direction, speed, force_mn, repeat])
    t = 3 + np.cumsum(rng.uniform(0.6, 1.4, round(8670 * SECONDS))) / 8670
    measured = np.floor(t * SENSOR_HZ) / SENSOR_HZ  # what the sensor holds until its next sample
    tone = 0.3 * np.sin(2 * np.pi * TONE_HZ * measured)
    accel = np.stack([t, tone, 0.01 * np.cos(9 * measured), -0.96 + 0.1 * tone], axis=1)
    slow = np.floor(t * 80) / 80  # the force's converter
    force = np.stack([t, force_mn / 1000 + 0.01 * np.sin(3 * slow)], axis=1)
    at = np.arange(0, SECONDS, 0.01)
    angle = np.radians(direction)
    position = np.stack([3 + at, 50 + speed * at * np.cos(angle), 50 + speed * at * np.sin(angle)], axis=1)
    for part, header, rows in (("accel", "X,Y,Z", accel), ("force", "force", force), ("position", "X,Y", position)):
        place = folder / "sensor_data" / part
        place.mkdir(parents=True, exist_ok=True)
        np.savetxt(place / name, rows, "%.9g", ",", header=f"time,{header}", comments="")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("texture_dataset")
    for direction, speed, force in ((0, 20, 500), (135, 40, 1000), (270, 60, 500)):
        write_clip(folder, 7, direction, speed, force)
    write_clip(folder, 11, 0, 20, 500)
    (folder / "sensor_data" / "force" / "11_0_20_500_0.csv").unlink()  # an incomplete clip
    return folder


def test_a_surface_is_all_its_clips_in_si_units_at_the_rate_of_its_samples(dataset: Path) -> None:
    """The documents say 6 kHz, the rows come 8670 times a second: the rate is that of the samples that differ."""
    recording, decisions = read_cluster(dataset, 7)
    assert [take.name for take in recording.takes] == ["7_0_20_500_0", "7_135_40_1000_0", "7_270_60_500_0"]
    assert "3 clips of surface 7" in decisions[0]
    assert recording["acceleration_x"].rate_hz == SENSOR_HZ
    trim_ms, block_ms = fitting_cut(recording)
    trace = preprocess(recording, PreprocessConfig(trim_ms=trim_ms, block_ms=block_ms))
    assert trace.take_blocks == (9, 9, 9)
    speeds = trace.blocks(trace.speed)[:, 100:].mean(axis=1).reshape(3, 9).mean(axis=1)
    np.testing.assert_allclose(speeds, [20, 40, 60], rtol=0.02)
    np.testing.assert_allclose(trace.force.reshape(3, -1).mean(axis=1), [0.5, 1.0, 0.5], atol=0.02)
    spectrum = np.abs(np.fft.rfft(trace.acceleration[:4000]))
    assert np.fft.rfftfreq(4000, 1 / 1000)[spectrum.argmax()] == pytest.approx(TONE_HZ, abs=0.5)
    rms = np.sqrt(np.square(trace.acceleration).mean())
    # DFT321 adds the third axis: 0.5 %; lines between samples: −1 %.
    assert rms == pytest.approx(0.3 * 9.80665 / np.sqrt(2), rel=0.03)


def test_the_command_names_what_there_is_and_keeps_the_credit(
    dataset: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert list(cluster_surfaces(dataset / "sensor_data")) == [7]
    path = tmp_path / "seven.h5"
    for arguments, words in (
        ([], "name one of its surfaces, --surface 7"),
        (["--surface", "3"], "there is no surface 3 in it, --surface 7"),
        (["--surface", "7", "--rate", "6000"], "--rate is for tables"),
        (["--surface", "7", str(dataset)], "got 2 files, expected only the folder of a dataset"),
    ):
        assert _status(["import", str(dataset), "-o", str(path), *arguments]) == 2
        assert words in capsys.readouterr().err
    assert _status(["import", str(tmp_path), "-o", str(path), "--surface", "7"]) == 2
    assert "is a folder of nothing that is known" in capsys.readouterr().err
    assert not path.exists()
    assert _status(["import", str(dataset), "-o", str(path), "--surface", "7", "--texture", "cork"]) == 0
    recording = load_recording(path)
    assert (recording.texture, len(recording.takes)) == ("cork", 3)
    assert "CC BY 4.0" in recording.notes


def test_a_damaged_clip_is_named(tmp_path: Path) -> None:
    write_clip(tmp_path, 1, 0, 20, 500)
    path = tmp_path / "sensor_data" / "position" / "1_0_20_500_0.csv"
    text = path.read_text()
    for damaged, message in (
        (text.replace("50,50", "50,none", 1), ", column Y: row 2 is 'none'"),
        (text + "1e9,50,50\n", " lasts 1e.09 s, expected 0.1 to 7200"),
        ("time,X,Y\n0,1,1\n5e-324,2,2\n1e-323,3,3\n", " lasts 9.88e-324 s, expected 0.1 to 7200"),
    ):
        path.write_text(damaged)
        with pytest.raises(ValueError, match=f"^position/1_0_20_500_0.csv{message}"):
            read_cluster(tmp_path, 1)
