"""The kernel in C: it renders what the reference does, the same bytes in any blocks; what it cannot prove it refuses."""

from __future__ import annotations

import ast
import ctypes
import dataclasses
import json
import os
import re
import runpy
import struct
import subprocess
import sys
import threading
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.numpy import save
from scipy.signal import butter, lfilter, lfilter_zi

import foten
from conftest import PLUS, SCALING, SMALL, exported
from foten.dsp.noise import gaussian
from foten.models import definitions as reference
from foten.models.definitions import model_of
from foten.models.foten.sizes import FotenSizes
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.stream import run
from foten.models.texture_file import CLOSED_LOOP_TOLERANCE, Texture
from foten.models.trainable import TRAINABLE
from foten.runtime.binding import _SIGNATURES, NativeActuator, Options, library
from foten.runtime.native import NativeState, NativeTexture
from foten.runtime.renderer import Renderer
from test_loops import EVERY, case, in_float64_alone, rounding
from test_reference import sizes_for
from test_rendering import stroke, with_card


@pytest.fixture(scope="module")
def native(texture: Texture) -> NativeTexture:
    return NativeTexture(texture.to_bytes())


def held(state: NativeState, n: int, speed: float = 90.0, force: float = 1.0) -> np.ndarray:
    """The next n samples under a condition that stays [m/s²]."""
    out = np.empty(n, dtype=np.float32)
    state.set_condition(speed, force)
    state.render(out)
    return out


@pytest.mark.parametrize(("key", "variant"), EVERY)
def test_it_renders_what_the_reference_renders(key: str, variant: str) -> None:
    """Seam: from the beginning, through rests, beyond the range and across some hundred samples; with chance and without."""
    texture, model = case(key, variant)
    native = NativeTexture(texture.to_bytes())
    n = 400 if in_float64_alone(texture.sizes) else 150
    speed, force = (channel.astype(np.float32) for channel in stroke(n))
    double = in_float64_alone(texture.sizes)
    for excitation in (True, False):
        expected = reference.render(texture, speed.astype(float), force.astype(float), 3, 2, excitation, model)
        states = [NativeState(native, seed=3, stream=k, excitation=excitation) for k in range(2)]
        rendered = [state.render_stroke(speed, force) for state in states]
        size = SCALING.sd[0] * np.maximum(1, np.abs(expected) / SCALING.sd[0])
        error = np.abs(rendered - expected) / size
        # What comes out is in float32. A network is as well, and what it rounds is fed back: for longer a loop of a network
        # alone may part from itself.
        exact = 2e-7 + rounding(texture.sizes)
        first, later = (exact, exact) if double else (CLOSED_LOOP_TOLERANCE, 10 * CLOSED_LOOP_TOLERANCE)
        assert error[:, :64].max() < first, excitation
        assert error.max() < (later if key in ("foten-plus", "ar") else 10 * later), excitation
        silent = not texture.predicts_samples and not excitation
        assert silent or np.abs(expected - SCALING.mean[0]).max() > 0.01


