"""The lattice: it is the filter it stands for, nothing makes it grow, and its fit recovers it."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import multivariate_normal

import foten.models.foten_plus.linear_model as linear_model
from foten.dsp import lattice
from foten.dsp.lattice import LEAK, analyse, check_reflections, delayed, polynomial, predict, push, rotate_back
from foten.dsp.speed_force_table import FORCE_FLOOR, SpeedForceTable, spanning
from foten.models.foten_plus.linear_model import LatticeData, _folds, fit_reflections, select_lattices
from foten.training import training_kernel as kernel


def validation_error(table: SpeedForceTable, data: LatticeData, first: int) -> float:
    """The mean absolute one-step error over validation blocks, but for the first samples of each."""
    errors = []
    for block in data.validation:
        e, gain, _ = analyse(data.x[block][None], table.at(data.speed[block], data.force[block])[None])
        errors.append(np.abs(e[0] * gain[0] * data.gain[block])[first:])
    return float(np.mean(errors))


def steady(x: np.ndarray, gain: np.ndarray, n_train: int | None = None) -> LatticeData:
    """Blocks under one hand: the first for training, the others for validation; all are for training by default."""
    blocks, n_train = tuple(range(len(x))), len(x) if n_train is None else n_train
    return LatticeData(x, gain, np.full(x.shape, 100.0), np.ones(x.shape), blocks[:n_train], blocks[n_train:])


def resonance(rng: np.random.Generator, n_blocks: int) -> np.ndarray:
    """White noise through one AR(2), of standard deviation 1."""
    x = lfilter([0.3], [1, -1.5, 0.8], rng.standard_normal((n_blocks, 1000)))
    return np.asarray(x / x.std())


def synthesized(reflections: np.ndarray, e: np.ndarray, states: np.ndarray | None = None) -> np.ndarray:
    """The lattice's output for innovations (s, n) under reflections (s, n, p)."""
    p = reflections.shape[2]
    states = np.zeros((p, len(e))) if states is None else states
    out = np.empty_like(e)
    for n in range(e.shape[1]):
        k = reflections[:, n].T
        expected, gain = predict(states, k)
        out[:, n] = expected + gain * e[:, n]
        states, _ = push(states, k, out[:, n])
    return out


def test_constant_reflections_are_an_all_pole_filter() -> None:
    """Oracle: scipy.signal.lfilter."""
    rng = np.random.default_rng(0)
    k = rng.uniform(-0.9, 0.9, 7)
    e = rng.standard_normal((2, 300))
    expected = lfilter([np.sqrt(1 - k**2).prod()], polynomial(k), e)
    result = synthesized(np.broadcast_to(k, (2, 300, 7)), e)
    np.testing.assert_allclose(result, expected, rtol=1e-9, atol=1e-9)  # rounding


def test_analysis_undoes_synthesis_under_switched_reflections() -> None:
    rng = np.random.default_rng(1)
    k = rng.uniform(-0.95, 0.95, (3, 200, 6))
    e = rng.standard_normal((3, 200))
    x = synthesized(k, e)
    result, gain, states = analyse(x, k)
    np.testing.assert_allclose(result, e, atol=1e-8)  # rounding through 200 sections of gain up to 3
    expected, scale = predict(states, k[:, -1].T)
    assert states.shape == (6, 3)
    np.testing.assert_allclose(gain[:, -1], np.sqrt(1 - k[:, -1] ** 2).prod(axis=1))
    np.testing.assert_allclose(scale, gain[:, -1])
    assert np.isfinite(expected).all()


