"""Columns to channels: mapped or guessed, converted, timed; refused in one line otherwise."""

import json
import re
import shlex
import struct

import h5py
import numpy as np
import openpyxl
import pytest
from nptdms import ChannelObject, TdmsWriter
from scipy.io import savemat, wavfile

from foten.cli.command_line import _status
from foten.datasets.binary import read_wav
from foten.datasets.hdf5 import load_recording
from foten.datasets.importing import DATASETS, import_recording, read_columns, read_stroke
from foten.datasets.isolated import isolated_columns
from foten.datasets.options import ImportOptions, parse_pairs, parse_rates
from foten.datasets.tabular import clock_seconds
from foten.datasets.timing import irregular, rate_of
from foten.datasets.units import FULL_SCALE

N = 2000
TIME = np.arange(N) / 1000
ACC = np.random.default_rng(0).standard_normal(N)
SPEED = 100 + 80 * np.sin(2 * np.pi * TIME)
FORCE = 1 + 0.5 * np.cos(2 * np.pi * TIME)
SUGGESTED = "time=0,acceleration=1,speed=2,force=3"


def _csv(path, header, *columns):
    rows = (("" if np.isnan(value) else repr(float(value)) for value in row) for row in zip(*columns, strict=True))
    path.write_text("\n".join([*([header] if header else []), *map(",".join, rows)]) + "\n")
    return path


def _import(path, **options):
    paths = path if isinstance(path, list) else [path]
    mapping = tuple(parse_pairs([options.pop("map", "")], "--map"))
    units = dict(parse_pairs([options.pop("unit", "")], "--unit"))
    rate_hz, rates_hz = parse_rates([str(options.pop("rate", ""))])
    return import_recording(paths, ImportOptions(mapping, units, rate_hz, rates_hz, **options))[0]


def _write(path):
    """Write acceleration, speed and force in a file of any format in the registry."""
    columns = {"acceleration": ACC, "speed": SPEED, "force": FORCE}
    match path.suffix:
        case ".csv" | ".txt" | ".dat":
            _csv(path, ",".join(columns), *columns.values())
        case ".tsv":
            np.savetxt(path, np.stack(list(columns.values()), axis=1), "%.17g", "\t")
        case ".xlsx":
            book = openpyxl.Workbook()
            book.active.append(list(columns))
            for row in zip(*columns.values(), strict=True):
                book.active.append([float(value) for value in row])
            book.save(path)
        case ".npz":
            np.savez(path, **columns)
        case ".npy":
            np.save(path, np.stack(list(columns.values()), axis=1))
        case ".mat":
            savemat(path, columns)
        case ".h5" | ".hdf5":
            with h5py.File(path, "w") as file:
                for name, samples in columns.items():
                    file[name] = samples
        case ".tdms":
            with TdmsWriter(path) as writer:
                writer.write_segment([ChannelObject("rig", name, samples) for name, samples in columns.items()])
        case ".wav":
            wavfile.write(path, 1000, np.stack(list(columns.values()), axis=1))


@pytest.mark.parametrize("suffix", DATASETS)
def test_every_format_gives_the_same_recording(tmp_path, suffix):
    path = tmp_path / f"rig{suffix}"
    _write(path)
    columns = ("0", "1", "2") if suffix in (".npy", ".tsv", ".wav") else ("acceleration", "speed", "force")
    recording = _import(path, map="acceleration={},speed={},force={}".format(*columns), rate=1000)
    for name, samples in {"acceleration": ACC, "speed": SPEED, "force": FORCE}.items():
        # Excel keeps 15 to 17 digits of a number, every other format all bits.
        np.testing.assert_allclose(recording[name].samples, samples, rtol=1e-15 if suffix == ".xlsx" else 0)
        assert (recording[name].rate_hz, recording[name].times_s) == (1000, None)


@pytest.mark.parametrize("suffix", [suffix for suffix in DATASETS if suffix not in (".csv", ".tsv", ".txt", ".dat")])
@pytest.mark.parametrize("damage", ["late", "early", "foreign", "empty"])
def test_a_damaged_file_of_any_format_is_refused_in_a_line(tmp_path, suffix, damage):
    path = tmp_path / f"rig{suffix}"
    _write(path)
    data = path.read_bytes()
    path.write_bytes({"late": data[:-100], "early": data[:60], "foreign": b"force\n1\n2\n" * 99, "empty": b""}[damage])
    with pytest.raises(ValueError, match=rf"^rig{suffix} (is (truncated|empty|not an HDF5)|holds no column)[^\n]*$"):
        read_columns(path)


def test_a_force_in_three_axes_is_projected_on_the_stated_normal(tmp_path):
    """Sec. III-c, of a sensor that stands askew; without a normal it is z, and that is said."""
    header = "t,acc,force_x,force_y,force_z,speed"
    path = _csv(tmp_path / "a.csv", header, TIME, ACC, 3 * FORCE, 4 * FORCE, FORCE, SPEED)
    recording, decisions = import_recording([path], ImportOptions(normal=(0.6, 0.8, 0.0)))
    np.testing.assert_allclose(recording["force"].samples, 5 * FORCE, rtol=1e-12)
    assert recording.normal_force == ["force"]
    assert "along the surface's normal (0.6, 0.8, 0.0)" in " ".join(recording.history)
    longer, _ = import_recording([path], ImportOptions(normal=(6.0, 8.0, 0.0)))
    np.testing.assert_allclose(longer["force"].samples, 5 * FORCE, rtol=1e-12)
    usual, said = import_recording([path], ImportOptions())
    assert usual.normal_force == ["force_z"]
    assert "the normal force is force_z; --normal x,y,z states another normal of the surface" in said
    path = _csv(tmp_path / "b.csv", "t,acc,force_z,speed", TIME, ACC, FORCE, SPEED)
    for sentences in (decisions, import_recording([path], ImportOptions())[1]):  # of one axis it would be of no use
        assert not any("normal" in sentence for sentence in sentences)