def test_a_stroke_of_a_network_that_grows_begins_within_bounds() -> None:
    """A window's length is run before the first sample, cut to ±50 standard deviations: nothing else bounds it."""
    sizes = FotenSizes(**SMALL, excitation=True)
    weight = 300 * exported("foten", sizes).tensors["head_3.weight"]
    texture = exported("foten", sizes, {"head_3.weight": weight}, saturation=60.0)
    speed, force = np.full(5, 80.0), np.full(5, 1.0)
    expected = reference.render(texture, speed, force, 1)[0]
    size = np.abs(expected - SCALING.mean[0]).max()
    assert size > 20 * SCALING.sd[0]
    # Such a loop multiplies what float32 rounds; uncut it is somewhere else altogether.
    assert np.abs(Renderer(texture, seed=1).render(speed, force) - expected).max() < 0.05 * size


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A texture file of every family."""
    folder = tmp_path_factory.mktemp("families")
    for key in TRAINABLE:
        (folder / f"{key}.foten").write_bytes(exported(key).to_bytes())
    return sorted(folder.iterdir())


ISAS = ("avx512", "avx2", "neon", "portable")


def printed_with(isa: str, program: str, paths: list[Path]) -> list[str]:
    """What a program prints in a process that is asked to use an instruction set."""
    command = [sys.executable, "-c", program, *map(str, paths)]
    env = {**os.environ, "FOTEN_ISA": isa}
    return subprocess.run(command, env=env, capture_output=True, text=True, check=True).stdout.split()


@pytest.mark.parametrize("name", ISAS)
def test_every_instruction_set_passes_the_proof(name: str, files: list[Path]) -> None:
    """All families; loading is the proof: golden windows within 1e-5, 64 closed-loop steps within 1e-4."""
    program = (
        "import sys, numpy; from foten.runtime.binding import isa, library; from foten.runtime.native import NativeTexture; "
        "[NativeTexture(open(path, 'rb').read()) for path in sys.argv[1:]]; noise = numpy.empty(100); "
        "library().foten_noise(1, 2, 3, 100, noise.ctypes); print(isa(), noise.tobytes().hex())"
    )
    used, numbers = printed_with(name, program, files)
    assert numbers == gaussian(1, 2, 3, 100).tobytes().hex()
    if used != name:
        pytest.skip(f"this processor has {used}, not {name}")


def test_every_instruction_set_renders_the_same_bytes_of_foten_plus(tmp_path: Path) -> None:
    """Whatever the width of vectors: layers as wide as they are trained, and a padded one."""
    paths = [tmp_path / f"{variant}.foten" for variant in ("usual-widths", "widths-of-no-panel")]
    for path in paths:
        path.write_bytes(exported("foten-plus", sizes_for("foten-plus", path.stem)).to_bytes())
    program = (
        "import sys, foten; from foten.runtime.binding import isa; "
        "print(isa(), *(foten.Renderer(path, seed=3).render(80.0, 1.0, 3000).tobytes().hex() for path in sys.argv[1:]))"
    )
    rendered = {}
    for name in ISAS:
        used, *samples = printed_with(name, program, paths)
        rendered[used] = samples
    assert "portable" in rendered
    assert all(samples == rendered["portable"] for samples in rendered.values())


def test_the_noise_is_that_of_dsp_noise_to_the_bit() -> None:
    noise = np.empty(50)
    for seed, stream, first in ((0, 0, 0), (2**64 - 1, 7, 2**32 - 3), (5, 2**63, 2**40)):
        library().foten_noise(seed, stream, first, 50, noise.ctypes)
        np.testing.assert_array_equal(noise, gaussian(seed, stream, first, 50))


@given(cuts=st.lists(st.integers(0, 600), max_size=8), rate=st.sampled_from([None, 1000.0, 2000.0, 44_100.0, 300.0]))
@settings(max_examples=25, deadline=None)
def test_any_block_sizes_give_the_same_bytes(native: NativeTexture, cuts: list[int], rate: float | None) -> None:
    at_once, pieces = held(NativeState(native, rate, seed=9), 600), NativeState(native, rate, seed=9)
    for a, b in pairwise([0, *sorted(cuts), 600]):
        np.testing.assert_array_equal(held(pieces, b - a), at_once[a:b])


@pytest.mark.parametrize("rate", [None, 8000.0, 48_000.0])
def test_a_stroke_is_a_condition_that_is_set_before_each_sample(native: NativeTexture, rate: float | None) -> None:
    speed, force = (channel.astype(np.float32) for channel in stroke(300))
    at_once = NativeState(native, rate, seed=1).render_stroke(speed, force)
    pieces = NativeState(native, rate, seed=1)
    out = [pieces.render_stroke(speed[i : i + 7], force[i : i + 7]) for i in range(0, 300, 7)]
    np.testing.assert_array_equal(np.concatenate(out), at_once)
    assert abs(at_once.size - 300 * (rate or 1000.0) / 1000.0) <= (rate or 1000.0) / 1000.0


@pytest.mark.parametrize("rate", [300.0, 2500.0, 8000.0, 44_100.0, 48_000.0])
def test_a_stroke_after_a_held_condition_goes_on_where_that_ended(native: NativeTexture, rate: float) -> None:
    """A held block may end between two of the texture's samples: what the first still gave was lost, and the next had no end."""
    mixed, parts = NativeState(native, rate, seed=1), []
    for n in (1, 5, 13, 1, 29):
        parts += [held(mixed, n), mixed.render_stroke(np.full(40, 90.0), np.full(40, 1.0))]
    result = np.concatenate(parts)
    np.testing.assert_array_equal(result, held(NativeState(native, rate, seed=1), result.size))
    assert result.size == pytest.approx(49 + 5 * 40 * rate / 1000, abs=2 + 5 * max(1.0, rate / 1000))


@pytest.mark.parametrize(("speed", "force"), [(0.0, -1e-9), (-1e-9, 0.0), (80.0, -2.0), (-90.0, 1.0)])
def test_a_condition_below_zero_counts_as_zero(native: NativeTexture, speed: float, force: float) -> None:
    """A tool that leaves a surface measures a force a little below zero: what was before must not go on."""
    zero = max(speed, 0.0), max(force, 0.0)
    below, at_zero = NativeState(native, seed=2), NativeState(native, seed=2)
    for state in (below, at_zero):
        state.set_condition(80.0, 1.0)
    np.testing.assert_array_equal(held(below, 50, speed, force), 0.0)
    np.testing.assert_array_equal(held(at_zero, 50, *zero), 0.0)
    assert below.statistics.n_refused == 1
    strokes = [np.full(20, value) for value in (speed, force, *zero)]
    np.testing.assert_array_equal(below.render_stroke(*strokes[:2]), at_zero.render_stroke(*strokes[2:]))
    assert below.statistics.n_refused == 21


