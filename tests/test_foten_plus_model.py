"""The definition of foten-plus, held to direct forms, and its recorded innovations: stored, chosen, and played by the kernel."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from conftest import PLUS, exported, recorded, untrained, untrained_tensors
from foten.dsp.noise import gaussian
from foten.models import definitions
from foten.models.definitions import model_of
from foten.models.foten_plus import recorded_fit, recorded_innovations
from foten.models.foten_plus.definition import FotenPlus
from foten.models.foten_plus.linear_model import fit_level, fit_linear_models
from foten.models.foten_plus.recorded_fit import recorded_innovations as fitted
from foten.models.foten_plus.recorded_innovations import (
    CANDIDATE,
    FORCE_FLOOR,
    FORCE_ORIGIN,
    MAX_LENGTH,
    MAX_SPEED_DIFFERENCE,
    MIN_DISTANCE,
    N_GROWTH,
    N_NEAREST,
    ONE,
    RUN_START,
    SPEED_FLOOR,
    SPEED_ORIGIN,
    Playback,
    RecordedInnovations,
    interpolation_taps,
    logarithm,
    neighbourhood,
    runs_of,
)
from foten.models.foten_plus.recorded_store import MIN_SPEED, thinned
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture, texture_from_bytes
from foten.models.trainable import recipe_of
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Channel, Recording
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.runtime.native import NativeState, NativeTexture
from foten.runtime.proof import Tensors
from foten.simulation.linear_family import LINEAR_FAMILY, linear_signal
from foten.simulation.stroking import stroking
from foten.training.job import ScaledBlocks, scaled_blocks

RATE = 1000.0


def playing(along_path: bool = False, **sizes: object) -> Texture:
    """An untrained texture that plays recorded innovations."""
    plus = {**PLUS, "recorded": True, "along_path": along_path, "order": 6, "n_speed": 3, **sizes}
    return exported("foten-plus", FotenPlusSizes(**plus))  # type: ignore[arg-type]


def played(
    playback: Playback, speed: np.ndarray, force: np.ndarray, noise: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Innovations, and the places in the recording that they were read at, in samples."""
    e, places = np.empty((2, len(speed)))
    for i in range(len(speed)):
        before = playback.place
        e[i] = playback.advance(speed[i], force[i], None if noise is None else float(noise[i]))
        places[i] = playback.place - playback.pace if playback.place >= 0 else before
    return e, places / ONE


def test_a_logarithm_is_that_of_the_value_rounded_down() -> None:
    """Oracle: NumPy's. The argument is held in 1/1024, which is 2·10⁻⁵ of the floor of force."""
    values = np.concatenate([[0.0], np.geomspace(1e-3, 1e6, 5000)])
    for floor, origin in ((SPEED_FLOOR, SPEED_ORIGIN), (FORCE_FLOOR, FORCE_ORIGIN)):
        exact = 256 * (np.log2(np.minimum(values + floor, 2.0**20)) + 10)
        difference = exact - logarithm(values, floor)
        assert difference.min() > -0.5 * 256 / np.log(2) / 1024 / floor - 1e-9
        assert difference.max() < 1 + 0.5 * 256 / np.log(2) / 1024 / floor
        assert logarithm(np.zeros(1), floor) == origin


def test_paces_are_far_from_a_tie_of_rounding() -> None:
    """So that another library's power of two, off by its last digit, gives the same whole number."""
    exact = ONE * 2.0 ** (np.arange(-256, 257) / 256)
    assert np.abs(exact - np.floor(exact) - 0.5)[exact % 1 != 0].min() > 1e-4


def test_interpolation_between_samples_keeps_a_tone() -> None:
    """A tone of 0.2 of the rate, at all phases: errors of the window are below 1 %."""
    n = np.arange(-7, 9)
    for phase, taps in enumerate(interpolation_taps()):
        assert taps @ np.cos(2 * np.pi * 0.2 * n) == pytest.approx(np.cos(2 * np.pi * 0.2 * phase / 64), abs=0.01)


