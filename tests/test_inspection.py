"""Faults that were put into a recording are reported, and nothing is where there is none."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from conftest import check_figures
from foten.cli.command_line import _status
from foten.datasets.hdf5 import write_recording
from foten.datasets.importing import import_recording
from foten.datasets.options import ImportOptions, parse_pairs
from foten.recording.inspection import inspect_recording
from foten.recording.inspection.values import NOTE, PROBLEM, UNUSABLE
from foten.recording.preprocess import preprocess
from foten.recording.recording import Channel, Recording
from foten.reporting.recording_pictures import coverage, density, overview, write_pictures
from foten.simulation.simulate import simulate

DATA = Path(__file__).parents[1].parent / "shared" / "data"
GOOD, HOSTILE = DATA / "cdplab-mdtexthapt" / "npz", DATA / "c128391-vibrotactile" / "original"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the recordings of ../shared/data are not here")

RATE = 1000.0
N = 20_000
HUM = np.sin(2 * np.pi * 50 * np.arange(N) / RATE)
LIFTED = np.r_[3000:3200, 9000:9500]
SENSOR = np.random.default_rng(8).normal(0, 0.01, LIFTED.size)  # N, of a force sensor in the air


def _clean():
    """Plausible recording of 20 s at 1 kHz as arrays: a resonance, a hand, a sensor's noise."""
    from scipy.signal import lfilter

    rng = np.random.default_rng(0)
    t = np.arange(N) / RATE
    speed = 120 + 90 * np.sin(2 * np.pi * 0.7 * t) + 15 * np.sin(2 * np.pi * 3.1 * t) + rng.normal(0, 0.05, N)
    force = 1.6 + 0.9 * np.sin(2 * np.pi * 0.43 * t) + 0.2 * np.sin(2 * np.pi * 5.3 * t) + rng.normal(0, 0.01, N)
    excitation = rng.standard_normal(N) * speed / 120
    # Poles at 0.9 e^{±i·2π·0.12}: a resonance at 120 Hz.
    vibration = lfilter([1], [1, -1.8 * np.cos(2 * np.pi * 0.12), 0.81], excitation)
    return {"acceleration": vibration, "speed": speed, "force": force}


def _inspect(samples, rates=None, times=None):
    channels = {
        name: Channel(np.asarray(x, dtype=np.float64), (rates or {}).get(name, RATE), (times or {}).get(name))
        for name, x in samples.items()
    }
    return inspect_recording(Recording(channels))


def _codes(inspection, severity=PROBLEM):
    return {(f.code, f.channel) for f in inspection.findings if f.severity == severity}


def _text(inspection, code, channel=None):
    return next(f.text for f in inspection.findings if f.code == code and channel in (None, f.channel))


def test_nothing_is_wrong_with_a_clean_recording():
    inspection = _inspect(_clean())
    assert inspection.problems == ()
    assert {code for code, _ in _codes(inspection, "note")} <= {"noise", "range", "coverage"}


@pytest.mark.parametrize("key", ["cardboard", "artificial-grass", "smooth-rubber", "linear-cloth"])
def test_a_simulated_recording_is_clean_but_for_its_clipping(key):
    # The simulated accelerometer has a range of ±3 g, which hard impacts exceed.
    assert {code for code, _ in _codes(inspect_recording(simulate(key, seconds=12)))} <= {"clipping"}


def test_the_numbers_of_a_channel():
    samples = _clean()
    report = next(c for c in _inspect(samples).channels if c.name == "force")
    assert (report.rate_hz, report.n_samples, report.duration_s, report.unit) == (1000, N, 20, "N")
    assert (report.minimum, report.maximum) == (samples["force"].min(), samples["force"].max())
    assert report.noise_floor == pytest.approx(0.01, rel=0.05)  # what was put in; the estimate's own error is 1 %


