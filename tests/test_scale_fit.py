"""A standard deviation over speed and force: one that is known is recovered, and is nowhere more than was recorded."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from conftest import scale
from foten.models.excitation import Scale
from foten.recording.scaling import Scaling
from foten.training import calibration
from foten.training.calibration import constant_scale, fit_scale


def under(speed: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, Scaling]:
    """Conditions (n, 2), scaled by what they are."""
    scaling = Scaling((0.0, speed.mean(), force.mean()), (1.0, speed.std() or 1.0, force.std() or 1.0))
    return scaling.scale(np.stack([0 * speed, speed, force], axis=1))[:, 1:], scaling


def test_a_power_law_is_recovered() -> None:
    rng = np.random.default_rng(2)
    n = 12_000
    speed, force = rng.uniform(5, 300, n), rng.uniform(0.2, 4, n)
    condition, scaling = under(speed, force)
    true = 0.3 * (speed / 100) ** 0.8 * force**0.4
    residual = true * rng.standard_normal(n)
    sigma = fit_scale(16, condition, residual, n - 2000, scaling, seed=0)
    # 10 000 residuals estimate a scale within 1/√(2·10000) = 0.7 %; a flexible σ costs some of it.
    assert np.abs(np.log(sigma(condition) / true)).mean() < 0.04
    again = fit_scale(16, condition, residual, n - 2000, scaling, seed=0)
    for name, tensor in again.tensors("").items():  # in float32, as the file has it
        np.testing.assert_array_equal(getattr(sigma, name.replace(".", "_")), tensor, name)


def test_no_shape_is_taken_that_validation_contradicts() -> None:
    """Loud where speed is high in training, and the other way round in validation: one scale for all."""
    rng = np.random.default_rng(5)
    speed = rng.uniform(50, 150, 4000)
    condition, scaling = under(speed, np.ones(4000))
    slope = np.where(np.arange(4000) < 2000, 1.0, -1.0)
    residual = np.exp(slope * (speed - 100) / 50) * rng.standard_normal(4000)
    sigma = fit_scale(16, condition, residual, 2000, scaling, seed=0)(condition)
    assert np.ptp(np.log(sigma)) < 1e-5
    assert sigma[0] == pytest.approx(np.sqrt(np.square(residual[:2000]).mean()), rel=1e-5)


def test_its_gradient_is_that_of_finite_differences(monkeypatch: pytest.MonkeyPatch) -> None:
    """Away from where the fit begins, at which the network's last layer is zero; in float64, by central differences."""
    fitted: list[tuple[Callable[[np.ndarray], tuple[float, np.ndarray]], np.ndarray]] = []

    def captured(loss: Any, x: np.ndarray, **_: object) -> SimpleNamespace:
        fitted.append((loss, x))
        return SimpleNamespace(x=x)

    monkeypatch.setattr(calibration, "minimize", captured)
    rng = np.random.default_rng(3)
    condition, scaling = under(rng.uniform(5, 300, 300), rng.uniform(0.2, 4, 300))
    fit_scale(3, condition, rng.standard_normal(300), 200, scaling, seed=0)
    ((loss, x),) = fitted
    at = x + 0.3 * rng.standard_normal(x.size)
    numerical = [(loss(at + step)[0] - loss(at - step)[0]) / 2e-6 for step in 1e-6 * np.eye(x.size)]
    np.testing.assert_allclose(loss(at)[1], numerical, rtol=1e-6, atol=1e-8)


def silent(exponents: list[float]) -> Scale:
    """A power law about 100 mm/s and 1 N whose network is silent."""
    parts = {"out_weight": np.zeros((1, 4)), "mean": np.array([100.0, 1.0]), "sd": np.array([60.0, 0.5])}
    return replace(scale(4, 0.0, 0), exponents=np.array(exponents), **parts)


def test_it_is_a_power_law_where_its_network_is_silent() -> None:
    speed, force = np.array([0.0, 10.0, 100.0, 300.0]), np.array([0.0, 0.1, 1.0, 4.0])
    scaled = np.stack([(speed - 100) / 60, (force - 1) / 0.5], axis=1)
    expected = ((speed + 2) / 102) ** 0.7 * ((force + 0.05) / 1.05) ** 0.4
    np.testing.assert_allclose(silent([0.7, 0.4, 0.0, 0.0, 0.0])(scaled), expected, rtol=1e-12)
    constant = constant_scale(5, Scaling((0.0, 100.0, 1.0), (1.0, 60.0, 0.5)))
    assert constant(scaled).tolist() == [1.0] * 4
    assert constant.sigma_max.tolist() == [1.0]


def test_speed_and_force_below_zero_count_as_zero() -> None:
    sigma = silent([0.7, 0.4, 0.1, 0.1, 0.1])
    below, at_rest = (replace(sigma, hidden_weight=0 * sigma.hidden_weight)(np.array([c])) for c in REST)
    assert np.isfinite(below).all()
    np.testing.assert_allclose(below, at_rest, rtol=1e-12)


REST = ([-50.0, -50.0], [-100 / 60, -2.0])  # scaled, far below rest and at it


def test_it_nowhere_exceeds_the_97th_percentile_of_where_it_was_trained() -> None:
    sigma = replace(silent([1.0, 0.0, 0.0, 0.0, 0.0]), sigma_max=np.array([1e-3]))  # of an earlier fit
    within = np.linspace(-1.5, 2.0, 1001)[:, None].repeat(2, axis=1)
    bounded = sigma.bounded(within)
    expected = np.quantile((within[:, 0] * 60 + 102) / 102, 0.97)
    assert bounded.sigma_max == pytest.approx([expected], rel=1e-9)
    np.testing.assert_allclose(bounded(np.array([[3.0, 0.0], [50.0, 0.0]])), expected, rtol=1e-9)
