"""foten-plus as its sizes describe it: the definition, held to direct forms; the kernel is held to it elsewhere."""

from __future__ import annotations

import math

import numpy as np
import pytest

from conftest import PLUS, untrained, untrained_tensors
from foten.models.definitions import model_of
from foten.models.foten_plus.definition import FotenPlus
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.runtime.proof import Tensors


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


@pytest.mark.parametrize("noise", [-5.6, None, 5.6])
def test_what_the_network_draws_is_bounded(noise: float | None) -> None:
    """In the unit that σ has, whatever the network says; without noise as well."""
    sizes, tensors = with_sizes(order=6)
    tensors["excitation.innovation_limit"] = np.array([2.5, 1e6])
    inputs = windows(200, sizes.history)
    silent = {**tensors, "rendering_network.out.weight": 0 * tensors["rendering_network.out.weight"]}
    silent["rendering_network.out.bias"] = tensors["rendering_network.out.bias"] * 0
    loud = {**tensors, "rendering_network.out.weight": 1e3 * tensors["rendering_network.out.weight"]}
    linear, drawn = (model(sizes, some).start(inputs).predict() for some in (silent, loud))
    assert drawn.scale is not None
    sample = drawn.sample if noise is None else drawn.excited(np.full(200, noise))
    share = (sample - linear.sample) / drawn.scale
    assert np.abs(share).max() <= 2.5 * (1 + 1e-9)  # rounding of the difference
    assert np.abs(share).max() > 2.49


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
