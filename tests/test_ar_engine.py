"""Local models as a texture: the difference equation they are, and bounded whatever the hand does."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest
from foten.architecture import ArArchitecture
from foten.runtime.ar import NumpyAr
from foten.runtime.closed_loop import ClosedLoop
from foten.runtime.engine import engine_for
from foten.train.export_local import LocalModels, export_local

from conftest import CARD, SCALING, exported, local_models
from foten.dsp.lattice import LEAK, reflections_of
from foten.dsp.lsf import line_spectral_frequencies, polynomial_of
from foten.families.conditions import Synthesizer
from foten.families.texture_file import Texture
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
    return exported("ar", ArArchitecture(**LOCAL[name]))


def steady(texture: Texture, model: int, n: int) -> np.ndarray:
    """Return n samples under the hand of one model, scaled."""
    hand = (np.full(n, value, np.float32) for value in texture.tensors["local.points"][model])
    played = NativeState(NativeTexture(texture.to_bytes()), seed=0).render_stroke(*hand)
    return (played.astype(float) - SCALING.mean[0]) / SCALING.sd[0]


@pytest.mark.parametrize("name", LOCAL)
def test_under_a_steady_hand_it_has_the_models_spectrum(name: str) -> None:
    """Oracle: |gain B / A|² of the polynomials, and their power, by Parseval over 4096 bins."""
    texture = made(name)
    models = local_models(texture.architecture)  # type: ignore[arg-type]
    a, b = (polynomial_of(angles[:1])[0] for angles in (models.lsf, models.ma_lsf))
    shape = np.abs(np.fft.rfft(b, 4096) / np.fft.rfft(a, 4096)) ** 2
    expected = models.gain[0] ** 2 * models.variance[0] * shape / SCALING.sd[0] ** 2
    played = steady(texture, 0, 200_000)
    n = 1024
    windows = played[: played.size // n * n].reshape(-1, n)
    power = (np.abs(np.fft.rfft(windows * np.hanning(n), axis=1)) ** 2).mean(axis=0) / np.square(
        np.hanning(n)
    ).sum()
    smooth = np.ones(9) / 9
    found, known = (np.convolve(p, smooth, "valid") for p in (power, expected[::4]))
    # 195 windows, nine bins: 3 % each; a resonance's top is wider through a window.
    assert np.median(np.abs(np.log(found / known))) < 0.05
    assert played.var() == pytest.approx(
        (expected[1:-1].sum() * 2 + expected[0] + expected[-1]) / 4096, rel=0.05
    )


@pytest.mark.parametrize("name", ["models", "with-zeros"])
def test_it_begins_as_if_it_had_always_been_there(name: str) -> None:
    texture = made(name)
    synthesizer = Synthesizer(texture, 1, n_streams=4000)
    begun = synthesizer.render(np.full(400, 110.0), np.full(400, 1.3))
    level = np.square(begun - SCALING.mean[0]).mean(axis=0)
    # 4000 streams: 2.2 % of power.
    assert level[:20].mean() == pytest.approx(level[-100:].mean(), rel=0.05)
    assert level[0] == pytest.approx(level[-100:].mean(), rel=0.1)


SWITCHED = 0.98  # radius of the poles of two resonances, one at 100 Hz and one at 400


def two_tones() -> LocalModels:
    """Return models of two sharp resonances, as loud as each other, that stable filters in turn grow with."""
    tones = [
        np.array([1.0, -2 * SWITCHED * np.cos(2 * np.pi * hz / 1000), SWITCHED**2]) for hz in (100.0, 400.0)
    ]
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


def test_no_hand_makes_it_grow() -> None:
    """The two resonances switched whenever that makes the most of it: a direct form runs away, the lattice does not."""
    texture = export_local(two_tones(), SCALING, CARD)
    engine = engine_for(texture)
    assert isinstance(engine, NumpyAr)
    points = (texture.tensors["local.points"] - texture.tensors["local.mean"]) / texture.tensors["local.sd"]
    reflections, _, drive = engine.mixed(points)
    bound = 5.68 * drive.max() / np.sqrt(1 - LEAK**2)
    taps = -polynomial_of(texture.tensors["local.lsf"])[:, 1:]
    direct, largest, state = np.array([1.0, 0.0]), [], engine.start(np.zeros((1, texture.window, 3)))
    loop = ClosedLoop(state)
    for _ in range(3000):
        # Whichever makes the next two samples of the direct form largest.
        if np.abs(direct).max() < 1e100:
            ahead = [(taps[i] @ direct, i) for i in range(2)]
            worst = max(ahead, key=lambda found: abs(found[0]))
            direct = np.array([worst[0], direct[0]])
        expected = [forecast(state.states, reflections[:, [i]])[0][0] for i in range(2)]
        i = int(np.argmax(np.abs(expected)))
        state._heed(points[[i]])
        outwards = np.array([5.68 if expected[i] >= 0 else -5.68])
        largest.append(float(np.abs(loop.step(points[[i]], outwards)).max()))
    assert np.abs(direct).max() > 1e50
    assert max(largest) < bound
    assert max(largest) > 5 * drive.max()


def test_two_streams_under_one_noise_meet() -> None:
    texture = made("with-zeros")
    engine = engine_for(texture)
    rng = np.random.default_rng(1)
    windows = 50.0 * rng.choice([-1.0, 1.0], (2, texture.window, 3))
    turning = np.stack([np.sin(np.arange(6000) / 70), np.cos(np.arange(6000) / 110)], axis=1)
    noise = np.tile(rng.standard_normal(6000), (2, 1))
    one, other = ClosedLoop(engine.start(windows)).run(np.tile(turning, (2, 1, 1)), noise)
    assert np.abs(one - other)[:10].max() > 1
    assert np.abs(one - other)[-1000:].max() < 0.01 * one[-1000:].std()


def test_a_model_in_no_triangle_is_refused() -> None:
    models = local_models(ArArchitecture(**LOCAL["a-few"]))
    with pytest.raises(ValueError, match="model 3 is a corner of no triangle"):
        export_local(dataclasses.replace(models, triangles=models.triangles[:1]), SCALING, CARD)


def test_a_pole_that_rings_for_ever_is_refused() -> None:
    a = np.array([1.0, -2 * 0.9999 * np.cos(0.4), 0.9999**2])
    angles = np.tile(line_spectral_frequencies(a), (3, 1))
    with pytest.raises(ValueError, match=r"local model 0 has a pole 0\.9999"):
        export_local(dataclasses.replace(two_tones(), lsf=angles), SCALING, CARD)


@pytest.mark.parametrize("radius", [0.9, 0.999])
def test_half_way_from_a_tone_to_noise_it_is_as_loud_as_both(radius: float) -> None:
    """A tone and white noise of one power: mixed by innovations, the middle was louder by the tone's gain."""
    tone = line_spectral_frequencies(np.array([1.0, -2 * radius * np.cos(0.9), radius**2]))
    noise = np.pi * np.arange(1, 3) / 3
    k = reflections_of(polynomial_of(tone[None]))[0]
    variance = np.array([np.prod(1 - k * k), 1.0, np.prod(1 - k * k)])
    models = dataclasses.replace(two_tones(), lsf=np.stack([tone, noise, tone]), variance=variance)
    texture = export_local(models, SCALING, CARD)
    state = NativeState(NativeTexture(texture.to_bytes()), seed=0)
    played = state.render_stroke(np.full(400_000, 100.0, np.float32), np.full(400_000, 1.0, np.float32))
    # The leak takes some of what rings long: 1.5 dB at 0.999.
    assert 10 * np.log10(played.var()) == pytest.approx(0.0, abs=0.5 if radius < 0.99 else 2.0)


