"""Level, tones and lattice before the network: innovations are what the kernel's predictions leave."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from conftest import PLUS, SCALING, exported, untrained, untrained_tensors
from foten.dsp.tones import tone
from foten.models.foten_plus.config import FotenPlusConfig
from foten.models.foten_plus.definition import Tones
from foten.models.foten_plus.linear_model import LinearModel, fit_level, fit_linear_models
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.foten_plus.tones_fit import fit_residual, tonal_model
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.split import Split, split_blocks
from foten.recording.trace import Trace
from foten.runtime.loops import predict_blocks
from foten.runtime.native import NativeTexture
from foten.simulation.simulate import TEXTURES, simulate
from foten.training.job import ScaledBlocks, scaled_blocks


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


def with_tensors(**counts: Any) -> LinearModel:
    """A linear model of seeded tensors."""
    sizes = FotenPlusSizes(**PLUS, **counts)
    return LinearModel(sizes, untrained_tensors("foten-plus", sizes, untrained("foten-plus", sizes)))


@pytest.mark.parametrize("before", [False, True])
def test_innovations_are_what_the_kernels_predictions_leave(before: bool) -> None:
    """In units of the scaled acceleration; the network of the file is none of the linear model."""
    model, blocks = with_tensors(order=6, n_speed=3, n_force=2, gain_before_filter=before), moving_blocks()
    m = model.sizes.history
    x, e, gain = model.innovations(blocks)
    assert x.shape == e.shape == gain.shape == (5, 300)
    assert not e[:, 0].any()
    kernel = NativeTexture(exported("foten-plus", model.sizes, model.tensors).to_bytes())
    predicted = predict_blocks(kernel, blocks.samples, "linear").sample
    # The kernel begins at a window, the innovations with the block: what is older is forgotten.
    settled = slice(100, None)
    np.testing.assert_allclose(
        (e * gain)[:, m:][:, settled], (blocks.samples[:, m:, 0] - predicted)[:, settled], 0, 1e-5
    )
    under = model.level(blocks.condition_before()[2]).reshape(5, 300)
    np.testing.assert_allclose((x * under)[:, 1:], blocks.samples[:, 1:, 0], atol=1e-9)


def test_innovations_beside_tones_are_of_what_the_tones_leave() -> None:
    """A recording of tones alone, whose phase is known, leaves nothing; without them it does."""
    model, blocks = with_tensors(order=4, n_tones=2, residual_order=3), moving_blocks()
    tones = Tones(model.tensors, model.level)
    path = blocks.conditions_with_speed()
    phase = np.cumsum(tones.phase_increment(path), axis=1) - tones.phase_increment(path)[:, :1]
    samples = blocks.samples.copy()
    coefficients = tones.coefficients(path[:, :-1].reshape(-1, 3)).reshape(5, 299, -1)
    samples[:, 1:, 0] = tone(coefficients, phase[:, 1:])
    model = dataclasses.replace(model, phase=phase)
    played = dataclasses.replace(blocks, samples=samples)
    _, e, _ = model.innovations(played, residual=True)
    assert np.abs(e).max() < 1e-9
    assert np.abs(model.innovations(played)[1]).max() > 0.1


def test_a_steady_power_is_that_of_excitation_and_tones() -> None:
    """Oracle: a tone's mean square over many periods."""
    model = dataclasses.replace(with_tensors(order=4, n_tones=2, residual_order=3), phase=np.zeros((1, 1)))
    condition = np.array([[-0.5, 0.2], [0.7, -0.3]])
    innovation, tones = model.power(condition)
    np.testing.assert_allclose(innovation, model.excited_lattice.level(condition) ** 2)
    speed = model.level.physical(condition)[:, :1]
    coefficients = Tones(model.tensors, model.level).coefficients(np.concatenate([condition, speed], axis=1))
    turns = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    for row, power in zip(coefficients, tones, strict=True):
        assert np.square(tone(np.tile(row, (1000, 1)), turns)).mean() == pytest.approx(power, rel=1e-9)


@pytest.mark.parametrize(("name", "precision"), [("steel-mesh-1", 2e-3), ("linear-cloth", None), ("linear-hum", None)])
def test_a_surface_that_repeats_is_fitted_once_more_with_its_tones(name: str, precision: float | None) -> None:
    """Simulated wires are a known distance apart; a linear process, though it rings, repeats nothing."""
    sizes, config = FotenPlusSizes(**PLUS), FotenPlusConfig(max_order=20, table=False)
    trace = preprocess(simulate(name, 10.0, seed=1), PreprocessConfig(trim_ms=0, block_ms=1000))
    blocks = scaled_blocks(trace, split_blocks(trace, "regrouped", 0))
    level, data = fit_level(blocks.flat[:, 0], sizes, blocks, config)
    linear = fit_linear_models(level, data, sizes, config)[0]
    assert linear.phase is None
    assert not linear.sizes.n_tones
    assert linear.report["wavelength_mm"] is None
    residual = fit_residual(data, sizes, blocks, config)
    assert (residual is None) == (precision is None)
    assert fit_residual(data, sizes, blocks, dataclasses.replace(config, tones=False)) is None
    if residual is not None:
        tonal = tonal_model(linear, residual, blocks.trace.rate_hz)
        assert tonal.sizes.n_tones
        length = TEXTURES[name].wavelength_mm
        assert tonal.report["wavelength_mm"] == pytest.approx(length, rel=precision)
        increment = tonal.tensors["tones.phase_params"][0]
        assert 2 * np.pi / increment / 1000 == pytest.approx(tonal.report["wavelength_mm"], rel=1e-6)