@pytest.mark.parametrize(
    ("header", "normal", "match"),
    [
        ("t,acc,force_x,force_z,speed", (0, 0, 1), "found force_x, force_z"),
        ("t,acc,force,speed", (0, 0, 1), "force_x, force_y and force_z, found force$"),
        ("t,acc,speed", (0, 0, 1), "found none"),
        ("t,acc,force,speed", (0, 0, 0), "expected three finite numbers, not all 0"),
        ("t,acc,force,speed", (0, np.inf, 0), "expected three finite numbers"),
    ],
)
def test_a_normal_that_cannot_be_is_refused(tmp_path, header, normal, match):
    columns = [TIME, ACC, *[FORCE] * (header.count("force")), SPEED]
    path = _csv(tmp_path / "a.csv", header, *columns)
    with pytest.raises(ValueError, match=match):
        import_recording([path], ImportOptions(normal=normal))


def test_axes_of_a_force_at_other_times_have_no_projection(tmp_path):
    """Of two files whose clocks run 0.2 s apart: to add them sample by sample would be a force that nobody pressed with."""
    late = TIME + 0.2 + 1e-4 * np.sin(np.arange(TIME.size))  # unsteady, so that they are kept
    first = _csv(tmp_path / "a.csv", "t,acc,speed,force_x,force_y", TIME, ACC, SPEED, FORCE, FORCE)
    other = _csv(tmp_path / "b.csv", "t,force_z", late, FORCE)
    with pytest.raises(ValueError, match="the axes of the force have other times: --normal needs those of one sensor"):
        import_recording([first, other], ImportOptions(normal=(0.0, 0.0, 1.0)))


def test_headers_that_leave_no_doubt_need_no_map(tmp_path):
    path = _csv(tmp_path / "a.csv", "Time (s),Accel [g],Velocity,Normal Force,friction", TIME, ACC, SPEED, FORCE, FORCE)
    recording, decisions = import_recording([path], ImportOptions())
    assert set(recording.channels) == {"acceleration", "speed", "force"}
    np.testing.assert_allclose(recording["acceleration"].samples, ACC * 9.80665, rtol=1e-15)  # the header says g
    assert recording["force"].rate_hz == 1000
    assert "left out: friction" in decisions
    assert "acceleration was converted from g to m/s^2" in recording.history


@pytest.mark.parametrize(
    ("header", "mapped"),
    [
        ("Uhrzeit,Vibration,Vorschub,Anpresskraft", "time acceleration speed force"),
        ("Takt [ms],Kanal 1 [m/s²],Kanal 2 [mm/s],Druck [N]", "time acceleration speed force"),  # by their units
        ("t,Beschl. längs,Beschl. quer,Beschl. hoch,Weg X,Weg Y,F", "time ax ay az px py force"),
        ("t,a,v,Kanal 3 [N],Reibung [N]", "time acceleration speed force"),  # which is not normal to the surface
    ],
)
def test_headers_of_many_labs_need_no_map(tmp_path, header, mapped):
    """`Anpresskraft [N]` was unknown, and the example mapped accelerations to speed and force."""
    columns = [1000 * TIME if "[ms]" in header else TIME, ACC, SPEED, FORCE, FORCE, ACC, FORCE]
    path = _csv(tmp_path / "a.csv", header, *columns[: header.count(",") + 1])
    recording, decisions = import_recording([path], ImportOptions())
    names = {"a": "acceleration", "p": "position"}
    short = {f"{letter}{axis}": f"{names[letter]}_{axis}" for letter in names for axis in "xyz"}
    assert {"time", *recording.channels} == {short.get(name, name) for name in mapped.split()}
    assert recording.normal_force is not None
    assert shlex.split(decisions[0])[-1].startswith("time=")  # that can be pasted


def test_a_map_adds_to_what_the_headers_say(tmp_path):
    """It replaced all of it: whoever named one column lost the others."""
    path = _csv(tmp_path / "a.csv", "t,acc,v,Fz_norm [au],f_reib", TIME, ACC, SPEED, FORCE, FORCE)
    _, decisions = import_recording([path], ImportOptions())
    missing = "there is no normal force (force or force_z); it may be Fz_norm [au]: add --map 'force=Fz_norm [au]'"
    assert missing in decisions
    recording = _import(path, map="force=Fz_norm [au]", unit="force=*2")
    assert set(recording.channels) == {"acceleration", "speed", "force"}
    np.testing.assert_array_equal(recording["force"].samples, 2 * FORCE)
    assert set(_import(path, map="time=t,position_x=v,position_y=f_reib").channels) == {
        *("acceleration", "position_x", "position_y")  # a speed would be a second movement
    }


def test_what_stands_above_a_table_is_said(tmp_path):
    path = _csv(tmp_path / "a.csv", "Lab 4\nSensor;ADXL356\n\nt,acc,v,F [cN]", TIME, ACC, SPEED, 100 * FORCE)
    recording, decisions = import_recording([path], ImportOptions())
    assert "above the table: Lab 4; Sensor;ADXL356; --tool, --sensors and --notes keep such things" in decisions
    np.testing.assert_allclose(recording["force"].samples, FORCE, rtol=1e-12)


RISES = "Stempel always rises: if it is the time, --map time=Stempel,position_x=x,position_y=y; or give"
MAP_XY = {"map": "position_x=x,position_y=y"}


@pytest.mark.parametrize(
    ("header", "columns", "options", "match"),
    [
        ("", "TAS", {"map": "time=0"}, "only time is mapped, expected a channel as well"),
        ("a,acc,Dehnung [V]", "ASF", {}, "--map acceleration=a,speed=COLUMN,force=COLUMN$"),  # none of another unit
        ("Lage [V],a", "AS", {"rate": 1000, "map": "speed=a,force=a"}, "force are both mapped to a, expected a column"),
        ("acc,force,fn", "AFF", {"rate": 1000}, "force could be any of force, fn; say which, e.g. --map"),
        ("", "AF", {"rate": 1000}, "no header says.*found 0, 1; say so, e.g. --map acceleration=0,speed=1"),
        ("Stempel,x,y", "TSF", MAP_XY, RISES),  # "Give --rate 10000" was the advice for a tablet's 120 Hz
        ("time,acc,speed,force", "TASF", {"rate": 500}, "column time says 1000 Hz and --rate 500; leave out --rate"),
    ],
)
def test_columns_that_leave_doubt_are_refused(tmp_path, header, columns, options, match):
    samples = {"T": TIME, "A": ACC, "S": SPEED, "F": FORCE}
    path = _csv(tmp_path / "a.csv", header, *(samples[letter] for letter in columns))
    with pytest.raises(ValueError, match=match):
        _import(path, **options)


