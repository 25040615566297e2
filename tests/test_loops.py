"""Closed loops and one-step predictions in the kernel: the reference's, sample by sample, for every family."""

from __future__ import annotations

from functools import cache
from typing import Any, get_args

import numpy as np
import pytest
from scipy.signal import lfilter

from conftest import PLUS, SCALING, exported, packed, sizes_with, untrained
from foten.dsp.lattice import LEAK, polynomial
from foten.dsp.noise import innovation_likelihood
from foten.models.definitions import model_of
from foten.models.excitation import Excitation
from foten.models.foten_plus.definition import FotenPlus, innovation_inputs
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.model_sizes import ModelSizes
from foten.models.piecewise_ar.definition import PiecewiseAr
from foten.models.piecewise_ar.sizes import PiecewiseArSizes
from foten.models.stream import Model, run
from foten.models.texture_file import CLOSED_LOOP_TOLERANCE, ONE_STEP_TOLERANCE, Texture
from foten.runtime.loops import predict_blocks, render_streams
from foten.runtime.native import NativeState, NativeTexture, PredictionPart
from test_piecewise_ar import LOCAL
from test_reference import CASES, sizes_for

GRAPHS: dict[str, dict[str, Any]] = {
    "fnn": {"window": 40, "n_lags": 3, "first": 8, "second": 4, "excitation": True},
    "dstn": {"channels": 8, "squeezed": 2, "recurrent": 8, "dense": 8},
    "ldhtd": {"window": 20, "recurrent": 8, "d_model": 8, "n_heads": 2, "excitation": True},
    "dftnet": {"first": 16, "second": 16, "third": 16},
    "gan": {"window": 42, "frame": 16, "stride": 1, "channels": 8},
}
"""One network of each kind: excited or not, recurrent, of noise."""
EVERY = [*CASES, *(("ar", name) for name in LOCAL), *((key, "graph") for key in GRAPHS)]


@cache
def case(key: str, variant: str) -> tuple[Texture, Model]:
    """A case's texture, and its model in the reference."""
    if key == "ar":
        texture = exported(key, PiecewiseArSizes(**LOCAL[variant]))
        return texture, model_of(texture.sizes, texture.tensors)
    if variant != "graph":
        texture = exported(key, sizes_for(key, variant))
        return texture, model_of(texture.sizes, texture.tensors)
    sizes = sizes_with(key, GRAPHS[key])
    texture, graph = exported(key, sizes), packed(untrained(key, sizes), sizes)
    return texture, graph.definition(graph.sizes, texture.tensors)


def in_float64_alone(sizes: ModelSizes) -> bool:
    """Whether the kernel does all of a loop in float64: no network of windows is in it."""
    return isinstance(sizes, FotenPlusSizes | PiecewiseArSizes)


