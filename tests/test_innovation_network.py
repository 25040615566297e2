"""The innovation network: mixtures by their definition, the unit and its head as PyTorch's."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.special import log_ndtr, ndtri_exp
from scipy.stats import norm

from conftest import PLUS, untrained
from foten.models.foten_plus.definition import Mixture, NetworkDefinition
from foten.models.foten_plus.network import InnovationNetwork, NextInnovation, negative_log_likelihood
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.training.texture_builder import tensors_of

SIZES = FotenPlusSizes(**PLUS)


def mixtures(n: int, k: int = 4, seed: int = 0) -> Mixture:
    """n mixtures: near, far, sharp and wide components."""
    rng = np.random.default_rng(seed)
    weight = rng.dirichlet(np.full(k, 0.5), n) + 1e-9
    scale = np.exp(rng.uniform(-5, 2, (n, k)))
    return Mixture(weight / weight.sum(axis=1, keepdims=True), 3 * rng.standard_normal((n, k)), scale)


def repeated(mixture: Mixture, n: int) -> Mixture:
    return Mixture(*(np.repeat(part, n, axis=0) for part in dataclasses.astuple(mixture)))


def standardised(mixture: Mixture, values: np.ndarray) -> np.ndarray:
    """The z of which values are the quantiles at Φ(z), by SciPy."""
    logs = np.log(mixture.weight)
    below, above = (
        np.logaddexp.reduce(logs + log_ndtr(sign * (values[:, None] - mixture.mean) / mixture.scale), axis=1)
        for sign in (1, -1)
    )
    return np.where(below < above, 1, -1) * ndtri_exp(np.minimum(below, above))


def test_a_quantile_has_as_much_below_it_as_a_normal_number() -> None:
    """By the definition of each: Σ w Φ((x − μ)/s) = Φ(z), and far in the upper tail by what is above."""
    z, drawn = np.array([-5.6, -3.0, -1.0, 0.0, 0.3, 2.0, 5.6]), mixtures(40)
    for row in range(40):
        mixture = repeated(Mixture(*(part[row : row + 1] for part in dataclasses.astuple(drawn))), len(z))
        x = mixture.quantile(z)
        below, above = (
            (mixture.weight * norm.cdf(sign * (x[:, None] - mixture.mean) / mixture.scale)).sum(axis=1)
            for sign in (1, -1)
        )
        np.testing.assert_allclose(np.where(z < 0, below, above), norm.cdf(-np.abs(z)), rtol=1e-9)
        assert (np.diff(x) > 0).all()
        np.testing.assert_allclose(standardised(mixture, x), z, atol=1e-7)


def test_a_single_component_is_a_normal_distribution() -> None:
    normal = Mixture(np.ones((3, 1)), np.array([[0.0], [2.0], [-1.0]]), np.array([[1.0], [0.1], [30.0]]))
    z = np.array([1.3, -2.0, 5.0])
    np.testing.assert_allclose(normal.quantile(z), normal.mean[:, 0] + normal.scale[:, 0] * z, rtol=1e-12)
    np.testing.assert_allclose(normal.log_density(normal.quantile(z)), norm.logpdf(z) - np.log(normal.scale[:, 0]))


def test_mean_and_spread_are_those_of_the_density() -> None:
    """Oracle: quadrature of exp(log_density)."""
    mixture = Mixture(np.array([[0.7, 0.3]]), np.array([[-0.5, 2.0]]), np.array([[0.4, 1.5]]))

    def moment(power: int, about: float = 0.0) -> float:
        def integrand(x: float) -> float:
            return (x - about) ** power * math.exp(mixture.log_density(np.array([x]))[0])

        return quad(integrand, -20, 20, limit=400)[0]

    assert moment(0) == pytest.approx(1.0)
    assert mixture.expected()[0] == pytest.approx(moment(1))
    assert mixture.sd()[0] == pytest.approx(math.sqrt(moment(2, moment(1))))


def test_the_unit_and_its_head_are_pytorchs() -> None:
    """Seam: PyTorch in float64 on the same tensors, sample by sample, and as a graph would be asked."""
    network = untrained("foten-plus", SIZES).double()
    rng = np.random.default_rng(0)
    inputs, innovation = 2 * rng.standard_normal((3, 30, 5)), rng.standard_normal((3, 30))
    definition, hidden = NetworkDefinition(tensors_of(network), ""), np.zeros((3, SIZES.n_hidden))
    with torch.no_grad():
        mixture = network(torch.from_numpy(inputs))
        last = NextInnovation(network)(torch.from_numpy(inputs)).numpy()
        expected = network.expected(torch.from_numpy(inputs)).numpy()
        nll = negative_log_likelihood(mixture, torch.from_numpy(innovation)).numpy()
    theirs = [part.numpy() for part in mixture]
    for i in range(30):
        hidden = definition.push(hidden, inputs[:, i])
        ours = definition.mixture(hidden, inputs[:, i])
        for part, other in zip((np.log(ours.weight), ours.mean, np.log(ours.scale)), theirs, strict=True):
            np.testing.assert_allclose(part, other[:, i], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(-ours.log_density(innovation[:, i]), nll[:, i], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(ours.expected(), expected[:, i], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(last, np.concatenate([part[:, -1] for part in theirs], axis=1), atol=1e-12)


def test_untrained_it_expects_nothing() -> None:
    torch.manual_seed(0)
    assert not InnovationNetwork(SIZES).expected(torch.randn(4, 20, 5)).any()
