"""Level, tones and lattice before the network: innovations are what the kernel's predictions miss."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from conftest import PLUS, SCALING, exported, untrained, untrained_tensors
from foten.dsp.tones import tone
from foten.models.foten_plus.definition import Tones
from foten.models.foten_plus.linear_model import LinearModel, fit_linear_parts
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.split import Split, split_blocks
from foten.recording.trace import Trace
from foten.runtime.loops import predict_blocks
from foten.runtime.native import NativeTexture
from foten.simulation.simulate import TEXTURES, simulate
from foten.training.blocks import ScaledBlocks, scaled_blocks
from foten.training.config import TrainConfig


def moving_blocks(n_blocks: int = 5, block: int = 300) -> ScaledBlocks:
    rng, n = np.random.default_rng(0), n_blocks * block
    t = np.arange(n) / 1000
    speed, force = 100 * 2.0 ** np.sin(3 * t), 1.6 ** np.sin(5 * t)
    trace = Trace(rng.standard_normal(n), speed, force, 1000.0, block)
    split = Split((0, 1, 2), (3,), (4,), n_blocks, block, "contiguous", 0)
    samples = SCALING.scale(trace.stacked()).reshape(n_blocks, block, 3)
    return ScaledBlocks(trace, split, SCALING, samples)


def test_a_prediction_knows_the_condition_of_the_sample_before_and_a_blocks_first_its_own() -> None:
    blocks = moving_blocks()
    speed, force, scaled = blocks.condition_before()
    for channel, before in ((blocks.trace.speed, speed), (blocks.trace.force, force)):
        recorded = blocks.trace.blocks(channel)
        np.testing.assert_array_equal(before[:, 1:], recorded[:, :-1])
        np.testing.assert_array_equal(before[:, 0], recorded[:, 0])
    physical = SCALING.scale(np.stack([0 * speed, speed, force], axis=2).reshape(-1, 3))
    np.testing.assert_allclose(scaled, physical[:, 1:], atol=1e-12)


@pytest.mark.parametrize("before", [False, True])
def test_innovations_are_what_the_kernel_misses(before: bool) -> None:
    """In units of the scaled acceleration; the network of the file is none of the linear part."""
    sizes = FotenPlusSizes(**PLUS, order=6, n_speed=3, n_force=2, gain_before_filter=before)
    tensors = untrained_tensors("foten-plus", sizes, untrained("foten-plus", sizes))
    blocks, m = moving_blocks(), sizes.history
    x, e, unit = LinearModel(sizes, tensors, None, {}).innovations(blocks)
    assert x.shape == e.shape == unit.shape == (5, 300)
    assert not e[:, 0].any()
    kernel = NativeTexture(exported("foten-plus", sizes, tensors).to_bytes())
    predicted = predict_blocks(kernel, blocks.samples, "linear").sample
    # The kernel begins at a window, the innovations with the block: what is older is forgotten.
    settled = slice(100, None)
    np.testing.assert_allclose(
        (e * unit)[:, m:][:, settled], (blocks.samples[:, m:, 0] - predicted)[:, settled], atol=1e-5
    )
    level = LinearModel(sizes, tensors, None, {}).excited_lattice.level
    under = level(blocks.condition_before()[2]).reshape(5, 300)
    np.testing.assert_allclose((x * under)[:, 1:], blocks.samples[:, 1:, 0], atol=1e-9)


def test_innovations_beside_tones_are_of_what_the_tones_leave() -> None:
    """A recording of tones alone, whose phase is known, leaves nothing; without them it does."""
    sizes = FotenPlusSizes(**PLUS, order=4, n_tones=2, residual_order=3, network_in_loop=False)
    tensors = untrained_tensors("foten-plus", sizes, untrained("foten-plus", sizes))
    blocks = moving_blocks()
    part = LinearModel(sizes, tensors, None, {})
    model = Tones(tensors, part.excited_lattice.level)
    path = blocks.path_conditions()
    phase = np.cumsum(model.increment(path), axis=1) - model.increment(path)[:, :1]
    samples = blocks.samples.copy()
    coefficients = model.coefficients(path[:, :-1].reshape(-1, 3)).reshape(5, 299, -1)
    samples[:, 1:, 0] = tone(coefficients, phase[:, 1:])
    part = dataclasses.replace(part, phase=phase)
    toned = dataclasses.replace(blocks, samples=samples)
    _, e, _ = part.innovations(toned, residual=True)
    assert np.abs(e).max() < 1e-9
    assert np.abs(part.innovations(toned)[1]).max() > 0.1


def test_a_steady_power_is_that_of_excitation_and_tones() -> None:
    """Oracle: a tone's mean square over many periods."""
    sizes = FotenPlusSizes(**PLUS, order=4, n_tones=2, residual_order=3, network_in_loop=False)
    tensors = untrained_tensors("foten-plus", sizes, untrained("foten-plus", sizes))
    part = LinearModel(sizes, tensors, np.zeros((1, 1)), {})
    condition = np.array([[-0.5, 0.2], [0.7, -0.3]])
    unit, tones = part.power(condition)
    np.testing.assert_allclose(unit, part.excited_lattice.level(condition) ** 2)
    lattice = LinearModel(sizes, tensors, None, {}).excited_lattice
    speed = lattice.level.physical(condition)[:, :1]
    coefficients = Tones(tensors, lattice.level).coefficients(np.concatenate([condition, speed], axis=1))
    turns = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    for one, power in zip(coefficients, tones, strict=True):
        made = tone(np.tile(one, (1000, 1)), turns)
        assert np.square(made).mean() == pytest.approx(power, rel=1e-9)


def test_a_surface_that_repeats_is_fitted_once_more_with_its_tones() -> None:
    """Simulated jeans, whose threads are a known distance apart; linear cloth has none."""
    sizes, config = FotenPlusSizes(**PLUS), TrainConfig(max_order=20, table=False)
    n_parts, reports = [], []
    for name in ("jeans", "linear-cloth"):
        trace = preprocess(simulate(name, 10.0, seed=1), PreprocessConfig(trim_ms=0, block_ms=1000))
        blocks = scaled_blocks(trace, split_blocks(trace, "regrouped", 0))
        parts = fit_linear_parts(sizes, blocks, config)
        n_parts.append(len(parts))
        reports.append(parts[-1].tried)
        assert parts[0].phase is None
        assert not parts[0].sizes.n_tones
    assert n_parts == [2, 1]
    assert reports[1]["wavelength_mm"] is None
    assert reports[0]["wavelength_mm"] == pytest.approx(TEXTURES["jeans"].wavelength_mm, rel=0.03)