def moving(n_streams: int, n: int, seed: int = 0) -> np.ndarray:
    """Scaled conditions over the trained range, and the speed of their path [mm/s]; they stand still at times."""
    rng = np.random.default_rng(seed)
    speed = 110 + 100 * np.sin(np.cumsum(0.05 * rng.standard_normal((n_streams, n)), axis=1))
    force = 1.4 + np.sin(np.cumsum(0.05 * rng.standard_normal((n_streams, n)), axis=1))
    for channel in (speed, force):
        channel[:, n // 2 : n // 2 + 10] = channel[:, n // 2 : n // 2 + 1]
    scaled = (np.stack([speed, force], axis=2) - SCALING.mean[1:]) / SCALING.sd[1:]
    return np.concatenate([scaled, speed[..., None]], axis=2)


def recorded(n_streams: int, n: int, seed: int = 1) -> np.ndarray:
    """Blocks of noise under such conditions, scaled, shape (n_streams, n, 3)."""
    samples = np.random.default_rng(seed).standard_normal((n_streams, n, 1))
    return np.concatenate([samples, moving(n_streams, n, seed)[..., :2]], axis=2)


def inputs(
    texture: Texture, n_streams: int, n: int, seed: int
) -> tuple[NativeTexture, np.ndarray, np.ndarray, np.ndarray]:
    """A texture's kernel; recorded windows, conditions and noise of streams of n samples."""
    noise = np.random.default_rng(seed).standard_normal((n_streams, n))
    return NativeTexture(texture.to_bytes()), recorded(n_streams, texture.window), moving(n_streams, n), noise


def rounding(sizes: ModelSizes) -> float:
    """What float64 rounds in sums of another order, as a share of a sample."""
    if isinstance(sizes, PiecewiseArSizes):
        return 1e-9 if sizes.order < 40 else 1e-6  # from forty angles to a polynomial digits are lost
    return 1e-9


@pytest.mark.parametrize(("key", "variant"), EVERY)
def test_the_kernels_loop_is_the_references(key: str, variant: str) -> None:
    """Seam: from recorded windows, with noise and without, cut and not."""
    texture, model = case(key, variant)
    native, windows, condition, drawn = inputs(texture, 2, 96, seed=2)
    # A network is in float32, and what it rounds is fed back: for 64 steps the file's own tolerance, then ten times that.
    double = in_float64_alone(texture.sizes)
    first, later = (rounding(texture.sizes),) * 2 if double else (1e-4, 1e-3)
    for noise in (drawn, None):
        for limit in (np.inf, 0.6):
            expected = run(model.start(windows), condition, noise, limit)
            out = render_streams(native, windows, condition, noise, limit)
            error = np.abs(out - expected) / np.maximum(1.0, np.abs(expected))
            assert error[:, :64].max() < first, (noise is None, limit)
            assert error.max() < later, (noise is None, limit)
            assert np.abs(expected).max() > 0.01 or (not texture.predicts_samples and noise is None)


def followed(
    model: Model, m: int, blocks: np.ndarray, part: PredictionPart
) -> tuple[np.ndarray, np.ndarray | None, np.ndarray | None, np.ndarray | None]:
    """The reference's predictions of recorded blocks, which it takes in sample by sample; with scales, z and nll."""
    n = blocks.shape[1]
    if isinstance(model, FotenPlus):
        stream, warm_up = model._analysed(blocks[:, :m], model.lattice)
        hidden, network, predicted = np.zeros((len(blocks), model.network.n_hidden)), model.network, []
        for inputs in warm_up[-model.sizes.window :]:
            hidden = network.push(hidden, inputs)
        for t in range(m, n):
            correction = stream.linear()[1] * network.expected(hidden, inputs) if part == "model" else 0.0
            predicted.append((stream.predict().sample + correction, stream.predict().scale))
            x, e = blocks[:, t, 0] / stream.level, stream.analyse(blocks[:, t, 0])
            stream.set_condition(model.with_speed(blocks[:, t, 1:]))
            inputs = innovation_inputs(e, x, model.lattice.level.logarithms(blocks[:, t, 1:]))
            hidden = network.push(hidden, inputs)
        samples, scales = (np.stack(some, axis=1) for some in zip(*predicted, strict=True))
        if part == "model" or model.sizes.n_tones:
            return samples, None, None, None
        return samples, scales, *innovation_likelihood(blocks[:, m:, 0] - samples, scales)
    if isinstance(model, PiecewiseAr):
        local, local_predictions = model.start(blocks[:, :m]), []
        for t in range(m, n):
            local_predictions.append(local.predict())
            local.infer(blocks[:, t, 0], blocks[:, t, 1:], known=True)
        samples, scales = (np.stack(some, axis=1) for some in zip(*(p[:2] for p in local_predictions), strict=True))
        scales = np.maximum(scales, 1e-9)
        return samples, scales, *innovation_likelihood(blocks[:, m:, 0] - samples, scales)
    windows = np.lib.stride_tricks.sliding_window_view(blocks, m, axis=1)[:, : n - m].swapaxes(2, 3)
    flat = windows.reshape(-1, m, 3)
    shape = (len(blocks), n - m)
    samples = model.predict(flat).reshape(shape)
    excitation: Excitation | None = model.excitation  # type: ignore[attr-defined]
    if excitation is None:
        return samples, None, None, None
    scales = excitation.sigma(flat[:, -1, 1:]).reshape(shape)
    return samples, scales, *innovation_likelihood(blocks[:, m:, 0] - samples, scales)


@pytest.mark.parametrize(("key", "variant"), [(key, variant) for key, variant in EVERY if key not in ("dftnet", "gan")])
def test_the_kernel_predicts_recorded_samples_as_the_reference(key: str, variant: str) -> None:
    """Seam: sample, scale of what is random, and how likely what came was, each part of the model by itself."""
    texture, model = case(key, variant)
    native, blocks = NativeTexture(texture.to_bytes()), recorded(2, texture.window + 40)
    exact = rounding(texture.sizes)
    predictions = {}
    for part in get_args(PredictionPart):
        sample, scale, standardised, nll = followed(model, texture.window, blocks, part)
        predictions[part] = predicted = predict_blocks(native, blocks, part)
        tolerance = exact if in_float64_alone(texture.sizes) else ONE_STEP_TOLERANCE  # a network's float32
        np.testing.assert_allclose(predicted.sample, sample, rtol=tolerance, atol=tolerance)
        if scale is None:
            np.testing.assert_array_equal(predicted[1:], 0.0)
        else:
            np.testing.assert_allclose(predicted.scale, scale, rtol=exact)
            # What a float32 rounds of a sample, over the scale; and squared.
            np.testing.assert_allclose(predicted.standardised, standardised, rtol=10 * tolerance, atol=10 * tolerance)
            np.testing.assert_allclose(predicted.nll, nll, rtol=100 * tolerance, atol=100 * tolerance)
    if isinstance(texture.sizes, FotenPlusSizes):
        assert np.abs(predictions["linear"].sample - predictions["model"].sample).max() > 1e-3


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(texture: Texture, bad: float) -> None:
    native = NativeTexture(texture.to_bytes())
    blocks = recorded(1, texture.window + 5)
    blocks[0, 3, 1] = bad
    with pytest.raises(ValueError, match="NaN or infinity"):
        predict_blocks(native, blocks)
    with pytest.raises(ValueError, match="NaN or infinity"):
        render_streams(native, blocks[:, : texture.window], moving(1, 5), None)
    with pytest.raises(ValueError, match=r"dimension|fewer"):
        predict_blocks(native, blocks[:, : texture.window - 1])
    assert predict_blocks(native, blocks[:, 4 : texture.window + 4]).sample.shape == (1, 0)


@pytest.mark.parametrize(("key", "variant"), [("foten", "one-layer"), ("foten", "excited"), ("ten", "default")])
def test_a_networks_history_is_its_own_output_as_it_was_cut(key: str, variant: str) -> None:
    """Each sample of the loop is what the network predicts of those before it, as if they had been recorded."""
    sizes = sizes_for(key, variant)
    weight = exported(key, sizes).tensors["head_3.weight"]
    # Untrained, its samples would hardly differ.
    texture = exported(key, sizes, {"head_3.weight": 40 * weight})
    native, windows, condition, _ = inputs(texture, 2, 200, seed=0)
    uncut = render_streams(native, windows, condition, None)
    for limit in (np.inf, 0.9 * float(np.median(np.abs(uncut)))):
        out = render_streams(native, windows, condition, None, limit)
        rendered = np.concatenate([out[..., None], condition[..., :2]], axis=2)
        predicted = predict_blocks(native, np.concatenate([windows, rendered], axis=1)).sample
        np.testing.assert_allclose(out, np.clip(predicted, -limit, limit), rtol=1e-6, atol=1e-6)  # float32
    was_cut = np.abs(out) == limit
    assert 0.05 < was_cut.mean() < 1
    # Going on from what was not cut would be seen.
    assert np.abs(np.clip(uncut, -limit, limit) - out).max() > 0.01


@pytest.mark.parametrize(("key", "variant"), [("foten-plus", "a-table"), ("foten-plus", "tones"), ("ar", "with-zeros")])
def test_a_bounded_model_goes_on_from_what_was_not_cut(key: str, variant: str) -> None:
    native, windows, condition, noise = inputs(case(key, variant)[0], 2, 300, seed=5)
    uncut, cut = (render_streams(native, windows, condition, noise, limit) for limit in (np.inf, 0.2))
    assert (np.abs(uncut) > 0.2).mean() > 0.05
    np.testing.assert_array_equal(cut, np.clip(uncut, -0.2, 0.2))


@pytest.mark.parametrize(
    ("key", "variant"),
    [("foten-plus", "a-table"), ("foten-plus", "tones"), ("foten", "excited"), ("ar", "models"), ("dstn", "graph")],
)
def test_a_sample_goes_by_the_condition_before_it(key: str, variant: str) -> None:
    """Eq. 1: a change of speed and force at a sample changes the next one first."""
    native, windows, condition, noise = inputs(case(key, variant)[0], 1, 30, seed=6)
    changed = condition.copy()
    changed[0, 20] += [0.5, -0.5, 30.0]
    one, other = (render_streams(native, windows, some, noise) for some in (condition, changed))
    np.testing.assert_array_equal(one[0, :21], other[0, :21])
    assert one[0, 21] != other[0, 21]


def test_under_a_constant_condition_the_lattice_is_an_all_pole_filter() -> None:
    """Oracle: scipy.signal.lfilter and the step-up recursion; white noise in, and a recorded window that rings out."""
    texture = exported("foten-plus", FotenPlusSizes(**{**PLUS, "order": 6}))
    native, model = NativeTexture(texture.to_bytes()), model_of(texture.sizes, texture.tensors)
    assert isinstance(model, FotenPlus)
    condition = np.tile([[[0.3, -0.2, 118.0]]], (2, 500, 1))
    noise = np.random.default_rng(0).standard_normal((2, 500))
    windows = np.zeros((2, texture.window, 3))
    windows[..., 1:] = condition[0, 0, :2]
    k = model.lattice.reflections(condition[:1, 0, :2])[:, 0]
    unit = model.lattice.level(condition[:1, 0, :2]) * model.excitation.sigma(condition[:1, 0, :2])
    expected = lfilter(unit * np.sqrt(1 - k * k).prod(), polynomial(k), noise)
    np.testing.assert_allclose(render_streams(native, windows, condition, noise), expected, rtol=1e-9, atol=1e-9)
    windows[:, -1, 0] = 1.0
    impulse = lfilter([1.0], polynomial(k), np.eye(1, 501)[0])[1:]
    np.testing.assert_allclose(render_streams(native, windows, condition, None)[0], impulse, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("largest", [(1.2, 1e6), (1e6, 0.15), (1.2, 0.15)])
@pytest.mark.parametrize("variant", ["order-7", "gain-before", "tones", "excited"])
def test_no_excitation_is_larger_than_the_largest_innovation(variant: str, largest: tuple[float, float]) -> None:
    """In units of σ and in scaled acceleration; a network of windows that predicts nothing leaves the excitation alone."""
    key = "foten" if variant == "excited" else "foten-plus"
    sizes = sizes_for(key, variant)
    bound = {"excitation.innovation_limit": np.array(largest)}
    if key == "foten":
        shapes = sizes.tensor_shapes()
        bound |= {name: np.zeros(shapes[name]) for name in ("head_3.weight", "head_3.bias")}
    texture = exported(key, sizes, bound)
    native, windows, condition, noise = inputs(texture, 2, 60, seed=8)
    noise = 2 * noise.clip(-2.5, 2.5)
    expected = run(model_of(sizes, texture.tensors).start(windows), condition, noise)
    out = render_streams(native, windows, condition, noise)
    tolerance = 1e-9 if in_float64_alone(sizes) or key == "foten" else CLOSED_LOOP_TOLERANCE
    np.testing.assert_allclose(out, expected, rtol=tolerance, atol=tolerance)
    free = exported(key, sizes, bound | {"excitation.innovation_limit": np.array([1e6, 1e6])})
    unbounded = render_streams(NativeTexture(free.to_bytes()), windows, condition, noise)
    assert np.abs(out - unbounded).max() > 0.05
    if key == "foten":
        assert np.abs(out).max() <= largest[1] * (1 + 1e-12)
        assert np.abs(unbounded).max() > largest[1] or largest[1] > 1


def test_streams_do_not_depend_on_each_other() -> None:
    texture, _ = case("foten-plus", "a-table")
    native, windows, condition, noise = inputs(texture, 5, 50, seed=7)
    at_once = render_streams(native, windows, condition, noise)
    alone = [render_streams(native, windows[[k]], condition[[k]], noise[[k]])[0] for k in range(5)]
    np.testing.assert_array_equal(at_once, alone)
    blocks = recorded(5, texture.window + 30)
    predicted = predict_blocks(native, blocks)
    for k in range(5):
        for one, other in zip(predicted, predict_blocks(native, blocks[[k]]), strict=True):
            np.testing.assert_array_equal(one[k], other[0])


@pytest.mark.parametrize("excitation", [True, False])
def test_after_a_prediction_a_state_begins_again(texture: Texture, excitation: bool) -> None:
    native, blocks = NativeTexture(texture.to_bytes()), recorded(1, texture.window + 30)
    states = [NativeState(native, seed=3, excitation=excitation) for _ in range(3)]
    speed, force = np.full(50, 80.0), np.full(50, 1.0)
    expected = states[0].render_stroke(speed, force)
    states[2].render_stroke(speed[:20], force[:20])
    for state in states[1:]:
        state.predict(blocks[0], "model", np.empty((30, 4)))
        assert state.statistics.n == 0
        np.testing.assert_array_equal(state.render_stroke(speed, force), expected)


SWITCHED = [(0.0, 0.0, 0.0), (350.0, 4.0, 350.0)]  # mm/s, N and the path's mm/s, in turn


@pytest.mark.parametrize("gain_before", [False, True])
@pytest.mark.parametrize("plays", [False, True])
@pytest.mark.parametrize("tones", [False, True])
def test_nothing_makes_it_grow(tones: bool, plays: bool, gain_before: bool) -> None:
    """Windows of ±50 standard deviations, speed and force switched at every sample, noise at its bound; and the saturator.

    The reference's lattice can be looked at; the kernel renders the same samples.
    """
    sizes = {**PLUS, "order": 6, "n_speed": 3, "n_force": 2}
    of_tones = {"n_tones": 3, "n_tone_speed": 4, "n_tone_force": 2, "residual_order": 4}
    gains = {"gain_before_filter": gain_before, "residual_gain_before_filter": gain_before}
    family = FotenPlusSizes(**(sizes | of_tones if tones else sizes), **gains, recorded=plays)
    texture = exported("foten-plus", family, {"excitation.innovation_limit": np.array([2.5, 1e6])})
    model = model_of(family, texture.tensors)
    assert isinstance(model, FotenPlus)
    rng = np.random.default_rng(2)
    streams, n = 16, 1000
    windows = 50 * rng.standard_normal((streams, texture.window, 3)).clip(-1, 1)
    condition = np.array(SWITCHED)[rng.integers(0, 2, (streams, n))]
    condition[..., :2] = (condition[..., :2] - SCALING.mean[1:]) / np.array(SCALING.sd[1:])
    noise = 5.68 * rng.choice([-1.0, 1.0], (streams, n))
    stream = model.start(windows)
    at_first = np.square(stream.states).sum(axis=0)
    expected = run(stream, condition, noise)
    assert np.isfinite(expected).all()
    energy = np.square(stream.states).sum(axis=0)
    known = np.concatenate([windows[:, -1:, 1:], condition[..., :2]], axis=1)  # of each sample the one before
    flat, limit = known.reshape(-1, 2), model.excitation.innovation_limit[0]
    innovation = float(model.excitation.sigma(flat).max()) * limit
    before, after = model.excited_lattice.gains(model.excited_lattice.level(flat))
    innovation *= float(before.max())
    left = LEAK ** (2 * n)
    assert (energy <= left * at_first + (1 - left) * innovation**2 / (1 - LEAK**2)).all()
    native = NativeTexture(texture.to_bytes())
    out = render_streams(native, windows, condition, noise)
    error = np.abs(out - expected) / np.maximum(1.0, np.abs(expected))
    assert error.max() < 1e-8  # float64
    loudest = np.sqrt(at_first.max() + innovation**2 / (1 - LEAK**2)) * float(after.max())
    if tones:
        tone = np.abs(texture.tensors["tones.values"]).sum(axis=1).max()
        loudest += float(model.lattice.level(flat).max()) * tone
    assert np.abs(out).max() <= loudest
    cut = render_streams(native, windows, condition, noise, 2.0)
    np.testing.assert_array_equal(cut, np.clip(out, -2.0, 2.0))