def test_headers_in_german_need_no_map_and_the_suggestion_reads_them(tmp_path):
    """`Beschl. X, Y, Z` were suggested as acceleration, speed and force, and a stamp in ms as nothing."""
    axes = ",".join(f"Beschl. {axis} [m/s²]" for axis in "XYZ")
    header = f"Zeitstempel [ms],{axes},Geschwindigkeit [mm/s],Normalkraft [N]"
    columns = (1000 * TIME, ACC, ACC, ACC, SPEED, FORCE)
    recording, _ = import_recording([_csv(tmp_path / "a.csv", header, *columns)], ImportOptions())
    assert set(recording.channels) == {*(f"acceleration_{axis}" for axis in "xyz"), "speed", "force"}
    assert recording["speed"].rate_hz == 1000
    doubtful = header.replace("Normalkraft", "Kanal 7").replace("Geschwindigkeit", "Kraft").replace("Kanal 7", "Kraft")
    with pytest.raises(ValueError, match="force could be any of") as refused:
        import_recording([_csv(tmp_path / "b.csv", doubtful, *columns)], ImportOptions())
    assert "acceleration_x=Beschl. X [m/s²],acceleration_y=Beschl. Y [m/s²]" in str(refused.value)
    assert "time=Zeitstempel [ms]" in str(refused.value)


@pytest.mark.parametrize("day", ["", "2026-05-01T", "2026-05-01 ", "1.5.2026 "])
def test_times_of_a_clock_are_seconds_from_the_first(tmp_path, day):
    """Hours, minutes and seconds had no way on: \"expected a number\"."""
    clock = [f"{day}11:59:{59 + t:09.6f}" if t < 1 else f"{day}12:00:{t - 1:09.6f}" for t in TIME]
    rows = "\n".join(
        f"{t},{a!r},{v!r},{f!r}" for t, a, v, f in zip(clock, *map(np.ndarray.tolist, (ACC, SPEED, FORCE)), strict=True)
    )
    (tmp_path / "a.csv").write_text(f"Time,acc,speed,force\n{rows}\n")
    recording = _import(tmp_path / "a.csv")
    assert recording["acceleration"].rate_hz == 1000
    np.testing.assert_array_equal(recording["acceleration"].samples, ACC)


@pytest.mark.parametrize(
    ("clock", "seconds"),
    [
        (["23:59:59.5", "00:00:00.5", "00:00:01"], [0, 1, 1.5]),
        (["12:00:00", "11:59:59.75", "12:00:01"], [0, -0.25, 1]),  # no midnight: a row out of order, which is refused
        (["2026-05-01T23:59:59", "2026-05-02T00:00:01"], [0, 2]),
    ],
)
def test_a_clock_without_a_date_passes_midnight_by_half_a_day_back_alone(clock, seconds):
    np.testing.assert_array_equal(clock_seconds(clock), seconds)


def test_times_in_whole_periods_hide_no_lost_row():
    """Stamps of 10 ms may hide half a period; row 700 of 1000 lost puts that before it 10 ms · 700/999 from an even grid."""
    assert irregular(np.arange(1001) / 100, 100.0) == ""
    assert irregular(np.delete(np.arange(1001), 700) / 100, 100.0).startswith("samples lie up to 6.997 ms")


@pytest.mark.parametrize("digits", [3, 4, 9, None, "single precision"])
def test_regular_times_become_a_rate(tmp_path, digits):
    times = 7.25 + np.arange(N) / 3000
    if digits == "single precision":
        np.savez(tmp_path / "a.npz", time=(times - 7.25).astype(np.float32), acc=ACC)
        assert _import(tmp_path / "a.npz")["acceleration"].rate_hz == 3000
        return
    times = times if digits is None else np.round(times, digits)
    if digits == 3:  # 1/3000 s does not fit into milliseconds: times repeat
        with pytest.raises(ValueError, match=r"time repeats at sample 1.*rounded\? Leave time out and give --rate"):
            _import(_csv(tmp_path / "a.csv", "t,acc", times, ACC))
        return
    channel = _import(_csv(tmp_path / "a.csv", "t,acc", times, ACC))["acceleration"]
    assert channel.times_s is None
    assert channel.rate_hz == pytest.approx(3000, rel=1e-9 if digits is None else 1e-4)


def test_irregular_times_are_kept(tmp_path):
    steps = np.random.default_rng(1).uniform(0.6e-3, 1.4e-3, N)
    times = np.cumsum(steps)
    path = _csv(tmp_path / "a.csv", "t,speed", times * 1000, SPEED)
    recording = _import(path, map="time=t,speed=speed", unit="time=ms")
    np.testing.assert_allclose(recording["speed"].times_s, times - times[0], atol=1e-12)
    assert recording["speed"].rate_hz == pytest.approx(1000, rel=0.02)  # the median step
    assert any("keeps its own times" in line for line in recording.history)
    late = TIME.copy()
    late[700] += 0.00005  # a twentieth of a period
    recording = _import(_csv(tmp_path / "a.csv", "t,speed", late, SPEED))
    assert recording["speed"].rate_hz == 1000
    assert recording["speed"].times_s[700] == pytest.approx(0.70005)


def test_times_that_begin_late_and_are_rounded_have_the_rate_of_their_clock():
    assert rate_of(np.round(100 + np.arange(3000) / 750, 3)) == 750
    assert np.isfinite(rate_of(np.array([0.0, 5e-324, 1e-323])))


