"""Tones of the path: recovered from a recording, gone on with by a rendering, and forgotten by it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from conftest import PLUS, SCALING, exported
from foten.dsp.tones import anti_alias_gain, fitted_phase, tone, tone_slope
from foten.models.definitions import model_of
from foten.models.foten_plus.definition import FotenPlus
from foten.models.foten_plus.linear_model import LatticeData
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.foten_plus.tones_fit import _period_jitter, fit_tones, n_multiples, wavelength
from foten.models.texture_file import Texture
from foten.runtime.loops import render_streams
from foten.runtime.native import NativeTexture
from foten.runtime.renderer import Renderer

RATE = 1000.0
LENGTH = 1.7  # mm
WITH_TONES = FotenPlusSizes(
    **{**PLUS, "order": 4, "n_tones": 3, "n_tone_speed": 4, "n_tone_force": 2, "residual_order": 4}
)


def stroke(n_blocks: int, block: int = 1500) -> tuple[np.ndarray, np.ndarray]:
    """Speeds [mm/s] between 30 and 170 and forces [N], each (n_blocks, block)."""
    t = np.arange(n_blocks * block) / RATE
    speed = 100 + 70 * np.sin(2 * np.pi * 0.9 * t)
    force = 1 + 0.6 * np.sin(2 * np.pi * 0.37 * t)
    return speed.reshape(n_blocks, block), force.reshape(n_blocks, block)


def periodic(n_blocks: int, noise: float, jitter: float, seed: int = 0) -> tuple[LatticeData, np.ndarray]:
    """A surface of three multiples whose phase jitters by `jitter` [rad²/mm], under coloured noise, and its true tones."""
    rng = np.random.default_rng(seed)
    speed, force = stroke(n_blocks)
    moved = speed / RATE
    jittered = np.cumsum(np.sqrt(jitter * moved) * rng.standard_normal(moved.shape), axis=1)
    phase = 2 * np.pi * np.cumsum(moved, axis=1) / LENGTH + jittered + rng.uniform(0, 6, (n_blocks, 1))
    loudness = np.sqrt(speed / 100)
    tones = loudness * (np.cos(phase) + 0.5 * np.sin(2 * phase) + 0.3 * np.cos(3 * phase + 1))
    x = tones + noise * lfilter([1.0], [1, -0.7], rng.standard_normal(speed.shape)) * np.sqrt(1 - 0.49)
    blocks = range(n_blocks)
    data = LatticeData(x, np.ones_like(x), speed, force, tuple(blocks[:-3]), tuple(blocks[-3:]))
    return data, tones


def test_a_tone_and_its_derivative() -> None:
    rng = np.random.default_rng(0)
    coefficients, phase = rng.standard_normal((5, 6)), rng.uniform(0, 7, 5)
    value, slope = tone(coefficients, phase), tone_slope(coefficients, phase)
    expected = sum(
        coefficients[:, 2 * h - 2] * np.cos(h * phase) + coefficients[:, 2 * h - 1] * np.sin(h * phase)
        for h in (1, 2, 3)
    )
    np.testing.assert_allclose(value, expected, rtol=1e-12)
    step = (tone(coefficients, phase + 1e-6) - tone(coefficients, phase - 1e-6)) / 2e-6
    np.testing.assert_allclose(slope, step, rtol=1e-6, atol=1e-8)


def test_a_phase_is_fitted_to_a_window() -> None:
    coefficients = np.broadcast_to([1.0, 0.0, 0.3, 0.4], (4, 60, 4))
    travelled = np.broadcast_to(0.3 * np.arange(60), (4, 60))
    true = np.array([0.1, 1.7, 3.3, 6.0])
    samples = tone(coefficients, travelled + true[:, None])
    away = fitted_phase(samples, coefficients, travelled) - true
    # Candidates are π/16 apart: half of that at most, and a little for the multiples.
    assert np.abs((away + np.pi) % (2 * np.pi) - np.pi).max() < 0.12


def test_a_wavelength_is_recovered_and_none_from_noise() -> None:
    data, _ = periodic(12, 0.8, 3e-3)
    assert wavelength(data, RATE) == pytest.approx(LENGTH, rel=0.03)
    rng = np.random.default_rng(1)
    speed, force = stroke(12)
    noise = LatticeData(
        rng.standard_normal(speed.shape), np.ones_like(speed), speed, force, tuple(range(9)), (9, 10, 11)
    )
    assert wavelength(noise, RATE) is None


def test_the_multiples_stay_below_the_rate() -> None:
    assert n_multiples(1.0, np.full(9, 100.0), 1000.0) == 4  # 100 Hz; 450 Hz is within the band
    assert n_multiples(0.1, np.full(9, 100.0), 1000.0) == 1
    assert n_multiples(10.0, np.full(9, 100.0), 1000.0) == 6


def test_tones_are_recovered_under_noise_and_jitter() -> None:
    data, true = periodic(15, 0.5, 3e-3)
    fitted = fit_tones(data, 1.01 * LENGTH, RATE)
    # A spectrum that says 1 % too much: the phases of twelve strokes of 150 mm put it right.
    assert fitted.wavelength_mm == pytest.approx(LENGTH, rel=1e-3)
    # The variance grows by 0.04 to 0.12 rad² on what is compared, and a few hundred such places scatter by a fifth.
    assert 4 * np.pi**2 * fitted.period_jitter**2 / LENGTH == pytest.approx(3e-3, rel=0.5)
    held = list(data.validation)  # its phases are fitted, its amplitudes are not
    error = np.square(fitted.waveform - true)[held, 100:-100].mean() / np.square(true)[held, 100:-100].mean()
    # Noise of a third of the tones' power, and a phase known from about a wavelength: 17 periods of 3 multiples a second.
    assert error < 0.1


def with_tones(period_jitter: float = 0.03) -> tuple[Texture, FotenPlus]:
    """An untrained texture of three tones, 2.5 mm long, and its model in the reference."""
    phase_params = np.array([2 * np.pi / 2.5 / RATE, period_jitter, 2e-3])
    texture = exported("foten-plus", WITH_TONES, {"tones.phase_params": phase_params})
    model = model_of(WITH_TONES, texture.tensors)
    assert isinstance(model, FotenPlus)
    return texture, model


def test_a_rendering_goes_on_where_the_recording_was() -> None:
    """A window of nothing but tones, from any phase: the next half period is the tones' own."""
    texture, model = with_tones()
    assert model.tones is not None
    m, n = texture.window, 12
    physical = np.array([120.0, 1.0])
    scaled = np.broadcast_to((physical - SCALING.mean[1:]) / SCALING.sd[1:], (4, m + n, 2))
    condition = model.with_speed(scaled)
    start = np.array([0.2, 1.9, 3.3, 5.5])[:, None]
    phase = start + 2 * np.pi / 2.5 / RATE * 120.0 * np.arange(m + n)
    coefficients = model.tones.coefficients(condition.reshape(-1, 3)).reshape(4, m + n, -1)
    true = tone(coefficients, phase)
    windows = np.concatenate([true[:, :m, None], scaled[:, :m]], axis=2)
    out = render_streams(NativeTexture(texture.to_bytes()), windows, condition[:, m:], None)
    # The phase is one of 32: up to 0.1 rad away, three times that in the third multiple.
    assert np.square(out - true[:, m:]).mean() < 0.05 * np.square(true[:, m:]).mean()