@pytest.mark.parametrize("along_path", [False, True])
@pytest.mark.parametrize("tones", [0, 3])
def test_the_kernel_plays_what_the_definition_plays(along_path: bool, tones: int) -> None:
    """Under strokes within the trained range, beyond it and at rest; a choice that differed would show at once.

    The kernel gives float32, of numbers up to 50 m/s².
    """
    texture = playing(along_path, n_tones=tones)
    stroke = stroking(8.0, 3, RATE)
    speed, force = 1.3 * stroke.speed, stroke.force
    speed[2000:2400] = 0.0
    expected = definitions.render(texture, speed, force, seed=5, n_streams=2)
    kernel = NativeTexture(texture.to_bytes())
    for k in range(2):
        rendered = NativeState(kernel, seed=5, stream=k).render_stroke(speed, force)
        np.testing.assert_allclose(rendered, expected[k], rtol=1e-6, atol=2e-5)
    assert np.abs(expected[0] - expected[1]).max() > 1


@pytest.mark.parametrize("along_path", [False, True])
def test_blocks_of_any_size_and_a_reset_give_the_same(along_path: bool) -> None:
    texture, stroke = playing(along_path), stroking(6.0, 4, RATE)
    kernel = NativeTexture(texture.to_bytes())
    state = NativeState(kernel, seed=2)
    whole = state.render_stroke(stroke.speed, stroke.force)
    state.reset(2)
    cuts = np.cumsum(np.random.default_rng(0).integers(1, 60, 400))
    parts = np.split(np.arange(len(whole)), cuts[cuts < len(whole)])
    pieces = [state.render_stroke(stroke.speed[part], stroke.force[part]) for part in parts]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)