def test_a_reset_keeps_the_condition(native: NativeTexture) -> None:
    state, again = NativeState(native, seed=3), np.empty(100, dtype=np.float32)
    before = held(state, 100)
    state.reset(3)
    state.render(again)
    np.testing.assert_array_equal(again, before)
    assert np.abs(before).max() > 0


@pytest.mark.parametrize("after_reset", [False, True])
def test_a_smoothed_condition_is_the_low_pass_of_the_one_that_is_set(
    native: NativeTexture, texture: Texture, after_reset: bool
) -> None:
    """Oracle: SciPy's Butterworth low-pass of second order, begun as after a long time of the first condition."""
    b, a = butter(2, float(texture.card["lowpass_hz"]), fs=texture.rate_hz)
    steps = np.repeat([100.0, 140.0, 90.0], 60)
    smooth = NativeState(native, seed=3, smooth=True)
    if after_reset:
        held(smooth, 100, 20.0, 2.0)
        smooth.reset(3)
    out = [held(smooth, 1, speed)[0] for speed in steps]  # at the texture's rate, so that a block is a sample
    speed, _ = lfilter(b, a, steps, zi=steps[0] * lfilter_zi(b, a))
    expected = NativeState(native, seed=3).render_stroke(speed, np.ones(180))
    np.testing.assert_allclose(out, expected, atol=1e-4 * np.abs(expected).max())


@pytest.mark.parametrize("rate", [None, 8000.0])
def test_smoothing_does_not_fade_a_held_condition_in(native: NativeTexture, rate: float | None) -> None:
    """It began at zero: the first 20 ms rose from silence. Whatever the blocks, and again after a reset."""
    smooth, expected = NativeState(native, rate, seed=3, smooth=True), held(NativeState(native, rate, seed=3), 400)
    for _ in range(2):
        parts = [held(smooth, n) for n in (1, 7, 150, 242)]
        # The low-pass rounds in float64, what comes out is in float32.
        np.testing.assert_allclose(np.concatenate(parts), expected, atol=1e-6 * np.abs(expected).max())
        assert smooth.statistics.n_below == 0
        smooth.reset(3)


def test_reset_begins_again_and_seeds_and_streams_differ(native: NativeTexture) -> None:
    speed, force = (channel.astype(np.float32) for channel in stroke(200))
    for rate in (44_100.0, None):  # at the first, 200 samples end within one of the texture's
        state = NativeState(native, rate, seed=4)
        first = state.render_stroke(speed, force)
        state.reset(4)
        np.testing.assert_array_equal(state.render_stroke(speed, force), first)
    for other in (NativeState(native, seed=5), NativeState(native, seed=4, stream=1)):
        assert np.corrcoef(other.render_stroke(speed, force), first)[0, 1] < 0.5
    silent = NativeState(native, excitation=False).render_stroke(speed, force)
    assert np.abs(silent[100:]).max() < 0.2 * np.abs(first[100:]).max()


def test_it_goes_on_from_a_recorded_window_as_the_reference_does(texture: Texture, native: NativeTexture) -> None:
    rng = np.random.default_rng(2)
    window = rng.standard_normal((texture.window, 3)).astype(np.float32)
    physical = np.abs((window * SCALING.sd + SCALING.mean).astype(np.float32))
    speed, force = np.linspace(20, 160, 100, dtype=np.float32), np.linspace(0.4, 1.5, 100, dtype=np.float32)
    state = NativeState(native)
    state.start(*physical.T)
    stroked = np.stack([speed, force], axis=1).astype(float)
    condition = np.concatenate([(stroked - SCALING.mean[1:]) / SCALING.sd[1:], stroked[:, :1]], axis=1)
    stream = model_of(texture.sizes, texture.tensors).start(SCALING.scale(physical.astype(float))[None])
    expected = SCALING.unscale_acceleration(run(stream, condition[None], gaussian(0, 0, 0, 100)[None])[0])
    rendered = state.render_stroke(speed, force)
    np.testing.assert_allclose(rendered, expected, atol=CLOSED_LOOP_TOLERANCE * SCALING.sd[0])
    with pytest.raises(ValueError, match="NaN"):
        state.start(np.full(texture.window, np.nan), physical[:, 1], physical[:, 2])
    with pytest.raises(ValueError, match="shapes"):
        state.start(physical[1:, 0], physical[1:, 1], physical[1:, 2])


