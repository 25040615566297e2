"""One-step scores: predict each sample of the test blocks from recorded history."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from foten.dsp.noise import innovation_likelihood
from foten.evaluate.bootstrap import intervals
from foten.evaluate.metrics import goodness_of_fit
from foten.recording.scaling import Scaling
from foten.recording.windows import windows
from foten.runtime.loops import Prediction, predict_blocks
from foten.runtime.native import NativeTexture, PredictionPart

Array = NDArray[np.float64]

_HALF, _NINE_TENTHS = 0.6744897501960817, 1.6448536269514722  # quantiles of a standard normal, |z| < …


class Predictor(Protocol):
    """Windows in, next samples out; stateless."""

    @property
    def window(self) -> int:
        """Return m, the samples in a window."""
        ...

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        ...


@dataclass(frozen=True)
class TexturePredictor:
    """A texture, or a part of it, one step ahead in the kernel."""

    texture: NativeTexture
    part: PredictionPart = "model"

    @property
    def window(self) -> int:
        """Return the samples before the first prediction."""
        return self.texture.info.window

    def predict_blocks(self, blocks: Array) -> Prediction:
        """Return predictions of recorded blocks, scaled (s, n, 3), from sample `window` on: (s, n − window)."""
        return predict_blocks(self.texture, blocks, self.part)


def one_step(
    predictor: Predictor | TexturePredictor, samples: Array, n: NDArray[np.int64], scaling: Scaling
) -> dict[str, Any]:
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


def predict(predictor: Predictor | TexturePredictor, samples: Array, n: NDArray[np.int64]) -> Array:
    """Return the predictions at the indices n, scaled: whole rows of consecutive samples, shape (n_blocks, k)."""
    if isinstance(predictor, TexturePredictor):
        return predictor.predict_blocks(_with_history(predictor.window, samples, n)).sample
    flat = n.ravel()
    pieces = np.array_split(flat, flat.size // 2048 + 1)
    return np.concatenate([predictor.predict(windows(samples, piece, predictor.window)) for piece in pieces]).reshape(
        n.shape
    )


def _with_history(window: int, samples: Array, n: NDArray[np.int64]) -> Array:
    """Return rows of samples and the window before each, shape (n_blocks, m + k, 3)."""
    return samples[n[:, :1] + np.arange(-window, n.shape[1])]


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
    predicted = predict_blocks(texture, _with_history(texture.info.window, samples, n), "rendering")
    if not predicted.scale.all():
        return {**dict.fromkeys(("nll", "coverage_50", "coverage_90", "standardised_sd")), "intervals": {}}
    missed = samples[n, 0] - predicted.sample
    standardised, nll = innovation_likelihood(missed, predicted.scale, predicted.tail)

    def figures(index: NDArray[np.int64]) -> dict[str, float | None]:
        some = counted[index]
        if not some.any():
            return dict.fromkeys(("nll", "coverage_50", "coverage_90", "standardised_sd"))
        size = np.abs(standardised[index][some])
        return {
            "nll": float(nll[index][some].mean()),
            "coverage_50": float((size < _HALF).mean()),
            "coverage_90": float((size < _NINE_TENTHS).mean()),
            "standardised_sd": float(np.sqrt(np.square(size).mean())),
        }

    return {**figures(np.arange(len(n))), "intervals": intervals(figures, len(n))}
