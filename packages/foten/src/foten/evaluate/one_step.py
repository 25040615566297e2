"""One-step scores of a model, and of linear predictors that are fitted on the training blocks."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.ar import MAX_POLE, solved, stabilised
from foten.evaluate.metrics import goodness_of_fit, with_intervals
from foten.recording.windows import first_scored, stretches, targets
from foten.runtime.loops import Prediction, predict_blocks
from foten.runtime.native import NativeTexture, PredictionPart

ORDERS = (5, 10, 20, 40, 80, 160, 240)
N_PARTS = 4  # of the training blocks, whose sums are taken at once
_HALF, _NINE_TENTHS = 0.6744897501960817, 1.6448536269514722  # quantiles of a standard normal, |z| < …


def one_step(recorded: Array, predicted: Array, sd: float, linear: Array | None = None) -> dict[str, Any]:
    """One-step figures of a predictor: `mae_scaled`, `mae_m_s2`, `gfc` (Eq. 13 on raw bins, mean over blocks), `intervals`.

    Args:
        recorded, predicted: scaled acceleration, shape (n_blocks, k); the same samples for every method that is compared.
        sd: training standard deviation of the acceleration [m/s²].
        linear: what AR(20) predicts of the same samples, scaled; with it also `mae_to_ar`, the error over AR(20)'s.
    """
    error, fit = np.abs(recorded - predicted).mean(axis=1), goodness_of_fit(recorded, predicted)
    beside = np.zeros(len(error)) if linear is None else np.abs(recorded - linear).mean(axis=1)

    def figures(index: NDArray[np.int64]) -> dict[str, float]:
        mae = float(error[index].mean())
        ratio = {"mae_to_ar": mae / float(beside[index].mean())} if beside.all() else {}
        return {"mae_scaled": mae, "mae_m_s2": mae * sd, "gfc": float(fit[index].mean()), **ratio}

    return with_intervals(figures, len(error))


def predict(texture: NativeTexture, samples: Array, n: NDArray[np.int64], part: PredictionPart = "model") -> Prediction:
    """Predictions of a texture for scaled samples (t, 3) at rows of consecutive indices n, shape (n_blocks, k)."""
    return predict_blocks(texture, stretches(samples, n, texture.info.window), part)


def excitation_scores(
    texture: NativeTexture, samples: Array, n: NDArray[np.int64], counted: NDArray[np.bool_]
) -> dict[str, Any]:
    """Fit of the excitation's scale to the error of the prediction that a rendering uses, without the network of foten-plus.

    `nll`: mean negative log-likelihood [nat, scaled]; `coverage_50`, `coverage_90`: the share of samples inside the central 50
    and 90 % of the predicted distribution; `standardised_sd`: of the errors as standard normal numbers, 1 where the distribution
    is right; `intervals`. Unknown where a rendering has tones (`dsp.tones`).

    Args:
        samples, n: scaled, shape (t, 3), and the indices to score, rows of consecutive ones, shape (n_blocks, k).
        counted: which of them lie where the rendering does not fade, shape (n_blocks, k).
    """
    unknown = dict.fromkeys(("nll", "coverage_50", "coverage_90", "standardised_sd"))
    predicted = predict(texture, samples, n, "linear")
    if not predicted.scale.all():
        return {**unknown, "intervals": {}}
    standardised, nll = predicted.standardised, predicted.nll

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

    return with_intervals(figures, len(n))


@dataclass(frozen=True)
class Linear:
    """AR(p) with a constant, each coefficient optionally affine in speed and force; all scaled."""

    coefficients: Array  # shape (p + 1,) or, scheduled, (3, p + 1): global, times speed, times force
    noise_sd: float  # standard deviation of its error on the training blocks

    @property
    def window(self) -> int:
        return self.coefficients.shape[-1] - 1

    @property
    def scheduled(self) -> bool:
        return self.coefficients.ndim == 2

    def predict(self, samples: Array, n: NDArray[np.int64]) -> Array:
        """One-step predictions of scaled samples (t, 3) at rows of consecutive indices: (s, k) → (s, k)."""
        designs = (_design(row, self.window, self.scheduled) for row in stretches(samples, n, self.window))
        return np.stack([design @ self.coefficients.ravel() for design in designs])

    def stable(self) -> Linear:
        """An unscheduled predictor with its poles inside 0.9995, for a closed loop."""
        return Linear(np.append(stabilised(self.coefficients[:-1], MAX_POLE), self.coefficients[-1]), self.noise_sd)


def fit_linear(
    samples: Array, blocks: tuple[int, ...], block: int, order: int, scheduled: bool = False
) -> Linear | None:
    """AR(order) by least squares over blocks of scaled samples (n, 3); None with less than two windows a coefficient."""
    if not _is_determined(blocks, block, order, scheduled):
        return None
    return _solved(_sums(samples, blocks, block, order, scheduled), len(blocks) * (block - order), order, scheduled)


def _is_determined(blocks: tuple[int, ...], block: int, order: int, scheduled: bool) -> bool:
    n_coefficients = (order + 1) * (3 if scheduled else 1)
    return block > order and len(blocks) * (block - order) >= 2 * n_coefficients


def _sums(
    samples: Array,
    blocks: Sequence[int],
    block: int,
    order: int,
    scheduled: bool,
    first: int | None = None,
    last: int | None = None,
) -> Array:
    """Sums of the products of each two of p coefficients' terms and the target, which is last: (p + 1, p + 1).

    Of AR(order) over the targets of blocks from `first`, the order by default, to before `last`, the end by default.
    """
    n_coefficients = (order + 1) * (3 if scheduled else 1)
    first, last = order if first is None else first, block if last is None else last
    sums = np.zeros((n_coefficients + 1,) * 2)
    for number in blocks:
        rows = samples[number * block + first - order : number * block + last]
        design, target = _design(rows, order, scheduled), rows[order:, 0]
        moment = (design.T @ target)[:, None]
        sums += np.block([[design.T @ design, moment], [moment.T, target @ target]])
    return sums


def _solved(sums: Array, n: int, order: int, scheduled: bool) -> Linear:
    gram, moment = np.ascontiguousarray(sums[:-1, :-1]), sums[:-1, -1].copy()
    coefficients = solved(gram, moment)
    residual = float(sums[-1, -1] - 2 * coefficients @ moment + coefficients @ gram @ coefficients)
    shaped = coefficients.reshape(3, order + 1) if scheduled else coefficients
    return Linear(shaped, math.sqrt(max(0.0, residual) / n))


def _design(block: Array, order: int, scheduled: bool) -> Array:
    """History and a constant, then both times speed and force of the sample before, for a block (n, 3) from `order` on."""
    history = np.lib.stride_tricks.sliding_window_view(block[:-1, 0], order)
    design = np.column_stack([history, np.ones(len(history))])
    if not scheduled:
        return design
    condition = block[order - 1 : -1, 1:]
    return np.concatenate([design, design * condition[:, :1], design * condition[:, 1:]], axis=1)


def best_linear(samples: Array, train: tuple[int, ...], validation: tuple[int, ...], block: int) -> Linear | None:
    """AR of any of `ORDERS` up to `first_scored`, scheduled or not, with the lowest absolute error on the validation blocks."""
    first = first_scored(block)
    if not validation or block <= first:
        return None
    n = targets(validation, block, first).reshape(len(validation), -1)
    kinds = [
        (order, scheduled)
        for order, scheduled in product(ORDERS, (False, True))
        if order <= first and _is_determined(train, block, order, scheduled)
    ]
    if not kinds:
        return None
    longest = max(order for order, _ in kinds)

    def judged(kind: tuple[int, bool]) -> tuple[float, Linear]:
        order, scheduled = kind
        latest = np.arange(longest - order, longest + 1)
        columns = np.concatenate([*(latest + group * (longest + 1) for group in range(3 if scheduled else 1)), [-1]])
        sums = whole[np.ix_(columns, columns)]
        if order < longest:
            sums += _sums(samples, train, block, order, scheduled, order, longest)
        fitted = _solved(sums, len(train) * (block - order), order, scheduled)
        return float(np.abs(samples[n, 0] - fitted.predict(samples, n)).mean()), fitted

    # NumPy's products release the interpreter's lock; parts are the same on every machine, and so are their sums.
    with ThreadPoolExecutor(min(N_PARTS, os.cpu_count() or 1)) as pool:
        parts, any_scheduled = np.array_split(train, min(len(train), N_PARTS)), any(scheduled for _, scheduled in kinds)
        first_part, *others = pool.map(lambda part: _sums(samples, part, block, longest, any_scheduled), parts)
        whole = sum(others, start=first_part)
        return min(pool.map(judged, kinds), key=lambda judgement: judgement[0])[1]