def test_what_it_counts(native: NativeTexture) -> None:
    speed = np.array([0.0, 4.0, 100.0, 230.0, 500.0, 100.0], dtype=np.float32)
    force = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 6.5], dtype=np.float32)
    state = NativeState(native)
    state.render_stroke(speed, force)
    counted = state.statistics
    assert (counted.n, counted.n_below, counted.n_refused, counted.n_saturated) == (6, 2, 0, 0)
    assert (counted.n_speed_beyond, counted.n_speed_clamped) == (2, 1)
    assert (counted.n_force_beyond, counted.n_force_clamped) == (1, 1)
    state.set_condition(float("nan"), 1.0)
    state.set_condition(1.0, -1.0)
    state.render_stroke(np.array([np.inf], dtype=np.float32), np.array([1.0], dtype=np.float32))
    assert state.statistics.n_refused == 3
    state.reset(0)
    assert state.statistics.n == state.statistics.n_refused == 0


def test_every_sample_that_fades_is_counted_as_below(texture: Texture) -> None:
    """A range that begins below 2 mm/s and 0.1 N ends where it fades: it was not counted there."""
    slow = with_card(texture, trained_range={"speed": [0.0026, 220.0], "force": [0.02, 2.5]})
    native = NativeTexture(slow.to_bytes())
    for fades, conditions in (
        (True, ((1.0, 1.0), (1.999, 1.0), (80.0, 0.05), (1.0, 0.05))),  # once a sample, though both fade at the last
        (False, ((2.0, 1.0), (80.0, 0.1001))),
    ):
        for speed, force in conditions:
            state = NativeState(native)
            held(state, 50, speed, force)
            assert state.statistics.n_below == 50 * fades, (speed, force)


def test_a_refused_condition_leaves_the_last_one(native: NativeTexture) -> None:
    state = NativeState(native, seed=2)
    state.set_condition(80.0, 1.0)
    np.testing.assert_array_equal(held(state, 50, np.inf), held(NativeState(native, seed=2), 50, 80.0))


def test_the_condition_may_come_from_any_thread(native: NativeTexture) -> None:
    """Speed and force are set at once: a rendering never takes the one of one call and the other of another."""
    state, stop = NativeState(native), threading.Event()
    state.set_condition(100.0, 1.0)

    def set_in_turn() -> None:
        while not stop.is_set():
            state.set_condition(100.0, 1.0)  # within the range
            state.set_condition(300.0, 3.0)  # above it in both: seen as one sample beyond

    setter = threading.Thread(target=set_in_turn)
    setter.start()
    out = np.empty(20_000, dtype=np.float32)
    try:
        # A kernel that stored speed and force one after the other was caught in five of six runs of so many samples, and in one
        # block never. On a busy machine the other thread may not have its turn for a while.
        for block in range(300):
            state.render(out)
            assert np.isfinite(out).all()
            if block >= 100 and 0 < state.statistics.n_speed_beyond < state.statistics.n:
                break
    finally:
        stop.set()
        setter.join()
    assert state.statistics.n_refused == 0
    assert state.statistics.n_speed_beyond == state.statistics.n_force_beyond
    assert 0 < state.statistics.n_speed_beyond < state.statistics.n


def power(signal: np.ndarray, rate: float, low: float, high: float = np.inf) -> float:
    """The power of a signal at that rate between two frequencies [Hz], per sample."""
    window = np.hanning(signal.size)
    hertz = np.fft.rfftfreq(signal.size, 1 / rate)
    spectrum = np.square(np.abs(np.fft.rfft(signal * window)))
    return float(spectrum[(hertz > low) & (hertz < high)].sum() / np.square(window).sum())


