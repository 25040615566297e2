import numpy as np
import pytest

from foten.recording.trace import CHANNELS, Trace


def test_blocks_are_consecutive_and_share_memory() -> None:
    n = np.arange(12.0)
    trace = Trace(n, n + 100, n + 200, 1000.0, 4)
    assert (trace.n_blocks, len(trace)) == (3, 12)
    np.testing.assert_array_equal(trace.blocks(trace.speed)[1], [104, 105, 106, 107])
    assert np.shares_memory(trace.blocks(trace.speed), trace.speed)


def test_the_columns_are_those_of_eq_1() -> None:
    n = np.arange(4.0)
    stacked = Trace(n, n + 100, n + 200, 1000.0, 2).stacked()
    assert CHANNELS == ("acceleration", "speed", "force")
    np.testing.assert_array_equal(stacked[3], [3, 103, 203])


@pytest.mark.parametrize(("n", "block"), [(10, 4), (3, 4), (0, 4), (4, 0), (4, -2)])
def test_only_whole_blocks(n: int, block: int) -> None:
    with pytest.raises(ValueError, match=f"{n} samples are not whole blocks of {block}"):
        Trace(np.zeros(n), np.zeros(n), np.zeros(n), 1000.0, block)


def test_lengths_agree() -> None:
    with pytest.raises(ValueError, match="lengths differ: 4, 4, 5"):
        Trace(np.zeros(4), np.zeros(4), np.zeros(5), 1000.0, 2)
