"""The equaliser: its definition, its fit in the closed loop, and what it does to a texture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from conftest import PLUS, exported
from foten.dsp.equaliser import MAX_LOG_GAIN, N_TERMS, Equaliser, EqualiserStream, in_bands, logarithms, terms_of
from foten.dsp.level import N_BANDS, band_energies, envelope_edges
from foten.editing.blend import blend
from foten.models.foten_plus.equaliser_fit import best_penalty, fit_equaliser, regression
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.runtime.native import NativeTexture
from test_calibration import loop_of

RATE = 1000.0


def random_equaliser(size: float = 0.1) -> Equaliser:
    return Equaliser.of_weights(size * np.random.default_rng(0).standard_normal((N_BANDS, N_TERMS)), RATE)


def stroke(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Speed [mm/s] and force [N] that come to rest and set out again, (1, n)."""
    t = np.arange(n) / RATE
    return np.abs(150 * np.sin(5 * t))[None], (0.8 + 0.5 * np.cos(3 * t))[None]


def test_sample_by_sample_it_is_what_it_is_at_once() -> None:
    n, equaliser = 800, random_equaliser()
    (speed, force), x = stroke(n), np.random.default_rng(1).standard_normal((1, n))
    at_once = equaliser.applied(x, terms_of(speed, force, RATE))
    stream = EqualiserStream(equaliser, speed[:, 0], force[:, 0])
    each = np.stack([stream.push(x[:, i], speed[:, i], force[:, i]) for i in range(n)], axis=1)
    np.testing.assert_allclose(each, at_once, atol=1e-12)
    assert np.abs(at_once - x).max() > 0.3


def test_a_band_is_as_strong_as_its_gain_says_and_others_as_they_were() -> None:
    """Oracle: noise through it, band energies by the listener's filters."""
    weights = np.zeros((N_BANDS, N_TERMS))
    weights[5, 0] = np.log(2.0)
    n = 200_000
    x = np.random.default_rng(2).standard_normal((1, n))
    y = Equaliser.of_weights(weights, RATE).applied(x, terms_of(np.full((1, n), 90.0), np.ones((1, n)), RATE))
    changed_db = 10 * np.log10(band_energies(y, RATE).mean(axis=2) / band_energies(x, RATE).mean(axis=2))[0]
    assert 4.0 < changed_db[5] < 6.5
    assert np.abs(changed_db[[0, 1, 2]]).max() < 0.5


def test_no_gain_changes_nothing() -> None:
    x = np.random.default_rng(3).standard_normal((2, 300))
    equaliser = Equaliser.of_weights(np.zeros((N_BANDS, N_TERMS)), RATE)
    np.testing.assert_array_equal(equaliser.applied(x, terms_of(*stroke(300), RATE)), x)


def test_terms_begin_as_after_a_long_time() -> None:
    speed, force = np.full(50, 40.0), np.full(50, 2.0)
    phi = terms_of(speed, force, RATE)
    np.testing.assert_allclose(phi[9:], 0, atol=1e-12)
    x, y = logarithms(speed, force)
    np.testing.assert_allclose(phi[[1, 2, 4]], [x, y, x * y])


def test_its_bound_holds_for_the_worst_signal() -> None:
    """The worst of signals within 1 is the sign of the impulse response backwards."""
    weights = np.zeros((N_BANDS, N_TERMS))
    weights[:, 0] = 2 * MAX_LOG_GAIN  # which is held
    equaliser, n = Equaliser.of_weights(weights, RATE), 6000
    phi = terms_of(np.full((1, n), 100.0), np.ones((1, n)), RATE)
    np.testing.assert_allclose(equaliser.gains(phi), np.e)  # 8.7 dB at most, whatever the weights say
    impulse = np.eye(1, n)
    worst = np.sign(equaliser.applied(impulse, phi))[:, ::-1]
    largest = np.abs(equaliser.applied(worst, phi)).max()
    assert 3 < largest <= equaliser.bound()