def test_noise_floor_of_an_accelerometer_at_standstill():
    samples = _clean()
    still = slice(8000, 11_000)
    samples["speed"][still] = 0.5
    samples["acceleration"][still] = 9.81 + np.random.default_rng(1).normal(0, 0.03, 3000)
    report = _inspect(samples).channels[0]
    assert report.noise_floor_from == "rest"
    assert report.noise_floor == pytest.approx(0.03, rel=0.1)


def _put(at, value):
    """Change of a channel that has a value at some samples."""

    def put(x):
        x[at] = value
        return x

    return put


@pytest.mark.parametrize(
    ("channel", "change", "kind", "text"),
    [
        ("force", _put([400, 9000], [505_831, -30]), "problem spikes", "2 spikes .*505831 N at sample 400 .0.400 s"),
        ("acceleration", _put(777, 200), "problem spikes", "1 spike of one or two samples"),
        ("acceleration", lambda x: np.clip(x, -3, 3), "problem clipping", "is clipped: .* highest"),
        ("acceleration", lambda x: np.maximum(x, -3), "problem clipping", "is clipped: .* lowest"),
        ("acceleration", _put(slice(6000, 6300), 0.5), "problem frozen", "to the last digit in 1 place"),
        ("force", lambda x: x[::10].repeat(10), "note repeated", "captured at 100 Hz and each value repeated"),
        ("acceleration", lambda x: x + 2 * HUM, "note pattern", "mains hum"),
        ("force", _put(LIFTED, SENSOR), "note contact", "in 2 places, 0.7 s together, the longest 0.5 s at 9.00 s"),
        ("speed", lambda x: x - 100, "unusable refused", "training refuses it: speed is negative"),
        ("speed", lambda x: x + 110, "note range", "never slower than 12"),
        ("speed", lambda x: x + 110, "note range", "force above 2.7 N never visited: above it the level grows"),
        ("speed", lambda x: x / 3, "note range", "never faster than 7"),
        ("force", lambda x: x + 1, "note range", "never lighter than 1.5"),
        (
            "force",
            lambda x: 20 * x + 15,
            "unusable coverage",
            "nothing of the plane up to .* was visited, only .*units right",
        ),
        ("speed", lambda x: x / 1000, "problem units", r"peaks at 0.2\d+, expected mm/s .*was it given in m/s"),
        ("force", lambda x: x / 9.80665e-3, "problem units", "peaks at .*was it given in mN or gf"),
        ("acceleration", lambda x: 1000 * x, "problem units", "was it given in mm/s² or mg"),
        ("acceleration", lambda x: x / 10_000, "problem units", "was it given in g or V"),
    ],
)
def test_a_fault_is_reported_and_hardly_any_other(channel, change, kind, text):
    samples = _clean()
    samples[channel] = change(samples[channel])
    inspection = _inspect(samples)
    texts = [f.text for f in inspection.findings if f"{f.severity} {f.code}" == kind]
    assert any(re.search(text, found) for found in texts), texts
    # What no hand does is refused as well, and by its sign; where it rests or is lifted, all is noise.
    also = {"refused", "sign", "noise"} if re.search("sign|refused|spikes|units|contact", kind) else set()
    also |= {"coverage"} if inspection.coverage and not inspection.coverage.fraction else set()
    also |= {"units"} if kind == "unusable coverage" else set()
    assert {code for code, _ in _codes(inspection)} - also <= {kind.split()[1]}


def test_a_light_touch_is_no_loss_of_contact():
    samples = _clean()
    samples["force"] = np.maximum(samples["force"] - 0.35, 0.1)
    assert "contact" not in {finding.code for finding in _inspect(samples).findings}


def _shuffled(n_rows, seed=3):
    order = np.arange(N).reshape(-1, n_rows)
    return np.random.default_rng(seed).permutation(order).ravel()