@pytest.mark.parametrize(
    ("at", "value", "what"),
    [
        (50, 0.0, "goes back at sample 50"),
        (51, 0.05, "repeats at sample 51"),
        (1, 0.0, "is the row there twice[?] Delete one of the two"),
        (60, np.nan, "NaN at sample 60"),
    ],
)
def test_impossible_times_are_refused(tmp_path, at, value, what):
    times = TIME.copy()
    times[at] = value
    with pytest.raises(ValueError, match=what):
        _import(_csv(tmp_path / "a.csv", "t,speed", times, np.r_[SPEED[0], SPEED[:-1]]))


def test_files_share_a_clock_and_count_from_the_acceleration(tmp_path):
    fast = _csv(tmp_path / "fast.csv", "t,acc", 100.25 + TIME, ACC)
    slow = _csv(tmp_path / "slow.csv", "t,speed,force", 100 + np.arange(300) / 100, SPEED[:300], FORCE[:300])
    recording = _import([fast, slow], map="time=t,acceleration=acc,speed=speed,force=slow:force")
    assert recording["acceleration"].times_s is None
    assert recording["force"].times_s[0] == pytest.approx(-0.25)
    assert recording["force"].rate_hz == 100
    late = _csv(tmp_path / "late.csv", "t,force", 1.7e9 + TIME, FORCE)
    with pytest.raises(ValueError, match="were their clocks different"):
        _import([fast, late], map="time=t,acceleration=acc,force=force")


def test_time_columns_of_one_file_go_by_their_lengths(tmp_path):
    np.savez(tmp_path / "a.npz", t1=TIME, acc=ACC, t2=np.arange(240) / 120, x=SPEED[:240])
    recording = _import(tmp_path / "a.npz", map="time=t1,time=t2,acceleration=acc,position_x=x")
    assert (recording["acceleration"].rate_hz, recording["position_x"].rate_hz) == (1000, 120)
    with pytest.raises(ValueError, match=r"x has 240 rows and time has t1 2000.*--rate position_x=HZ"):
        _import(tmp_path / "a.npz", map="time=t1,acceleration=acc,position_x=x")


def test_a_rate_that_is_not_used_is_said_once_per_file(tmp_path):
    path = _csv(tmp_path / "a.csv", "t,acc,force", TIME, ACC, FORCE)
    wavfile.write(tmp_path / "b.wav", 44_100, SPEED.repeat(40).astype(np.float32))
    mapping = (("time", "a:t"), ("acceleration", "a:acc"), ("force", "a:force"), ("speed", "b:0"))
    options = ImportOptions(mapping, rate_hz=500.0)
    imported, decisions = import_recording([path, tmp_path / "b.wav"], options)
    assert imported["force"].rate_hz == 1000
    assert decisions == [
        "rate 500 Hz not used: a.csv has a time column, 1000 Hz",
        "rate 500 Hz not used: b.wav states 44100 Hz",
        "no unit is stated: taken as acceleration m/s^2, force N, speed mm/s, time s; --unit changes it",
    ]


def test_units_that_nobody_states_are_said_once(tmp_path):
    path = _csv(tmp_path / "a.csv", "t,acc,speed [mm/s],force", TIME, ACC, SPEED, FORCE)

    def decisions(**units):
        return [line for line in import_recording([path], ImportOptions(units=units))[1] if "unit" in line]

    message = "no unit is stated: taken as acceleration m/s^2, force N, time s; --unit changes it"
    assert decisions() == [message]
    assert decisions(force="N") == ["no unit is stated: taken as acceleration m/s^2, time s; --unit changes it"]
    assert decisions(force="N", acceleration="m/s^2", time="s") == []


def test_a_unit_that_cannot_be_is_doubted_at_once(tmp_path):
    path = _csv(tmp_path / "a.csv", "t [s],acc [g],speed [mm/s],force [N]", TIME, ACC, SPEED / 1000, FORCE)
    decisions = import_recording([path], ImportOptions())[1]
    assert "speed peaks at 0.18, expected mm/s up to about 350; was it given in m/s?" in decisions
    assert not any("no unit is stated" in line for line in decisions)
    decisions = import_recording([path], ImportOptions(units={"speed": "m/s"}))[1]
    assert not any("was it given" in line for line in decisions)


def test_wav_for_acceleration_beside_a_table(tmp_path):
    wavfile.write(tmp_path / "acc.wav", 10_000, (ACC.repeat(10) * 3000).astype(np.int16))
    of_speed_and_force = _csv(tmp_path / "hand.csv", "v,f", SPEED, FORCE)
    mapping = "acceleration=acc.wav:0,speed=hand:v,force=hand.csv:f"
    with pytest.raises(ValueError, match=r"fractions of full scale; say how many m/s\^2 full scale is"):
        _import([tmp_path / "acc.wav", of_speed_and_force], map=mapping, rate=1000)
    recording = _import([tmp_path / "acc.wav", of_speed_and_force], map=mapping, rate=1000, unit="acceleration=*50")
    assert (recording["acceleration"].rate_hz, recording["force"].rate_hz) == (10_000, 1000)
    expected = np.trunc(ACC.repeat(10) * 3000) / 32768 * 50
    np.testing.assert_allclose(recording["acceleration"].samples, expected, rtol=1e-12)
    # Without a mapping the sound is the acceleration; its rate gives way by name alone, and not silently.
    wavfile.write(tmp_path / "acc.wav", 8000, np.stack([ACC] * 3, axis=1).astype(np.float32))
    of_speed_and_force = _csv(tmp_path / "hand.csv", "t,speed,force", TIME, SPEED, FORCE)
    recording = _import([tmp_path / "acc.wav", of_speed_and_force])
    assert [axis.rate_hz for axis in recording.axes("acceleration")] == [8000] * 3
    recording = _import(tmp_path / "acc.wav", map="acceleration=0", rate="acceleration=10000")
    assert recording["acceleration"].rate_hz == 10_000
    assert any("states 8000 Hz" in line for line in recording.history)


