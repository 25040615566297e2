"""Piecewise AR as a texture, in the kernel: the difference equations that it is, and bounded however the condition moves."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from conftest import CARD, SCALING, exported, local_models
from foten.dsp.ar import line_spectral_frequencies, polynomial_of
from foten.dsp.lattice import LEAK, predict, push, reflections_of
from foten.models.definitions import render
from foten.models.piecewise_ar.definition import PiecewiseAr
from foten.models.piecewise_ar.local_models import LocalModels, local_texture
from foten.models.piecewise_ar.sizes import PiecewiseArSizes
from foten.models.texture_file import Texture
from foten.runtime.loops import render_streams
from foten.runtime.native import NativeState, NativeTexture

LOCAL: dict[str, dict[str, Any]] = {
    "models": {"order": 20, "n_models": 9, "n_triangles": 8},
    "a-few": {"order": 7, "n_models": 4, "n_triangles": 3, "window": 8},
    "with-zeros": {"order": 18, "ma": 16, "n_models": 9, "n_triangles": 8, "window": 257},
    "more-zeros-than-poles": {"order": 2, "ma": 5, "n_models": 6, "n_triangles": 5, "window": 257},
    "a-fan-with-a-hole": {"order": 4, "n_models": 9, "n_triangles": 7, "window": 5},
    "as-high-as-can-be": {"order": 40, "n_models": 6, "n_triangles": 5, "window": 41},
}


def made(name: str) -> Texture:
    return exported("ar", PiecewiseArSizes(**LOCAL[name]))


def steady(texture: Texture, model: int, n: int) -> np.ndarray:
    """N samples under the condition of one model, scaled."""
    condition = (np.full(n, value, np.float32) for value in texture.tensors["piecewise_ar.points"][model])
    rendered = NativeState(NativeTexture(texture.to_bytes()), seed=0).render_stroke(*condition)
    return (rendered.astype(float) - SCALING.mean[0]) / SCALING.sd[0]


@pytest.mark.parametrize("name", LOCAL)
def test_under_a_steady_condition_it_has_the_models_spectrum(name: str) -> None:
    """Oracle: |gain B / A|² of the polynomials, and their power, by Parseval over 4096 bins."""
    texture = made(name)
    models = local_models(texture.sizes)  # type: ignore[arg-type]
    a, b = (polynomial_of(angles[:1])[0] for angles in (models.lsf, models.ma_lsf))
    shape = np.abs(np.fft.rfft(b, 4096) / np.fft.rfft(a, 4096)) ** 2
    expected = models.gain[0] ** 2 * models.variance[0] * shape / SCALING.sd[0] ** 2
    rendered = steady(texture, 0, 200_000)
    n = 1024
    windows = rendered[: rendered.size // n * n].reshape(-1, n) * np.hanning(n)
    power = (np.abs(np.fft.rfft(windows, axis=1)) ** 2).mean(axis=0) / np.square(np.hanning(n)).sum()
    smooth = np.ones(9) / 9
    measured, known = (np.convolve(p, smooth, "valid") for p in (power, expected[::4]))
    # 195 windows, nine bins: 3 % each; a resonance's top is wider through a window.
    assert np.median(np.abs(np.log(measured / known))) < 0.05
    assert rendered.var() == pytest.approx((expected[1:-1].sum() * 2 + expected[0] + expected[-1]) / 4096, rel=0.05)


@pytest.mark.parametrize("name", ["models", "with-zeros"])
def test_it_begins_as_if_its_condition_had_always_been_there(name: str) -> None:
    native, n_streams = NativeTexture(made(name).to_bytes()), 3000
    speed, force = np.full(400, 110.0, np.float32), np.full(400, 1.3, np.float32)
    rendered = [NativeState(native, seed=1, stream=k).render_stroke(speed, force) for k in range(n_streams)]
    power = np.square(np.array(rendered, dtype=float) - SCALING.mean[0]).mean(axis=0)
    # 3000 streams: 2.6 % of power.
    assert power[:20].mean() == pytest.approx(power[-100:].mean(), rel=0.05)
    assert power[0] == pytest.approx(power[-100:].mean(), rel=0.1)


def test_what_rings_longer_than_it_settles_begins_as_the_reference_does() -> None:
    """Poles of radius 0.999 keep four fifths of their first states through the 256 samples, and zeros say how large those are."""
    a, b = (np.array([1.0, -2 * r * np.cos(w), r * r]) for r, w in ((0.999, 0.6), (0.8, 2.2)))
    lsf, ma_lsf = (np.tile(line_spectral_frequencies(each), (3, 1)) for each in (a, b))
    texture = local_texture(dataclasses.replace(two_tones(), lsf=lsf, ma_lsf=ma_lsf), SCALING, CARD).texture
    speed, force = np.full(200, 90.0), np.full(200, 1.3)
    rendered = NativeState(NativeTexture(texture.to_bytes()), seed=4).render_stroke(
        speed.astype(np.float32), force.astype(np.float32)
    )
    expected = render(texture, speed, force, seed=4)[0]
    # What leaves the kernel is float32.
    np.testing.assert_allclose(rendered, expected, rtol=0, atol=1e-5 * np.abs(expected).max())


SWITCHED = 0.98  # radius of the poles of two resonances, one at 100 Hz and one at 400


def two_tones() -> LocalModels:
    """Models of two sharp resonances, as loud as each other, that stable filters in turn grow with."""
    tones = [np.array([1.0, -2 * SWITCHED * np.cos(2 * np.pi * hz / 1000), SWITCHED**2]) for hz in (100.0, 400.0)]
    angles = np.array([line_spectral_frequencies(a) for a in tones])[[0, 1, 0]]
    return LocalModels(
        np.array([[50.0, 1.0], [150.0, 1.0], [100.0, 2.0]]),
        angles,
        np.full(3, 0.04),
        np.array([[0, 1, 2]]),
        np.array([60.0, 0.5]),
        np.empty((3, 0)),
        np.ones(3),
    )


def test_no_stroke_makes_it_grow() -> None:
    """The two resonances switched whenever that makes the most of it: a direct form runs away, the lattice does not.

    The reference, whose states can be looked at, says what is worst; the kernel is run by it.
    """
    texture = local_texture(two_tones(), SCALING, CARD).texture
    assert isinstance(texture.sizes, PiecewiseArSizes)
    model = PiecewiseAr(texture.sizes, texture.tensors)
    points, mean, sd = (texture.tensors[f"piecewise_ar.{name}"] for name in ("points", "mean", "sd"))
    scaled = (points - mean) / sd
    reflections, _, gain = model.mixed(scaled)
    taps = -polynomial_of(texture.tensors["piecewise_ar.lsf"])[:, 1:]
    windows = np.zeros((1, texture.window, 3))
    windows[0, :, 1:] = scaled[0]
    direct, stream = np.array([1.0, 0.0]), model.start(windows)
    condition, noise, samples, outwards = np.zeros((1, 3000, 3)), np.empty((1, 3000)), np.empty(3000), 5.68
    for n in range(3000):
        # Whichever makes the next two samples of the direct form largest.
        if np.abs(direct).max() < 1e100:
            worst = max((taps[i] @ direct for i in range(2)), key=abs)
            direct = np.array([worst, direct[0]])
        noise[0, n] = outwards
        sample = stream.predict().excited(noise[:, n])
        states, _ = push(stream.states, stream.reflections, sample)
        expected = [float(predict(states, reflections[:, [i]])[0][0]) for i in range(2)]
        i = int(np.argmax(np.abs(expected)))
        condition[0, n, :2], outwards = scaled[i], 5.68 if expected[i] >= 0 else -5.68
        stream.push(sample, condition[:, n], noise[:, n])
        samples[n] = sample[0]
    assert np.abs(direct).max() > 1e50
    out = render_streams(NativeTexture(texture.to_bytes()), windows, condition, noise)[0]
    np.testing.assert_allclose(out, samples, rtol=1e-9, atol=1e-9)  # float64 both, in other orders
    assert np.abs(out).max() < 5.68 * gain.max() / np.sqrt(1 - LEAK**2)
    assert np.abs(out).max() > 5 * gain.max()


def test_two_streams_under_one_noise_meet() -> None:
    texture = made("with-zeros")
    rng = np.random.default_rng(1)
    windows = 50.0 * rng.choice([-1.0, 1.0], (2, texture.window, 3))
    turning = np.stack([np.sin(np.arange(6000) / 70), np.cos(np.arange(6000) / 110), np.zeros(6000)], axis=1)
    noise = np.tile(rng.standard_normal(6000), (2, 1))
    one, other = render_streams(NativeTexture(texture.to_bytes()), windows, np.tile(turning, (2, 1, 1)), noise)
    assert np.abs(one - other)[:10].max() > 1
    assert np.abs(one - other)[-1000:].max() < 0.01 * one[-1000:].std()


def test_a_model_in_no_triangle_is_refused() -> None:
    models = local_models(PiecewiseArSizes(**LOCAL["a-few"]))
    with pytest.raises(ValueError, match="model 3 is a corner of no triangle"):
        local_texture(dataclasses.replace(models, triangles=models.triangles[:1]), SCALING, CARD)


def test_a_pole_that_rings_for_ever_is_refused() -> None:
    a = np.array([1.0, -2 * 0.9999 * np.cos(0.4), 0.9999**2])
    angles = np.tile(line_spectral_frequencies(a), (3, 1))
    with pytest.raises(ValueError, match=r"local model 0 has a pole 0\.9999"):
        local_texture(dataclasses.replace(two_tones(), lsf=angles), SCALING, CARD)


@pytest.mark.parametrize("radius", [0.9, 0.999])
def test_half_way_from_a_tone_to_noise_it_is_as_loud_as_both(radius: float) -> None:
    """A tone and white noise of one power: mixed by innovations, the middle was louder by the tone's gain."""
    tone = line_spectral_frequencies(np.array([1.0, -2 * radius * np.cos(0.9), radius**2]))
    noise = np.pi * np.arange(1, 3) / 3
    k = reflections_of(polynomial_of(tone[None]))[0]
    variance = np.array([np.prod(1 - k * k), 1.0, np.prod(1 - k * k)])
    models = dataclasses.replace(two_tones(), lsf=np.stack([tone, noise, tone]), variance=variance)
    texture = local_texture(models, SCALING, CARD).texture
    state = NativeState(NativeTexture(texture.to_bytes()), seed=0)
    rendered = state.render_stroke(np.full(400_000, 100.0, np.float32), np.full(400_000, 1.0, np.float32))
    # The leak takes some of what rings long: 1.5 dB at 0.999.
    assert 10 * np.log10(rendered.var()) == pytest.approx(0.0, abs=0.5 if radius < 0.99 else 2.0)


