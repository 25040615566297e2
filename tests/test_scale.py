"""Standard deviations over speed and force: PyTorch, which fits them, beside NumPy and beside their equation."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from conftest import untrained_tensors
from foten.families import FotenPlusSizes
from foten.families.excitation import HEAVIEST_TAIL
from foten.networks.scale import Excitation, Scale
from foten.reference.excitation import Excitation as ReferenceExcitation
from foten.reference.excitation import Scale as ReferenceScale
from foten.train.export import tensors_of


def excitation() -> Excitation:
    """Return one of 100 mm/s and 1 N on the mean, whose network is silent."""
    sigma = Excitation(4).requires_grad_(False)
    sigma.mean.copy_(torch.tensor([100.0, 1.0]))
    sigma.sd.copy_(torch.tensor([60.0, 0.5]))
    sigma.out.weight.zero_()
    sigma.out.bias.zero_()
    sigma.power_law.weight.zero_()
    return sigma


def both(sigma: Excitation, condition: np.ndarray) -> list[np.ndarray]:
    """Return what PyTorch and NumPy make of it, in float64."""
    tensors = tensors_of(sigma)
    return [sigma.double()(torch.from_numpy(condition)).numpy(), ReferenceScale(tensors, "")(condition)]


def test_it_is_a_power_law_where_its_network_is_silent() -> None:
    speed, force = np.array([0.0, 10.0, 100.0, 300.0]), np.array([0.0, 0.1, 1.0, 4.0])
    sigma = excitation()
    sigma.power_law.weight.copy_(torch.tensor([[0.7, 0.4, 0.0, 0.0, 0.0]]))
    scaled = np.stack([(speed - 100) / 60, (force - 1) / 0.5], axis=1)
    expected = ((speed + 2) / 102) ** 0.7 * ((force + 0.05) / 1.05) ** 0.4
    for values in both(sigma, scaled):
        np.testing.assert_allclose(values, expected, rtol=1e-6)  # exponents and floors come from float32


def test_speed_and_force_below_zero_count_as_zero() -> None:
    sigma = excitation()
    sigma.power_law.weight.copy_(torch.tensor([[0.7, 0.4, 0.1, 0.1, 0.1]]))
    below, zero = np.full((3, 2), -50.0), np.tile([[-100 / 60, -2.0]], (3, 1))
    for one, other in zip(both(sigma, below), both(sigma, zero), strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_allclose(one, other, rtol=1e-6)


def test_it_nowhere_exceeds_the_97th_percentile_of_where_it_was_trained() -> None:
    sigma = excitation()
    sigma.power_law.weight.copy_(torch.tensor([[1.0, 0.0, 0.0, 0.0, 0.0]]))
    within = torch.linspace(-1.5, 2.0, 1001)[:, None].repeat(1, 2)
    expected = float(torch.quantile(sigma(within), 0.97))
    sigma.highest.fill_(1e-3)  # of an earlier fit
    sigma.bound(within)
    assert float(sigma.highest) == pytest.approx(expected, rel=1e-6)
    for values in both(sigma, np.array([[3.0, 0.0], [50.0, 0.0]])):
        np.testing.assert_allclose(values, expected, rtol=1e-6)


def test_scales_and_tails_in_numpy_are_those_that_were_fitted() -> None:
    sizes = FotenPlusSizes(excitation_width=7)
    tensors = untrained_tensors("foten-plus", sizes, torch.nn.Module())
    condition = np.random.default_rng(0).standard_normal((200, 2)) * [2.0, 2.0]
    for prefix, kind in (("excitation.", Excitation), ("lattice.level.", Scale)):
        module = kind(7)
        module.load_state_dict({n: torch.from_numpy(tensors[prefix + n]) for n in module.state_dict()})
        with torch.no_grad():
            expected = module.double()(torch.from_numpy(condition)).numpy()
        np.testing.assert_allclose(ReferenceScale(tensors, prefix)(condition), expected, rtol=1e-12)
    sigma = Excitation(7)
    sigma.load_state_dict({n: torch.from_numpy(tensors[f"excitation.{n}"]) for n in sigma.state_dict()})
    sigma.tail.bias.data.fill_(0.3)
    tensors["excitation.tail.bias"] = np.array([0.3], dtype=np.float32)
    with torch.no_grad():
        tails = sigma.double().tails(torch.from_numpy(condition)).numpy()
    np.testing.assert_allclose(ReferenceExcitation(tensors).tail(condition), tails, rtol=1e-12)
    assert 0 <= tails.min() < tails.max() <= HEAVIEST_TAIL