@pytest.mark.parametrize(("speed", "hertz"), [(110.0, 44.0), (330.0, 132.0)])
def test_tones_keep_to_the_path_above_the_trained_speed_too_and_never_alias(speed: float, hertz: float) -> None:
    """Trained up to 220 mm/s at 2.5 mm: 88 Hz."""
    texture, _ = with_tones()
    rendered = Renderer(texture, excitation=False).render(np.full(4000, speed), np.ones(4000))[2000:]
    power = np.abs(np.fft.rfft((rendered - rendered.mean()) * np.hanning(2000))) ** 2
    multiples = (np.arange(1, 4) * 2 * hertz).round().astype(int)
    near = multiples[:, None] + np.arange(-4, 5)
    assert power[near].sum() > 0.999 * power.sum()
    assert (power[near].sum(axis=1) > 0.001 * power.sum()).all()
    assert anti_alias_gain(3, np.array([2 * np.pi * 0.151]))[0] == pytest.approx([1, 1, 1, 1, 0.94, 0.94])
    assert anti_alias_gain(3, np.array([2 * np.pi * 0.17]))[0, 4:] == pytest.approx([0, 0])


@pytest.mark.parametrize("period_jitter", [0.03, 0.3])
def test_a_rendering_forgets_the_window_that_it_started_from(period_jitter: float) -> None:
    """Other phases of the surface, ±50 standard deviations: under the same noise they meet within four seconds.

    With 0.3 the phase leaves the path by several turns.
    """
    texture, model = with_tones(period_jitter)
    rng = np.random.default_rng(1)
    windows = rng.standard_normal((3, texture.window, 3))
    windows[1, :, 0] *= 50
    windows[2, :, 0] = 50 * (-1.0) ** np.arange(texture.window)
    n = 5000
    speed = 90 + 60 * np.sin(np.arange(n) / 300)
    physical = np.stack([speed, np.full(n, 1.0)], axis=1)
    condition = model.with_speed((physical - SCALING.mean[1:]) / np.array(SCALING.sd[1:]))
    noise = np.tile(rng.standard_normal(n), (3, 1))
    out = render_streams(NativeTexture(texture.to_bytes()), windows, np.tile(condition, (3, 1, 1)), noise)
    apart = np.abs(out - out[0]).max(axis=0)
    assert apart[:20].max() > 0.1
    # The phase closes in by e in half a second: e^-8 of half a turn, through three multiples of it.
    assert apart[4000:].max() < 0.02 * out[0].std()


