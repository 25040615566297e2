"""What a user gets from a texture under speed and force: silence at rest, fade and growth, onset, level, independence, bounds."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from conftest import PLUS, SCALING, SMALL, exported
from foten.dsp.lattice import polynomial
from foten.models.conditions import EXTRAPOLATION_LIMIT, FADE_FORCE, FADE_SPEED, REACH_FORCE, REACH_SPEED
from foten.models.definitions import model_of
from foten.models.foten.sizes import FotenSizes
from foten.models.foten_plus.definition import FotenPlus
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture
from foten.runtime.loops import render_streams
from foten.runtime.native import NativeState, NativeTexture
from foten.runtime.renderer import Renderer

LOW, HIGH = (8.0, 0.3), (220.0, 2.5)  # the trained range of the fixtures
FLOAT32 = 1e-6  # relative: 24 bits of what goes in and what comes out, where the loop is in float64


def stroke(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Speeds [mm/s] and forces [N] that wander over and beyond the trained range, with rests."""
    rng = np.random.default_rng(seed)
    speed = np.abs(100 + np.cumsum(5 * rng.standard_normal(n)))
    force = np.abs(1 + np.cumsum(0.1 * rng.standard_normal(n)))
    speed[n // 3 : n // 3 + 20] = 0.0
    return speed, force


def steady(n: int, speed: float = 80.0, force: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A condition that stays."""
    return np.full(n, speed), np.full(n, force)


def with_card(texture: Texture, **entries: Any) -> Texture:
    """A texture with other entries in its card."""
    return dataclasses.replace(texture, card={**texture.card, **entries})


def rendered(texture: Texture, speed: np.ndarray, force: np.ndarray, **options: Any) -> np.ndarray:
    """A rendering from its beginning [m/s²]."""
    return Renderer(texture, **options).render(speed, force).astype(float)


def streams(texture: Texture, n: int, speed: np.ndarray, force: np.ndarray, seed: int = 0) -> np.ndarray:
    """Renderings of n independent streams, shape (n, len(speed))."""
    native = NativeTexture(texture.to_bytes())
    return np.array(
        [NativeState(native, seed=seed, stream=k).render_stroke(speed, force) for k in range(n)], dtype=float
    )


@pytest.mark.parametrize(("speed", "force"), [(0.0, 1.0), (80.0, 0.0), (0.0, 0.0)])
def test_standing_still_or_lifted_off_it_is_silent(
    texture: Texture, plain_texture: Texture, speed: float, force: float
) -> None:
    from_nothing = {"speed": [0.0, 220.0], "force": [0.0, 2.5]}
    for used in (texture, plain_texture, with_card(texture, trained_range=from_nothing)):
        renderer = Renderer(used)
        assert np.abs(renderer.render(*steady(50))).max() > 0
        np.testing.assert_array_equal(renderer.render(*steady(50, speed, force)), 0.0)


def test_with_the_gain_before_the_filter_what_rang_rings_out() -> None:
    """As a tool does that comes to rest: by the lattice alone, to nothing. Oracle: its direct form, of which no input is left."""
    sizes = FotenPlusSizes(**PLUS, order=6, gain_before_filter=True)
    texture = exported("foten-plus", sizes)
    model = model_of(sizes, texture.tensors)
    assert isinstance(model, FotenPlus)
    renderer = Renderer(texture)
    before = renderer.render(*steady(200)).astype(float)
    out = renderer.render(*steady(600, 0.0)).astype(float)
    k = model.lattice.reflections((np.array([[LOW[0], 1.0]]) - SCALING.mean[1:]) / SCALING.sd[1:])[:, 0]
    left = np.convolve(out, polynomial(k))[7:600]
    assert np.abs(out[7:60]).max() > 0.05 * before.std()
    assert np.abs(left).max() < 1e-5 * before.std()  # float32 of what leaves
    assert np.abs(out[-100:]).max() < 1e-6 * before.std()
    assert not Renderer(texture).render(*steady(50, 0.0)).any()


def test_the_texture_is_there_again_with_the_first_movement(texture: Texture) -> None:
    speed = np.concatenate([np.full(120, 80.0), np.zeros(100), np.full(120, 80.0)])
    out = streams(texture, 64, speed, np.where(speed > 0, 1.0, 0.0))
    # 64 streams of 20·(1 − 0.95²) = 2 independent samples: an RMS is known to 1/√(2·128) = 6 %, two of them to 9 %.
    assert out[:, 320:].std() == pytest.approx(out[:, 100:120].std(), rel=0.3)
    assert out[:, 220:240].std() == pytest.approx(out[:, 100:120].std(), rel=0.3)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.9999, 1.0])
@pytest.mark.parametrize("exponents", [(0.7, 0.4), (0.0, 0.0)])
def test_below_the_trained_range_the_level_follows_its_law_and_falls_to_rest(
    texture: Texture, share: float, exponents: tuple[float, float]
) -> None:
    """The loop goes by the lowest trained condition below it, so the level alone differs; linearly where there is no law."""
    law = with_card(texture, extrapolation_exponents=dict(zip(("speed", "force"), exponents, strict=True)))
    for i, rest in enumerate((FADE_SPEED, FADE_FORCE)):
        at = [LOW[0], 0.8] if i == 0 else [80.0, LOW[1]]
        reference = rendered(law, *steady(200, *at))
        assert np.std(reference) > 0.005
        x = at[i] = share * LOW[i]
        level = (max(x, rest) / LOW[i]) ** exponents[i] * min(x / rest, 1.0) if exponents[i] else share
        # 32 bits of the lowest trained force are 4e-8 of it above it, which the loop goes by.
        out = rendered(law, *steady(200, *at))
        np.testing.assert_allclose(out, level * reference, rtol=3 * FLOAT32, atol=FLOAT32 * np.std(reference))


@pytest.mark.parametrize("low", [(0.0, 0.0), (1.0, 0.04)])
def test_below_2_mm_s_and_a_tenth_of_a_newton_every_texture_fades(texture: Texture, low: tuple[float, float]) -> None:
    """Whatever was recorded. The loop, from the window in the file, goes by the true condition there."""
    assert (FADE_SPEED, FADE_FORCE) == (2.0, 0.1)
    slow = with_card(texture, trained_range={"speed": [low[0], 220.0], "force": [low[1], 2.5]})
    native = NativeTexture(slow.to_bytes())
    window = slow.tensors["warm_start"].astype(float)[None]
    for speed, force, share in (
        (1.0, 1.0, 0.5),
        (1.6, 1.0, 0.8),
        (2.0, 1.0, 1.0),
        (6.0, 1.0, 1.0),
        (80.0, 0.05, 0.5),
        (80.0, 0.1, 1.0),
        (80.0, 0.12, 1.0),
        (1.2, 0.075, 0.45),
    ):
        rounded = np.array([speed, force], dtype=np.float32).astype(float)  # as the kernel takes it
        scaled = (rounded - SCALING.mean[1:]) / SCALING.sd[1:]
        condition = np.tile([*scaled, rounded[0]], (1, 100, 1))
        loop = SCALING.unscale_acceleration(render_streams(native, window, condition, None)[0])
        out = rendered(slow, *steady(100, speed, force), excitation=False)
        np.testing.assert_allclose(out, share * loop, rtol=FLOAT32, atol=1e-9)
        assert np.abs(loop).max() > 0.1


@pytest.mark.parametrize("bad", [-1e-9, -5.0, float("nan"), float("-inf"), float("inf")])
@pytest.mark.parametrize(("name", "unit"), [("speed", "mm/s"), ("force", "N")])
def test_a_bad_condition_is_refused_and_changes_nothing(texture: Texture, bad: float, name: str, unit: str) -> None:
    renderer = Renderer(texture)
    renderer.render(*steady(10))
    condition = {"speed": np.full(5, 80.0), "force": np.full(5, 1.0)}
    condition[name][3] = bad
    with pytest.raises(ValueError, match=f"a {name} is negative, NaN or infinite, expected a finite number of {unit}"):
        renderer.render(condition["speed"], condition["force"])
    with pytest.raises(ValueError, match=f"a {name} is negative"):
        renderer.step(*(bad if channel == name else 1.0 for channel in ("speed", "force")))
    np.testing.assert_array_equal(renderer.render(*steady(10)), rendered(texture, *steady(20))[10:])


def test_shapes_are_checked(texture: Texture) -> None:
    with pytest.raises(ValueError, match=r"shape|broadcast"):
        Renderer(texture).render(np.ones(5), np.ones(4))
    with pytest.raises(ValueError, match=r"shape \(3, 5\).*expected \(n,\)"):
        Renderer(texture).render(np.ones((3, 5)), np.ones((3, 5)))


def test_above_the_range_the_level_grows_by_its_power_law_as_far_as_it_reaches(texture: Texture) -> None:
    """Twice the range of speed, which is more than 400 mm/s; 6 N, which is more than twice the range of force."""
    assert (EXTRAPOLATION_LIMIT, REACH_SPEED, REACH_FORCE) == (2, 400, 6)
    speed, force = np.linspace(100.0, 900.0, 200), np.linspace(1.0, 9.0, 200)
    inside = rendered(texture, np.minimum(speed, HIGH[0]), np.minimum(force, HIGH[1]))
    growth = np.clip(speed / HIGH[0], 1, 2) ** 0.7 * np.clip(force / HIGH[1], 1, 6 / HIGH[1]) ** 0.4
    np.testing.assert_allclose(rendered(texture, speed, force), growth * inside, rtol=FLOAT32)


@pytest.mark.parametrize("excitation", [True, False])
def test_any_stroke_gives_a_finite_bounded_vibration(
    texture: Texture, plain_texture: Texture, excitation: bool
) -> None:
    n = 250
    ramp = np.linspace(0, 350, n)
    switched = np.where(np.arange(n) % 50 < 25, 0.0, 350.0)
    strokes = [
        (np.zeros(n), np.zeros(n)),
        (switched, switched / 50),
        (ramp, np.full(n, 1.0)),
        (ramp[::-1], ramp / 50),
        (np.full(n, 1e9), np.full(n, 1e9)),
    ]
    for used in (texture, plain_texture, with_card(texture, saturation=0.1), with_card(plain_texture, saturation=0.1)):
        bound = used.card["saturation"] * SCALING.sd[0] + abs(SCALING.mean[0])
        for speed, force in strokes:
            out = rendered(used, speed, force, excitation=excitation)
            assert np.isfinite(out).all()
            # What leaves the loop is cut; growth beyond the trained range comes after it.
            growth = np.ones(n)
            for name, channel, reach in (("speed", speed, REACH_SPEED), ("force", force, REACH_FORCE)):
                high = used.trained_range(name)[1]
                share = np.clip(channel / high, 1.0, max(EXTRAPOLATION_LIMIT, reach / high))
                growth *= share ** used.extrapolation_exponent(name)
            assert (np.abs(out) <= bound * growth * (1 + FLOAT32)).all()


@pytest.mark.parametrize(
    "sizes",
    [
        {"order": 6},
        {"order": 6, "gain_before_filter": True},
        {"n_tones": 2, "residual_order": 6},
        {"n_tones": 2, "residual_order": 6, "residual_gain_before_filter": True},
    ],
)
def test_a_stroke_begins_as_if_its_condition_had_always_been_there(sizes: dict[str, Any]) -> None:
    """As loud and of the same colour from the first sample on, over many streams, as half a second later."""
    family = FotenPlusSizes(**{**PLUS, **sizes})
    texture = exported("foten-plus", family)
    out = streams(texture, 3000, *steady(640, *LOW)) - SCALING.mean[0]

    def correlations(at: int) -> np.ndarray:
        return np.array([(out[:, at] * out[:, at + lag]).mean() for lag in range(8)])

    settled = np.mean([correlations(at) for at in range(500, 630, 10)], axis=0)
    # Over 3000 streams a mean square has a standard error of 2.6 %: six of them.
    np.testing.assert_allclose(correlations(0), settled, atol=0.16 * settled[0])
    first = np.mean([correlations(at) for at in range(12)], axis=0)
    np.testing.assert_allclose(first, settled, atol=0.09 * settled[0])


def test_a_stroke_of_a_network_in_the_loop_begins_settled() -> None:
    """The first samples are as loud as those half a second later: a window's length was run before them."""
    texture = exported("foten", FotenSizes(**{**SMALL, "n_layers": 1, "window": 8}, excitation=True))
    out = streams(texture, 1000, *steady(120)) - SCALING.mean[0]
    out -= out[:, 60:].mean()
    settled = np.square(out[:, 60:]).mean()
    # Over 1000 streams a mean square has a standard error of 4.5 %.
    assert np.square(out[:, 0]).mean() == pytest.approx(settled, rel=0.2)
    assert np.square(out[:, :10]).mean() == pytest.approx(settled, rel=0.15)


@pytest.mark.parametrize("excitation", [True, False])
def test_the_saturator_cuts_and_counts(texture: Texture, plain_texture: Texture, excitation: bool) -> None:
    """What left its bound is cut to it, sample by sample, in loops that are bounded and in one of a network alone."""
    for used in (texture, plain_texture):
        loud = rendered(used, *steady(500), excitation=excitation)
        bound = 0.5 * float(np.abs((loud - SCALING.mean[0]) / SCALING.sd[0]).max())
        renderer = Renderer(with_card(used, saturation=bound), excitation=excitation)
        out = (renderer.render(*steady(500)).astype(float) - SCALING.mean[0]) / SCALING.sd[0]
        on_it = np.abs(out) > bound * (1 - FLOAT32)
        assert np.abs(out).max() <= bound * (1 + FLOAT32)
        assert renderer.stats.n_saturated == np.count_nonzero(on_it) > 0
        if used is texture:
            # A bounded loop goes on from what was not cut.
            uncut = np.clip((loud - SCALING.mean[0]) / SCALING.sd[0], -bound, bound)
            np.testing.assert_allclose(out, uncut, atol=FLOAT32)


def test_streams_are_independent(texture: Texture) -> None:
    out = streams(texture, 4, *steady(1000), seed=9)
    np.testing.assert_array_equal(out[0], rendered(texture, *steady(1000), seed=9))
    correlation = np.corrcoef(out) - np.eye(4)
    # Poles at 0.95 leave about 1000·(1 − 0.95²) = 100 independent samples: four standard errors are 0.4.
    assert np.abs(correlation).max() < 0.4
    np.testing.assert_array_equal(out[2], rendered(texture, *steady(1000), seed=9, stream=2))


def test_states_of_one_texture_do_not_disturb_each_other(texture: Texture) -> None:
    native = NativeTexture(texture.to_bytes())
    strokes = [tuple(channel.astype(np.float32) for channel in stroke(100, k)) for k in range(3)]
    alone = [NativeState(native, seed=2, stream=k).render_stroke(*strokes[k]) for k in range(3)]
    states = [NativeState(native, seed=2, stream=k) for k in range(3)]
    in_turn = [
        [
            state.render_stroke(speed[n : n + 1], force[n : n + 1])
            for state, (speed, force) in zip(states, strokes, strict=True)
        ]
        for n in range(100)
    ]
    np.testing.assert_array_equal(np.concatenate(in_turn, axis=1), alone)


@pytest.mark.parametrize("gain_before_filter", [False, True])
def test_the_level_follows_the_excitation(gain_before_filter: bool) -> None:
    """The lattice has unit gain, whatever its reflections: the vibration is as loud as level times excitation."""
    sizes = FotenPlusSizes(**{**PLUS, "order": 6, "n_speed": 3, "n_force": 2}, gain_before_filter=gain_before_filter)
    texture = exported("foten-plus", sizes)
    model = model_of(sizes, texture.tensors)
    assert isinstance(model, FotenPlus)
    scaled = (np.array([[80.0, 1.0]]) - SCALING.mean[1:]) / SCALING.sd[1:]
    unit = model.lattice.level(scaled)[0] * model.excitation.sigma(scaled)[0]
    out = streams(texture, 64, *steady(450))[:, 150:] - SCALING.mean[0]
    # 64·300·(1 − 0.95²) = 1800 independent samples: the RMS is known to 1/√(2·1800) = 1.7 %; three of them.
    assert np.sqrt(np.square(out).mean()) == pytest.approx(unit * SCALING.sd[0], rel=0.05)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("golden.one_step", "one step differs"),
        ("golden.sigma", "the excitation differs"),
        ("golden.closed_loop", "64 closed-loop steps differs"),
        ("network.recurrent.weight_hh_l0", "differs"),
        ("network.head.weight", "differs"),
        ("lattice.reflections", "differs"),
        ("lattice.level.out.bias", "differs"),
        ("excitation.out.bias", "differs"),
        ("warm_start", "differs"),
    ],
)
def test_a_texture_that_fails_its_own_proof_is_refused(texture: Texture, name: str, message: str) -> None:
    damaged = texture.tensors[name].copy()
    damaged.flat[::5] += 0.05 if name == "lattice.reflections" else 0.5
    broken = dataclasses.replace(texture, tensors={**texture.tensors, name: damaged})
    with pytest.raises(ValueError, match=f"fails its own proof: .*{message}.*is the file damaged"):
        Renderer(broken)


def test_a_network_that_answers_nan_is_refused() -> None:
    """Its weights are finite, and so large that float32 overflows."""
    sizes = FotenSizes(**SMALL)
    texture = exported("foten", sizes)
    for name in ("head_1.weight", "temporal.layers.0.attention_in.weight"):
        overflowing = {**texture.tensors, name: np.full_like(texture.tensors[name], 3e38)}
        with pytest.raises(ValueError, match="fails its own proof"):
            Renderer(dataclasses.replace(texture, tensors=overflowing))
