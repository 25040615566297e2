import dataclasses
from dataclasses import asdict
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from foten.architecture import FotenPlusArchitecture
from foten.runtime.closed_loop import ClosedLoop
from foten.runtime.engine import engine_for
from foten.runtime.excitation import Excitation
from foten.runtime.window_state import WindowState
from hypothesis import given, settings
from hypothesis import strategies as st

from conftest import SCALING, SMALL, exported
from foten.families.conditions import FADE_FORCE, FADE_SPEED, RenderStatistics, Synthesizer, prove
from foten.families.texture_file import CLOSED_LOOP_TOLERANCE, Texture
from foten.recording.preprocess import PreprocessConfig

LOW, HIGH = (8.0, 0.3), (220.0, 2.5)  # the trained range of the fixtures


def stroke(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return a hand that wanders over and beyond the trained range, with rests."""
    rng = np.random.default_rng(seed)
    speed = np.abs(100 + np.cumsum(5 * rng.standard_normal(n)))
    force = np.abs(1 + np.cumsum(0.1 * rng.standard_normal(n)))
    speed[n // 3 : n // 3 + 20] = 0.0
    return speed, force


def steady(n: int, speed: float = 80.0, force: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    return np.full(n, speed), np.full(n, force)


def with_card(texture: Texture, **fields: Any) -> Texture:
    return dataclasses.replace(texture, card={**texture.card, **fields})


@given(cuts=st.lists(st.integers(0, 200), max_size=8), seed=st.integers(0, 2**64 - 1))
@settings(max_examples=10, deadline=None)
def test_any_block_sizes_give_what_one_call_gives(texture: Texture, cuts: list[int], seed: int) -> None:
    speed, force = stroke(200)
    whole = Synthesizer(texture, seed).render(speed, force)
    pieces = Synthesizer(texture, seed)
    edges = [0, *sorted(cuts), 200]
    out = [pieces.render(speed[a:b], force[a:b]) for a, b in pairwise(edges)]
    np.testing.assert_array_equal(np.concatenate(out), whole)


def test_step_is_render_one_by_one(texture: Texture) -> None:
    speed, force = stroke(60)
    stepped = Synthesizer(texture, 5)
    found = [stepped.step(v, f) for v, f in zip(speed, force, strict=True)]
    np.testing.assert_array_equal(found, Synthesizer(texture, 5).render(speed, force))


def test_how_much_noise_is_drawn_ahead_does_not_matter(
    texture: Texture, monkeypatch: pytest.MonkeyPatch
) -> None:
    speed, force = steady(200)
    whole = Synthesizer(texture).render(speed, force)
    monkeypatch.setattr("foten.runtime.synthesizer._NOISE_BLOCK", 64)
    pieces = Synthesizer(texture)
    out = [pieces.render(speed[a : a + 50], force[a : a + 50]) for a in range(0, 200, 50)]
    np.testing.assert_array_equal(np.concatenate(out), whole)


def test_reset_and_replay_is_identical(texture: Texture) -> None:
    speed, force = stroke(200)
    synthesizer = Synthesizer(texture, 3)
    first = synthesizer.render(speed, force)
    assert not np.array_equal(synthesizer.render(speed, force), first)
    synthesizer.reset()
    assert synthesizer.statistics.n == 0
    np.testing.assert_array_equal(synthesizer.render(speed, force), first)


def test_a_seed_is_a_signal(texture: Texture) -> None:
    speed, force = steady(200)
    drawn = [Synthesizer(texture, seed).render(speed, force) for seed in (0, 1, 2**64 - 1)]
    assert all(not np.array_equal(a, b) for a, b in pairwise(drawn))
    for seed in (-1, 2**64):
        with pytest.raises(ValueError, match="expected 0 to 2"):
            Synthesizer(texture, seed)


@pytest.mark.parametrize(("speed", "force"), [(0.0, 1.0), (80.0, 0.0), (0.0, 0.0)])
def test_at_rest_and_lifted_off_it_is_silent(
    texture: Texture, plain_texture: Texture, speed: float, force: float
) -> None:
    for given_texture in (
        texture,
        plain_texture,
        with_card(texture, trained_range={"speed": [0.0, 220.0], "force": [0.0, 2.5]}),
    ):
        synthesizer = Synthesizer(given_texture)
        synthesizer.render(*steady(50))
        np.testing.assert_array_equal(synthesizer.render(*steady(50, speed, force)), 0.0)


def test_the_texture_is_there_again_with_the_first_movement(texture: Texture) -> None:
    synthesizer = Synthesizer(texture, n_streams=64)
    synthesizer.render(*steady(100))
    before = synthesizer.render(*steady(20))
    synthesizer.render(*steady(100, 0.0, 0.0))
    synthesizer.render(*steady(100))
    after = synthesizer.render(*steady(20))
    # 64 streams of 20·(1 − 0.95²) = 2 independent samples: an RMS is known to 1/√(2·128) = 6 %, two of them to 9 %.
    assert np.std(after) == pytest.approx(np.std(before), rel=0.3)


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.999999, 1.0])
def test_below_the_trained_range_it_fades_linearly_and_without_a_step(texture: Texture, share: float) -> None:
    """The loop hears the lowest trained condition whatever the hand's, so that the fade alone differs."""
    reference = Synthesizer(texture).render(*steady(200, LOW[0]))
    assert np.std(reference) > 0.005
    np.testing.assert_allclose(
        Synthesizer(texture).render(*steady(200, share * LOW[0])), share * reference, atol=1e-12
    )
    reference = Synthesizer(texture).render(*steady(200, 80.0, LOW[1]))
    found = Synthesizer(texture).render(*steady(200, 80.0, share * LOW[1]))
    np.testing.assert_allclose(found, share * reference, atol=1e-12)  # rounding


def test_a_texture_recorded_from_rest_fades_too(texture: Texture) -> None:
    from_rest = with_card(texture, trained_range={"speed": [0.0, 220.0], "force": [0.0, 2.5]})
    hand = steady(200, FADE_SPEED / 2, FADE_FORCE / 2)
    whole = Synthesizer(from_rest)
    whole._fade = whole._fade / 2  # the loop hears the same hand
    np.testing.assert_allclose(Synthesizer(from_rest).render(*hand), 0.25 * whole.render(*hand), rtol=1e-12)


@pytest.mark.parametrize("bad", [-1e-9, -5.0, float("nan"), float("-inf")])
@pytest.mark.parametrize(("name", "unit"), [("speed", "mm/s"), ("force", "N")])
def test_a_bad_condition_is_refused_and_changes_nothing(
    texture: Texture, bad: float, name: str, unit: str
) -> None:
    synthesizer = Synthesizer(texture)
    synthesizer.render(*steady(10))
    condition = {"speed": np.full(5, 80.0), "force": np.full(5, 1.0)}
    condition[name][3] = bad
    with pytest.raises(
        ValueError, match=f"a {name} is negative, NaN or infinite, expected a finite number of {unit}"
    ):
        synthesizer.render(condition["speed"], condition["force"])
    whole = Synthesizer(texture).render(*steady(20))
    np.testing.assert_array_equal(synthesizer.render(*steady(10)), whole[10:])


def test_an_infinite_force_is_refused(texture: Texture) -> None:
    with pytest.raises(ValueError, match="a force is negative, NaN or infinite"):
        Synthesizer(texture).step(80.0, float("inf"))


def test_shapes_are_checked(texture: Texture) -> None:
    with pytest.raises(ValueError, match="shape"):
        Synthesizer(texture).render(np.ones(5), np.ones(4))
    with pytest.raises(ValueError, match=r"speed has shape \(3, 5\), expected \(n,\) or \(2, n\)"):
        Synthesizer(texture, n_streams=2).render(np.ones((3, 5)), np.ones((3, 5)))


def test_what_lies_beyond_the_range_is_counted(texture: Texture) -> None:
    synthesizer = Synthesizer(texture)
    speed = np.array([0.0, 4.0, 8.0, 100.0, 220.0, 220.1, 900.0])
    force = np.array([1.0, 0.1, 0.3, 2.5, 2.6, 9.0, 1.0])
    synthesizer.render(speed, force)
    synthesizer.render(speed[-1:], force[-1:])
    s = synthesizer.statistics
    assert (s.n, s.n_speed_beyond, s.n_force_beyond, s.n_below_range, s.n_saturated) == (8, 3, 2, 2, 0)
    assert (s.n_speed_clamped, s.n_force_clamped) == (2, 1)


def test_above_the_range_the_level_grows_by_its_power_law_and_no_further_than_twice_the_range(
    texture: Texture,
) -> None:
    speed = np.linspace(100.0, 900.0, 200)
    force = np.linspace(1.0, 9.0, 200)
    inside = Synthesizer(texture).render(np.minimum(speed, HIGH[0]), np.minimum(force, HIGH[1]))
    growth = np.clip(speed / HIGH[0], 1, 2) ** 0.7 * np.clip(force / HIGH[1], 1, 2) ** 0.4
    np.testing.assert_allclose(Synthesizer(texture).render(speed, force), growth * inside, rtol=1e-12)


def test_the_papers_network_clamps(plain_texture: Texture) -> None:
    card = {**plain_texture.card, "beyond_exponents": {"speed": 0.0, "force": 0.0}}
    plain = dataclasses.replace(plain_texture, card=card)
    inside = Synthesizer(plain).render(*steady(50, HIGH[0], HIGH[1]))
    np.testing.assert_array_equal(Synthesizer(plain).render(*steady(50, 900.0, 9.0)), inside)


@pytest.mark.parametrize("excitation", [True, False])
def test_any_hand_gives_a_finite_bounded_vibration(
    texture: Texture, plain_texture: Texture, excitation: bool
) -> None:
    n = 250
    ramp = np.linspace(0, 350, n)
    step = np.where(np.arange(n) % 50 < 25, 0.0, 350.0)
    hands = [
        (np.zeros(n), np.zeros(n)),
        (step, step / 50),
        (ramp, np.full(n, 1.0)),
        (ramp[::-1], ramp / 50),
        (np.full(n, 1e9), np.full(n, 1e9)),
    ]
    for given_texture in (texture, plain_texture):
        bound = given_texture.card["saturation"] * SCALING.sd[0] + abs(SCALING.mean[0])
        synthesizer = Synthesizer(given_texture, n_streams=len(hands), excitation=excitation)
        out = synthesizer.render(np.stack([v for v, _ in hands]), np.stack([f for _, f in hands]))
        assert np.isfinite(out).all()
        # What leaves the loop is cut; growth beyond the trained range comes after it.
        growth = np.ones_like(out)
        for k, channel in enumerate(("speed", "force")):
            beyond = np.stack([hand[k] for hand in hands]) / given_texture.trained_range(channel)[1]
            growth *= np.clip(beyond, 1.0, 2.0) ** given_texture.beyond_exponent(channel)
        assert (np.abs(out) <= bound * growth).all()


@pytest.mark.parametrize(
    "sizes",
    [
        {"order": 6},
        {"order": 6, "level_drives": True},
        {"n_tones": 2, "rest_order": 6},
        {"n_tones": 2, "rest_order": 6, "rest_level_drives": True},
    ],
)
def test_a_stroke_begins_as_if_its_hand_had_always_been_there(
    sizes: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """As loud, as spiky and of the same colour from the first sample on, over many streams, as half a second later."""
    network = FotenPlusArchitecture(**{**SMALL, "n_layers": 1, "network_heard": False, **sizes})
    given_texture = exported("foten-plus", network)
    monkeypatch.setattr(Excitation, "tail", lambda _, condition: np.full(len(condition), 0.12))
    monkeypatch.setattr("foten.runtime.synthesizer.prove", lambda *_: None)
    monkeypatch.setattr("foten.runtime.synthesizer._NOISE_BLOCK", 1)
    n_streams = 3000
    synthesizer = Synthesizer(given_texture, n_streams=n_streams)
    out = synthesizer.render(*steady(640, *LOW)) - SCALING.mean[0]

    def correlations(at: int) -> np.ndarray:
        return np.array([(out[:, at] * out[:, at + lag]).mean() for lag in range(8)])

    settled = np.mean([correlations(at) for at in range(500, 630, 10)], axis=0)
    # Over 3000 streams a mean square has a standard error of 2.6 %, with the tails and the swell of 4 %.
    np.testing.assert_allclose(correlations(0), settled, atol=0.16 * settled[0])
    first = np.mean([correlations(at) for at in range(12)], axis=0)
    np.testing.assert_allclose(first, settled, atol=0.09 * settled[0])


@pytest.mark.parametrize("sizes", [{"order": 6}, {"n_tones": 2, "rest_order": 6}])
def test_what_a_stroke_begins_with_is_chance_alone(sizes: dict[str, Any]) -> None:
    """Not the window that the streams were started with, network and tones included; another seed, another beginning."""
    network = FotenPlusArchitecture(**{**SMALL, "n_layers": 1, **sizes})
    engine: Any = engine_for(exported("foten-plus", network))
    rng = np.random.default_rng(3)
    hand = np.array([[0.3, -0.2], [1.0, 0.5]])
    states = [engine.start(rng.standard_normal((2, network.history, 3))) for _ in range(3)]
    noise = rng.standard_normal((2, states[0].n_to_begin))
    for state, drawn in zip(states, (noise, noise, -noise), strict=True):
        state.begin(hand, drawn)
    assert (
        states[0].swell.state != states[2].swell.state
    ).all()  # what was played since tells noise from −noise no more
    one, same, other = (ClosedLoop(state).run(np.tile(hand[:, None], (1, 50, 1)), None) for state in states)
    np.testing.assert_array_equal(one, same)
    assert (one[:, 0] != other[:, 0]).all()


def test_a_network_that_is_heard_has_seen_what_was_played() -> None:
    """Of the stream that it goes on in, as many samples as it looks at; the last of them is the lattice's own last one."""
    network = FotenPlusArchitecture(**{**SMALL, "n_layers": 1, "order": 6})
    engine: Any = engine_for(exported("foten-plus", network))
    hand = np.array([[0.3, -0.2]])
    state = engine.start(np.zeros((1, network.history, 3)))
    noise = np.random.default_rng(4).standard_normal((1, state.n_to_begin))
    assert state.n_to_begin == 6 + 1 + network.window
    state.begin(hand, noise)
    assert (state.seen[..., 0] != 0).all()
    assert (state.seen[..., 1:3] == hand).all()
    assert state.seen[0, -1, 0] == pytest.approx(float(state.states[0, 0]))  # a level of what leaves: x is b₀


def test_a_call_goes_on_where_the_last_one_ended_and_given_windows_as_they_are() -> None:
    network = FotenPlusArchitecture(**{**SMALL, "n_layers": 1, "order": 6, "level_drives": True})
    given_texture = exported("foten-plus", network)
    speed, force = stroke(40)
    whole = Synthesizer(given_texture, excitation=False).render(speed, force)
    again = Synthesizer(given_texture, excitation=False)
    pieces = []
    for a, b in ((0, 0), (0, 7), (7, 40)):
        pieces.append(again.render(speed[a:b], force[a:b]))
        again.statistics = RenderStatistics()
    np.testing.assert_array_equal(np.concatenate(pieces), whole)
    given_window = given_texture.tensors["warm_start"][None].astype(float)
    again.reset(given_window)
    alone = engine_for(given_texture).start(given_window).forecast().sample
    assert again.step(*LOW) == pytest.approx(float(SCALING.unscale_acceleration(alone)[0]), rel=1e-9)


def test_the_saturator_counts_what_it_cuts(texture: Texture) -> None:
    tight = with_card(texture, saturation=0.5)
    synthesizer = Synthesizer(tight)
    out = synthesizer.render(*steady(500))
    scaled = (out - SCALING.mean[0]) / SCALING.sd[0]
    # On the bound but for the rounding of m/s² and back.
    assert np.abs(scaled).max() == pytest.approx(0.5, abs=1e-12)
    assert synthesizer.statistics.n_saturated == np.count_nonzero(np.abs(scaled) > 0.5 - 1e-12) > 0


def test_streams_are_independent_and_the_first_is_the_only_one(texture: Texture) -> None:
    speed, force = stroke(300)
    alone = Synthesizer(texture, 9).render(speed, force)
    together = Synthesizer(texture, 9, n_streams=4).render(speed, force)
    assert together.shape == (4, 300)
    # Products of other shapes sum in another order, in float32; the loop forgets a rounding within 1/(1 − 0.95) samples.
    np.testing.assert_allclose(together[0], alone, atol=CLOSED_LOOP_TOLERANCE * SCALING.sd[0])
    moving = Synthesizer(texture, 9, n_streams=4).render(*steady(1000))
    correlation = np.corrcoef(moving) - np.eye(4)
    # Poles at 0.95 leave about 1000·(1 − 0.95²) = 100 independent samples: four standard errors are 0.4.
    assert np.abs(correlation).max() < 0.4


def test_every_stream_has_its_own_hand(texture: Texture) -> None:
    speed, force = (
        np.stack([stroke(100, s)[0] for s in range(3)]),
        np.stack([stroke(100, s)[1] for s in range(3)]),
    )
    together = Synthesizer(texture, 2, n_streams=3)
    found = together.render(speed, force)
    crossed = Synthesizer(texture, 2, n_streams=3)
    other = speed.copy()
    other[1] = 50.0
    changed = crossed.render(other, force)
    np.testing.assert_array_equal(changed[[0, 2]], found[[0, 2]])
    assert not np.array_equal(changed[1], found[1])
    assert together.statistics.n == 300


def test_the_level_follows_the_excitation(texture: Texture) -> None:
    """The lattice has unit gain, whatever its reflections: the vibration is as loud as level times excitation."""
    still = dict(texture.tensors)
    for name in ("network.head_3.weight", "network.head_3.bias"):
        still[name] = np.zeros_like(still[name])
    engine: Any = engine_for(texture)
    scaled = np.array([[(80.0 - SCALING.mean[1]) / SCALING.sd[1], (1.0 - SCALING.mean[2]) / SCALING.sd[2]]])
    expected = engine.lattice.level(scaled)[0] * engine.sigma(scaled)[0] * SCALING.sd[0]
    linear = proved_again(dataclasses.replace(texture, tensors=still))
    found = Synthesizer(linear, n_streams=64).render(*steady(450))[:, 150:]
    # 64·300·(1 − 0.95²) = 1800 independent samples: the RMS is known to 1/√(2·1800) = 1.7 %; three of them.
    assert found.std() == pytest.approx(expected, rel=0.05)


def proved_again(texture: Texture) -> Texture:
    """Return a texture with the golden outputs of its own engine, to look at the loop apart from the proof."""
    from foten.runtime.closed_loop import ClosedLoop

    from foten.dsp.noise import gaussian

    engine: Any = engine_for(texture)
    tensors = dict(texture.tensors)
    tensors["golden.one_step"] = engine.predict(tensors["golden.windows"])
    loop = ClosedLoop(engine.start(tensors["warm_start"][None].astype(float)))
    tensors["golden.closed_loop"] = loop.run(tensors["golden.condition"][None], gaussian(0, 0, 0, 64)[None])[
        0
    ]
    return dataclasses.replace(texture, tensors=tensors)


def test_without_excitation_it_is_the_deterministic_loop(texture: Texture, plain_texture: Texture) -> None:
    out = [Synthesizer(texture, seed, excitation=False).render(*steady(100)) for seed in (0, 1)]
    np.testing.assert_array_equal(out[0], out[1])
    assert not Synthesizer(plain_texture).excitation
    np.testing.assert_array_equal(
        Synthesizer(plain_texture, 0).render(*steady(100)), Synthesizer(plain_texture, 1).render(*steady(100))
    )


def test_it_starts_from_given_windows_and_leaves_them_alone(texture: Texture) -> None:
    warm_start = texture.tensors["warm_start"].copy()
    windows = np.random.default_rng(0).standard_normal((2, texture.window, 3))
    before = windows.copy()
    synthesizer = Synthesizer(texture, n_streams=2)
    synthesizer.reset(windows)
    first = synthesizer.render(*steady(50))
    np.testing.assert_array_equal(windows, before)
    np.testing.assert_array_equal(texture.tensors["warm_start"], warm_start)
    assert not np.array_equal(first, Synthesizer(texture, n_streams=2).render(*steady(50)))


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("golden.one_step", "one step differs"),
        ("golden.sigma", "the excitation differs"),
        ("golden.closed_loop", "64 closed-loop steps differs"),
        ("network.temporal.layers.0.feedforward_out.weight", "differs"),
        ("network.spectral.magnitude_in.weight", "differs"),
        ("lattice.reflections", "differs"),
        ("lattice.level.out.bias", "differs"),
        ("excitation.out.bias", "differs"),
    ],
)
def test_a_texture_that_fails_its_own_proof_is_refused(texture: Texture, name: str, message: str) -> None:
    damaged = texture.tensors[name].copy()
    damaged.flat[::5] += 0.05 if name == "lattice.reflections" else 0.5
    broken = dataclasses.replace(texture, tensors={**texture.tensors, name: damaged})
    with pytest.raises(ValueError, match=f"fails its own proof: .*{message}.*is the file damaged"):
        Synthesizer(broken)


def test_an_engine_that_answers_nan_is_refused(texture: Texture) -> None:
    class Broken:
        window = texture.window

        def predict(self, windows: np.ndarray) -> np.ndarray:
            return np.full(len(windows), np.nan)

        def start(self, windows: np.ndarray) -> WindowState:
            return WindowState(self, windows)

    with pytest.raises(ValueError, match="fails its own proof"):
        prove(texture, Broken())


@pytest.mark.parametrize("rate_hz", [1000.0, 2500.0, 10_000.0])
def test_the_rate_is_the_cards(rate_hz: float) -> None:
    made = exported("foten-plus", rate_hz=rate_hz, preprocess=asdict(PreprocessConfig(rate_hz=rate_hz)))
    assert made.rate_hz == rate_hz
    assert np.isfinite(Synthesizer(made).render(*steady(20))).all()