def test_a_stretch_ends_in_time_where_the_hand_strays_and_before_its_run_does() -> None:
    """Every place that is read is in a run, its condition is near the hand's, and no stretch lasts longer than 250 ms."""
    source, stroke = recorded(), stroking(30.0, 1, RATE)
    speed = np.clip(stroke.speed, 10, 218)
    force = np.clip(stroke.force, 0.35, 2.4)
    _, places = played(Playback(source), speed, force, gaussian(1, 0, 0, len(speed)))
    moments = (places // source.step).astype(int)
    jumps = np.flatnonzero(np.diff(places) != 1) + 1
    assert np.diff(jumps).max() <= MAX_LENGTH * source.step
    assert (source.run_start[moments[jumps]] <= moments[jumps] - N_GROWTH).all()
    lengths = np.diff(jumps)
    ends = jumps[1:][lengths < 20 * source.step]  # which nothing but the hand or the run's end explains
    hand = logarithm(speed, SPEED_FLOOR), logarithm(force, FORCE_FLOOR)
    left = moments[ends - 1] + 1
    differs = [np.abs(hand[k][ends] - source.logarithms[np.minimum(left, 179), k]) for k in range(2)]
    near_end = source.run_end[np.minimum(left, 179)] - left < 9
    assert ((differs[0] > MAX_SPEED_DIFFERENCE) | (differs[1] > 2 * MAX_SPEED_DIFFERENCE) | near_end).all()
    assert (np.abs(moments[jumps[1:]] - moments[jumps[1:] - 1]) >= MIN_DISTANCE - 1).all()


def test_the_next_stretch_is_one_of_the_nearest() -> None:
    """Under a steady hand, without levels at first: oracle, a search by floating point over all candidates."""
    source = recorded()
    chosen = set()
    for noise in gaussian(3, 0, 0, 200):
        playback = Playback(source)
        playback.advance(100.0, 1.0, float(noise))
        chosen.add(playback.place // ONE // source.step)
    j = source.candidates
    growth = source.logarithms[j] - source.logarithms[j - N_GROWTH]
    query = np.array([logarithm(np.array(100.0), SPEED_FLOOR), logarithm(np.array(1.0), FORCE_FLOOR), 0, 0])
    distance = np.square((np.concatenate([source.logarithms[j], growth], axis=1) - query) * [23, 12, 9, 5.0]).sum(
        axis=1
    )
    nearest = set(j[np.argsort(distance, kind="stable")[:N_NEAREST]].tolist())
    assert chosen == nearest


def test_excluded_moments_are_not_played_by_definition_nor_kernel() -> None:
    """With all but a few candidates excluded those are played; with all of them, noise as of an excitation."""
    source, n = recorded(), 3000
    speed, force, noise = np.full(n, 100.0), np.full(n, 1.0), gaussian(1, 0, 0, n)
    _, places = played(Playback(source, (0, 90)), speed, force, noise)
    assert (places >= 90 * source.step).all()
    e, _ = played(Playback(source, (0, 180)), speed, force, noise)
    np.testing.assert_array_equal(e, noise)
    texture = playing()
    kernel = NativeTexture(texture.to_bytes())

    def rendered(excluded: tuple[int, int]) -> np.ndarray:
        state = NativeState(kernel, seed=1)
        state.exclude(*excluded)
        return np.asarray(state.render_stroke(speed, force))

    silent = replace(
        texture, tensors={**texture.tensors, "recorded.innovations": texture.tensors["recorded.innovations"] * 0}
    )
    assert not np.array_equal(rendered((0, 0)), rendered((0, 90)))
    muted = NativeState(NativeTexture(reproved(silent)), seed=1)
    muted.exclude(0, 180)
    np.testing.assert_array_equal(muted.render_stroke(speed, force), rendered((0, 180)))


def reproved(texture: Texture) -> bytes:
    """The file of a texture whose tensors changed, with golden steps of its own."""
    from foten.runtime.proof import proved

    names = ("golden.", "warm_start")
    tensors = {name: value for name, value in texture.tensors.items() if not name.startswith(names)}
    card = {
        key: texture.card[key] for key in texture.card if key not in ("model", "sizes", "scaling", "window", "units")
    }
    golden = texture.tensors["golden.windows"][:-2].astype(float)
    start = texture.tensors["warm_start"].astype(float)
    return proved("foten-plus", texture.sizes, tensors, texture.scaling, golden, start, card).texture.to_bytes()


def test_what_is_played_is_bounded_by_the_files_limit() -> None:
    """As an excitation is: an innovation beyond the limit is cut."""
    limit = {"excitation.innovation_limit": np.array([0.5, 1e6])}
    sizes = FotenPlusSizes(**{**PLUS, "recorded": True, "order": 1})
    cut, free = (exported("foten-plus", sizes, tensors) for tensors in (limit, {}))
    speed, force = np.full(2000, 100.0), np.full(2000, 1.0)
    loudest = [np.abs(definitions.render(each, speed, force)).max() for each in (cut, free)]
    assert loudest[0] < 0.4 * loudest[1]


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("moments", lambda m: m * (np.arange(5) < 4)),  # no candidate, nor a run
        ("moments", lambda m: m | CANDIDATE * (np.arange(5) == 4)),  # candidates at the ends of runs
        ("moments", lambda m: np.concatenate([m[1:], m[:1]])),  # begins within a run
        ("moments", lambda m: np.concatenate([m, m])),  # twice as many as innovations
        ("moments", lambda m: m.astype(np.float32)),
        ("innovations", lambda x: x[:-1]),
        ("innovations", lambda x: x.astype(np.float32)),
        ("values", lambda v: np.where(v > 2.9, np.nan, v)),
        ("values", lambda v: v[:-1]),
    ],
)
def test_a_file_whose_recorded_innovations_do_not_fit_is_refused(
    name: str, change: Callable[[np.ndarray], np.ndarray]
) -> None:
    """By the kernel, which checks what it is given; bytes stay bytes where they are not made floats."""
    texture = playing()
    stored = texture.tensors[f"recorded.{name}"]
    changed = change(stored)
    changed = changed.astype(stored.dtype) if changed.dtype.kind in "iu" else changed
    tensors = {**texture.tensors, f"recorded.{name}": changed}
    with pytest.raises(ValueError, match=r"recorded\b|recorded\."):
        NativeTexture(replace(texture, tensors=tensors).to_bytes())


def blocks_of(marker: float = 0.0, seconds: float = 20.0) -> ScaledBlocks:
    """A linear process in blocks of 2 s; in the test blocks a marker is added to each sample."""
    stroke = stroking(seconds, 5, RATE)
    x = linear_signal(LINEAR_FAMILY["linear-hum"], stroke.speed, stroke.force, np.random.default_rng(1))
    split = Split((0, 1, 3, 4, 6), (7, 9), (2, 5, 8), 10, 2000, "regrouped", 0)
    for block in split.test:
        x[2000 * block : 2000 * (block + 1)] += marker * np.cos(np.pi * np.arange(2000))
    return scaled_blocks(Trace(x, stroke.speed, stroke.force, RATE, 2000), split)


