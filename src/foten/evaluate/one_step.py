"""One-step scores: predict each sample of the test blocks from recorded history."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.evaluate.bootstrap import intervals
from foten.evaluate.metrics import goodness_of_fit
from foten.recording.scaling import Scaling
from foten.recording.windows import windows
from foten.render.forecast import ExcitedEngine, Predictor, excitation_fit

Array = NDArray[np.float64]

_HALF, _NINE_TENTHS = 0.6744897501960817, 1.6448536269514722  # quantiles of a standard normal, |z| < …


def one_step(predictor: Predictor, samples: Array, n: NDArray[np.int64], scaling: Scaling) -> dict[str, Any]:
    """Return a predictor's one-step figures over the scored samples of some blocks.

    Args:
        predictor: windows (b, m, 3) → (b,).
        samples: scaled, shape (t, 3).
        n: indices to score, one row a block, shape (n_blocks, k); the same for every method that is compared.
        scaling: for errors in m/s².

    Returns:
        `mae_scaled`, `mae_m_s2`, `gfc` (Eq. 13 on raw bins, mean over blocks), `intervals`.
    """
    recorded, predicted = samples[n, 0], predict(predictor, samples, n)
    error = np.abs(recorded - predicted).mean(axis=1)
    fit = np.array([goodness_of_fit(a, b) for a, b in zip(recorded, predicted, strict=True)])

    def figures(index: NDArray[np.int64]) -> dict[str, float]:
        mae = float(error[index].mean())
        return {"mae_scaled": mae, "mae_m_s2": mae * scaling.sd[0], "gfc": float(fit[index].mean())}

    return {**figures(np.arange(len(n))), "intervals": intervals(figures, len(n))}


def predict(predictor: Predictor, samples: Array, n: NDArray[np.int64]) -> Array:
    """Return the predictions at the indices n, scaled: whole rows of consecutive samples, shape (n_blocks, k)."""
    if hasattr(predictor, "follow"):
        return predictor.follow(_with_history(predictor, samples, n)).sample
    flat = n.ravel()
    pieces = np.array_split(flat, flat.size // 2048 + 1)
    return np.concatenate(
        [predictor.predict(windows(samples, piece, predictor.window)) for piece in pieces]
    ).reshape(n.shape)


def _with_history(predictor: Predictor, samples: Array, n: NDArray[np.int64]) -> Array:
    """Return rows of samples and the window before each, shape (n_blocks, m + k, 3)."""
    return samples[n[:, :1] + np.arange(-predictor.window, n.shape[1])]


def excitation_scores(
    engine: ExcitedEngine, samples: Array, n: NDArray[np.int64], heard: NDArray[np.bool_]
) -> dict[str, Any]:
    """Return how well the excitation, its scale and its tails, describes the one-step error.

    Settling the level in the closed loop (`train.excitation`) trades likelihood for level. The error is that of the forecast
    which a rendering hears, with the network or without; none of it is known where the rendering knows its place on the
    surface (`dsp.tones`).

    Args:
        engine: of the model.
        samples: scaled, shape (t, 3).
        n: indices to score, whole rows of consecutive samples, shape (n_blocks, k).
        heard: which of them lie where the rendering does not fade, shape (n_blocks, k); the others do not count, since there
            σ is that of a texture falling silent and the recording is its sensors' noise.

    Returns:
        `nll`: mean negative log-likelihood [nat, scaled]; `coverage_50`, `coverage_90`: the share of samples inside the
        central 50 and 90 % of the predicted distribution; `standardised_sd`: of the errors, taken back through the tails to
        what should be a standard normal, 1 when the excitation is right; `intervals`.
    """
    forecast = engine.follow_heard(_with_history(engine, samples, n))
    if forecast.scale is None:
        return {**dict.fromkeys(("nll", "coverage_50", "coverage_90", "standardised_sd")), "intervals": {}}
    standardised, nll = excitation_fit(forecast, samples[n, 0])

    def figures(index: NDArray[np.int64]) -> dict[str, float | None]:
        counted = heard[index]
        if not counted.any():
            return dict.fromkeys(("nll", "coverage_50", "coverage_90", "standardised_sd"))
        size = np.abs(standardised[index][counted])
        return {
            "nll": float(nll[index][counted].mean()),
            "coverage_50": float((size < _HALF).mean()),
            "coverage_90": float((size < _NINE_TENTHS).mean()),
            "standardised_sd": float(np.sqrt(np.square(size).mean())),
        }

    return {**figures(np.arange(len(n))), "intervals": intervals(figures, len(n))}