@pytest.mark.parametrize("n_rows", [10, 40, 500])
def test_pieces_in_a_wrong_order(n_rows):
    order = _shuffled(n_rows)
    inspection = _inspect({name: x[order] for name, x in _clean().items()})
    assert {("order", "speed"), ("order", "force")} <= _codes(inspection)
    assert f"multiples of {n_rows} samples" in _text(inspection, "order", "speed")
    assert "at the same rows as in" in _text(inspection, "order", "force")
    places = np.array(next(f.places_s for f in inspection.findings if f.code == "order"))
    assert np.mean((np.round(places * RATE).astype(int) + 1) % n_rows == 0) > 0.8


def test_single_rows_in_a_wrong_order():
    order = np.random.default_rng(4).permutation(N)
    inspection = _inspect({name: x[order] for name, x in _clean().items()})
    assert {("order", "speed"), ("order", "force"), ("white", "acceleration")} <= _codes(inspection)


def test_a_vibration_without_memory_and_with_a_fixed_pattern():
    samples = _clean()
    rng = np.random.default_rng(5)
    samples["acceleration"] = rng.standard_normal(N) + np.tile(rng.standard_normal(10), N // 10)
    inspection = _inspect(samples)
    assert "repeats exactly every 10 samples (100 Hz)" in _text(inspection, "pattern")
    assert {("pattern", "acceleration"), ("white", "acceleration")} <= _codes(inspection)
    samples["acceleration"] = rng.standard_normal(N) + np.tile([1.0, -1.0], N // 2)
    assert "repeats exactly every 2 samples (500 Hz)" in _text(_inspect(samples), "pattern")


def test_a_coarse_slow_sensor_is_not_clipped():
    samples = _clean()
    samples["force"] = np.round(samples["force"] / 0.05) * 0.05
    samples["speed"] = np.round(samples["speed"])
    assert _inspect(samples).problems == ()


@pytest.mark.parametrize("digits", [2, 3, 4])
@pytest.mark.parametrize("hz", [0.2, 0.5, 1.3, 4.0])
def test_the_rounded_tops_of_a_smooth_force_are_not_clipped(digits, hz):
    t = np.arange(N) / RATE
    samples = _clean()
    samples["force"] = np.round(0.8 + 0.5 * np.sin(2 * np.pi * hz * t + 0.3), digits)
    assert not any(code == "clipping" for code, _ in _codes(_inspect(samples)))


@pytest.mark.parametrize("hz", [0.2, 0.5, 1.3, 4.0])
def test_a_smooth_rounded_force_cut_off_at_its_tops_is_clipped(hz):
    t = np.arange(N) / RATE
    samples = _clean()
    samples["force"] = np.round(np.minimum(0.8 + 0.5 * np.sin(2 * np.pi * hz * t + 0.3), 1.25), 4)
    inspection = _inspect(samples)
    assert [f.channel for f in inspection.findings if f.code == "clipping"] == ["force"]
    assert "highest value, 1.25 N" in _text(inspection, "clipping")


@pytest.mark.parametrize("share", [0.98, 0.3])
def test_few_peaks_at_the_limit_of_an_accelerometer_are_clipped(share):
    """Runs of 3, 5 and 3 equal samples at 3001.0 mg were none: they were held against the few other pairs of equal samples."""
    t = np.arange(40_000) / 10_000
    strength = 1 + 0.8 * np.sin(2 * np.pi * 0.6 * t)
    x = np.round(strength * np.sin(2 * np.pi * 180 * t) + 0.2 * np.sin(2 * np.pi * 37.3 * t), 4)
    for limit, expected in ((share * x.max(), True), (x.max(), False)):
        recording = Recording({"acceleration": Channel(np.minimum(x, np.round(limit, 4)), 10_000.0)})
        found = [f for f in inspect_recording(recording).findings if f.code == "clipping"]
        assert bool(found) == expected
        if expected:
            few = share == 0.98
            assert ("so few change little: nothing to do" in found[0].text) == few == (found[0].severity == NOTE)


@pytest.mark.parametrize("key", ["plastic-mesh", "towel", "smooth-rubber", "linear-cloth"])
@pytest.mark.parametrize("digits", [None, 2, 3])
def test_only_the_limit_of_the_simulated_accelerometer_clips(key, digits):
    recording = simulate(key, seconds=12, seed=1)
    rounded = {
        name: Channel(c.samples if digits is None else np.round(c.samples, digits), c.rate_hz, c.times_s)
        for name, c in recording.channels.items()
    }
    clipped = [f.channel for f in inspect_recording(Recording(rounded)).findings if f.code == "clipping"]
    assert bool(clipped) == (key in ("plastic-mesh", "towel"))
    for name in clipped:  # within a step of its converter
        assert np.abs(rounded[name].samples).max() == pytest.approx(3 * 9.80665, abs=0.03)


@pytest.mark.parametrize(
    ("height", "severity", "advice"),
    [(0.3, NOTE, "nothing to do: the low-pass .* leaves 0.0"), (300, PROBLEM, "blank their cells .* --fill-gaps 3")],
)
def test_a_spike_comes_with_what_to_do(height, severity, advice):
    samples = _clean()
    samples["force"][5000] += height
    inspection = _inspect(samples)
    assert ("spikes", "force") in _codes(inspection, severity)
    assert re.search(advice, _text(inspection, "spikes"))
    samples["acceleration"][777] = 200
    assert "if they are no impacts, cut the table there" in _text(_inspect(samples), "spikes", "acceleration")


def test_axes_of_one_sensor_jump_together_under_an_impact():
    """The load cell's x and y were "probably not in time order" beside its z."""
    rng = np.random.default_rng(3)
    t = np.arange(40_000) / 10_000
    struck = np.zeros(t.size)
    for at in rng.integers(60, 240, 250).cumsum():
        struck[at : at + 30] = 0.1
    z = 1.6 + 0.9 * np.sin(2 * np.pi * 0.43 * t) + struck + rng.normal(0, 0.001, t.size)
    samples = {"force_z": z, "force_x": z / 3 + rng.normal(0, 0.001, t.size), "acceleration": rng.normal(0, 1, t.size)}
    inspection = _inspect(samples, dict.fromkeys(samples, 10_000.0))
    assert {f.channel for f in inspection.findings if f.code == "jumps"} == {"force_z", "force_x"}
    assert not any(f.code == "order" for f in inspection.findings)


def test_a_channel_that_starts_late_leaves_the_common_part():
    samples = _clean()
    times = np.arange(3000, N - 2000) / RATE
    late = samples | {"speed": samples["speed"][3000 : N - 2000]}
    inspection = _inspect(late, times={"speed": times})
    assert [f.channel for f in inspection.findings if f.code == "durations"] == ["speed"]
    assert _text(inspection, "durations").startswith("speed covers 3.00 to 18.00 s, of 0.00 to 20.00 s: training uses")
    first = {name: x[:16_000] for name, x in samples.items()} | {"speed": late["speed"][:13_000]}
    inspection = _inspect(first, times={"speed": times[:13_000]})
    assert inspection.cut_ms == (0, 500)  # of 16 s, the 13 that are common
    assert "\ntraining cuts it into blocks of 500 ms, with nothing trimmed" in inspection.to_text()


@pytest.mark.parametrize(
    ("seconds", "options"),
    [(20, "--rate 1000"), (1.9, "--rate 10000 --trim 0 --block 200"), (3, "--rate 2500 --trim 0 --block 200")],
)
def test_inspection_and_training_give_a_short_recording_the_same_options(seconds, options):
    slow = np.repeat(np.stack(list(_clean().values())), 10, axis=1)  # at 10 kHz, nothing beyond 1 kHz that counts
    samples = dict(zip(_clean(), slow[:, : round(10_000 * seconds)], strict=True))
    samples["acceleration"] = np.sin(2 * np.pi * 100 * np.arange(samples["force"].size) / 10_000)
    recording = Recording({name: Channel(x, 10_000.0) for name, x in samples.items()})
    inspection = inspect_recording(recording)
    assert inspection.options == inspection.to_dict()["options"] == options
    assert f"train with {options}\n" in inspection.to_text()
    cut = "\ntraining cuts it into blocks of 500 ms, with nothing trimmed at the ends; --block and --trim"
    assert (cut in inspection.to_text()) == (seconds == 20)
    if seconds < 14:
        begun_late = {name: Channel(x, 10_000.0, 90 + np.arange(x.size) / 10_000) for name, x in samples.items()}
        assert inspect_recording(Recording(begun_late)).options == options
        assert f"14 s: train with {options}" in _text(inspection, "short")
        with pytest.raises(ValueError, match=f"less than 5 blocks of 2000 ms; use {options}$"):
            preprocess(recording, n_blocks=5)


def test_a_still_pen_with_noisy_positions_is_at_a_standstill():
    # 0.05 mm at 1 kHz read 44 mm/s when the norm was taken before the low-pass.
    rng = np.random.default_rng(6)
    samples = _clean()
    samples["acceleration"] = rng.normal(0, 0.03, N)
    del samples["speed"]
    samples |= {name: 50 + rng.normal(0, 0.05, N) for name in ("position_x", "position_y")}
    inspection = _inspect(samples)
    assert inspection.channels[0].noise_floor_from == "rest"
    assert inspection.coverage is None


def test_gaps_in_time():
    samples = _clean()
    recorded = np.delete(np.arange(N), np.r_[5000:5200, 8000:8003])
    times = recorded / RATE
    inspection = _inspect(samples | {"speed": samples["speed"][recorded]}, times={"speed": times})
    assert "2 gaps in time, about 203 samples lost; the longest lasts 201 ms at 4.999 s" in _text(inspection, "gaps")


def test_coverage_counts_the_seconds_in_each_cell():
    n = 4000
    speed = np.concatenate([np.full(n, 60.0), np.full(n, 210.0), np.full(n, 1.0)])
    force = np.concatenate([np.full(n, 0.7), np.full(n, 2.2), np.full(n, 2.2)])
    vibration = np.random.default_rng(0).standard_normal(3 * n)
    coverage = _inspect({"acceleration": vibration, "speed": speed, "force": force}).coverage
    assert coverage.covered == 2  # the third part is at rest
    # The low-pass takes 50 ms at the ends of the recording and some 20 ms at the step.
    assert coverage.seconds[2, 1] == pytest.approx(4, abs=0.08)
    assert coverage.seconds[8, 4] == pytest.approx(4, abs=0.08)
    assert coverage.fraction == 2 / coverage.seconds.size


def test_speed_comes_from_positions_and_force_from_its_normal():
    t = np.arange(2400) / 120
    channels = {
        "position_x": Channel(50 + 40 * np.sin(2 * np.pi * 0.5 * t), 120.0),
        "position_y": Channel(50 + 40 * np.cos(2 * np.pi * 0.5 * t), 120.0),
        "force_z": Channel(np.full(20_000, -1.3), 1000.0),
    }
    coverage = inspect_recording(Recording(channels)).coverage
    # A circle of 40 mm radius at half a turn a second: 40·π mm/s; central differences at 120 Hz lose 0.01 %.
    assert coverage.speed_range[0] == pytest.approx(40 * np.pi, rel=0.01)
    assert coverage.force_range == (pytest.approx(1.3), pytest.approx(1.3))


@pytest.mark.parametrize(("jitter", "is_noted"), [(0.03, False), (0.08, True)])
def test_an_unsteady_sampling_period_is_noted(jitter, is_noted):
    samples = _clean()
    # Of a uniform deviation the median is half of the largest.
    times = np.cumsum(1 + np.random.default_rng(0).uniform(-2 * jitter, 2 * jitter, N)) / RATE
    notes = _codes(_inspect(samples, times={"speed": times}), "note")
    assert (("jitter", "speed") in notes) == is_noted


def test_a_tone_of_an_instrument_is_a_narrow_line():
    samples = _clean()
    samples["acceleration"] = samples["acceleration"] + 2 * np.sin(2 * np.pi * 312.5 * np.arange(N) / RATE)
    assert "narrow lines at 312.5 Hz" in _text(_inspect(samples), "lines")


def test_missing_channels_and_slow_accelerometers_are_problems():
    samples = _clean()
    assert ("missing", "acceleration") in _codes(_inspect({k: samples[k] for k in ("speed", "force")}), UNUSABLE)
    alone = _inspect({"acceleration": samples["acceleration"]})
    assert {("missing", "speed"), ("missing", "force")} <= _codes(alone, UNUSABLE)
    assert alone.verdict == "record again: there is no speed, and no position to take it from"
    assert ("rate", "acceleration") in _codes(_inspect(samples, rates=dict.fromkeys(samples, 500.0)))


@pytest.mark.parametrize(
    ("channel", "value", "text"),
    [
        ("speed", 0.3, "record again: speed never exceeds 0.3 mm/s, so the tool rests from begin to end"),
        ("force", 0.0, "record again: force never exceeds"),
    ],
)
def test_a_recording_without_a_stroke_is_of_no_use(channel, value, text):
    """Zero force, zero speed and m/s were learned from without a word."""
    inspection = _inspect({**_clean(), channel: np.full(N, value)})
    assert inspection.verdict.startswith(text)
    assert not inspection.to_dict()["usable"]


def test_the_last_line_says_what_a_recording_is_good_for():
    """It said "no problem found" of a recording that visited 15 % of the conditions."""
    few = _inspect({**_clean(), "speed": _clean()["speed"] / 3})
    assert few.coverage.fraction < 0.25
    assert re.fullmatch(r"usable from \d+ to \d+ mm/s and from [\d.]+ to [\d.]+ N, a small part.*", few.verdict)
    assert few.to_text().splitlines()[-1] == few.verdict
    clipped = _inspect({**_clean(), "acceleration": np.clip(_clean()["acceleration"], -3, 3)})
    assert clipped.verdict.startswith("usable with care (2 problems above) from 15 to 220 mm/s and from 0.")
    grams = _inspect({**_clean(), "force": _clean()["force"] / 9.80665e-3})
    assert grams.verdict.startswith("record again: nothing of the plane up to 300 mm/s and 10 N was visited, only")


@needs_data
@pytest.mark.parametrize("texture", ["copper", "fabric", "leather", "wood"])
def test_no_false_alarm_on_real_recordings(texture):
    recording = import_recording([GOOD / f"{texture}.npz"], ImportOptions(rate_hz=10_000))[0]
    inspection = inspect_recording(recording)
    assert inspection.problems == ()
    notes = {code for code, _ in _codes(inspection, "note")}
    assert {"short", "range"} <= notes <= {"short", "range", "coverage", "noise", "lines"}
    assert "never slower than" in inspection.to_text()


@needs_data
@pytest.mark.parametrize("k", [2, 4, 5])
def test_a_hostile_recording_is_seen_through(k):
    paths = [HOSTILE / f"T{k}" / f"{k}-{name}.xlsx" for name in ("acc", "speed", "force")]
    mapping = tuple(parse_pairs([f"acceleration={k}-acc:0,speed={k}-speed:0,force={k}-force:0"], "--map"))
    if k == 5:
        with pytest.raises(ValueError, match=r"speed reaches 39788.1 mm/s at sample 143.*spikes"):
            import_recording(paths, ImportOptions(mapping, rate_hz=1000))
    recording = import_recording(paths, ImportOptions(mapping, rate_hz=1000, force_units=True))[0]
    assert all(channel.samples.size == 10_000 for channel in recording.channels.values())  # the first row too
    inspection = inspect_recording(recording)
    for name in ("speed", "force"):
        assert {("order", name), ("spikes", name)} <= _codes(inspection)
        assert "at multiples of 10 samples" in _text(inspection, "order", name)
    assert {("white", "acceleration"), ("pattern", "acceleration")} <= _codes(inspection)
    assert "every 10 samples" in _text(inspection, "pattern")
    if k == 5:
        assert "505831 N at sample 7616" in _text(inspection, "spikes", "force")
        assert "speed is negative" in _text(inspection, "refused")


def test_the_command(tmp_path, capsys):
    samples = _clean()
    samples["force"][400] = 90
    recording = Recording({name: Channel(x, RATE) for name, x in samples.items()}, texture="denim")
    write_recording(recording, tmp_path / "a.h5")
    assert _status(["inspect", str(tmp_path / "a.h5"), "-o", str(tmp_path / "out")]) == 0
    captured = capsys.readouterr()
    assert "problem  force: 1 spike" in captured.out
    assert {p.name for p in (tmp_path / "out").iterdir()} == {"inspect.json", "overview.png", "coverage.png", "psd.png"}
    document = json.loads((tmp_path / "out" / "inspect.json").read_text())
    assert document["recording_sha256"] == recording.sha256()
    assert _status(["inspect", str(tmp_path / "a.h5"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == document
    assert _status(["inspect", str(tmp_path / "a.h5"), "--strict"]) == 1
    capsys.readouterr()
    assert _status(["inspect", str(tmp_path / "a.csv")]) == 2
    assert capsys.readouterr().err.startswith("foten: no such file")


def _recording(**changed):
    samples = _clean()
    vibration = samples.pop("acceleration")
    samples = {"acceleration_x": vibration, "acceleration_z": vibration[::-1].copy(), **samples, **changed}
    return Recording({name: Channel(x, RATE) for name, x in samples.items()}, texture="denim")


def test_one_panel_a_channel_with_its_unit_and_its_marks():
    force = _recording()["force"].samples.copy()
    force[5000] = 800
    recording = _recording(force=force)
    figure = overview(recording, inspect_recording(recording))
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["acceleration x\n[m/s²]", "acceleration z\n[m/s²]", "speed\n[mm/s]", "force\n[N]"]
    panel = figure.axes[3]
    (marks,) = [line for line in panel.lines if line.get_label() == "spikes"]
    assert marks.get_xdata() == pytest.approx([5.0])
    assert panel.get_ylim()[1] < 10  # the spike does not hide the signal, and the picture says so
    assert any("to 800 N" in text.get_text() for text in panel.texts)


def test_the_pictures_are_as_they_were_looked_at():
    """Of twenty and of eight seconds an envelope, of five the samples; marks of problems and of notes."""
    force = np.maximum(_recording()["force"].samples, 0.9)
    force[LIFTED], force[5000] = SENSOR, 800
    vibration = _put(slice(6000, 6300), 0.5)(np.clip(_recording()["acceleration_x"].samples, -3, 3))
    long = _recording(acceleration_x=vibration, force=force)
    n_samples = {"acceleration_x": 8000, "acceleration_z": 5000, "speed": 5000, "force": 5000}
    short = Recording({name: Channel(_recording()[name].samples[:n], RATE) for name, n in n_samples.items()})
    drawn = {draw.__name__: draw(long, inspect_recording(long)) for draw in (overview, coverage, density)}
    drawn |= {"overview-short": overview(short, inspect_recording(short))}
    check_figures({f"recording-{name}": figure for name, figure in drawn.items()})


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
    variance = recording["acceleration_x"].samples.var()
    assert power.sum() * (frequency[1] - frequency[0]) == pytest.approx(variance, rel=0.05)


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