def recorded_of(blocks: ScaledBlocks) -> RecordedInnovations:
    sizes, config = FotenPlusSizes(), recipe_of("foten-plus", max_order=10, table=False, gain_before_filter=False)
    level, data = fit_level(blocks.flat[:, 0], sizes, blocks, config)
    model = fit_linear_models(level, data, sizes, config)[0]
    found = fitted(model, replace(level, exponents=0 * level.exponents, out_weight=0 * level.out_weight), blocks)
    assert found is not None
    return found


def test_a_file_holds_nothing_of_test_blocks() -> None:
    """A marker in each of their samples changes not a byte of what is stored."""
    plain, marked = recorded_of(blocks_of()), recorded_of(blocks_of(marker=1e3))
    np.testing.assert_array_equal(plain.codes, marked.codes)
    np.testing.assert_array_equal(plain.moments, marked.moments)
    np.testing.assert_array_equal(plain.values, marked.values)


def test_what_filters_carry_out_of_a_test_block_is_not_stored() -> None:
    """Ten standard deviations on three axes: windows carry them 64 ms on, and the high-pass less than 3 % of them further."""
    stroke, noise = stroking(20.0, 5, RATE), np.random.default_rng(2).standard_normal((3, 20_000))
    split = Split((0, 1, 3, 4, 6), (7, 9), (2, 5, 8), 10, 2000, "regrouped", 0)

    def recorded(marker: float) -> ScaledBlocks:
        marked = noise + marker * np.isin(np.arange(20_000) // 2000, split.test)
        axes = {f"acceleration_{axis}": Channel(samples, RATE) for axis, samples in zip("xyz", marked, strict=True)}
        hand = {"speed": Channel(stroke.speed, RATE), "force": Channel(stroke.force, RATE)}
        config = PreprocessConfig(trim_ms=0.0, zero_phase=True)
        return scaled_blocks(preprocess(Recording({**axes, **hand}), config), split)

    plain = recorded(0.0)
    trace = recorded(10.0).trace
    marked = replace(plain, trace=trace, samples=plain.scaling.scale(trace.stacked()).reshape(plain.samples.shape))
    sizes, config = FotenPlusSizes(), recipe_of("foten-plus", max_order=10, table=False, gain_before_filter=False)
    level, data = fit_level(plain.flat[:, 0], sizes, plain, config)
    model = fit_linear_models(level, data, sizes, config)[0]
    one = replace(level, exponents=0 * level.exponents, out_weight=0 * level.out_weight)

    run = runs_of(split, trace)[1]
    first, second = (recorded_fit._analysed(model, one, blocks, run).innovations for blocks in (plain, marked))
    moved = np.abs(first - second)
    assert moved[:64].max() > 0.5
    assert moved[-64:].max() > 0.5
    assert moved[64:-64].max() < 0.3
    stored = fitted(model, one, plain)
    assert stored is not None
    of_run = stored.innovations[4000:8000]
    assert np.abs([of_run[:64], of_run[-64:]]).max() < 1e-3  # the code of least magnitude
    np.testing.assert_allclose(of_run[64:-64], first[64:-64], atol=0.1)


def test_what_was_recorded_near_rest_is_no_louder_under_a_hand_that_leaves_it(monkeypatch: pytest.MonkeyPatch) -> None:
    """At 10 mm/s an innovation of a slower moment is as strong as it was when recorded."""
    blocks, config = blocks_of(), recipe_of("foten-plus", max_order=10, table=False, gain_before_filter=False)
    level, data = fit_level(blocks.flat[:, 0], FotenPlusSizes(), blocks, config)
    model = fit_linear_models(level, data, FotenPlusSizes(), config)[0]
    run = runs_of(blocks.split, blocks.trace)[0]
    of_slow = recorded_fit._analysed(model, level, blocks, run)
    monkeypatch.setattr(recorded_fit, "SLOW_SPEED", 0.0)
    plain = recorded_fit._analysed(model, level, blocks, run).innovations
    slow = of_slow.speed < 10
    np.testing.assert_array_equal(of_slow.innovations[~slow], plain[~slow])
    speed, force = of_slow.speed[slow], of_slow.force[slow]
    then, at_10 = (
        np.square(level(blocks.scaling.scale(np.stack([0 * speed, of, force], axis=1))[:, 1:]))
        for of in (speed, np.full(speed.shape, 10.0))
    )
    assert slow.sum() > 100
    np.testing.assert_allclose(of_slow.innovations[slow] * at_10, plain[slow] * then, rtol=1e-5)  # the level is float32


def test_moments_are_those_of_the_recording() -> None:
    """Runs of neighbouring blocks; speed and force before each moment, within a step of what is stored."""
    blocks = blocks_of()
    found = recorded_of(blocks)
    runs = [(0, 1), (3, 4), (6, 7), (9,)]
    assert len(found.moments) == 500 * 7
    starts = np.cumsum([0, 1000, 1000, 1000, 500])  # and 64 ms before the next, which are not played
    np.testing.assert_array_equal(
        np.flatnonzero(found.moments[:, 4] & RUN_START), np.unique([starts[:4], starts[1:] - 16])
    )
    at = 0
    for run in runs:
        samples = np.concatenate([np.arange(2000 * b, 2000 * (b + 1)) for b in run])
        before = np.maximum(samples[::4] - 1, samples[0])
        logs = logarithm(blocks.trace.speed[before], SPEED_FLOOR)
        stored = found.logarithms[at : at + len(before), 0]
        assert (np.abs(logs - stored) < 8 + 1).all()
        at += len(before)
    assert (found.logarithms[found.candidates, 0] >= logarithm(np.array(MIN_SPEED), SPEED_FLOOR) - 8).all()


def test_innovations_are_stored_to_two_hundredths() -> None:
    """Eight bits by the μ-law: the error of rounding is below 2 % of the signal."""
    blocks = blocks_of()
    found = recorded_of(blocks)
    e = found.innovations
    sorted_values = np.sort(found.values)
    gap = np.diff(sorted_values)[np.clip(np.searchsorted(sorted_values, np.abs(e)) - 1, 0, 254)]
    assert np.sqrt(np.square(gap / np.sqrt(12)).mean() / np.square(e).mean()) < 0.02
    assert e.std() == pytest.approx(1, abs=0.1)


def test_the_neighbourhood_of_a_block_is_a_second_and_a_stretch_on_either_side() -> None:
    """Test blocks too, of which the file holds nothing but what lies beside them."""
    split = Split((0, 1, 3, 4, 6), (7, 9), (2, 5, 8), 10, 2000, "regrouped", 0)
    trace = Trace(*np.zeros((3, 20_000)), RATE, 2000)
    assert neighbourhood(split, trace, 0) == (0, 500 + 313)
    assert neighbourhood(split, trace, 1) == (
        500 - 312,
        1000,
    )  # block 2 is not in the file, block 3 is two seconds away
    assert neighbourhood(split, trace, 2) == (1000 - 312, 1000 + 313)
    assert neighbourhood(split, trace, 9) == (3000, 3500)


def test_a_run_ends_with_its_take() -> None:
    """Hand and vibration of the next begin anew."""
    split = Split((0, 1, 3, 4), (5,), (2,), 6, 2000, "regrouped", 0)
    trace = Trace(*np.zeros((3, 12_000)), RATE, 2000, take_blocks=(4, 2))
    assert [run.tolist() for run in runs_of(split, trace)] == [[0, 1], [3], [4, 5]]


def test_candidates_are_thinned_where_they_lie_dense() -> None:
    """No more than are searched; of the rarest condition all are left."""
    rng = np.random.default_rng(0)
    n = 60_000
    speed = np.where(np.arange(n) < 500, 200, rng.integers(60, 70, n))
    moments = np.stack(
        [speed, np.full(n, 100), rng.integers(120, 130, n), np.full(n, 128), np.full(n, CANDIDATE)], axis=1
    )
    kept = (thinned(moments.astype(np.uint8))[:, 4] & CANDIDATE) > 0
    assert 0.9 * 2**14 < kept.sum() <= 2**14
    assert kept[:500].all()


def test_a_texture_with_recorded_innovations_comes_back_from_its_bytes() -> None:
    texture = playing(along_path=True)
    again = texture_from_bytes(texture.to_bytes())
    assert again.sizes == texture.sizes
    assert again.tensors["recorded.innovations"].dtype == np.uint8


def test_rougher_is_a_power_of_the_recorded_envelope() -> None:
    """Innovations that swell by a factor of 4 swell by 16 at strength 1, and not at −1; they are as loud as before."""
    from foten.editing.envelope import with_envelope

    source = recorded(n=400)
    swell = 4.0 ** np.sin(2 * np.pi * np.arange(source.codes.size) / 800)
    e = source.innovations * swell / 3
    changed = recorded_innovations.encoded(e.reshape(source.codes.shape), source.moments, float(np.abs(e).max()))
    sizes = FotenPlusSizes(**{**PLUS, "recorded": True, "order": 6})
    texture = exported("foten-plus", sizes, changed.tensors())
    swelled = []
    for strength in (-1.0, 0.0, 1.0):
        played_now = RecordedInnovations.of(with_envelope(texture, strength).tensors, False).innovations
        assert np.square(played_now).mean() == pytest.approx(np.square(e).mean(), rel=0.05)
        power = np.square(played_now).reshape(-1, 200).mean(axis=1)
        swelled.append(float(np.sqrt(power[::4].mean() / power[2::4].mean())))
    assert swelled[0] == pytest.approx(1, abs=0.2)
    assert swelled[1] > 4
    assert swelled[2] == pytest.approx(swelled[1] ** 2, rel=0.4)


def test_a_blend_plays_stretches_of_either_side_by_its_share() -> None:
    """Of noise as well, which is stored behind the innovations of the first texture."""
    from foten.editing.blend import blend

    first, second = playing(), exported("foten-plus", FotenPlusSizes(**{**PLUS, "order": 4}))
    for at in (0.25, 0.75):
        between = RecordedInnovations.of(blend(first, second, at, n_steps=0).tensors, False)
        of_second = between.candidates >= len(first.tensors["recorded.moments"])
        assert of_second.mean() == pytest.approx(at, abs=0.02)


def with_sizes(**changed: object) -> tuple[FotenPlusSizes, Tensors]:
    sizes = FotenPlusSizes(**{**PLUS, **changed})  # type: ignore[arg-type]
    return sizes, untrained_tensors("foten-plus", sizes, untrained("foten-plus", sizes))


def model(sizes: FotenPlusSizes, tensors: Tensors) -> FotenPlus:
    of = model_of(sizes, tensors)
    assert isinstance(of, FotenPlus)
    return of


def windows(n: int, m: int) -> np.ndarray:
    return np.random.default_rng(0).standard_normal((n, m, 3))


@pytest.mark.parametrize("before", [False, True])
def test_a_prediction_takes_no_more_than_its_history(before: bool) -> None:
    """Innovations that the network sees need the lattice's order before them, and a level the sample before that.

    With the gain before the filter the lattice is of the acceleration itself, whose first sample needs no level.
    """
    sizes, tensors = with_sizes(window=5, order=4, n_speed=3, gain_before_filter=before)
    predictor, m = model(sizes, tensors), sizes.history
    longer = windows(30, m + 3)
    changed, first = longer.copy(), longer.copy()
    changed[:, :3] += 1.0
    first[:, 3, 1:] += 1.0
    expected = predictor.predict(longer)
    np.testing.assert_allclose(predictor.predict(changed), expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(predictor.predict(longer[:, 3:]), expected, rtol=1e-9, atol=1e-9)
    moved = np.abs(predictor.predict(first) - expected).max() > 1e-8  # rounding is 1e-14 of 30
    assert moved != before


@pytest.mark.parametrize("before", [False, True])
def test_the_network_sees_a_vibration_of_unit_size_whatever_the_level(before: bool) -> None:
    """Twice the level and twice the vibration: twice the prediction."""
    sizes, tensors = with_sizes(order=6, gain_before_filter=before)
    inputs = windows(40, sizes.history)
    doubled = inputs.copy()
    doubled[..., 0] *= 2
    louder = {**tensors, "lattice.level.out.bias": tensors["lattice.level.out.bias"].astype(float) + math.log(2)}
    expected = 2 * model(sizes, tensors).predict(inputs)
    np.testing.assert_allclose(model(sizes, louder).predict(doubled), expected, rtol=1e-9)  # rounding
