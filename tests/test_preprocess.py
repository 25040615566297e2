from collections.abc import Mapping
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest

from foten.dsp.dft321 import dft321
from foten.dsp.kinematics import at_rate, speed_of, velocity
from foten.recording.preprocess import PreprocessConfig, condition, fitting_options, preprocess, pressing
from foten.recording.recording import Channel, Recording

SHORT = PreprocessConfig(trim_ms=500.0, block_ms=500.0)


def tone(hz: float, seconds: float = 6.0, rate_hz: float = 1000.0) -> np.ndarray:
    return np.sin(2 * np.pi * hz * np.arange(round(seconds * rate_hz)) / rate_hz)


TONE = tone(100.0)


def recording(
    acceleration: np.ndarray | Mapping[str, np.ndarray] = TONE, rate_hz: float = 1000.0, **channels: Channel
) -> Recording:
    """Acceleration at `rate_hz`, of one axis or more, with a steady hand unless channels say otherwise."""
    axes = acceleration if isinstance(acceleration, Mapping) else {"acceleration": acceleration}
    n = len(next(iter(axes.values())))
    steady = {"speed": Channel(np.full(n, 80.0), rate_hz), "force": Channel(np.full(n, 1.0), rate_hz)}
    if any(name.startswith("position") for name in channels):
        del steady["speed"]
    return Recording({**{k: Channel(v, rate_hz) for k, v in axes.items()}, **steady, **channels})


def amplitude(samples: np.ndarray) -> float:
    return float(np.sqrt(2 * np.square(samples).mean()))


@pytest.mark.parametrize("rate_hz", [1000.0, 10_000.0])
@pytest.mark.parametrize("zero_phase", [False, True])
def test_the_hand_and_gravity_go_and_the_vibration_stays(rate_hz: float, zero_phase: bool) -> None:
    config = replace(SHORT, zero_phase=zero_phase)

    def through(samples: np.ndarray) -> float:
        return amplitude(preprocess(recording(samples, rate_hz=rate_hz), config).acceleration)

    # Second order: the square of the frequency's share of 20 Hz; forwards and backwards twice that.
    assert through(tone(5.0, rate_hz=rate_hz)) < (1.05 * (5 / 20) ** 2) ** (1 + zero_phase)
    assert through(tone(100.0, rate_hz=rate_hz)) == pytest.approx(1.0, abs=2e-3)  # 1/√(1 + (20/100)⁴) = 0.9992
    assert through(tone(300.0, rate_hz=rate_hz)) == pytest.approx(1.0, abs=1e-3)
    assert through(np.full(round(6 * rate_hz), 9.81)) < 1e-9  # rounding
    tilted = 9.81 * np.cos(0.3 * tone(0.5, rate_hz=rate_hz))  # a wrist that turns
    assert through(tilted) < 0.01


def test_what_lies_above_the_new_rate_does_not_come_back_as_an_alias() -> None:
    trace = preprocess(recording(tone(930.0, rate_hz=10_000.0), rate_hz=10_000.0), SHORT)
    assert amplitude(trace.acceleration) < 1e-4  # 80 dB; unfiltered it would stand at 70 Hz with amplitude 1


@pytest.mark.parametrize("rate_hz", [1000.0, 2500.0, 10_000.0])
def test_any_rate_up_to_the_accelerometers_own(rate_hz: float) -> None:
    recorded = recording(tone(100.0, rate_hz=10_000.0), rate_hz=10_000.0)
    trace = preprocess(recorded, replace(SHORT, rate_hz=rate_hz))
    assert trace.block == 0.5 * rate_hz
    assert len(trace) == 5 * rate_hz - trace.n_dropped
    assert amplitude(trace.acceleration) == pytest.approx(1.0, abs=2e-3)


def bump(seconds: float, rate_hz: float, at_s: float = 3.0, width_s: float = 0.1) -> np.ndarray:
    times_s = np.arange(round(seconds * rate_hz)) / rate_hz
    return np.exp(-0.5 * ((times_s - at_s) / width_s) ** 2)


def centre_ms(weight: np.ndarray, rate_hz: float = 1000.0) -> float:
    return float((np.arange(weight.size) * weight).sum() / weight.sum() / rate_hz * 1000)