GAPS_TIME = np.arange(1000) / 100  # of a motion capture, s
LOST = np.r_[50:53, 100, 400:600]


@pytest.mark.parametrize("written_as", ["blank", "rows left out", "blank at irregular times"])
def test_gaps_are_filled_on_request_alone(tmp_path, written_as):
    """A straight line is filled to itself; rows are counted as the file has them."""
    line = 20 * GAPS_TIME
    path = _csv(tmp_path / "m.csv", "# rig\nt,x", GAPS_TIME, np.where(np.isin(np.arange(1000), LOST), np.nan, line))
    if written_as == "rows left out":
        recorded = np.delete(np.arange(1000), LOST)
        _csv(path, "# rig\nt,x", GAPS_TIME[recorded], line[recorded])
    elif written_as == "blank at irregular times":
        path.write_text(path.read_text().replace("\n9.0,", "\n9.003,"))
    for allowed_ms in (0.0, 1999.0):
        message = r"x: samples are missing.* in 3 gaps, the longest 2000 ms, the first after 0.49 s \(row 52\); --fill-gaps 2000 "
        with pytest.raises(ValueError, match=message):
            _import(path, map="time=t,position_x=x", fill_gaps_ms=allowed_ms)
    recording = _import(path, map="time=t,position_x=x", fill_gaps_ms=2000)
    np.testing.assert_allclose(np.delete(recording["position_x"].samples, 900), np.delete(line, 900), atol=1e-9)
    assert any("204 samples on straight lines" in sentence for sentence in recording.history)


def test_gaps_elsewhere_are_never_filled(tmp_path):
    gapped = ACC.copy()
    gapped[50] = np.nan
    path = _csv(tmp_path / "a.csv", "x", gapped)
    message = r"acceleration: .* in 1 gap, the longest 1 ms.*; only position, speed and force"
    with pytest.raises(ValueError, match=message):
        _import(path, map="acceleration=x", rate=1000, fill_gaps_ms=1000)
    for ends in ("nan\n1\n2\n", "1\n2\nnan\n"):
        path.write_text("x\n" + ends)
        with pytest.raises(ValueError, match=r"NaN or blank at its (start|end): nothing to draw a line from"):
            _import(path, map="position_x=x", rate=10, fill_gaps_ms=1000)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"map": "force=forse"}, "force: there is no column 'forse' among acc, speed, force; did you mean force"),
        ({"map": "acceleration=7"}, "no column '7' among acc, speed, force"),
        ({"map": "acc=acc"}, "unknown channel 'acc', expected time, acceleration.*"),
        ({"map": "force=force,force=speed"}, "force is mapped twice"),
        ({"map": "time=acc"}, "a.csv: the time goes back at sample 1"),
        ({"map": "acceleration"}, "--map 'acceleration' is not CHANNEL=VALUE"),
        ({"map": "acceleration=acc", "rate": "fast"}, "--rate 'fast' is not HZ or CHANNEL=HZ"),
        ({"map": "acceleration=acc", "rate": 0}, "is 0 Hz, expected above 0"),
        (
            {"map": "acceleration=acc"},
            "does not say how fast it was sampled; add a time column to the mapping: time=COLUMN; or give --rate HZ",
        ),
        ({"map": "acceleration=acc", "unit": "acceleration=inch"}, "'inch' is not one of m/s.*V\\*4.9"),
        ({"map": "acceleration=acc", "unit": "acceleration=g*2"}, "takes no factor; write acceleration=g, or"),
        ({"map": "acceleration=acc", "unit": "acceleration=V*x"}, "'x' is not a factor"),
        ({"map": "acceleration=acc", "unit": "position_x=mm"}, "position_x has a unit or rate but is not mapped"),
        ({"map": "acceleration=acc", "rate": 40_000}, "too short: 2000 samples at 40000 Hz, 50 ms, expected 100 ms"),
        ({"map": "acceleration=acc", "rate": 5e7}, "the rate is 5e.07 Hz, expected 1e.07 at most; is it right"),
        ({"map": "acceleration=acc", "rate": 20}, "a rate of 20 Hz, too slow for any vibration; is the rate right"),
    ],
)
def test_wrong_usage_is_explained(tmp_path, options, message):
    path = _csv(tmp_path / "a.csv", "acc,speed,force", ACC, SPEED, FORCE)
    with pytest.raises(ValueError, match=message):
        _import(path, **options)


@pytest.mark.parametrize(
    ("channel", "factor", "guess"),
    [
        ("speed", 1000, "is it a raw reading"),
        ("acceleration", 9806.65, "was it given in mm/s² or mg"),
        ("force", 600, "was it given in mN or gf"),
    ],
)
def test_absurd_units_are_refused_unless_forced(tmp_path, channel, factor, guess):
    samples = {"speed": SPEED, "acceleration": ACC * 5, "force": FORCE}[channel] * factor
    path = _csv(tmp_path / "a.csv", "x", samples)
    with pytest.raises(ValueError, match=guess):
        _import(path, map=f"{channel}=x", rate=1000)
    recording = _import(path, map=f"{channel}=x", rate=1000, force_units=True)
    np.testing.assert_array_equal(recording[channel].samples, samples)
    assert any("let through (--force-units)" in line for line in recording.history)
    spiky = np.r_[1.0, 2 * samples.max(), np.ones(N - 2)]
    with pytest.raises(ValueError, match=rf"{channel} reaches .* at sample 1.*1 of 2000 samples: spikes?"):
        _import(_csv(path, "x", spiky), map=f"{channel}=x", rate=1000)


def test_a_pickle_is_refused_unopened(tmp_path):
    (tmp_path / "a.pkl").write_bytes(b"cos\nsystem\n(S'false'\ntR.")
    with pytest.raises(ValueError, match="is a pickle, which can run code when opened"):
        _import(tmp_path / "a.pkl")
    (tmp_path / "a.abc").touch()
    with pytest.raises(ValueError, match=r"cannot read a.abc, expected one of .csv"):
        _import(tmp_path / "a.abc")


