"""One-step scores: predict each sample of the test blocks from recorded history."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.evaluate.bootstrap import intervals
from foten.evaluate.metrics import goodness_of_fit
from foten.evaluate.references import FIRST_SCORED
from foten.recording.scaling import Scaling
from foten.recording.windows import targets, windows
from foten.render.closed_loop import Sigma
from foten.render.engine import Predictor

Array = NDArray[np.float64]


def one_step(
    predictor: Predictor, samples: Array, blocks: tuple[int, ...], block: int, scaling: Scaling
) -> dict[str, Any]:
    """Return a predictor's one-step figures over the scored samples of some blocks.

    Args:
        predictor: windows (b, m, 3) → (b,).
        samples: scaled, shape (n, 3).
        blocks: block numbers to score; in each, the first 160 samples are not, so that every method is scored on the same.
        block: samples in a block.
        scaling: for errors in m/s².

    Returns:
        `mae_scaled`, `mae_m_s2`, `gfc` (Eq. 13 on raw bins, mean over blocks), `intervals`.
    """
    return _scores(predict_blocks(predictor, samples, blocks, block), samples, blocks, block, scaling)


def predict_blocks(predictor: Predictor, samples: Array, blocks: tuple[int, ...], block: int) -> Array:
    """Return the predictions at the scored samples, scaled, shape (n_blocks, block − 160)."""
    n = targets(blocks, block, FIRST_SCORED)
    predicted = np.concatenate(
        [
            predictor.predict(windows(samples, piece, predictor.window))
            for piece in np.array_split(n, len(n) // 2048 + 1)
        ]
    )
    return predicted.reshape(len(blocks), -1)


def _scores(
    predicted: Array, samples: Array, blocks: tuple[int, ...], block: int, scaling: Scaling
) -> dict[str, Any]:
    recorded = samples[targets(blocks, block, FIRST_SCORED), 0].reshape(len(blocks), -1)
    error = np.abs(recorded - predicted).mean(axis=1)
    fit = np.array([goodness_of_fit(a, b) for a, b in zip(recorded, predicted, strict=True)])

    def figures(index: NDArray[np.int64]) -> dict[str, float]:
        mae = float(error[index].mean())
        return {"mae_scaled": mae, "mae_m_s2": mae * scaling.sd[0], "gfc": float(fit[index].mean())}

    every = np.arange(len(blocks))
    return {**figures(every), "intervals": intervals(figures, len(blocks))}


def excitation_scores(
    predictor: Predictor, sigma: Sigma, samples: Array, blocks: tuple[int, ...], block: int
) -> dict[str, Any]:
    """Return how well σ(speed, force) describes the one-step error.

    Returns:
        `nll`: mean Gaussian negative log-likelihood [nat, scaled]; `coverage_50`, `coverage_90`: the share of samples
        inside the central 50 and 90 % of the predicted distribution; `standardised_sd`: 1 when σ is right.
    """
    n = targets(blocks, block, FIRST_SCORED)
    residual = samples[n, 0] - predict_blocks(predictor, samples, blocks, block).ravel()
    scale = sigma(samples[n - 1, 1:])
    standardised = residual / scale
    return {
        "nll": float((np.log(scale) + 0.5 * standardised**2).mean()) + 0.5 * math.log(2 * math.pi),
        "coverage_50": float((np.abs(standardised) < 0.6744897501960817).mean()),
        "coverage_90": float((np.abs(standardised) < 1.6448536269514722).mean()),
        "standardised_sd": float(standardised.std()),
    }