@pytest.mark.parametrize("largest", [0.3, 0.99, 1 - 1e-12])
@pytest.mark.parametrize("p", [1, 2, 60])
def test_all_sections_at_once_are_one_after_the_other(p: int, largest: float) -> None:
    """Oracle: the recursion of the module's docstring; the gain of sixty of the largest is no number."""
    rng = np.random.default_rng(p)
    k, states, x = rng.uniform(-largest, largest, (p, 5)), rng.standard_normal((p, 5)), rng.standard_normal(5)
    if largest > 0.99:
        k = largest * np.sign(k)
    c = np.sqrt(1 - k * k)
    # What a lattice whose gain is no number is driven by would be no number either.
    small = 1e-200 if c.prod(axis=0).min() == 0 else 1.0
    states, x = small * states, small * x
    f = np.zeros(5)
    for i in reversed(range(p)):
        f = c[i] * f - k[i] * LEAK * states[i]
    result, gain = predict(states, k)
    np.testing.assert_allclose(result, f, rtol=1e-9, atol=1e-12 * small)
    np.testing.assert_allclose(gain, c.prod(axis=0))
    f, after = x, [x]
    for i in range(p):
        b = LEAK * states[i]
        f, backward = (f + k[i] * b) / c[i], (b + k[i] * f) / c[i]
        after.append(backward)
    pushed, e = push(states, k, x)
    np.testing.assert_allclose(pushed, np.stack(after[:-1]), rtol=1e-7, atol=1e-12 * small)
    np.testing.assert_allclose(e, f, rtol=1e-7)


def test_the_states_energy_is_a_lyapunov_function_for_all_reflections() -> None:
    """States of ±50, reflections drawn at every sample, innovations at their bound."""
    rng = np.random.default_rng(2)
    p, s, bound = 8, 64, 8.68  # 5.68 of the noise and 3 of the correction
    states = rng.uniform(-50, 50, (p, s))
    energy = np.square(states).sum(axis=0)
    for n in range(2000):
        k = rng.uniform(-0.9999, 0.9999, (p, s))
        e = bound * rng.choice([-1.0, 1.0], s)
        x, gain = predict(states, k)
        states, _ = push(states, k, x + gain * e)
        after = np.square(states).sum(axis=0)
        assert (after <= LEAK**2 * energy + e**2 + 1e-6 * energy).all(), n
        energy = after


def test_a_schedule_is_bilinear_between_its_vertices_and_constant_outside() -> None:
    values = np.array([[0.1], [0.3], [0.5], [0.9]])
    schedule = SpeedForceTable(np.array([10.0, 20.0]), np.log([0.55, 1.05]), values)
    at = schedule.at(np.array([10.0, 20.0, 15.0, 0.0, 99.0]), np.array([0.5, 1.0, 0.5, 0.0, 9.0]))
    np.testing.assert_allclose(at[:, 0], [0.1, 0.9, 0.3, 0.1, 0.9], atol=1e-12)
    halfway = np.exp(np.log([0.55, 1.05]).mean()) - FORCE_FLOOR
    assert schedule.at(np.array([15.0]), np.array([halfway]))[0, 0] == pytest.approx((0.1 + 0.3 + 0.5 + 0.9) / 4)


@pytest.mark.parametrize(("n_speed", "n_force"), [(1, 1), (5, 1), (1, 3), (12, 3)])
def test_values_between_four_vertices_are_those_by_the_weights_of_all(n_speed: int, n_force: int) -> None:
    rng = np.random.default_rng(5)
    speed, force = rng.uniform(0, 300, 500), rng.uniform(-0.1, 4, 500)
    table = spanning(speed[:50], force[:50], n_speed, n_force)
    table = dataclasses.replace(table, values=rng.standard_normal((len(table.values), 7)))
    speed[:12] = np.resize(table.speed_knots, 12)
    np.testing.assert_allclose(table.at(speed, force), table.weights(speed, force) @ table.values, atol=1e-12)


@pytest.mark.parametrize("largest", [1.0, -1.2, float("nan")])
def test_a_schedule_that_would_not_be_stable_is_refused(largest: float) -> None:
    with pytest.raises(ValueError, match="expected less than 1"):
        check_reflections(np.array([[0.3, largest]]))
    with pytest.raises(ValueError, match="do not rise"):
        SpeedForceTable(np.array([5.0, 5.0]), np.zeros(1), np.zeros((2, 1)))


