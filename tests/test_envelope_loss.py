"""The loss of renderings: a proper score of band envelopes, of strokes alone."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from foten.dsp.bands import band_energies
from foten.models.foten_plus.closed_loop_training import EnvelopeEnergyDistance, energies

RATE = 1000.0


def test_energies_are_those_of_the_listener() -> None:
    """But for a thousandth of a unit of power that still rings in the lowest band when the transform comes round."""
    signal = np.random.default_rng(6).standard_normal((2, 1000))
    ours = energies(torch.from_numpy(signal).float(), RATE).numpy()
    np.testing.assert_allclose(ours, band_energies(signal, RATE), atol=1e-3)


def bursts(rng: np.random.Generator, n: int, deep: float) -> np.ndarray:
    """Noise whose loudness goes up and down over some 50 ms, by so much."""
    slow = np.repeat(rng.standard_normal((n, 16)), 48, axis=1)
    return rng.standard_normal((n, 768)) * np.exp(deep * slow)


@pytest.mark.parametrize("wrong", [0.0, 0.3, 1.0])
def test_the_score_is_lowest_for_the_distribution_that_was_recorded(wrong: float) -> None:
    rng = np.random.default_rng(7)
    recorded, moving = bursts(rng, 300, 0.6), np.ones((300, 96), dtype=bool)
    distance = EnvelopeEnergyDistance(recorded, moving, RATE)

    def score(deep: float) -> float:
        both, prefix = np.stack([bursts(rng, 300, deep), bursts(rng, 300, deep)]), np.zeros((300, 0))
        drawn, truth, before = (torch.from_numpy(part).float() for part in (both, recorded, prefix))
        return float(distance(drawn, truth, before, torch.from_numpy(moving)))

    assert score(0.6) < score(wrong) - 0.01


def test_what_is_at_rest_does_not_count() -> None:
    """A sensor's noise at rest moves the score of nothing, and an excerpt at rest adds nothing to it.

    Changed are the last 30 frames, of which the last 24 rest: what a band-pass rings is after what it is given.
    """
    rng = np.random.default_rng(8)
    recorded, moving = bursts(rng, 60, 0.6), np.ones((60, 96), dtype=bool)
    moving[:, 72:] = False
    moving[50:] = False
    distance = EnvelopeEnergyDistance(recorded, moving, RATE)
    drawn, noisy = (torch.from_numpy(bursts(rng, 120, 0.6)).float().unflatten(0, (2, 60)) for _ in range(2))
    at_rest = drawn.clone()
    at_rest[:, :, 72 * 8 :] = 10 * noisy[:, :, 72 * 8 :]
    at_rest[:, 50:] = 10 * noisy[:, 50:]

    def score(of: Tensor, counted: Tensor) -> float:
        return float(distance(of, torch.from_numpy(recorded).float(), torch.zeros(60, 0), counted))

    strokes = torch.from_numpy(moving)
    # Of the transform that comes round a thousandth of the power is left, a hundred times as much here.
    assert score(at_rest, strokes) == pytest.approx(score(drawn, strokes), rel=2e-2)
    everywhere = torch.ones_like(strokes)
    assert score(at_rest, everywhere) > 1.2 * score(drawn, everywhere)
