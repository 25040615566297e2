"""One-step scores: predict each sample of the test blocks from recorded history."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.noise import innovation_likelihood
from foten.evaluate.metrics import goodness_of_fit, intervals
from foten.recording.windows import stretches
from foten.runtime.loops import Prediction, predict_blocks
from foten.runtime.native import NativeTexture, PredictionPart

_HALF, _NINE_TENTHS = 0.6744897501960817, 1.6448536269514722  # quantiles of a standard normal, |z| < …


def one_step(recorded: Array, predicted: Array, sd: float) -> dict[str, Any]:
    """Return the one-step figures of a predictor over the scored samples of some blocks.

    Args:
        recorded: acceleration, scaled, shape (n_blocks, k); the same samples for every method that is compared.
        predicted: likewise.
        sd: training standard deviation of the acceleration [m/s²].

    Returns:
        `mae_scaled`, `mae_m_s2`, `gfc` (Eq. 13 on raw bins, mean over blocks), `intervals`.
    """
    error, fit = np.abs(recorded - predicted).mean(axis=1), goodness_of_fit(recorded, predicted)

    def figures(index: NDArray[np.int64]) -> dict[str, float]:
        mae = float(error[index].mean())
        return {"mae_scaled": mae, "mae_m_s2": mae * sd, "gfc": float(fit[index].mean())}

    return {**figures(np.arange(len(error))), "intervals": intervals(figures, len(error))}


def predict(texture: NativeTexture, samples: Array, n: NDArray[np.int64], part: PredictionPart = "model") -> Prediction:
    """Return what a texture expects of scaled samples (t, 3) at rows of consecutive indices n, shape (n_blocks, k)."""
    return predict_blocks(texture, stretches(samples, n, texture.info.window), part)


def excitation_scores(
    texture: NativeTexture, samples: Array, n: NDArray[np.int64], counted: NDArray[np.bool_]
) -> dict[str, Any]:
    """Return how well the excitation, its scale and its tails, describes the one-step error.

    Settling the level in the closed loop (`train.excitation`) trades likelihood for level. The error is that of the prediction
    which a rendering uses, with the network or without. It is not known where a rendering has tones (`dsp.tones`).

    Args:
        texture: with an excitation.
        samples: scaled, shape (t, 3).
        n: indices to score, whole rows of consecutive samples, shape (n_blocks, k).
        counted: which of them lie where the rendering does not fade, shape (n_blocks, k); elsewhere the recording is its
            sensors' noise.

    Returns:
        `nll`: mean negative log-likelihood [nat, scaled]; `coverage_50`, `coverage_90`: the share of samples inside the
        central 50 and 90 % of the predicted distribution; `standardised_sd`: of the errors, taken back through the tails to
        what should be a standard normal, 1 when the excitation is right; `intervals`.
    """
    unknown = dict.fromkeys(("nll", "coverage_50", "coverage_90", "standardised_sd"))
    predicted = predict(texture, samples, n, "rendering")
    if not predicted.scale.all():
        return {**unknown, "intervals": {}}
    standardised, nll = innovation_likelihood(samples[n, 0] - predicted.sample, predicted.scale, predicted.tail)

    def figures(index: NDArray[np.int64]) -> dict[str, Any]:
        some = counted[index]
        if not some.any():
            return unknown
        size = np.abs(standardised[index][some])
        return {
            "nll": float(nll[index][some].mean()),
            "coverage_50": float((size < _HALF).mean()),
            "coverage_90": float((size < _NINE_TENTHS).mean()),
            "standardised_sd": float(np.sqrt(np.square(size).mean())),
        }

    return {**figures(np.arange(len(n))), "intervals": intervals(figures, len(n))}