@pytest.mark.parametrize("name", ["a.csv", "a.txt", "a.xlsx", "a.npz", "a.h5"])
def test_a_table_that_lies_on_its_side_is_refused_before_its_columns_are_made(tmp_path, name):
    """A million columns of text took a minute to refuse; the other formats have one more than are read."""
    path, width = tmp_path / name, 4097
    if path.suffix in (".csv", ".txt"):
        width = 1_000_000
        delimiter = "," if path.suffix == ".csv" else " "
        # Rows of two lengths are refused for that where the columns are looked at first.
        path.write_text("\n".join([delimiter.join(["1"] * width), delimiter.join(["1"] * (width - 1))]))
    elif path.suffix == ".xlsx":
        book = openpyxl.Workbook()
        book.active.append([1.0] * width)
        book.save(path)
    elif path.suffix == ".npz":
        np.savez(path, **dict.fromkeys(map(str, range(width)), np.ones(2)))
    else:
        with h5py.File(path, "w") as file:
            for k in range(width):
                file[str(k)] = 1.0
    message = rf"{name} has {width:,} columns, expected 1,000 at most; do its samples lie along"
    with pytest.raises(ValueError, match=message):
        read_columns(path)


def test_a_column_with_an_endless_name_is_called_by_its_beginning(tmp_path):
    (tmp_path / "a.csv").write_text("t;" + 100_000 * "x" + "\n0;1\n1;1\n")
    assert [column.name for column in read_columns(tmp_path / "a.csv")] == ["t", 200 * "x"]


def test_the_command_writes_a_recording(tmp_path, capsys):
    path = _csv(tmp_path / "denim.csv", "t,acc,speed,force", TIME, ACC, SPEED, FORCE)
    arguments = ["import", str(path), "-o", str(tmp_path / "a.h5"), "--tool", "ball", "--json"]
    assert _status(arguments) == 0
    captured = capsys.readouterr()
    document = json.loads(captured.out)
    assert document["channels"]["force"] == {
        "unit": "N",
        "rate_hz": 1000,
        "regular": True,
        "n_samples": N,
        "duration_s": pytest.approx(2),
        "minimum": FORCE.min(),
        "maximum": FORCE.max(),
    }
    assert "taken from the headers: --map time=t,acceleration=acc,speed=speed,force=force" in captured.err
    recording = load_recording(tmp_path / "a.h5")
    assert (recording.texture, recording.tool, recording.sha256()) == ("denim", "ball", document["sha256"])
    assert re.search(r"force is column force of denim.csv \(sha256 [0-9a-f]{16}\)", "\n".join(recording.history))
    assert str(tmp_path) not in "\n".join(recording.history)  # a recording names files, not machines


@pytest.mark.parametrize(
    ("header", "factors", "wrong", "right", "message"),
    [
        ("t,acc,speed,force", (1000, 1), {}, {"unit": "time=ms"}, r"1 Hz, too slow .*was the time given in ms\?"),
        ("t,acc,speed,force", (1, 1000), {}, {"unit": "force=mN"}, "was it given in mN"),
        ("", (1, 1), {}, {"map": SUGGESTED}, f"--map {SUGGESTED}"),
    ],
)
def test_what_was_meant_is_guessed_and_helps(tmp_path, header, factors, wrong, right, message):
    path = _csv(tmp_path / "a.csv", header, factors[0] * TIME, ACC, SPEED, factors[1] * FORCE)
    with pytest.raises(ValueError, match=message):
        _import(path, **wrong)
    recording = _import(path, **right)
    assert (recording["acceleration"].rate_hz, recording["acceleration"].times_s) == (1000, None)
    np.testing.assert_allclose(recording["force"].samples, FORCE, rtol=1e-12)


def test_a_unit_of_a_quantity_serves_its_axes(tmp_path):
    path = _csv(tmp_path / "a.csv", "t,ax,ay,speed,force", TIME, ACC, ACC, SPEED, FORCE)
    recording = _import(path, unit="acceleration=g")
    np.testing.assert_allclose(recording["acceleration_y"].samples, 9.80665 * ACC, rtol=1e-12)
    with pytest.raises(ValueError, match="unknown channel 'position'"):
        _import(path, unit="position=mm")


def _stroke(path, text, **units):
    path.write_bytes(text.encode("latin-1"))
    return {name: samples.tolist() for name, samples in read_stroke(path, units).items()}


SAID = {"time": [0, 0.5, 1], "speed": [0, 80, 40.5], "force": [1, 0.75, 1]}


@pytest.mark.parametrize(
    "text",
    [
        "t,speed,force\n0,0,1\n0.5,80,0.75\n1,40.5,1\n",
        "t [ms],speed [m/s],force [mN]\n0,0,1000\n500,0.08,750\n1000,0.0405,1000\n",
        "t;speed;force\n0;0;1\n0,5;80;0,75\n1;40,5;1\n",
        "T\tSpeed\tForce\n(s)\t(cm/s)\t(N)\n0\t0\t1\n0,5\t8\t0,75\n1\t4,05\t1\n",
        "# Strich µ\nNote,Force,T,Speed\na,1,0,0\n\nb,0.75,0.5,80\n# Marke\nc,1,1,40.5\n\n",
        "Time (s),Velocity,Normal Force,Pressure mat\n0,0,1,9\n0.5,80,0.75,9\n1,40.5,1,9\n",
    ],
)
def test_a_stroke_is_read_as_an_import_is(tmp_path, text):
    read = _stroke(tmp_path / "s.csv", text)
    assert {name: pytest.approx(values, rel=1e-12) for name, values in SAID.items()} == read