def test_silence_is_silent() -> None:
    """A model of variance 0 renders nothing, from the first sample on."""
    rendered = steady(made("models"), 8, 100)
    # A condition of 32 bits stands 1e-8 of the way to the next model, whose deviation goes by the root of that.
    assert np.abs(rendered).max() < 1e-3


BROKEN: dict[str, tuple[str, Any, str]] = {
    "angles that fall": ("piecewise_ar.lsf", lambda t: t[:, ::-1], "does not rise from 0 to"),
    "an angle of 4 rad": ("piecewise_ar.lsf", lambda t: t + 3.0, "does not rise from 0 to"),
    "zeros that fall": ("piecewise_ar.ma_lsf", lambda t: t[:, ::-1], "does not rise from 0 to"),
    "less than no variance": ("piecewise_ar.variance", lambda t: t - 1.0, "negative variance or gain"),
    "less than no gain": ("piecewise_ar.gain", lambda t: -t, "negative variance or gain"),
    "a corner that is not there": ("piecewise_ar.triangles", lambda t: t + 7.0, "no model is at"),
    "half a corner": ("piecewise_ar.triangles", lambda t: t + 0.5, "corner that"),
    "a flat triangle": ("piecewise_ar.triangles", lambda t: 0 * t, "flat"),
    "another variance": ("piecewise_ar.variance", lambda t: 1.1 * t, "fails its own proof"),
    "a hand from elsewhere": ("piecewise_ar.sd", lambda t: -t, "models stand at speeds or forces"),
    "models far away": ("piecewise_ar.points", lambda t: t - 1000.0, "models stand at speeds or forces"),
    "too loud": ("piecewise_ar.variance", lambda t: 1e12 * t, "louder than"),
    "other angles": ("piecewise_ar.lsf", lambda t: 0.999 * t, "fails its own proof"),
    "other zeros": ("piecewise_ar.ma_lsf", lambda t: 0.999 * t, "fails its own proof"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_what_is_broken_is_refused(what: str) -> None:
    name, change, message = BROKEN[what]
    texture = made("with-zeros")
    broken = dataclasses.replace(
        texture, tensors={**texture.tensors, name: np.ascontiguousarray(change(texture.tensors[name]))}
    )
    with pytest.raises(ValueError, match=message):
        NativeTexture(broken.to_bytes())