def test_silence_is_silent() -> None:
    """A model of variance 0 is heard as nothing, from the first sample on."""
    played = steady(made("models"), 8, 100)
    # A hand of 32 bits stands 1e-8 of the way to the next model, whose deviation goes by the root of that.
    assert np.abs(played).max() < 1e-3


BROKEN: dict[str, tuple[str, Any, str]] = {
    "angles that fall": ("local.lsf", lambda t: t[:, ::-1], "does not rise from 0 to"),
    "an angle of 4 rad": ("local.lsf", lambda t: t + 3.0, "does not rise from 0 to"),
    "zeros that fall": ("local.ma_lsf", lambda t: t[:, ::-1], "does not rise from 0 to"),
    "less than no variance": ("local.variance", lambda t: t - 1.0, "negative variance or gain"),
    "less than no gain": ("local.gain", lambda t: -t, "negative variance or gain"),
    "a corner that is not there": ("local.triangles", lambda t: t + 7.0, "no model is at"),
    "half a corner": ("local.triangles", lambda t: t + 0.5, "corner that"),
    "a flat triangle": ("local.triangles", lambda t: 0 * t, "flat"),
    "another variance": ("local.variance", lambda t: 1.1 * t, "fails its own proof"),
    "a hand from elsewhere": ("local.sd", lambda t: -t, "of no hand"),
    "models far away": ("local.points", lambda t: t - 1000.0, "of no hand"),
    "too loud": ("local.variance", lambda t: 1e12 * t, "louder than"),
    "other angles": ("local.lsf", lambda t: 0.999 * t, "fails its own proof"),
    "other zeros": ("local.ma_lsf", lambda t: 0.999 * t, "fails its own proof"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_what_is_broken_is_refused(what: str) -> None:
    """By NumPy and by the kernel, with the same line."""
    name, change, message = BROKEN[what]
    texture = made("with-zeros")
    broken = dataclasses.replace(
        texture, tensors={**texture.tensors, name: np.ascontiguousarray(change(texture.tensors[name]))}
    )
    with pytest.raises(ValueError, match=message):
        Synthesizer(broken)
    with pytest.raises(ValueError, match=message):
        NativeTexture(broken.to_bytes())


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ({"order": 41, "window": 42}, "order is 41, expected 40 at most"),
        ({"ma": 41}, "ma is 41, expected 40 at most"),
        ({"window": 20}, "window is 20, expected a whole number, 21 or more"),
        ({"order": "x"}, "order is 'x', expected a whole number"),
        ({"n_models": 2}, "n_models is 2"),
        ({"n_triangles": 0}, "n_triangles is 0"),
    ],
)
def test_sizes_that_cannot_be_are_refused(sizes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ArArchitecture(**sizes)