@pytest.mark.parametrize("zero_phase", [False, True])
@pytest.mark.parametrize("source", ["speed", "position"])
def test_speed_force_and_the_vibration_they_cause_stay_side_by_side(zero_phase: bool, source: str) -> None:
    """A burst of all three, as the sensors of Sec. III-c see it: 10 kHz, 10 kHz and 120 Hz."""
    vibration = np.sqrt(bump(6.0, 10_000.0)) * tone(100.0, rate_hz=10_000.0)  # its energy has one centre
    slow = bump(6.0, 120.0)
    if source == "speed":
        channels = {"speed": Channel(100 * slow, 120.0)}
    else:
        fine = np.cumsum(100 * bump(6.0, 12_000.0)) / 12_000.0  # the path, of which the tracker sees one in 100
        channels = {"position_x": Channel(0.6 * fine[::100], 120.0), "position_y": Channel(-0.8 * fine[::100], 120.0)}
    channels["force"] = Channel(bump(6.0, 10_000.0), 10_000.0)
    recorded = recording(vibration, rate_hz=10_000.0, **channels)
    trace = preprocess(recorded, PreprocessConfig(trim_ms=500.0, block_ms=5000.0, zero_phase=zero_phase))
    # A linear filter moves a centre of mass by its delay at 0 Hz exactly, here known to half a sample.
    assert centre_ms(trace.speed) == pytest.approx(2500.0, abs=1.0)
    assert centre_ms(trace.force) == pytest.approx(2500.0, abs=1.0)
    # The high-pass delays the envelope of a tone by its group delay, 0.5 ms at 100 Hz and less above.
    assert centre_ms(np.square(trace.acceleration)) == pytest.approx(2500.0, abs=1.0)


@pytest.mark.parametrize("zero_phase", [False, True])
def test_three_axes_become_one_in_each_block_by_itself(zero_phase: bool) -> None:
    """Without windows."""
    rng = np.random.default_rng(0)
    axes = {f"acceleration_{axis}": rng.standard_normal(6000) for axis in "xyz"}
    config = replace(SHORT, zero_phase=zero_phase, dft321_ms=0.0)
    before = preprocess(recording(axes), config)
    # One sample of the fifth block; the high-pass carries it on, but never back.
    changed = {**axes, "acceleration_y": axes["acceleration_y"].copy()}
    changed["acceleration_y"][500 + 4 * 500 + 250] += 5.0
    after = preprocess(recording(changed), config)
    moved = np.abs(after.blocks(after.acceleration) - before.blocks(before.acceleration)).max(axis=1)
    assert moved[4] > 1.0
    # The poles at 20 Hz have fallen by e^(-0.25·89) over a quarter of a second: nothing is left.
    assert moved[[0, 1, 2, 3, 5, 6, 7]].max() < 1e-6
    if not zero_phase:
        assert moved[:4].max() == 0.0


def test_a_window_carries_a_sample_64_ms_at_most_into_the_block_before() -> None:
    """What recorded innovations leave out beside a test block; the high-pass carries it on as far in the block after."""
    rng = np.random.default_rng(0)
    axes = {f"acceleration_{axis}": rng.standard_normal(6000) for axis in "xyz"}
    changed = {**axes, "acceleration_y": axes["acceleration_y"].copy()}
    changed["acceleration_y"][500 + 4 * 500] += 5.0  # the first sample of the fifth block
    before, after = (preprocess(recording(of), SHORT).acceleration for of in (axes, changed))
    moved = np.abs(after - before)
    assert moved[2000 - 64 : 2000].max() > 0.1
    assert moved[: 2000 - 64].max() == 0.0


@pytest.mark.parametrize("dft321_ms", [0.0, 64.0])
def test_the_axes_are_joined_after_they_are_filtered(dft321_ms: float) -> None:
    """Block by block, or in windows across them."""
    rng = np.random.default_rng(0)
    axes = {f"acceleration_{axis}": rng.standard_normal(6000) for axis in "xyz"}
    joint = preprocess(recording(axes), replace(SHORT, dft321_ms=dft321_ms))
    alone = [preprocess(recording(samples), SHORT) for samples in axes.values()]
    blocks = np.stack([trace.blocks(trace.acceleration) for trace in alone], axis=1)
    expected = dft321(np.stack([trace.acceleration for trace in alone]), 64) if dft321_ms else dft321(blocks).ravel()
    np.testing.assert_allclose(joint.acceleration, expected, atol=1e-12)  # rounding


def test_a_card_of_before_has_its_axes_joined_block_by_block() -> None:
    assert PreprocessConfig.of_card({"rate_hz": 2000.0}) == PreprocessConfig(rate_hz=2000.0, dft321_ms=0.0)
    assert PreprocessConfig.of_card(asdict(PreprocessConfig())) == PreprocessConfig()


@pytest.mark.parametrize("dft321_ms", [-1.0, 1.0])
def test_a_window_of_less_than_two_samples_is_refused(dft321_ms: float) -> None:
    with pytest.raises(ValueError, match=f"dft321_ms is {dft321_ms:g}, expected 0 or two samples and more, 2 ms"):
        PreprocessConfig(dft321_ms=dft321_ms)


