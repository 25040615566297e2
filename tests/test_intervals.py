"""Intervals over blocks: `metrics.intervals`."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from foten.evaluate.metrics import intervals

Draw = Callable[[np.random.Generator, int], np.ndarray]


def mean_of(values: np.ndarray) -> Any:
    return lambda index: {"mean": float(values[index].mean())}


def test_the_interval_of_a_mean_is_students() -> None:
    """Oracle: SciPy's t-test."""
    values = np.random.default_rng(0).standard_normal(7)
    expected = ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert intervals(mean_of(values), 7)["mean"] == pytest.approx([expected.low, expected.high], rel=1e-12)


@pytest.mark.parametrize("n_blocks", [4, 6, 11])
@pytest.mark.parametrize(
    ("draw", "mean", "least"),
    [
        (lambda rng, n: rng.standard_normal(n), 0.0, 0.94),
        # Distances of spectra, mean errors of a block: skewed by a long tail. Sample means of so few cover less whatever is done.
        (lambda rng, n: rng.gamma(4.0, 0.25, n), 1.0, 0.92),
    ],
    ids=["normal", "skewed"],
)
def test_it_covers_the_truth_as_often_as_it_says(draw: Draw, mean: float, least: float, n_blocks: int) -> None:
    rng, n_draws = np.random.default_rng(n_blocks), 4000
    covered = 0
    for _ in range(n_draws):
        low, high = intervals(mean_of(draw(rng, n_blocks)), n_blocks)["mean"]
        covered += low <= mean <= high
    assert least <= covered / n_draws <= 0.96  # a share of 4000 is known to 0.0034


def test_the_interval_of_a_ratio_of_pooled_blocks_covers_it() -> None:
    rng, n_draws, covered = np.random.default_rng(0), 2000, 0
    for _ in range(n_draws):
        above, below = rng.gamma(8.0, 1.0, 6), rng.gamma(8.0, 2.0, 6)

        def ratio(index: np.ndarray, above: np.ndarray = above, below: np.ndarray = below) -> dict[str, float]:
            return {"db": float(10 * np.log10(above[index].sum() / below[index].sum()))}

        low, high = intervals(ratio, 6)["db"]
        covered += low <= 10 * np.log10(0.5) <= high
    assert 0.935 <= covered / n_draws <= 0.965  # known to 0.005


def test_blocks_that_agree_leave_no_doubt() -> None:
    assert intervals(mean_of(np.full(9, 2.5)), 9) == {"mean": [2.5, 2.5]}


def test_each_block_is_left_out_once() -> None:
    seen: list[list[int]] = []

    def figures(index: np.ndarray) -> dict[str, Any]:
        seen.append(index.tolist())
        return {}

    assert intervals(figures, 5) == {}
    assert seen == [list(range(5)), *([k for k in range(5) if k != i] for i in range(5))]


@pytest.mark.parametrize("n_blocks", [0, 1, 3])
def test_few_blocks_have_no_interval(n_blocks: int) -> None:
    assert intervals(mean_of(np.ones(n_blocks)), n_blocks) == {}


def test_what_is_no_figure_has_none_and_each_of_a_list_has_its_own() -> None:
    def figures(index: np.ndarray) -> dict[str, Any]:
        return {"unknown": None, "bands": (float(index.mean()), None, 4.0), "sometimes": 1.0 if 2 in index else None}

    found = intervals(figures, 5)
    assert set(found) == {"bands"}
    (low, high), unknown, constant = found["bands"]
    assert low < 2.0 < high
    assert (unknown, constant) == (None, [4.0, 4.0])