@pytest.mark.parametrize("poles", [(0.0, 1.01), (1.5, 0.5), (-1.6, 0.5)])
def test_an_unstable_band_pass_is_refused(poles: tuple[float, float]) -> None:
    """Coefficients on or beyond each side of the triangle |a₂| < 1, |a₁| < 1 + a₂, within which both poles are below 1."""
    texture = exported("foten-plus", FotenPlusSizes(**PLUS, equalised=True))
    tensors = dict(texture.tensors)
    tensors["equaliser.filters"] = tensors["equaliser.filters"].copy()
    tensors["equaliser.filters"][2, 1:] = poles
    with pytest.raises(ValueError, match="band-pass of the equaliser is unstable"):
        Equaliser.of(tensors)
    with pytest.raises(ValueError, match="band-pass of the equaliser is unstable"):
        NativeTexture(replace(texture, tensors=tensors).to_bytes())


def test_what_the_closed_loop_lacks_is_found_and_added() -> None:
    """Oracle: a recording that went through a known equaliser, by level and by how speed changes."""
    loop, excitation = loop_of()
    weights = np.zeros((N_BANDS, N_TERMS))
    weights[1, 0], weights[1, 17] = 0.4, 0.6  # of the second band: always, and as speed grows
    trace, n = loop.blocks.trace, len(loop.blocks.trace)
    known = Equaliser.of_weights(weights, RATE)
    phi = terms_of(trace.speed[None], trace.force[None], RATE)
    scaled = loop.blocks.scaling.scale_channel(0, trace.acceleration)
    louder = known.applied(scaled[None], phi)[0]
    samples = loop.blocks.samples.copy()
    samples[..., 0] = louder.reshape(samples.shape[:2])
    acceleration = loop.blocks.scaling.unscale_acceleration(louder)
    blocks = replace(loop.blocks, trace=replace(trace, acceleration=acceleration), samples=samples)
    loop = replace(loop, blocks=blocks)
    fitted = fit_equaliser(loop, excitation, 3)
    assert fitted is not None
    wanted, found = known.log_gains(phi)[:, 0], fitted.log_gains(phi)[:, 0]
    errors = np.sqrt(np.square(found - wanted).mean(axis=1))
    assert errors[1] < 0.5 * np.sqrt(np.square(wanted[1]).mean())
    assert errors.max() < 0.2
    assert n == found.shape[1]


def test_a_closed_loop_that_lacks_nothing_gets_next_to_none() -> None:
    """A recording that is a free run itself; what is left of a gain is chance, less than 1 dB."""
    loop, excitation = loop_of()
    fitted = fit_equaliser(loop, excitation, 3)
    if fitted is not None:
        phi = terms_of(loop.blocks.trace.speed, loop.blocks.trace.force, RATE)
        assert np.sqrt(np.square(fitted.log_gains(phi)).mean()) < 0.115


def test_too_few_blocks_bear_no_equaliser_out() -> None:
    loop, excitation = loop_of()
    split = replace(loop.blocks.split, train=(0, 1, 2), validation=(3,))
    assert fit_equaliser(replace(loop, blocks=replace(loop.blocks, split=split)), excitation, 3) is None


def test_the_penalty_is_the_one_that_left_out_blocks_bear_out() -> None:
    rng = np.random.default_rng(5)
    terms, counted = rng.standard_normal((4, 16, 50)), np.ones((16, 50), dtype=bool)
    noise = rng.standard_normal((N_BANDS, 16, 50))
    assert (best_penalty(terms, noise, counted) or np.inf) >= 3000
    assert best_penalty(terms, noise + 2 * terms[1], counted) in (30.0, 100.0)
    weights = regression(terms.reshape(4, -1), (2 * terms[1]).reshape(1, -1), 1e-9)
    np.testing.assert_allclose(weights, [[0, 2, 0, 0]], atol=1e-6)


def test_bands_are_half_as_strong_at_their_edges() -> None:
    edges, impulse = envelope_edges(RATE), np.eye(1, 8000)[0]
    response = np.abs(np.fft.rfft(in_bands(impulse, random_equaliser().filters)))
    at = np.rint(edges * 8).astype(int)
    for k in range(N_BANDS):
        np.testing.assert_allclose(np.square(response[k, at[k : k + 2]]), 0.5, atol=0.03)


def test_a_blend_has_the_gains_between() -> None:
    equalised, plain = (exported("foten-plus", FotenPlusSizes(**PLUS, equalised=on)) for on in (True, False))
    half = blend(equalised, plain, 0.5, n_steps=0)
    np.testing.assert_allclose(half.tensors["equaliser.weights"], 0.5 * equalised.tensors["equaliser.weights"], 0, 1e-7)