def moving_tone(n_blocks: int, seed: int) -> tuple[LatticeData, np.ndarray]:
    """A process whose resonance moves with speed, and its true reflections."""
    rng = np.random.default_rng(seed)
    block = 1000
    t = np.arange(n_blocks * block)
    speed = 100 + 80 * np.sin(2 * np.pi * t / 1700)
    force = 1 + 0.5 * np.sin(2 * np.pi * t / 2300)
    angle, radius = 0.2 + speed / 100, 0.95
    k = np.stack([-2 * radius * np.cos(angle) / (1 + radius**2), np.full(t.size, radius**2)], axis=1)
    x = synthesized(k[None], rng.standard_normal((1, t.size))).reshape(n_blocks, block)
    shaped = (a.reshape(n_blocks, block) for a in (speed, force))
    blocks = list(range(n_blocks))
    return LatticeData(x, np.ones_like(x), *shaped, tuple(blocks[:-6]), tuple(blocks[-6:])), k


def test_a_resonance_that_moves_with_speed_is_recovered() -> None:
    data, k = moving_tone(30, 0)
    fitted = select_lattices(data, 40)[0]
    schedule = fitted.table
    assert len(schedule.values) > 1
    result = schedule.at(data.speed.ravel(), data.force.ravel())[:, :2]
    # Straight lines between twelve speeds miss the cosine by 0.004; 24 000 samples know a vertex to within 0.02.
    assert np.abs(result - k).mean() < 0.02
    truth = float(np.abs(np.sqrt(1 - k**2).prod(axis=1)).mean() * np.sqrt(2 / np.pi))
    # 6000 validation samples: 0.755/√6000 = 1.0 %.
    assert validation_error(schedule, data, 40) == pytest.approx(truth, rel=0.03)
    alone = min(line["mae_scaled"] for line in fitted.tried if line["vertices"] == 1)
    assert validation_error(schedule, data, 40) < 0.7 * alone


