import dataclasses
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foten.recording.recording import Channel, Recording
from foten.recording.scaling import Scaling, fit_scaling
from foten.recording.trace import Trace
from foten.recording.windows import targets, windows


def channel(n: int = 100, rate_hz: float = 1000.0, seed: int = 0) -> Channel:
    return Channel(np.random.default_rng(seed).standard_normal(n), rate_hz)


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


def test_channels_cannot_be_exchanged() -> None:
    original = {"force": channel()}
    recording = Recording(original)
    original["speed"] = channel()
    assert "speed" not in recording
    with pytest.raises(TypeError, match="assignment"):
        recording.channels["force"] = channel()  # type: ignore[index]


def test_a_channel_lasts_one_period_past_its_last_sample_and_a_recording_as_its_shortest() -> None:
    times_s = np.array([3.0, 3.01, 3.05, 3.2])
    assert Channel(np.zeros(4), 100.0, times_s).duration_s == pytest.approx(0.2 + 1 / 100)
    recording = Recording({"acceleration": channel(2000, 1000.0), "speed": channel(239, 120.0)})
    assert recording.duration_s == pytest.approx(239 / 120)


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


def test_blocks_are_consecutive_and_share_memory() -> None:
    n = np.arange(12.0)
    trace = Trace(n, n + 100, n + 200, 1000.0, 4)
    assert (trace.n_blocks, len(trace)) == (3, 12)
    np.testing.assert_array_equal(trace.blocks(trace.speed)[1], [104, 105, 106, 107])
    assert np.shares_memory(trace.blocks(trace.speed), trace.speed)


@given(st.lists(st.integers(0, 5), min_size=1, max_size=4, unique=True), st.integers(1, 7), st.integers(0, 3))
@settings(max_examples=30, deadline=None)
def test_windows_are_eq_1(blocks: list[int], m: int, extra: int) -> None:
    """Oracle: Eq. 1 as loops."""
    block = 12
    samples = np.random.default_rng(m).standard_normal((6 * block, 3))
    expected, answers = [], []
    for b in blocks:
        for n in range(b * block + m + extra, (b + 1) * block):
            expected.append([[samples[n - m + i, channel] for channel in range(3)] for i in range(m)])
            answers.append(samples[n, 0])
    n = targets(tuple(blocks), block, m + extra)
    np.testing.assert_array_equal(windows(samples, n, m), np.array(expected).reshape(-1, m, 3))
    np.testing.assert_array_equal(samples[n, 0], answers)


def trace(seed: int = 0) -> Trace:
    rng = np.random.default_rng(seed)
    n = 600
    return Trace(0.3 + 2 * rng.standard_normal(n), rng.uniform(10, 200, n), rng.uniform(0.2, 3, n), 1000.0, block=100)


def test_the_training_blocks_become_standard() -> None:
    original = trace()
    scaled = fit_scaling(original, (1, 3, 4)).scale(original.stacked()).reshape(6, 100, 3)[[1, 3, 4]].reshape(-1, 3)
    np.testing.assert_allclose(scaled.mean(axis=0), 0.0, atol=1e-13)  # rounding
    np.testing.assert_allclose(scaled.std(axis=0), 1.0, rtol=1e-13)


def test_other_blocks_have_no_say() -> None:
    original = trace()
    changed = original.acceleration.copy()
    changed[:100] *= 1e3
    changed[200:300] = 7.0
    other = dataclasses.replace(original, acceleration=changed)
    assert fit_scaling(original, (1, 3, 4)) == fit_scaling(other, (1, 3, 4))
    assert fit_scaling(original, (0, 1)) != fit_scaling(other, (0, 1))


def test_scaling_and_back() -> None:
    scaling = Scaling((0.3, 90.0, 1.2), (2.0, 50.0, 0.4))
    samples = trace().stacked()
    scaled = scaling.scale(samples)
    np.testing.assert_allclose(scaling.unscale_acceleration(scaled[:, 0]), samples[:, 0], rtol=1e-13)  # rounding
    for channel in range(3):
        np.testing.assert_array_equal(scaling.scale_channel(channel, samples[:, channel]), scaled[:, channel])


def test_one_condition_still_scales_to_order_one() -> None:
    original = dataclasses.replace(trace(), speed=np.full(600, 80.0), force=np.full(600, 0.5))
    scaling = fit_scaling(original, (0, 1))
    assert scaling.mean[1:] == (80.0, 0.5)
    assert scaling.sd[1:] == (80.0, 1.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Recording({"velocity": channel()}), r"unknown channel 'velocity', expected one of .*force_z"),
        (lambda: Recording({}), "no channel"),
        (lambda: Channel(np.zeros(0), 1000.0), r"expected \(n,\)"),
        (lambda: Channel(np.zeros((3, 4)), 1000.0), r"expected \(n,\)"),
        (lambda: Channel(np.zeros(3), 0.0), "expected a positive number"),
        (lambda: Channel(np.zeros(3), float("nan")), "expected a positive number"),
        (lambda: Channel(np.zeros(3), 1000.0, np.zeros(2)), "2 times for 3 samples"),
        (lambda: Trace(*np.zeros((3, 10)), 1000.0, 4), "10 samples are not whole blocks of 4"),
        (lambda: Trace(*np.zeros((3, 0)), 1000.0, 4), "0 samples are not whole blocks of 4"),
        (lambda: Trace(*np.zeros((3, 4)), 1000.0, 0), "4 samples are not whole blocks of 0"),
        (lambda: Trace(np.zeros(4), np.zeros(4), np.zeros(5), 1000.0, 2), "lengths differ: 4, 4, 5"),
        (lambda: Scaling((0.0, 0.0, 0.0), (1.0, 0.0, 1.0)), "speed has mean 0.0 and standard deviation"),
        (lambda: Scaling((0.0, 0.0, 0.0), (float("inf"), 1.0, 1.0)), "acceleration has mean 0.0 and standard"),
        (
            lambda: fit_scaling(dataclasses.replace(trace(), acceleration=np.full(600, 9.81)), (0, 1)),
            r"acceleration is constant.*right column",
        ),
    ],
)
def test_what_cannot_be_is_refused(make: Callable[[], object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