@pytest.mark.parametrize("name", ["force", "force_z"])
def test_pressing_counts_positive(name: str) -> None:
    pressing = np.abs(1.0 + 0.5 * tone(0.7))

    def through(samples: np.ndarray) -> np.ndarray:
        channels: dict[str, Any] = {name: Channel(samples, 1000.0)}
        recorded = recording(**channels)
        if name != "force":
            recorded = Recording({k: v for k, v in recorded.channels.items() if k != "force"})
        return preprocess(recorded, SHORT).force

    np.testing.assert_array_equal(through(-pressing), through(pressing))
    assert through(pressing).mean() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_sign_of_pressing_is_that_of_most_samples(sign: float) -> None:
    """A short spike the other way has more weight than all of them in the mean."""
    samples = np.full(1000, sign)
    samples[:10] = -200.0 * sign
    np.testing.assert_array_equal(pressing(Channel(samples, 1000.0)), sign * samples)


@pytest.mark.parametrize(
    ("name", "noise", "wrong", "message"),
    [
        ("force", -0.4, -0.6, r"force runs from -0.6 to 1 N, expected 0 or more; is the sensor not zeroed\?"),
        ("speed", -4.0, -6.0, r"speed is negative in 1 of 6000 samples, down to -6 mm/s; is it one axis of a"),
    ],
)
def test_a_magnitude_may_be_negative_by_its_noise_alone(name: str, noise: float, wrong: float, message: str) -> None:
    samples = np.ones(6000)
    samples[300] = noise
    preprocess(recording(**{name: Channel(samples, 1000.0)}), SHORT)
    samples[300] = wrong
    with pytest.raises(ValueError, match=message):
        preprocess(recording(**{name: Channel(samples, 1000.0)}), SHORT)


def test_speed_and_force_are_never_negative() -> None:
    step = np.where(np.arange(6000) < 3000, 200.0, 0.0)  # a second-order low-pass undershoots by 4 %
    speed, force = Channel(step, 1000.0), Channel(step / 100, 1000.0)
    trace = preprocess(recording(speed=speed, force=force), SHORT)
    assert SHORT.delay_ms == pytest.approx(1000 * np.sqrt(2) / (2 * np.pi * 20), rel=2e-3)  # prewarping
    assert trace.speed.min() == 0.0
    assert trace.force.min() == 0.0


def test_rendering_conditions_a_stroke_as_training_does() -> None:
    """One low-pass on both sides: a recorded stroke, conditioned for rendering, is the trace before its delay is cut."""
    rng = np.random.default_rng(0)
    speed = np.abs(100 + np.cumsum(rng.standard_normal(6000)))
    force = np.abs(1 + 0.01 * np.cumsum(rng.standard_normal(6000)))
    trace = preprocess(recording(speed=Channel(speed, 1000.0), force=Channel(force, 1000.0)), SHORT)
    rendered = condition(speed[None], force, 1000.0, SHORT.render_lowpass_hz)
    delay = round(SHORT.delay_ms)
    for found, expected in zip(rendered, (trace.speed, trace.force), strict=True):
        # SciPy and ours sum the same products in another order.
        np.testing.assert_allclose(found[500 + delay :][: len(trace)], expected, rtol=1e-9)


def test_whole_blocks_and_what_was_dropped() -> None:
    trace = preprocess(recording(tone(100.0, 6.3)), SHORT)
    # 6.3 s less twice 0.5 s is 5.3 s: ten blocks and 300 samples.
    assert (trace.n_blocks, trace.n_dropped) == (10, 300)


def test_the_trace_says_where_it_came_from() -> None:
    recorded = recording()
    trace = preprocess(recorded, SHORT)
    assert trace.recording_sha256 == recorded.sha256()
    assert PreprocessConfig(**trace.preprocess) == SHORT


def test_a_short_recording_names_the_options() -> None:
    """As a training may choose its rate, and as a texture that has one cannot."""
    short = recording(tone(100.0, 5.0))
    message = r"^5 s are covered.*a trim of 2000 ms.*1 s, less than 5 blocks of 2000 ms; use --rate 1000 --trim 0 --block 500$"
    with pytest.raises(ValueError, match=message):
        preprocess(short, n_blocks=5)
    with pytest.raises(ValueError, match=r"leaves 1 s, less than a block of 2000 ms; use --trim 0 --block 500$"):
        preprocess(short)
    with pytest.raises(ValueError, match=r"leaves 0 s.*that is too short: record for longer"):
        preprocess(recording(tone(100.0, 0.4)))