@pytest.mark.parametrize("of", ["portable", kernel.isa()])
@pytest.mark.parametrize(("n_speed", "n_force"), [(1, 1), (5, 1), (1, 3), (4, 3)])
def test_sections_in_c_are_those_of_the_definition(
    n_speed: int, n_force: int, of: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Oracle: the least squares of each section written out with the weights of all vertices."""
    monkeypatch.setattr(kernel, "_function", lambda name: getattr(kernel.training_library(), f"{name}_{of}"))
    rng = np.random.default_rng(4)
    x, gain, weight = rng.standard_normal((3, 4, 53)) ** [[[1]], [[2]], [[2]]]
    speed, force = np.abs(np.cumsum(rng.standard_normal((2, 4, 53)), axis=2)) * [[[20]], [[0.3]]]
    data = LatticeData(x, gain, speed, force, (0, 2, 3), (), weight)
    blocks = list(data.train)
    table = spanning(speed[blocks], force[blocks], n_speed, n_force)
    shares = table.weights(speed[blocks].ravel(), force[blocks].ravel())
    sections = linear_model.Sections(data, data.train, table)
    f = b = x[blocks]
    gain = gain[blocks]
    for first in (1, 2, 7):
        power, product = (weight[blocks] * (f * f + delayed(b) ** 2) / 2)[:, first:], weight[blocks] * f * delayed(b)
        filled = shares.reshape(3, 53, -1)[:, first:]
        by_pair = np.einsum("bn,bni,bnj->ij", power, filled, filled)
        for ours, expected in (
            (sections.block_sums(first), (power.sum(axis=1), product[:, first:].sum(axis=1))),
            (sections.vertex_sums(first), (by_pair, np.einsum("bn,bni->i", product[:, first:], filled))),
        ):
            for part, other in zip(ours, expected, strict=True):
                np.testing.assert_allclose(part, other, rtol=1e-12, atol=1e-12)  # rounding
        reflections = rng.uniform(-0.9, 0.9, len(table.values))
        sections.rotate_back(reflections)
        f, b, cosine = rotate_back(f, delayed(b), (shares @ reflections).reshape(f.shape))
        gain = gain * cosine
        np.testing.assert_allclose(sections.forward, f, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(sections.gain, gain, rtol=1e-9)
    assert data.x is x  # and what they came from is as it was
    np.testing.assert_array_equal(x, np.random.default_rng(4).standard_normal((3, 4, 53))[0])


def test_deviations_are_shrunk_by_the_prior_of_the_greatest_evidence() -> None:
    """Oracle: the density of the scores under each prior of the grid, and the posterior mean of a Gaussian."""
    rng = np.random.default_rng(2)
    parts = linear_model._covariances(3, 2)
    root = rng.standard_normal((6, 40)) * 3
    information = root @ root.T
    true = 0.3 * np.linalg.cholesky(parts[0] + 1e-9 * np.eye(6)) @ rng.standard_normal(6)
    score = information @ true + root @ rng.standard_normal(40)

    def evidence(scales: tuple[float, ...]) -> float:
        prior = sum(scale**2 * part for scale, part in zip(scales, parts, strict=True))
        return float(multivariate_normal(cov=information + information @ prior @ information).logpdf(score))

    scales = max(itertools.product(linear_model.SCALES, repeat=3), key=evidence)
    assert max(scales) > 0
    prior = sum(scale**2 * part for scale, part in zip(scales, parts, strict=True))
    noise = np.linalg.inv(information)
    expected = prior @ np.linalg.solve(prior + noise, noise @ score)
    np.testing.assert_allclose(
        linear_model.posterior_deviations(information, score, parts), expected, rtol=1e-6, atol=1e-9
    )
    np.testing.assert_array_equal(
        linear_model.posterior_deviations(information[:1, :1], score[:1], linear_model._covariances(1, 1)), [0.0]
    )


def test_errors_of_all_orders_at_once_are_those_of_each() -> None:
    """Oracle: the analysis of the whole recording by the first sections alone."""
    data, _ = moving_tone(12, 2)
    table = fit_reflections(data, 9, 4, 2)
    orders = [1, 4, 9]
    alone = [dataclasses.replace(table, values=table.values[:, :order]) for order in orders]
    expected = [validation_error(one, data, 9) for one in alone]
    np.testing.assert_allclose(linear_model.validation_errors(table, data, orders), expected, rtol=1e-9)  # rounding


def test_a_process_that_does_not_move_costs_nothing() -> None:
    """White noise through one AR(2): whatever is tried stays near the best error, and no long lattice is taken."""
    rng = np.random.default_rng(3)
    x = resonance(rng, 20)
    speed, force = rng.uniform(5, 300, x.shape), rng.uniform(0.2, 4, x.shape)
    data = LatticeData(x, np.ones_like(x), speed, force, tuple(range(14)), tuple(range(14, 20)))
    fitted = select_lattices(data, 120)[0]
    assert fitted.table.values.shape[1] <= 20
    errors = [line["mae_scaled"] for line in fitted.tried]
    assert max(errors) < 1.01 * min(errors)


def test_vertices_that_no_stroke_came_near_are_like_the_others() -> None:
    """Fast is always soft, so the corner of fast and firm, the last vertex, is never visited."""
    data, k = moving_tone(10, 1)
    apart = dataclasses.replace(data, force=np.minimum(data.force, 2.0 - data.speed / 100))
    schedule = fit_reflections(apart, 4, 12, 3)
    assert schedule.values.shape == (36, 4)
    fast_and_firm, fast_and_soft = schedule.values[-1], schedule.values[-3]
    assert fast_and_firm[:2] == pytest.approx(fast_and_soft[:2], abs=0.1)
    assert np.ptp(k[:, 0]) > 1.0


def test_a_growing_signal_gives_a_lattice_that_is_stable() -> None:
    t = np.arange(3000)
    x = np.exp(0.001 * t) * np.sin(0.3 * t) + 1e-3 * np.random.default_rng(4).standard_normal(3000)
    schedule = select_lattices(steady(x.reshape(6, 500), np.ones((6, 500)), 4), 20)[0].table
    assert np.abs(schedule.values).max() <= lattice.MAX_REFLECTION


def test_no_knot_leaves_less_to_the_innovation_than_a_sensor_resolves() -> None:
    """Fast strokes hum without noise, so their knot left 1e-13 of the amplitude, which innovations were divided by."""
    t = np.arange(8000)
    hum = sum(np.sin(2 * np.pi * frequency * t) for frequency in (0.05, 0.11, 0.17, 0.23))
    x = np.concatenate([np.random.default_rng(6).standard_normal(8000), hum]).reshape(32, 500)
    speed = np.repeat([20.0, 200.0], 16)[:, None] + 0 * x
    data = LatticeData(x, np.ones_like(x), speed, np.ones_like(x), tuple(range(32)), ())
    slow, *_, fast = np.sqrt(1 - np.square(fit_reflections(data, 40, 3, 1).values)).prod(axis=1)
    assert fast == pytest.approx(linear_model.MIN_INNOVATION, rel=1e-6)
    assert slow > 0.9


def test_reflections_of_chance_are_not_kept() -> None:
    """Half a second of an AR(2) in five blocks: 80 sections beyond it are noise, and predict worse unless they are shrunk."""
    x = resonance(np.random.default_rng(5), 25)
    data = steady(x, np.ones_like(x), 5)
    long = fit_reflections(data, 80, 1, 1)
    assert np.abs(long.values[0, 12:]).mean() < 0.5 * np.sqrt(2 / np.pi / 5000)  # what 5000 samples leave unshrunk
    short = fit_reflections(data, 2, 1, 1)
    # Unshrunk, 78 needless coefficients on 5000 samples cost 78/5000/2 = 0.8 %.
    assert validation_error(long, data, 100) < 1.004 * validation_error(short, data, 100)


def test_each_known_block_is_in_one_validation_set_and_test_blocks_in_none() -> None:
    data, _ = moving_tone(30, 0)
    data = dataclasses.replace(data, train=tuple(range(4, 27)), validation=(27, 29))
    folds = _folds(data)
    known = {*range(4, 27), 27, 29}
    assert sorted(block for fold in folds for block in fold.validation) == sorted(known)
    assert all(set(fold.train) == known - set(fold.validation) for fold in folds)
    assert len(folds) == linear_model.N_FOLDS_OF_MANY
    some = dataclasses.replace(data, train=tuple(range(10)), validation=(10, 11))
    assert len(_folds(some)) == linear_model.N_FOLDS
    few = dataclasses.replace(data, train=(0, 1), validation=(2,))
    assert [(fold.train, fold.validation) for fold in _folds(few)] == [((1, 2), (0,)), ((0, 2), (1,)), ((0, 1), (2,))]


def test_two_validation_blocks_that_show_no_difference_do_not_choose() -> None:
    """Reflections of opposite sign at slow and fast; the validation blocks have the spectrum of all, at a middle speed."""
    rng = np.random.default_rng(3)
    block = 1000
    kinds = [(-0.8, 0.0), (0.8, 0.0)] * 6 + [(0.0, -0.64)] * 2
    k = np.repeat(np.array(kinds), block, axis=0)
    shape = (len(kinds), block)
    x = synthesized(k[None], rng.standard_normal((1, len(k)))).reshape(shape)
    speed = (100 + 100 * k[:, 0]).reshape(shape)
    data = LatticeData(x, np.ones(shape), speed, np.ones(shape), tuple(range(12)), (12, 13))
    single, table = (fit_reflections(data, 10, n_speed, 1) for n_speed in (1, 3))
    assert validation_error(table, data, 10) > validation_error(single, data, 10)
    assert len(select_lattices(data, 10)[0].table.values) > 1


def test_the_error_of_a_kind_is_the_mean_over_all_folds_by_their_blocks() -> None:
    rng = np.random.default_rng(8)
    block, n_blocks = 400, linear_model.N_FOLDS + 2  # so that two folds have two blocks
    moving = lfilter([1.0], [1.0, -0.9], rng.standard_normal(n_blocks * block)).reshape(n_blocks, block)
    moving[0] *= 5  # so that the first fold alone says something else
    data = steady(moving, np.ones((n_blocks, block)), linear_model.N_FOLDS)
    folds, order = _folds(data), 5
    weights = [2, 2] + [1] * (linear_model.N_FOLDS - 2)
    assert [len(fold.validation) for fold in folds] == weights
    each = [linear_model.validation_errors(fit_reflections(fold, order, 1, 1), fold, [order])[0] for fold in folds]
    tried = select_lattices(data, order, table=False, both_gains=False)[0].tried
    assert tried[-1]["order"] == order
    assert tried[-1]["mae_scaled"] == pytest.approx(np.average(each, weights=weights), rel=1e-9)
    assert tried[-1]["mae_scaled"] < 0.8 * each[0]


@pytest.mark.parametrize("before", [False, True])
def test_where_the_gain_lies_is_recovered(before: bool) -> None:
    """A long memory under a level that changes by ten within it, before the filter or after it."""
    rng = np.random.default_rng(5)
    n_blocks, block = 12, 1000
    speed = 100 + 90 * np.sin(np.arange(n_blocks * block) / 25)
    level = (speed / 100) ** 1.5
    k = np.broadcast_to(np.array([-0.95, 0.98]), (1, speed.size, 2))
    e = rng.standard_normal((1, speed.size))
    signal = synthesized(k, level * e) if before else level * synthesized(k, e)
    shape = (n_blocks, block)
    x, gain, speed = ((a.reshape(shape)) for a in (signal[0] / level, level, speed))
    data = LatticeData(x, gain, speed, np.ones(shape), tuple(range(9)), (9, 10, 11))
    fitted = select_lattices(data, 10)[0]
    assert fitted.gain_before_filter == before
    right, wrong = (
        min(line["mae_scaled"] for line in fitted.tried if line["gain_before_filter"] == kind)
        for kind in (before, not before)
    )
    # Of unit innovations: E|e| times the gain, times the mean level; 12 000 samples of such a level know it to 1.3 %.
    assert right == pytest.approx(np.sqrt(2 / np.pi) * np.sqrt(1 - k[0, 0] ** 2).prod() * level.mean(), rel=0.05)
    assert wrong > 1.02 * right
    result = fitted.table.at(np.array([100.0]), np.array([1.0]))[0]
    np.testing.assert_allclose(result[:2], k[0, 0], atol=0.02)
    assert np.abs(result[2:]).max() < 0.05  # 9000 samples know one to 0.011


def test_a_level_that_changes_within_the_memory_does_not_bias_the_gain_before_the_filter() -> None:
    """Loud and soft in turn, each shorter than the memory: soft samples are mostly the ringing of loud ones."""
    rng = np.random.default_rng(0)
    level = np.broadcast_to(np.where(np.arange(4000) // 40 % 2 == 0, 1.0, 0.02), (8, 4000))
    x = lfilter([1.0], [1.0, -0.98], level * rng.standard_normal(level.shape), axis=1)
    result = fit_reflections(steady(x / level, level).with_gain_before_filter(), 1, 1, 1).values
    assert result[0, 0] == pytest.approx(-0.98, abs=0.006)  # of 16 000 loud samples √((1 − k²)/n) is 0.0016


def test_soft_blocks_count_as_much_as_loud_ones() -> None:
    """Opposite spectra, one fifty times as loud: a filter for both is white."""
    rng = np.random.default_rng(0)
    level = np.repeat([1.0, 0.02], 4)[:, None] * np.ones((8, 4000))
    colours = [-0.9] * 4 + [0.9] * 4
    x = np.stack([lfilter([1.0], [1.0, k], rng.standard_normal(4000)) for k in colours])
    result = fit_reflections(steady(x, level).with_gain_before_filter(), 1, 1, 1).values
    # The power of each block is known to √(2 (1 + k²)/(1 − k²)/n) = 7 %, that of either colour to half of it.
    assert result[0, 0] == pytest.approx(0.0, abs=4 * 0.9 * 0.035 / np.sqrt(2))


@pytest.mark.parametrize("speed", [123.4, 50.0, 0.0])
@pytest.mark.parametrize("force", [0.77, 0.8, 0.0])
def test_a_hand_that_hardly_varied_has_one_vertex(speed: float, force: float) -> None:
    """What a low-pass leaves of a constant differs in its last bits, and by a little more where the hand trembled."""
    trembling = 1 + 0.005 * np.sin(np.arange(1000.0))
    for jitter in (1 + 1e-15 * np.sin(np.arange(1000.0)), trembling):
        table = spanning(speed * jitter, force * jitter, 12, 3)
        assert len(table.speed_knots) == len(table.force_knots) == 1


def test_vertices_span_where_the_hand_was() -> None:
    table = spanning(np.linspace(10, 200, 1000), np.linspace(0.5, 2.0, 1000), 12, 3)
    assert table.speed_knots[[0, -1]].tolist() == [10, 200]
    assert len(table.speed_knots) == 12
    assert len(table.force_knots) == 3
    assert table.values.shape == (36, 0)
