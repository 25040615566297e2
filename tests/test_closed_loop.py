from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from foten.runtime.closed_loop import ClosedLoop
from foten.runtime.window_state import WindowState
from scipy.signal import lfilter

from conftest import resonance


@dataclass
class Taps:
    """A linear predictor that remembers what it was shown."""

    taps: np.ndarray
    seen: list[np.ndarray] = field(default_factory=list)

    @property
    def window(self) -> int:
        return self.taps.size

    def predict(self, windows: np.ndarray) -> np.ndarray:
        self.seen.append(windows.copy())
        return windows[:, :, 0] @ self.taps


M = 4
TAPS = resonance(120.0, 0.95, M)


def test_with_noise_it_is_the_ar_filter() -> None:
    """Oracle: scipy.signal.lfilter."""
    noise = np.random.default_rng(0).standard_normal((3, 500))
    loop = ClosedLoop(WindowState(Taps(TAPS), np.zeros((3, M, 3)), lambda c: np.full(len(c), 0.7)))
    found = loop.run(np.zeros((3, 500, 2)), noise)
    expected = lfilter([0.7], np.concatenate([[1.0], -TAPS[::-1]]), noise)
    np.testing.assert_allclose(found, expected, atol=1e-10)  # rounding, amplified by 1/(1 − 0.95)


def test_without_noise_the_first_window_rings_out() -> None:
    window = np.zeros((1, M, 3))
    window[0, -1, 0] = 1.0
    found = ClosedLoop(WindowState(Taps(TAPS), window)).run(np.zeros((1, 400, 2)), None)[0]
    impulse = lfilter([1.0], np.concatenate([[1.0], -TAPS[::-1]]), np.eye(1, 401)[0])
    np.testing.assert_allclose(found, impulse[1:], atol=1e-12)  # the first sample stands in the window


def test_a_prediction_hears_speed_and_force_up_to_the_sample_before() -> None:
    """Eq. 1: the window for n ends at n − 1, for speed and force too."""
    predictor = Taps(np.zeros(M))
    condition = np.arange(1.0, 13).reshape(1, 6, 2)
    heard: list[np.ndarray] = []

    def sigma(last: np.ndarray) -> np.ndarray:
        heard.append(last.copy())
        return last[:, 0]

    found = ClosedLoop(WindowState(predictor, np.zeros((1, M, 3)), sigma)).run(condition, np.ones((1, 6)))[0]
    for n, window in enumerate(predictor.seen):
        past = np.concatenate([np.zeros((M, 2)), condition[0]])[n : n + M]
        np.testing.assert_array_equal(window[0, :, 1:], past)
        np.testing.assert_array_equal(heard[n][0], past[-1])
    np.testing.assert_array_equal(found, [0, 1, 3, 5, 7, 9])  # σ of the condition before each sample


def test_its_own_output_is_its_history() -> None:
    predictor = Taps(np.zeros(M))
    found = ClosedLoop(WindowState(predictor, np.zeros((1, M, 3)), lambda c: np.ones(1))).run(
        np.zeros((1, 10, 2)), np.arange(1.0, 11)[None]
    )
    np.testing.assert_array_equal(predictor.seen[-1][0, :, 0], found[0, -1 - M : -1])


def test_the_saturator_cuts_counts_and_feeds_back_what_it_cut() -> None:
    growing = Taps(np.array([0.0, 2.0]))
    start = np.zeros((2, 2, 3))
    start[0, -1, 0], start[1, -1, 0] = 1.0, -1.0
    loop = ClosedLoop(WindowState(growing, start), limit=5.0)
    found = loop.run(np.zeros((2, 4, 2)), None)
    np.testing.assert_array_equal(
        found, [[2, 4, 5, 5], [-2, -4, -5, -5]]
    )  # 8 and 10 are cut, 5 doubles again
    assert loop.n_saturated == 4


def test_a_bounded_state_hears_what_it_played_before_the_cut() -> None:
    class Half(WindowState):
        bounded: ClassVar[bool] = True

    start = np.zeros((1, 2, 3))
    start[0, -1, 0] = 40.0
    loop = ClosedLoop(Half(Taps(np.array([0.0, 0.5])), start), limit=6.0)
    np.testing.assert_array_equal(loop.run(np.zeros((1, 4, 2)), None), [[6, 6, 5, 2.5]])
    assert loop.n_saturated == 2


def test_noise_without_a_scale_and_a_scale_without_noise_are_the_deterministic_loop() -> None:
    start = np.random.default_rng(0).standard_normal((1, M, 3))
    noise = np.ones((1, 20))

    def run(sigma: object, noise: np.ndarray | None) -> np.ndarray:
        state = WindowState(Taps(TAPS), start.copy(), sigma)  # type: ignore[arg-type]
        return ClosedLoop(state).run(np.zeros((1, 20, 2)), noise)

    np.testing.assert_array_equal(run(None, noise), run(None, None))
    np.testing.assert_array_equal(run(lambda c: np.ones(1), None), run(None, None))
    assert not np.array_equal(run(lambda c: np.ones(1), noise), run(None, None))