def test_a_multiple_that_is_louder_than_the_fundamental_does_not_halve_the_wavelength() -> None:
    rng = np.random.default_rng(5)
    speed, force = stroke(12)
    phase = 2 * np.pi * np.cumsum(speed / RATE, axis=1) / LENGTH
    x = 0.5 * np.cos(phase) + np.cos(2 * phase) + 0.3 * rng.standard_normal(speed.shape)
    data = LatticeData(x, np.ones_like(x), speed, force, tuple(range(9)), (9, 10, 11))
    assert wavelength(data, RATE) == pytest.approx(LENGTH, rel=0.03)


def test_a_phase_that_the_tool_turns_with_speed_is_not_period_jitter() -> None:
    rng = np.random.default_rng(0)
    speed, _ = stroke(30)
    path = np.cumsum(speed / RATE, axis=1)
    q = 4 * np.pi**2 * 0.03**2 / LENGTH
    jittered = np.cumsum(np.sqrt(q * speed / RATE) * rng.standard_normal((20, *speed.shape)), axis=2)
    shift = np.pi * speed / 150  # by π within 150 mm/s
    # Some hundred places whose variances scatter by a tenth, a little turned by what their speeds still differ.
    assert _period_jitter(path, jittered[0] + shift, speed, LENGTH) == pytest.approx(0.03, rel=0.4)
    # By itself it scatters by 8 %, twenty of it by 2 %.
    assert np.mean([_period_jitter(path, one, speed, LENGTH) for one in jittered]) == pytest.approx(0.03, rel=0.06)


@pytest.mark.parametrize("varied", [0.0, 0.1])
def test_a_tone_whose_frequency_does_not_move_with_speed_is_not_treated_as_spatial(varied: float) -> None:
    rng = np.random.default_rng(3)
    seconds = np.arange(4000) / RATE
    x = rng.standard_normal((12, 4000)) + 2 * np.sin(2 * np.pi * 50 * seconds)
    speed = 100 * (1 + varied * np.sin(2 * np.pi * seconds / 3 + np.arange(12)[:, None]))
    data = LatticeData(x, np.ones_like(x), speed, np.ones_like(x), tuple(range(9)), (9, 10, 11))
    assert wavelength(data, RATE) is None


def test_a_slope_at_the_lowest_spatial_frequencies_is_no_wavelength() -> None:
    """Short strokes over a surface whose power falls with spatial frequency: the first bin has all others below it."""
    rng = np.random.default_rng(0)
    x = lfilter([1.0], [1, -1.98, 0.9801], rng.standard_normal((12, 3000)))
    speed = np.full_like(x, 120.0)
    data = LatticeData(x, np.ones_like(x), speed, np.ones_like(x), tuple(range(9)), (9, 10, 11))
    assert wavelength(data, 10_000.0) is None
