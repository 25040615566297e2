import numpy as np
import pytest

from foten.dsp.dft321 import dft321


def direct(axes: np.ndarray) -> np.ndarray:
    """DFT321 by its definition: sums over n and k, no fast transform."""
    n = axes.shape[1]
    turn = np.exp(-2j * np.pi * np.outer(np.arange(n), np.arange(n)) / n)
    spectra = [turn @ axis for axis in axes]
    magnitude = np.sqrt(sum(np.abs(spectrum) ** 2 for spectrum in spectra))
    phase = np.angle(sum(spectra))
    return np.real(turn.conj() @ (magnitude * np.exp(1j * phase))) / n


@pytest.mark.parametrize("n", [64, 63])
@pytest.mark.parametrize("n_axes", [2, 3])
def test_it_is_the_direct_sum(n: int, n_axes: int) -> None:
    """Oracle: the O(n²) definition."""
    axes = np.random.default_rng(n).standard_normal((n_axes, n))
    np.testing.assert_allclose(dft321(axes), direct(axes), atol=1e-11)  # 64² roundings of order one


@pytest.mark.parametrize("n", [2000, 1999, 5, 2, 1])
def test_the_energy_of_all_axes_is_kept(n: int) -> None:
    axes = np.random.default_rng(n).standard_normal((3, n))
    assert np.square(dft321(axes)).sum() == pytest.approx(np.square(axes).sum(), rel=1e-12)  # Parseval; rounding


def test_cancelling_axes_do_not_vanish() -> None:
    axis = np.random.default_rng(0).standard_normal(200)
    found = dft321(np.stack([axis, -axis, np.zeros(200)]))
    assert np.square(found).sum() == pytest.approx(2 * np.square(axis).sum(), rel=1e-12)
    # The phase is one axis's own: the signal itself, not rounding noise.
    assert np.abs(np.corrcoef(found, axis)[0, 1]) == pytest.approx(1.0, abs=1e-9)


def test_blocks_are_taken_one_by_one() -> None:
    blocks = np.random.default_rng(0).standard_normal((4, 3, 100))
    at_once = dft321(blocks)
    for block, found in zip(blocks, at_once, strict=True):
        np.testing.assert_array_equal(dft321(block), found)
