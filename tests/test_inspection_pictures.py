"""Figures show the findings, with units, for any set of channels."""

import numpy as np
import pytest

from foten.recording.inspection import inspect_recording
from foten.recording.inspection.pictures import coverage, density, overview, write_pictures
from foten.recording.recording import Channel, Recording

N = 12_000


def _recording(**extra):
    rng = np.random.default_rng(0)
    t = np.arange(N) / 1000
    channels = {
        "acceleration_x": Channel(np.convolve(rng.standard_normal(N + 7), np.ones(8), "valid"), 1000.0),
        "acceleration_z": Channel(np.convolve(rng.standard_normal(N + 7), np.ones(8), "valid"), 1000.0),
        "speed": Channel(120 + 90 * np.sin(t), 1000.0),
        "force": Channel(1 + 0.5 * np.sin(0.7 * t), 1000.0),
    }
    return Recording(channels | extra, texture="denim")


def test_one_panel_a_channel_with_its_unit_and_its_marks():
    force = _recording()["force"].samples.copy()
    force[5000] = 800
    recording = _recording(force=Channel(force, 1000.0))
    figure = overview(recording, inspect_recording(recording))
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["acceleration x\n[m/s²]", "acceleration z\n[m/s²]", "speed\n[mm/s]", "force\n[N]"]
    panel = figure.axes[3]
    (marks,) = [line for line in panel.lines if line.get_label() == "spikes"]
    assert marks.get_xdata() == pytest.approx([5.0])
    assert panel.get_ylim()[1] < 10  # the spike does not hide the signal, and the picture says so
    assert any("to 800 N" in text.get_text() for text in panel.texts)


def test_an_envelope_loses_no_extreme():
    recording = _recording()
    figure = overview(recording, inspect_recording(recording))
    (band,) = figure.axes[0].collections
    drawn = band.get_paths()[0].vertices[:, 1]
    samples = recording["acceleration_x"].samples
    assert (drawn.min(), drawn.max()) == (samples.min(), samples.max())


def test_coverage_and_density_show_the_numbers_of_the_inspection():
    recording = _recording()
    inspection = inspect_recording(recording)
    figure = coverage(recording, inspection)
    mesh = figure.axes[0].collections[0]
    np.testing.assert_array_equal(mesh.get_array().filled(0), inspection.coverage.seconds.T)
    assert figure.axes[0].get_xlabel() == "scanning speed [mm/s]"
    lines = density(recording, inspection).axes[0].lines
    for name, line in zip(("acceleration x", "acceleration z"), lines, strict=False):
        assert line.get_label() == name
    np.testing.assert_array_equal(lines[0].get_ydata(), inspection.psd["acceleration_x"][1])


def test_density_integrates_to_the_variance():
    # Parseval: a density in (m/s²)²/Hz and not a spectrum; Welch's windows cost a few percent.
    recording = _recording()
    frequency, power = inspect_recording(recording).psd["acceleration_x"]
    assert power.sum() * (frequency[1] - frequency[0]) == pytest.approx(
        recording["acceleration_x"].samples.var(), rel=0.05
    )


def test_only_the_pictures_that_the_channels_allow_are_written_and_they_are_reproducible(tmp_path):
    recording = _recording()
    inspection = inspect_recording(recording)
    names = [path.name for path in write_pictures(recording, inspection, tmp_path)]
    assert names == ["overview.png", "coverage.png", "psd.png"]
    first = {name: (tmp_path / name).read_bytes() for name in names}
    write_pictures(recording, inspection, tmp_path)
    assert first == {name: (tmp_path / name).read_bytes() for name in names}
    alone = Recording({"speed": recording["speed"]})
    (tmp_path / "alone").mkdir()
    assert [p.name for p in write_pictures(alone, inspect_recording(alone), tmp_path / "alone")] == ["overview.png"]
