"""Cluster Haptic Texture Dataset: 118 surfaces under a rubber fingertip on a machine, in clips of 5 s (CC BY 4.0).

    sensor_data/accel/ID_DIRECTION_SPEED_FORCE_REPEAT.csv      time [s], X, Y, Z [g]
    sensor_data/force/…, sensor_data/position/…                time [s], force [N]; time [s], X, Y [mm]

A clip is a take. A row that repeats the last is no sample; the rate is that of the others, by the documents 6 kHz. Untried on
the real files, which could not be reached. Source: Eguchi, Hayase, Hiroi and Hiraki, Scientific Data 13:756, doi
10.6084/m9.figshare.29438288, `dataset_details.md`.
"""

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from foten.datasets.bounds import MAX_DURATION_S, MIN_DURATION_S, check_overlap
from foten.datasets.columns import Column
from foten.datasets.importing import read_columns
from foten.datasets.units import G
from foten.dsp import Array
from foten.recording.recording import Channel, Recording, counted, joined_takes

SENSORS = "accelerometer IIS3DWB, load cell SC616C, position of the machine"
TOOL = "urethane rubber fingertip on a three-axis machine"
NOTES = "Cluster Haptic Texture Dataset, CC BY 4.0, doi 10.6084/m9.figshare.29438288: name its authors if you share it"
STEP_HZ = 500.0  # rates of the grid are its multiples: any that a model may have divides them
PARTS = ("accel", "force", "position")
_CLIP = re.compile(r"(?P<surface>\d+)_(?P<direction>\d+)_(?P<speed>\d+)_(?P<force>\d+)_(?P<repeat>\d+)\.csv")


def cluster_surfaces(folder: Path) -> dict[int, list[str]]:
    """Names of the clips by surface; a clip counts whose acceleration, force and position are all there."""
    names = set.intersection(*({path.name for path in (folder / part).glob("*.csv")} for part in PARTS))
    surfaces: dict[int, list[str]] = {}
    for name in sorted(names):
        if match := _CLIP.fullmatch(name):
            surfaces.setdefault(int(match["surface"]), []).append(name)
    return dict(sorted(surfaces.items()))


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # absurd times and values are refused, in a sentence
def read_cluster(folder: Path, surface: int | None) -> tuple[Recording, list[str]]:
    """Recording of a surface, a take for each clip, and sentences on what was decided; ValueError where there is none."""
    places = (folder, folder / "sensor_data", folder / "texture_dataset" / "sensor_data")
    place = next((place for place in places if all((place / part).is_dir() for part in PARTS)), None)
    if place is None:
        expected = f"sensor_data with {', '.join(PARTS)}, as the Cluster Haptic Texture Dataset has them"
        raise ValueError(f"{folder} is a folder of nothing that is known, expected {expected}")
    surfaces = cluster_surfaces(place)
    if surface not in surfaces:
        known = ", ".join(map(str, list(surfaces)[:12])) + f" and {len(surfaces) - 12} more" * (len(surfaces) > 12)
        what = "name one of its surfaces" if surface is None else f"there is no surface {surface} in it"
        raise ValueError(f"{folder}: {what}, --surface {known or 'N (there is no complete clip)'}")
    takes = [_take(place, name) for name in surfaces[surface]]
    rates = sorted({take["acceleration_x"].rate_hz for take in takes})
    clips = f"{counted(len(takes), 'clip')} of surface {surface}, a take each"
    at_hz = " and ".join(f"{rate:g}" for rate in rates)
    return joined_takes(takes), [f"{clips}, at {at_hz} Hz by the rows that differ and their times"]


def _take(place: Path, name: str) -> Recording:
    acceleration, force, position = (_columns(place / part / name) for part in PARTS)
    rate_hz, grid, samples = _evened(name, acceleration)
    channels = {
        f"acceleration_{axis}": Channel(G * np.interp(grid, *axis_samples), rate_hz, None)
        for axis, axis_samples in samples.items()
    }
    start_s = float(grid[0])
    channels |= {
        f"position_{axis}": Channel(values, *_timed(times - start_s))
        for axis, (times, values) in zip("xy", _distinct(position), strict=True)
    }
    ((times, values),) = _distinct(force)
    channels["force"] = Channel(values, *_timed(times - start_s))
    check_overlap(channels)
    history = (
        f"acceleration: the rows of accel/{name} that differ from the one before, on an even grid of {rate_hz:.6g} Hz between "
        "their times, in straight lines; converted from g",
        "position and force keep their own times",
    )
    about = {"texture": f"surface {name.partition('_')[0]}", "tool": TOOL, "sensors": SENSORS, "notes": NOTES}
    return Recording(channels, **about, history=history, name=name.removesuffix(".csv"))  # type: ignore[arg-type]


def _columns(path: Path) -> list[Column]:
    """Columns of a clip's table, time first."""
    try:
        columns = read_columns(path)
    except ValueError as error:
        raise ValueError(f"{path.parent.name}/{error}") from error
    for column in columns:
        if column.fault or not np.isfinite(column.samples).all():
            raise ValueError(f"{path.parent.name}/{path.name}, column {column.name}: {column.fault or 'blank or NaN'}")
    if len({column.samples.size for column in columns}) != 1 or columns[0].samples.size < 3 or len(columns) < 2:
        rows = "expected time and others, of three rows or more"
        raise ValueError(f"{path.parent.name}/{path.name} has {len(columns)} columns, {rows}")
    if not MIN_DURATION_S <= (lasts_s := np.ptp(columns[0].samples)) <= MAX_DURATION_S:
        expected = f"expected {MIN_DURATION_S:g} to {MAX_DURATION_S:g}; was the time given in ms?"
        raise ValueError(f"{path.parent.name}/{path.name} lasts {lasts_s:.3g} s, {expected}")
    return columns


def _distinct(columns: Sequence[Column]) -> list[tuple[Array, Array]]:
    """Times, which rise, and values of each column of a table but time, without the rows that repeat the one before."""
    times, values = columns[0].samples, np.stack([column.samples for column in columns[1:]])
    changed = np.append(True, np.any(np.diff(values, axis=1) != 0, axis=0))
    changed[-1] = True  # so that a force that is held lasts to the end
    rises = np.append(True, np.diff(np.maximum.accumulate(times)) > 0)
    kept = changed & rises
    return [(times[kept], row[kept]) for row in values]


def _evened(name: str, columns: Sequence[Column]) -> tuple[float, Array, dict[str, tuple[Array, Array]]]:
    """Rate [Hz] of the distinct samples of three axes, an even grid of their times [s], and times and values by axis."""
    axes = _distinct(columns)
    if len(axes) != 3:
        raise ValueError(f"accel/{name} has {counted(len(axes), 'column')} beside time, expected three axes")
    times = axes[0][0]
    if times.size < 3:
        raise ValueError(f"accel/{name} has {counted(times.size, 'distinct sample')}, expected a clip")
    rate_hz = max(STEP_HZ, STEP_HZ * np.floor((1 + 1e-3) * (times.size - 1) / (times[-1] - times[0]) / STEP_HZ))
    grid = np.arange(times[0], times[-1], 1 / rate_hz)
    return rate_hz, grid, dict(zip("xyz", axes, strict=True))


def _timed(times: Array) -> tuple[float, Array]:
    """Nominal rate [Hz] and times [s] of a channel that keeps its own."""
    return float(1 / np.median(np.diff(times))), times
