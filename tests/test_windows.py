import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from foten.recording.windows import targets, window_indices, windows


@given(
    blocks=st.lists(st.integers(0, 5), min_size=1, max_size=4, unique=True),
    m=st.integers(1, 7),
    extra=st.integers(0, 3),
)
@settings(max_examples=30, deadline=None)
def test_windows_are_eq_1(blocks: list[int], m: int, extra: int) -> None:
    """Oracle: Eq. 1 as loops."""
    block = 12
    samples = np.random.default_rng(m).standard_normal((6 * block, 3))
    expected, answers = [], []
    for b in blocks:
        for n in range(b * block + m + extra, (b + 1) * block):
            expected.append([[samples[n - m + i, channel] for channel in range(3)] for i in range(m)])
            answers.append(samples[n, 0])
    n = targets(tuple(blocks), block, m + extra)
    np.testing.assert_array_equal(windows(samples, n, m), np.array(expected).reshape(-1, m, 3))
    np.testing.assert_array_equal(samples[n, 0], answers)


@pytest.mark.parametrize("m", [1, 5, 20])
def test_no_window_straddles_blocks(m: int) -> None:
    block = 25
    n = targets((0, 3, 4), block, m)
    of_target = n // block
    assert set(of_target.tolist()) == {0, 3, 4}
    assert np.all(window_indices(n, m) // block == of_target[:, None])
    assert n.size == 3 * (block - m)  # and none that does not is left out


def test_the_answer_is_not_in_the_question() -> None:
    n = targets((0, 1), 30, 20)
    assert np.all(window_indices(n, 20) < n[:, None])
    np.testing.assert_array_equal(window_indices(n, 20)[:, -1], n - 1)


def test_a_block_of_no_more_than_the_history_gives_nothing() -> None:
    assert targets((0, 1), 20, 20).size == 0
    assert windows(np.zeros((40, 3)), targets((0, 1), 20, 20), 20).shape == (0, 20, 3)