def test_a_strokes_units_may_be_given(tmp_path):
    text = "t,x [in],y,pressure [%]\n0,0,0,50\n1000,1,2,100\n"
    assert _stroke(tmp_path / "s.csv", text, time="ms", position_y="m") == {
        "time": [0, 1],
        "position_x": [0, 25.4],
        "position_y": [0, 2000],
        "pressure": [0.5, 1],
    }
    with pytest.raises(ValueError, match=r"force has a unit, and s.csv has no column of it"):
        _stroke(tmp_path / "s.csv", text, force="mN")
    with pytest.raises(ValueError, match=r"speed: unit 'px' is not one of mm/s"):
        _stroke(tmp_path / "s.csv", text.replace("x [in]", "speed"), speed="px")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("t,speed\n0,1\n1,2\n", r"has the columns t, speed; expected t \(s\), and speed"),
        ("0,80,1\n1,80,1\n", r"has the columns 0, 1, 2; expected t"),
        ("t,speed,force\n0,1,1\n", "has 1 row below its header, expected two or more"),
        ("t,speed,force\n# a\n0,1,1\n\n# b\n0,1,1\n", "time does not increase at row 6"),
        ("t,speed,force\n0,1,1\n# a\n1,,1\n", "speed at row 4 is blank or NaN, expected a finite number"),
        ("t,speed,force\n0,1,1\n# a\n1,1e400,1\n", "speed at row 4 is infinite, expected a finite number"),
        ("t,speed,force\n0,1,1\n# a\n1,x,1\n", "speed: row 4 is 'x', expected a number"),
        ("t,v,velocity,force\n0,1,1,1\n1,1,1,1\n", "speed could be any of v, velocity; keep one"),
        ("t,speed,force [kg]\n0,1,1\n1,1,1\n", "force: unit 'kg' of column .* --unit force=kgf"),
        ("t,speed,pressure [kPa]\n0,1,1\n1,1,1\n", "the pressure is in kPa, expected a share"),
    ],
)
def test_bad_strokes_are_refused(tmp_path, text, message):
    with pytest.raises(ValueError, match=message):
        _stroke(tmp_path / "s.csv", text)


def test_a_recording_is_no_stroke(tmp_path):
    with pytest.raises(ValueError, match=r"a.h5 is no table \(.csv.*expected one of t \(s\)"):
        _stroke(tmp_path / "a.h5", "")


def test_channels_with_their_rates_and_units(tmp_path):
    channels = [
        ChannelObject("fast", "acc", ACC, {"wf_increment": 1e-4, "unit_string": "g"}),
        ChannelObject("fast", "force", FORCE, {"wf_increment": 1e-4}),
        ChannelObject("slow", "force", FORCE[::10], {"wf_increment": 1 / 3000, "unit_string": "N"}),
    ]
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment(channels)
    columns = {column.name: column for column in isolated_columns("TDMS", tmp_path / "a.tdms")}
    assert list(columns) == ["acc", "fast/force", "slow/force"]
    np.testing.assert_array_equal(columns["acc"].samples, ACC)
    assert (columns["acc"].rate_hz, columns["acc"].unit) == (10_000, "g")
    assert (columns["slow/force"].rate_hz, columns["slow/force"].unit) == (3000, "N")


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


def test_what_is_missing_is_named_and_columns_that_may_be_positions(tmp_path):
    path = _csv(tmp_path / "a.csv", "t,acc,X,Y,force", TIME, ACC, SPEED, SPEED, FORCE)
    decisions = import_recording([path], ImportOptions())[1]
    missing = "there is no speed, and no position to take it from; it may be X and Y: "
    assert f"{missing}add --map position_x=X,position_y=Y" in decisions


def test_all_that_is_missing_is_refused_in_one_message_that_can_be_copied(tmp_path, capsys):
    """Each was told after the one before had been mended, and the columns were left out in silence."""
    header = "t [s],Acc [g],Load X [gf],Load Z [gf],Grip [N],Tip X [um],Tip Y [um],Cam X [mm],Cam Y [mm]"
    path = _csv(tmp_path / "a.csv", header, TIME, ACC, *[100 * FORCE] * 3, *[250 * SPEED] * 2, *[SPEED] * 2)
    arguments = ["import", str(path), "-o", str(tmp_path / "a.h5")]
    assert _status(arguments) == 2
    refusal = capsys.readouterr().err.splitlines()[-1]
    speed = "position_x=Tip X [um],position_y=Tip Y [um]", "position_x=Cam X [mm],position_y=Cam Y [mm]"
    force = "force_x=Load X [gf],force_z=Load Z [gf]", "force=Grip [N]"
    assert refusal == (
        "foten: nothing sensible can be learned: there is no speed, and no position to take it from; it may be Tip X [um] and "
        f"Tip Y [um] or Cam X [mm] and Cam Y [mm]: add --map '{speed[0]}' or --map '{speed[1]}'. There is no normal force "
        f"(force or force_z); it may be Load X [gf] and Load Z [gf] or Grip [N]: add --map '{force[0]}' or --map '{force[1]}' "
        "(use --anyway to continue)"
    )
    assert _status([*arguments, "--map", speed[0], "--map", force[0]]) == 0
    recording = load_recording(tmp_path / "a.h5")
    np.testing.assert_allclose(recording["position_x"].samples, SPEED / 4, rtol=1e-12)
    np.testing.assert_allclose(recording["force_z"].samples, FORCE * 0.980665, rtol=1e-12)


