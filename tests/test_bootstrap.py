from typing import Any

import numpy as np
import pytest

from foten.evaluate.metrics import intervals


def mean_of(values: np.ndarray) -> Any:
    return lambda index: {"mean": float(values[index].mean())}


def test_the_interval_of_a_mean_is_the_textbooks() -> None:
    """Oracle: mean ± 1.96 sd/√n."""
    values = np.random.default_rng(0).standard_normal(60)
    ends = np.mean([intervals(mean_of(values), 60, seed)["mean"] for seed in range(20)], axis=0)
    half = 1.96 * values.std() / np.sqrt(60)
    # A 2.5 % quantile of 400 draws scatters by √(0.025·0.975/400)/φ(1.96) = 0.13 standard errors, 7 % of 1.96;
    # over 20 seeds by 1.5 %, and four of that.
    np.testing.assert_allclose(ends, values.mean() + half * np.array([-1, 1]), atol=0.06 * half)


def test_it_covers_the_truth_about_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    covered = 0
    for seed in range(100):
        low, high = intervals(mean_of(rng.standard_normal(30)), 30, seed)["mean"]
        covered += low <= 0 <= high
    assert 86 <= covered <= 99  # 93 or so for 30 blocks, and 2.5 standard deviations of a count


def test_blocks_that_agree_leave_no_doubt() -> None:
    assert intervals(mean_of(np.full(9, 2.5)), 9) == {"mean": [2.5, 2.5]}


def test_a_seed_is_an_interval() -> None:
    values = np.random.default_rng(0).standard_normal(20)
    drawn = [intervals(mean_of(values), 20, seed) for seed in (0, 0, 1)]
    assert drawn[0] == drawn[1] != drawn[2]


def test_every_block_is_drawn_and_the_count_stays() -> None:
    seen: set[int] = set()

    def figures(index: np.ndarray) -> dict[str, Any]:
        assert index.shape == (7,)
        seen.update(index.tolist())
        return {}

    assert intervals(figures, 7) == {}
    assert seen == set(range(7))


@pytest.mark.parametrize("n_blocks", [0, 1])
def test_one_block_has_no_interval(n_blocks: int) -> None:
    assert intervals(mean_of(np.ones(1)), n_blocks) == {}


def test_what_is_no_figure_is_left_out() -> None:
    def figures(index: np.ndarray) -> dict[str, Any]:
        return {"unknown": None, "share": float(index.mean())}

    assert set(intervals(figures, 5)) == {"share"}


def test_draws_without_a_value_do_not_count() -> None:
    def figures(index: np.ndarray) -> dict[str, Any]:
        return {"sometimes": None if (index == 0).sum() > 1 else 4.0}

    assert intervals(figures, 6) == {"sometimes": [4.0, 4.0]}
