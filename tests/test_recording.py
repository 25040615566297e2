import dataclasses

import numpy as np
import pytest

from foten.recording.recording import UNITS, Channel, Recording


def channel(n: int = 100, rate_hz: float = 1000.0, seed: int = 0) -> Channel:
    return Channel(np.random.default_rng(seed).standard_normal(n), rate_hz)


def test_channels_keep_their_own_rates_and_the_shortest_counts() -> None:
    recording = Recording(
        {"acceleration": channel(2000, 1000.0), "speed": channel(239, 120.0), "force": channel(25_000, 10_000.0)}
    )
    assert recording["speed"].duration_s == pytest.approx(239 / 120)
    assert recording.duration_s == pytest.approx(239 / 120)


def test_irregular_times_give_the_duration() -> None:
    times_s = np.array([3.0, 3.01, 3.05, 3.2])
    # 0.2 s between the first and the last, and one period of the nominal rate.
    assert Channel(np.zeros(4), 100.0, times_s).duration_s == pytest.approx(0.21)


def test_axes_come_in_order_and_before_the_scalar() -> None:
    z, x, scalar = channel(seed=1), channel(seed=2), channel(seed=3)
    recording = Recording({"acceleration_z": z, "acceleration": scalar, "acceleration_x": x})
    assert [axis is expected for axis, expected in zip(recording.axes("acceleration"), (x, z), strict=True)]
    assert recording.axes("acceleration")[0] is x
    assert Recording({"force": scalar}).axes("force") == [scalar]
    assert recording.axes("force") == []


def test_the_digest_is_of_the_samples_and_their_times() -> None:
    a, b = channel(seed=1), channel(seed=2)
    first = Recording({"acceleration": a, "force": b}, texture="T1", notes="x")
    assert first.sha256() == Recording({"force": b, "acceleration": a}, texture="T2").sha256()
    times_s = np.arange(100) / 1000.0
    other = a.samples.copy()
    other[57] = np.nextafter(other[57], 9)
    changed = [
        Recording({"acceleration": dataclasses.replace(a, samples=other), "force": b}),
        Recording({"acceleration": dataclasses.replace(a, rate_hz=1001.0), "force": b}),
        Recording({"acceleration": dataclasses.replace(a, times_s=times_s), "force": b}),
        Recording({"acceleration": dataclasses.replace(a, times_s=times_s + 1e-9), "force": b}),
        Recording({"acceleration": b, "force": a}),
        Recording({"acceleration": a}),
    ]
    digests = {recording.sha256() for recording in (first, *changed)}
    assert len(digests) == 1 + len(changed)


def test_the_digest_does_not_hang_on_memory_layout() -> None:
    samples = np.random.default_rng(0).standard_normal((100, 3))
    strided, packed = samples[:, 1], samples[:, 1].copy()
    swapped = packed.astype(">f8")
    digests = {Recording({"force": Channel(s, 1000.0)}).sha256() for s in (strided, packed, swapped)}
    assert len(digests) == 1


def test_channels_cannot_be_exchanged() -> None:
    given = {"force": channel()}
    recording = Recording(given)
    given["speed"] = channel()
    assert "speed" not in recording
    with pytest.raises(TypeError, match="assignment"):
        recording.channels["force"] = channel()  # type: ignore[index]


def test_an_unknown_channel_is_refused_with_what_is_known() -> None:
    with pytest.raises(ValueError, match=r"unknown channel 'velocity', expected one of acceleration, .*force_z"):
        Recording({"velocity": channel()})
    with pytest.raises(ValueError, match="no channel"):
        Recording({})


@pytest.mark.parametrize("samples", [np.zeros(0), np.zeros((3, 4)), np.float64(1.0)])
def test_samples_are_a_line(samples: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"expected \(n,\)"):
        Channel(np.asarray(samples), 1000.0)


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rate_is_positive(rate_hz: float) -> None:
    with pytest.raises(ValueError, match="expected a positive number"):
        Channel(np.zeros(3), rate_hz)


def test_times_go_with_samples() -> None:
    with pytest.raises(ValueError, match="2 times for 3 samples"):
        Channel(np.zeros(3), 1000.0, np.zeros(2))


def test_every_channel_has_a_unit() -> None:
    assert set(UNITS.values()) == {"m/s^2", "mm/s", "mm", "N"}


def test_holes_are_lost_samples_and_not_late_time_stamps() -> None:
    rng = np.random.default_rng(0)
    for lost in (0, 1, 40):
        grid = np.delete(np.arange(20_000), slice(5000, 5000 + lost)) / 1000
        jittered = grid + 2e-4 * rng.uniform(-1, 1, grid.size)
        found = Channel(np.zeros(grid.size), 1000.0, jittered).holes()
        assert found.tolist() == ([4999] if lost else [])
    late = np.arange(100) / 100
    late[50] += 0.009
    assert not Channel(np.zeros(100), 100.0, late).holes().size