@pytest.mark.parametrize("captured_hz", [100.0, 800.0, 3000.0, 10_000.0, 51_200.0])
@pytest.mark.parametrize("seconds", [0.53, 0.912, 1.0, 1.9, 4.7, 5.02, 8.0, 13.99, 14.0])
def test_the_options_for_a_short_recording_fit_it(seconds: float, captured_hz: float) -> None:
    n = round(seconds * captured_hz)
    recorded = Recording({name: Channel(np.ones(n), captured_hz) for name in ("acceleration", "speed", "force")})
    words = fitting_options(n / captured_hz, 1000.0, captured_hz).split()
    assert words[::2] == ["--rate", "--trim", "--block"]
    rate, trim, block = map(float, words[1::2])
    trace = preprocess(recorded, PreprocessConfig(rate_hz=rate, trim_ms=trim, block_ms=block), n_blocks=5)
    assert trace.n_blocks >= (9 if 1 <= seconds < 14 else 5)
    if captured_hz == 10_000:  # a short recording is trained at a higher rate
        assert rate == {0.53: 10_000, 0.912: 10_000, 1.0: 10_000, 1.9: 10_000, 4.7: 2500}.get(seconds, 1000)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"rate_hz": 0.0}, "rate is 0 Hz"),
        ({"trim_ms": -1.0}, "trim is -1 ms"),
        ({"block_ms": 0.0}, "block 0 ms"),
        ({"highpass_hz": 500.0}, "highpass_hz is 500 Hz"),
        ({"lowpass_hz": 0.0}, "lowpass_hz is 0 Hz"),
        ({"rate_hz": 40.0}, "half the rate, 20 Hz"),
        ({"highpass_order": 3}, "order is 3"),
        ({"highpass_order": 22}, "highpass_order is 22, expected 20 at most"),
        ({"lowpass_hz": float("nan")}, "lowpass_hz is nan, expected a finite number"),
    ],
)
def test_a_config_is_checked(fields: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        PreprocessConfig(**fields)


def test_what_not_every_channel_covers_is_left_out_and_counted() -> None:
    """Speed and force from 2 to 6 s beside 6 s of acceleration: nothing is invented for the first two."""
    times = 2.0 + np.arange(400) / 100
    speed, force = (Channel(values, 100.0, times) for values in (50 * times, 0 * times + 1))
    recorded = recording(speed=speed, force=force)
    trace = preprocess(recorded, PreprocessConfig(trim_ms=0, block_ms=500))
    assert trace.n_uncovered == 2000
    # The first sample of the trace is at 2 s, where the speed is 100 mm/s, to within the low-pass's settling.
    assert trace.speed[200] == pytest.approx(50 * 2.2, rel=0.02)


def test_a_stroke_along_one_axis_has_a_speed_both_ways() -> None:
    position = 20 * np.sin(2 * np.pi * 1.0 * np.arange(720) / 120)
    recorded = recording(position_x=Channel(position, 120.0), force=Channel(np.ones(6000), 1000.0))
    trace = preprocess(recorded, SHORT)
    # The mean of |cos| is 2/π.
    assert trace.speed.mean() == pytest.approx(20 * 2 * np.pi * 2 / np.pi, rel=0.05)


@pytest.mark.parametrize(
    ("name", "peak", "message"),
    [
        ("acceleration", 2000.0, r"the acceleration reaches 2000 m/s², beyond any hand \(1000 m/s²\)"),
        ("speed", 50_000.0, "the speed reaches 50000 mm/s"),
        ("force", 900.0, "the force reaches 900 N"),
    ],
)
def test_what_no_hand_does_is_refused_unless_forced(name: str, peak: float, message: str) -> None:
    """Also in a recording that another program wrote, which `foten import` never saw."""
    channels = {"acceleration": tone(100.0), "speed": np.full(6000, 80.0), "force": np.ones(6000)}
    loudest = channels["acceleration"] / channels["acceleration"].max()
    channels[name] = np.full(6000, peak) if name != "acceleration" else peak * loudest
    absurd = Recording({key: Channel(values, 1000.0) for key, values in channels.items()})
    with pytest.raises(ValueError, match=message):
        preprocess(absurd, SHORT)
    trace = preprocess(absurd, replace(SHORT, force_units=True))
    assert float(np.abs(getattr(trace, name)).max()) == pytest.approx(peak, rel=0.1)


def _changed(**channels: Channel | None) -> Recording:
    """Usable recording with other channels, or without some."""
    changed = {**recording().channels, **channels}
    return Recording({name: channel for name, channel in changed.items() if channel is not None})


ROWS_S = np.delete(np.arange(600) / 100, slice(200, 300))


@pytest.mark.parametrize(
    ("unusable", "message"),
    [
        (_changed(acceleration=None), "no acceleration"),
        (_changed(speed=None), "no speed and no position_x"),
        (_changed(force=None), "no force and no force_z"),
        (_changed(acceleration=Channel(tone(100.0), 800.0)), "captured at 800 Hz and 1000 Hz is asked for.*--rate 800"),
        (_changed(acceleration=Channel(tone(100.0), 1000.0, np.arange(6000) / 1000.0)), "irregular times, expected a"),
        (_changed(speed=None, position_x=Channel(20 * ROWS_S, 100.0, ROWS_S)), "1 hole in its times, the longest 1010"),
    ],
)
def test_what_cannot_be_used_is_named(unusable: Recording, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        preprocess(unusable, SHORT)


def test_a_circle_has_one_speed() -> None:
    turn = 2 * np.pi * 2.0 * np.arange(2000) / 1000.0  # 2 Hz, radius 10 mm
    speed = speed_of(velocity(10.0 * np.stack([np.cos(turn), np.sin(turn)]), 1000.0))
    # Central differences scale a frequency by sin(ωh)/(ωh).
    step = 2 * np.pi * 2.0 / 1000.0
    np.testing.assert_allclose(speed[1:-1], 10 * 2 * np.pi * 2.0 * np.sin(step) / step, rtol=1e-9)


def test_where_the_pen_stands_or_has_no_history_speed_is_zero() -> None:
    np.testing.assert_array_equal(velocity(np.full((2, 10), 7.0), 100.0), 0.0)
    np.testing.assert_array_equal(velocity(np.ones((2, 1)), 100.0), np.zeros((2, 1)))
    assert velocity(np.ones((2, 0)), 100.0).shape == (2, 0)


@pytest.mark.parametrize("source_hz", [120.0, 1000.0, 10_000.0])
def test_a_still_pen_reads_no_speed_whatever_noise_its_position_has(source_hz: float) -> None:
    rng = np.random.default_rng(0)
    times_s = np.arange(round(4 * source_hz)) / source_hz
    positions = 0.02 * rng.standard_normal((2, times_s.size))
    at_model = np.stack([at_rate(axis, times_s, 1000.0, 3900) for axis in positions])
    speed, _ = condition(velocity(at_model, 1000.0), np.ones(3900), 1000.0, 20.0)
    # 0.02 mm over 60 Hz of noise, differentiated below 20 Hz, is 0.8 mm/s an axis; far below FADE_SPEED.
    assert speed[200:].mean() < 1.6


def test_a_dense_signal_is_averaged_over_each_period() -> None:
    times_s = np.arange(10_000) / 10_000.0
    noise = np.random.default_rng(1).standard_normal(10_000)
    found = at_rate(noise, times_s, 1000.0, 1000)
    # Ten neighbours averaged, the outermost by half: the deviation falls to about 1/√10.
    assert found[5:-5].std() == pytest.approx(10**-0.5, rel=0.1)
    np.testing.assert_allclose(at_rate(3 * times_s, times_s, 1000.0, 999)[1:], 3 * np.arange(1, 999) / 1000)


def test_a_dense_signal_stays_averaged_beside_a_hole_in_it() -> None:
    """Whether a signal is dense is the usual step's to say: one hole of 20 s makes their mean longer than a sample."""
    times_s = np.concatenate([np.arange(10_000), np.arange(10_000) + 210_000]) / 10_000.0
    noise = np.random.default_rng(1).standard_normal(times_s.size)
    assert at_rate(noise, times_s, 1000.0, 1000)[5:-5].std() == pytest.approx(10**-0.5, rel=0.1)


def test_the_ends_of_a_dense_signal_are_held() -> None:
    """Before its first sample and after its last, and in the periods that it covers by half."""
    times_s = 0.1 + np.arange(10_000) / 10_000.0
    np.testing.assert_allclose(at_rate(np.full(10_000, 3.0), times_s, 1000.0, 1500), 3.0, rtol=1e-9)  # of sums to 3


def test_a_line_is_interpolated_exactly_and_its_ends_are_held() -> None:
    times_s = np.arange(12) / 120.0 + 0.01
    found = at_rate(3.0 + 5.0 * times_s, times_s, 1000.0, 150)
    grid = np.clip(np.arange(150) / 1000.0, times_s[0], times_s[-1])
    np.testing.assert_allclose(found, 3.0 + 5.0 * grid, rtol=1e-12)  # rounding