@pytest.mark.parametrize("rate", [2000.0, 8000.0, 48_000.0, 44_100.0])
def test_another_rate_keeps_the_band_and_adds_nothing_above(
    texture: Texture, native: NativeTexture, rate: float
) -> None:
    """Physics: the spectrum below 450 Hz stays, images above 550 Hz are 50 dB below it, and the delay is the one stated."""
    n = 20_000
    base, state = held(NativeState(native, seed=6), n, 100.0), NativeState(native, rate, seed=6)
    out = held(state, round(n * rate / 1000), 100.0)
    assert state.delay_s == pytest.approx(1.53e-3, abs=0.05e-3)
    in_band = power(out, rate, 20, 450)
    assert power(out, rate, 550) < 1e-5 * in_band
    assert in_band * (1000 / rate) / power(base, 1000.0, 20, 450) == pytest.approx(1.0, rel=0.01)
    # A slow part, as it would be at the output's rate, against the delayed one.
    slow = np.fft.rfft(base)
    slow[np.fft.rfftfreq(n, 1e-3) > 100] = 0
    padded = np.zeros(out.size // 2 + 1, dtype=complex)
    padded[: slow.size] = slow[: padded.size]
    wanted = np.fft.irfft(padded, out.size) * rate / 1000
    part = np.fft.rfft(out)
    part[np.fft.rfftfreq(out.size, 1 / rate) > 100] = 0
    lags = np.arange(0, round(0.004 * rate))
    result = np.fft.irfft(part, out.size)
    match = [float(result[lag : lag + out.size // 2] @ wanted[: out.size // 2]) for lag in lags]
    assert lags[int(np.argmax(match))] / rate == pytest.approx(state.delay_s, abs=0.2e-3 + 0.5 / rate)


@pytest.mark.parametrize("rate", [700.0, 250.0, 150.0])
def test_a_slower_device_keeps_its_band_and_gets_no_more(native: NativeTexture, rate: float) -> None:
    """Physics: below 0.4 of the device's rate the power stays, and that of the texture's 120 Hz is not folded into it."""
    n = 40_000
    powers, signals = [], []
    for of, base in ((None, 1000.0), (rate, rate)):
        state = NativeState(native, of, seed=6)
        signal = held(state, round(n * base / 1000), 100.0)
        powers.append(power(signal - signal.mean(), base, 2, 0.4 * rate) / base)
        signals.append(signal.astype(float))
    # The same realisation: what differs is the first and the last samples of a window, and a ripple of the passband.
    assert powers[1] == pytest.approx(powers[0], rel=0.02)
    assert state.delay_s == pytest.approx(1.53e-3 * 1000 / rate, rel=0.05)
    assert signals[1].mean() == pytest.approx(signals[0].mean(), abs=0.02 * signals[0].std())


@pytest.mark.parametrize("rate", [60.0, 250.0, 999.0, 1001.0, 8000.0])
def test_a_constant_stays_itself_at_any_rate(rate: float) -> None:
    """Physics: a lattice without excitation dies away, and leaves the mean acceleration."""
    sizes = FotenPlusSizes(**PLUS)
    texture = exported("foten-plus", sizes, scaling={"mean": [0.7, 100.0, 1.0], "sd": list(SCALING.sd)})
    state = NativeState(NativeTexture(texture.to_bytes()), rate, excitation=False)
    out = held(state, int(20 * rate), 100.0)
    # Between two of the texture's samples it dips by 0.5 %, which puts −73 dB at the texture's rate.
    np.testing.assert_allclose(out[out.size * 3 // 4 :], 0.7, rtol=0.01)
    assert out[out.size * 3 // 4 :].mean() == pytest.approx(0.7, rel=1e-3)


NATIVE = Path(__file__).parents[1] / "packages/foten/native"


def test_a_change_of_rate_stops_what_its_header_says() -> None:
    table = runpy.run_path(str(NATIVE / "tools" / "resample_table.py"))
    kernel = table["kernel"]()
    spectrum = np.abs(np.fft.rfft(kernel, 1 << 18))
    rates = np.fft.rfftfreq(1 << 18, 1 / table["STEPS"])
    assert 20 * np.log10(spectrum[rates >= 0.55].max() / spectrum[0]) < -58
    assert 20 * np.log10(spectrum[rates <= 0.45].min() / spectrum[0]) > -0.01


def test_a_change_of_rate_does_not_drift(native: NativeTexture) -> None:
    """Oracle: the table at places that are counted in fractions, after 10 s. A step of 32 bits would be 10⁻⁵ of a sample off."""
    rate, n, last = 44_100, 441_000, 50
    base, out = held(NativeState(native, seed=3), 10_000), held(NativeState(native, float(rate), seed=3), n)
    table = runpy.run_path(str(NATIVE / "tools" / "resample_table.py"))
    kernel, steps = np.append(table["kernel"](), 0.0), table["STEPS"]
    expected = []
    for place in (Fraction(1000 * k, rate) for k in range(n - last, n)):
        newest, taps = int(place), np.arange(kernel.size // steps)
        at = steps * (float(place - newest) + taps)
        expected.append(base[newest - taps] @ np.interp(at, np.arange(kernel.size), kernel))
    # Both are float32, and so is the table.
    np.testing.assert_allclose(out[-last:], expected, atol=1e-6 * np.abs(base).max())


def test_rates_that_cannot_be_are_refused(native: NativeTexture) -> None:
    for rate in (40.0, 500_000.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="expected 50 to 400000 Hz"):
            NativeState(native, rate)
        options = Options(rate, 0, 0, 0, 0)
        assert library().foten_state_new(native.pointer, ctypes.byref(options)) is None


@pytest.mark.parametrize("base", [101.0, 1000.0, 10_000.0])
def test_both_ends_of_the_rates_can_be_rendered(texture: Texture, base: float) -> None:
    """A twentieth of 101 Hz was refused, for want of memory: 101 · 0.05 is more than 101 / 20 in float64."""
    preprocess_entry = {**texture.card["preprocess"], "rate_hz": base}
    native = NativeTexture(with_card(texture, rate_hz=base, preprocess=preprocess_entry).to_bytes())
    for rate in (base / 20, 400 * base):
        assert NativeState(native, rate).delay_s > 0


NULLS = """
import sys
from ctypes import Structure, c_double, c_float, c_int, c_size_t, c_uint64
from foten.runtime.binding import PREDICTOR, _SIGNATURES, library
from foten.runtime.native import NativeState, NativeTexture

def tried(name, *first):
    kinds = _SIGNATURES[name][1]
    nulls = [1 if kind in (c_double, c_float, c_int, c_size_t, c_uint64) else None for kind in kinds]
    nulls = [PREDICTOR() if kind is PREDICTOR else null for kind, null in zip(kinds, nulls)]
    if None in nulls:
        given = getattr(library(), name)(*first, *nulls[len(first):])
        print(name, sum(bytes(given)) if isinstance(given, Structure) else given)

native = NativeTexture(open(sys.argv[1], "rb").read())
state = NativeState(native)
for name in _SIGNATURES:
    tried(name)
for end in ("condition", "start", "start_scaled", "run_scaled", "predict", "render", "render_stroke", "render_stylus"):
    tried("foten_" + end, state.pointer)
tried("foten_stylus_next", library().foten_stylus_new(native.pointer, None))
"""


def test_null_is_refused_or_does_nothing(texture: Texture, tmp_path: Path) -> None:
    """Of every function, for all pointers; and for all but the state. In a process of its own, which a crash ends."""
    path = tmp_path / "t.foten"
    path.write_bytes(texture.to_bytes())
    command = [sys.executable, "-c", NULLS, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    results = [line.split() for line in done.stdout.splitlines()]
    assert len(results) == len(_SIGNATURES) - 3 + 9  # three take no pointer
    refused = {"foten_model_load", "foten_model_load_with", "foten_start", "foten_start_scaled", "foten_predict"}
    for name, result in results:
        expected = ["2"] if name in {*refused, "foten_set_actuator"} else ["None", "0", "0.0"]
        assert result in expected, name


def test_why_nothing_was_loaded_is_always_said() -> None:
    """Also where it is the caller's own mistake: `why` was left as it had been."""
    model, data = ctypes.c_void_p(1), b"no texture"
    cases = (
        ((data, len(data), None), 2, "model is NULL"),
        ((None, 100, ctypes.byref(model)), 2, "bytes is NULL"),
        ((None, 0, ctypes.byref(model)), 1, "the file has 0 bytes, expected a texture file; is it truncated?"),
        ((data, len(data), ctypes.byref(model)), 1, "this is not a texture file, or it is truncated"),
    )
    for arguments, status, message in cases:
        why = ctypes.create_string_buffer(b"before", 64)
        assert library().foten_model_load(*arguments, why, len(why)) == status
        assert why.value.decode() == message
        assert library().foten_model_load(*arguments, None, 0) == status
        library().foten_model_load(*arguments, why, 5)
        assert why.value.decode() == message[:4]
    assert not model  # it was set to NULL


@pytest.mark.parametrize("rate", [None, 8000.0])
def test_what_is_no_number_is_silence_and_the_loop_begins_again(plain_texture: Texture, rate: float | None) -> None:
    """The drive of an actuator that hardly moves, 1e-60 m/s² for one of drive, is more than float32 holds."""
    plain = NativeTexture(plain_texture.to_bytes())
    state, other = NativeState(plain, rate), NativeState(plain, rate)
    state.set_actuator(NativeActuator(0.0, 0.0, 1e-60, 0.0, 0.0))
    np.testing.assert_array_equal(held(state, 50), 0.0)
    n_lost = state.statistics.n_lost
    assert n_lost == 50 if rate is None else n_lost >= 5
    state.set_actuator(None)
    out, expected = held(state, 50), held(other, 50)
    assert state.statistics.n_lost == n_lost
    if rate is None:
        np.testing.assert_array_equal(out, expected)
    assert np.isfinite(out).all()
    assert np.abs(out).max() > 0


def test_a_file_cut_anywhere_is_refused(texture: Texture) -> None:
    data = texture.to_bytes()
    rng = np.random.default_rng(0)
    for n in [*range(0, 40), *rng.integers(40, len(data) - 1, 60)]:
        with pytest.raises(ValueError, match=r"texture|tensor|card|header"):
            NativeTexture(data[:n])


def test_a_file_whose_tensors_were_cut_off_is_called_truncated(texture: Texture) -> None:
    """Its header is whole: the tensor that was read first was said to be missing, or damaged."""
    data = texture.to_bytes()
    header = 8 + int.from_bytes(data[:8], "little")
    for n in (header, header + 1, (header + len(data)) // 2, len(data) - 1):
        message = f"{n - header} bytes of tensors, expected {len(data) - header}: is it truncated"
        with pytest.raises(ValueError, match=message):
            NativeTexture(data[:n])


def test_the_proof_finds_damage_that_is_large(texture: Texture) -> None:
    """A flipped bit of a weight, as docs/texture-file.md says: an exponent's is found, the last of a mantissa is not."""
    name = "lattice.reflections"
    for bit, detected in ((0, False), (29, True)):
        bits = np.ascontiguousarray(texture.tensors[name], dtype=np.float32).view(np.uint32).copy()
        bits.flat[0] ^= np.uint32(1 << bit)
        damaged = dataclasses.replace(texture, tensors={**texture.tensors, name: bits.view(np.float32)})
        if not detected:
            NativeTexture(damaged.to_bytes())
            continue
        with pytest.raises(ValueError, match=r"proof|stable"):
            NativeTexture(damaged.to_bytes())


def test_what_is_wrong_in_a_file_is_named(texture: Texture) -> None:
    def bytes_of(card: dict[str, Any] | None = None, **tensors: np.ndarray) -> bytes:
        tensors_ = {name: np.ascontiguousarray(t) for name, t in {**texture.tensors, **tensors}.items()}
        return bytes(save(tensors_, metadata={"foten": json.dumps({**texture.card, **(card or {})})}))

    sizes = dict(texture.card["sizes"])
    cases = [
        (bytes_of({"format_version": 1}), "format version"),
        (bytes_of({"format_version": 5}), "format version 5, expected 6: train it again: foten train RECORDING"),
        (bytes_of({"model": "gpt"}), "does not run"),
        (bytes_of({"rate_hz": 0}), "rate_hz"),
        (bytes_of({"window": 3}), "window"),
        (bytes_of({"saturation": -1}), "saturation"),
        (bytes_of({"lowpass_hz": 600.0}), "lowpass_hz"),
        (bytes_of({"scaling": {"mean": [0, 0, 0], "sd": [1, 0, 1]}}), "standard deviation"),
        (bytes_of({"trained_range": {"speed": [5, 1], "force": [0, 1]}}), "trained range of speed"),
        (bytes_of({"extrapolation_exponents": {"speed": 1, "force": 9}}), "exponent of force"),
        (bytes_of({"units": {**texture.card["units"], "speed": "m/s"}}), "speed is not in mm/s"),
        (bytes_of({"units": {**texture.card["units"], "force": "lbf"}}), "force is not in N"),
        (bytes_of({"units": {**texture.card["units"], "acceleration": "g"}}), r"acceleration is not in m/s\^2"),
        (bytes_of({"units": {"acceleration": "relative", "force": "N"}}), "speed is not in mm/s"),
        (bytes_of({"sizes": {**sizes, "n_hidden": 0}}), "n_hidden"),
        (bytes_of({"sizes": {**sizes, "recorded": 1}}), "recorded"),
        (bytes_of({"sizes": {**sizes, "colour": 1}}), "size that this library does not know"),
        (bytes_of({"sizes": {**sizes, "phase_input": "angle"}}), "size that this library does not know"),
        (bytes_of({"sizes": {**sizes, "n_components": 65537}}), "n_components"),
        (bytes_of({"sizes": {**sizes, "order": 7}}), "window"),
        (bytes_of(**{"head_9.weight": np.zeros(3, dtype=np.float32)}), "tensors"),
        (bytes_of(**{"excitation.sd": np.full(2, np.nan)}), "NaN"),
        (bytes_of(**{"warm_start": np.zeros((3, 3))}), "warm_start"),
        (bytes_of(**{"lattice.reflections": np.full((6, 6), 1.0)}), "stable"),
        (bytes_of(**{"lattice.speed_knots": np.array([3.0, 2.0, 1.0])}), "rise"),
        (bytes_of(**{"golden.one_step": texture.tensors["golden.one_step"] + 1e-3}), "proof: one step"),
        (bytes_of(**{"golden.sigma": texture.tensors["golden.sigma"] * 1.01}), "proof: the excitation"),
        (bytes_of(**{"golden.closed_loop": texture.tensors["golden.closed_loop"] + 1e-2}), "proof: 64"),
        (b'\x08\0\0\0\0\0\0\0{"a":1} ', "texture card"),
    ]
    for data, message in cases:
        with pytest.raises(ValueError, match=message):
            NativeTexture(data)
    NativeTexture(bytes_of())


def test_a_window_without_a_prediction_hides_no_other(texture: Texture) -> None:
    """One so large that the network overflows came after those that were wrong, and the file was let through."""
    tensors = {name: tensor.copy() for name, tensor in texture.tensors.items()}
    tensors["golden.one_step"][:6] += 1
    tensors["golden.windows"] = tensors["golden.windows"].astype(np.float64)
    tensors["golden.windows"][6, -1, 0] = 1.7e308
    data = save(tensors, metadata={"foten": json.dumps(dict(texture.card))})
    with pytest.raises(ValueError, match="proof: one step"):
        NativeTexture(data)


def test_silence_does_not_become_slow() -> None:
    """A lattice without excitation dies away: its state becomes zero before it becomes denormal."""
    texture = exported("foten-plus", FotenPlusSizes(**PLUS))
    state = NativeState(NativeTexture(texture.to_bytes()), excitation=False)
    out = held(state, 2_000_000, 100.0)
    tail = out[-1000:] - out[-1]
    assert np.abs(tail).max() == 0.0
    assert struct.pack("<f", float(out[-1])) == struct.pack("<f", float(out[-2]))


def test_the_public_renderer(texture: Texture, tmp_path: Path) -> None:
    path = tmp_path / "t.foten"
    path.write_bytes(texture.to_bytes())
    by_path, by_bytes, in_memory = (foten.Renderer(t, rate=8000, seed=7) for t in (path, path.read_bytes(), texture))
    blocks = [one.render(speed_mm_s=80.0, force_n=0.8, n=480) for one in (by_path, by_bytes, in_memory)]
    assert blocks[0].dtype == np.float32
    np.testing.assert_array_equal(blocks[0], blocks[1])
    np.testing.assert_array_equal(blocks[0], blocks[2])
    by_path.reset()
    np.testing.assert_array_equal([by_path.step(80.0, 0.8) for _ in range(20)], blocks[0][:20])
    # 20 samples at 8 kHz begin at 0 and end after 2.4 of the texture's own.
    assert repr(by_path.stats).startswith("Statistics(n=3, n_speed_beyond=0,")
    stroke_ = foten.Renderer(texture, seed=7).render(np.full(50, 80.0), 0.8)
    np.testing.assert_array_equal(stroke_, foten.Renderer(texture, seed=7).render(80.0, 0.8, 50))
    with pytest.raises(FileNotFoundError, match="no such file"):
        foten.Renderer(tmp_path / "none.foten")
    for call in (
        lambda r: r.render(1.0, 1.0),
        lambda r: r.render(np.ones(3), 1.0, 5),
        lambda r: foten.Renderer(texture, seed=-1),
        lambda r: foten.Renderer(texture, stream=2**64),
        lambda r: r.reset(2**64),
        lambda r: foten.Renderer(texture, rate=1.0),
    ):
        with pytest.raises(ValueError, match=r"expected|n was given"):
            call(foten.Renderer(texture))


def test_a_stroke_may_be_read_only_and_one_of_its_arrays_a_single_number(texture: Texture) -> None:
    speed = np.full(50, 80.0, dtype=np.float32)
    speed.flags.writeable = False
    expected = foten.Renderer(texture, seed=7).render(80.0, 0.8, 50)
    for force in (0.8, np.array([0.8])):  # warnings are errors: NumPy's of a broadcast array was one
        np.testing.assert_array_equal(foten.Renderer(texture, seed=7).render(speed, force), expected)
    np.testing.assert_array_equal(foten.Renderer(texture, seed=7).render(np.array([80.0]), 0.8), expected[:1])
    renderer = foten.Renderer(texture)
    with pytest.raises(ValueError, match="to be written to"):
        renderer.render_into(speed, 80.0, 0.8)


def test_a_large_order_runs() -> None:
    texture = exported("foten-plus", FotenPlusSizes(**{**PLUS, "order": 240}))
    assert np.isfinite(Renderer(texture).render(80.0, 1.0, 1000)).all()


HEADER = (NATIVE / "src" / "constants.h").read_text()
DEFINED = re.findall(r"^#define (FOTEN_\w+) (.+)$", HEADER, re.MULTILINE)
SHARED = re.compile(r"(\S+) +/\* (foten[\w.]+)(?:\[(\d+)\])? \*/")


@pytest.mark.parametrize(("name", "definition"), DEFINED, ids=[name for name, _ in DEFINED])
def test_the_kernel_and_python_agree(name: str, definition: str) -> None:
    """Exactly: both languages round a decimal number to the nearest float64."""
    match = SHARED.fullmatch(definition)
    assert match, f"{name} is {definition!r}, expected a number and a comment that names a Python constant"
    number, path, index = match.groups()
    value = resolve_name(path)
    assert ast.literal_eval(number) == (value if index is None else value[int(index)])