@pytest.mark.parametrize(
    ("header", "channels"),
    [
        ("t,acc,Load X [gf],Load Y [gf],Load Z [gf],speed", "acceleration force_x force_y force_z speed"),
        ("t,acc,LoadZ [N],speed", "acceleration force_z speed"),
        ("t,Head x [g],Head y [g],Head z [g],speed,force", "acceleration_x acceleration_y acceleration_z speed force"),
        ("t,acc,Tip X [um],Tip Y [um],Tip Z [um],force", "acceleration position_x position_y position_z force"),
        ("t,acc,Tip Z [um],Tip X [um],Tip Y [um],force", "acceleration position_x position_y position_z force"),
        ("t,acc,Height [mm],Tip X [mm],Tip Y [mm],force", "acceleration position_x position_y force"),
        # In doubt nothing is taken.
        ("t,acc,Load X [N],Load Z [N],Grip [N],speed", "acceleration speed"),
        ("t,acc,Tip X [mm],Tip Y [mm],Cam X [mm],Cam Y [mm],force", "acceleration force"),
        ("t,acc,Tip X [mm],Cam X [mm],force", "acceleration force"),
        ("t,acc,Drag X [mm],speed,force", "acceleration speed force"),
        ("t,acc,Friction X [N],Friction Z [N],speed", "acceleration speed"),
        ("t,acc,Max [mm],Index [mm],force", "acceleration position_x position_y force"),  # which name no axis
    ],
)
def test_unit_and_axis_say_what_a_column_of_an_unknown_name_is(tmp_path, header, channels):
    """`Load X [gf]` and `Tip X [um]` were left out."""
    names = header.split(",")
    path = _csv(tmp_path / "a.csv", header, TIME, *(ACC + 3 * k for k in range(1, len(names))))
    recording, decisions = import_recording([path], ImportOptions())
    assert set(recording.channels) == set(channels.split())
    by_axis = {name.split(" [")[0][-1:].lower(): k for k, name in enumerate(names) if k}
    for name, channel in recording.channels.items():
        axis = name.partition("_")[2]
        if axis and "Max" not in header:  # the axis of the name, wherever it stands
            factor = {"[gf]": 0.00980665, "[g]": 9.80665, "[um]": 1e-3}.get(names[by_axis[axis]].split()[-1], 1.0)
            np.testing.assert_allclose(channel.samples, (ACC + 3 * by_axis[axis]) * factor, rtol=1e-12)
    by_unit = re.search(r"\((.+) by unit\)", decisions[0])
    left_out = "".join(line for line in decisions if line.startswith("left out"))
    known = {name for name in names if "[" in name and name not in left_out}
    assert (set(by_unit[1].split(", ")) if by_unit else set()) == known


@pytest.mark.parametrize("clock", ["time column", "--rate"])
@pytest.mark.parametrize(("rate_hz", "late", "rounding"), [(120, 0, np.round), (333, 4, np.ceil), (2000, 9, np.floor)])
def test_a_sensor_slower_than_the_rows_has_a_rate_of_its_own(tmp_path, rate_hz, late, rounding, clock):
    """A tracker in every 83rd row was "2879 gaps"; straight lines between made its noise another's."""
    n, row_hz = 20_000, 10_000
    rows = late + rounding(np.arange(0, n, row_hz / rate_hz)).astype(int)
    rows = rows[rows < n]
    moved = 30 * np.sin(2 * np.pi * 1.5 * np.arange(n) / row_hz)
    sparse = np.full(n, np.nan)
    sparse[rows] = moved[rows]
    header, first = ("t", [37 + np.arange(n) / row_hz]) if clock == "time column" else ("n", [np.zeros(n)])
    acc = np.random.default_rng(0).standard_normal(n)
    path = _csv(tmp_path / "a.csv", f"{header},acc,force,Tip X [mm],Tip Y [mm]", *first, acc, acc, sparse, sparse)
    recording, decisions = import_recording([path], ImportOptions(rate_hz=None if header == "t" else row_hz))
    channel = recording["position_x"]
    assert channel.rate_hz == rate_hz
    assert recording["acceleration"].times_s is None
    np.testing.assert_array_equal(channel.samples, moved[rows])
    assert np.abs(channel.times - rows / row_hz).max() <= 1 / row_hz
    every = f"position_x, position_y: a value every {row_hz / rate_hz:.3g} rows, taken as sensors at {rate_hz} Hz"
    assert every in decisions
    assert not any("ends" in line for line in recording.history)


def test_a_rate_given_of_a_slower_sensor_is_the_sensors(tmp_path):
    sparse = np.full(N, np.nan)
    sparse[::8] = SPEED[::8]
    path = _csv(tmp_path / "a.csv", "acc,speed", ACC, sparse)
    recording = _import(path, rate="1000,speed=125")
    assert (recording["speed"].rate_hz, recording["speed"].times_s) == (125, None)
    np.testing.assert_array_equal(recording["speed"].samples, SPEED[::8])


@pytest.mark.parametrize("lost", [[], [400], [5], [100, 200, 300, 400]])
def test_a_lost_value_is_no_slower_sensor(tmp_path, lost):
    """Neither in every row nor in every tenth; what is irregular stays a gap."""
    for every in (1, 10):
        sparse = np.full(20_000 // (10 // every), np.nan)
        at = np.delete(np.arange(0, sparse.size, every), lost)
        sparse[at] = at / 10
        path = _csv(tmp_path / "a.csv", "speed", sparse[: at[-1] + 1])
        if lost:
            with pytest.raises(ValueError, match="speed: samples are missing, NaN or blank in"):
                _import(path, rate=10_000)
        else:
            assert _import(path, rate=10_000)["speed"].rate_hz == 10_000 / every


def test_texture_and_tool_stated_above_the_table_are_taken_unless_given(tmp_path, capsys):
    above = "Device;TexRig\nSurface: walnut, planed\nTool:\tsteel ball\n\nt\tacc\tspeed\tforce\n"
    rows = "\n".join("\t".join(map(str, row)) for row in zip(TIME, ACC, SPEED, FORCE, strict=True))
    (tmp_path / "run3.txt").write_text(f"{above}{rows}\n")
    arguments = ["import", str(tmp_path / "run3.txt"), "-o", str(tmp_path / "a.h5")]
    assert _status(arguments) == 0
    recording = load_recording(tmp_path / "a.h5")
    assert (recording.texture, recording.tool) == ("walnut, planed", "steel ball")
    message = "texture: walnut, planed, read from the lines above the table; --texture overrides it"
    assert message in capsys.readouterr().err
    assert _status([*arguments, "--texture", "oak"]) == 0
    assert (load_recording(tmp_path / "a.h5").texture, load_recording(tmp_path / "a.h5").tool) == ("oak", "steel ball")
    assert "texture: walnut" not in capsys.readouterr().err
