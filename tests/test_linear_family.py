import dataclasses

import numpy as np
import pytest
from scipy.signal import butter, freqz, lfilter

from foten.simulation.linear_family import LINEAR_FAMILY, LinearParameters, linear_truth, one_step_bounds
from foten.simulation.simulate import simulate

KEYS = list(LINEAR_FAMILY)
HIGHPASS = butter(2, 20, "high", fs=1000)
ONE = (np.array([100.0]), np.array([1.0]))  # the reference speed [mm/s] and force [N]


def lagged_covariance(x: np.ndarray, window: int) -> np.ndarray:
    """Means of x[n-i] x[n-j] for i, j = 0 … window, shape (window + 1, window + 1)."""
    lags = np.lib.stride_tricks.sliding_window_view(x, window + 1)[:, ::-1]
    return np.asarray(lags.T @ lags) / len(lags)


def least_squares(x: np.ndarray, window: int) -> tuple[np.ndarray, float]:
    """AR coefficients fitted by least squares and the rms of what is left."""
    covariance = lagged_covariance(x, window)
    a = np.linalg.solve(covariance[1:, 1:], covariance[1:, 0])
    return a, float(np.sqrt(covariance[0, 0] - a @ covariance[1:, 0]))


@pytest.mark.parametrize("key", KEYS)
def test_least_squares_finds_the_truth(key: str) -> None:
    recording = simulate(key, 200, seed=5)
    truth = linear_truth(recording)
    y = recording["acceleration"].samples
    sigma = truth.sigma(recording["speed"].samples, recording["force"].samples)
    p = len(truth.coefficients)
    past = np.stack([y[p - i : y.size - i] for i in range(1, p + 1)], axis=1)
    weighted = past / sigma[p:, None]
    fitted, *_ = np.linalg.lstsq(weighted, y[p:] / sigma[p:], rcond=None)
    error = np.sqrt(np.linalg.inv(weighted.T @ weighted).diagonal())  # standard error for a unit innovation
    assert np.abs((fitted - truth.coefficients) / error).max() < 4
    innovation = (y[p:] - past @ truth.coefficients) / sigma[p:]
    assert innovation.std() == pytest.approx(1, abs=4 / np.sqrt(2 * y.size))
    assert np.mean(innovation**4) == pytest.approx(3, abs=4 * np.sqrt(96 / y.size))
    assert abs(np.corrcoef(innovation[1:], innovation[:-1])[0, 1]) < 4 / np.sqrt(y.size)


def test_the_members_differ_and_sigma_follows_the_stroke() -> None:
    spectra = []
    for parameters in LINEAR_FAMILY.values():
        _, response = freqz([1], [1, *(-a for a in parameters.coefficients)], worN=512)
        level = 20 * np.log10(np.abs(response))
        spectra.append(level - level.mean())
        sigma = parameters.sigma(np.array([20.0, 300.0]), np.array([0.3, 3.0]))
        assert 20 * np.log10(sigma[1] / sigma[0]) > 6
        assert parameters.sigma(np.zeros(1), np.ones(1)) < 0.05 * parameters.level
    for one in range(3):
        for other in range(one):
            assert np.sqrt(np.mean((spectra[one] - spectra[other]) ** 2)) > 6  # dB


@pytest.mark.parametrize("key", KEYS)
def test_the_window_bound_is_what_a_million_samples_give(key: str) -> None:
    truth = linear_truth(simulate(key, 1))
    noise = np.random.default_rng(7).standard_normal(1_000_000)
    x = lfilter(HIGHPASS[0], np.convolve(HIGHPASS[1], truth.denominator), noise)
    unit = np.sqrt(2 / np.pi) * truth.sigma(*ONE) * noise.std()  # measured innovation, 0.1 % from 1
    for window in (5, 20):
        bound = one_step_bounds(truth, *ONE, *HIGHPASS, window)[1] / unit
        assert bound == pytest.approx(least_squares(x, window)[1], rel=0.002)


def test_the_infinite_past_knows_all_but_the_innovation() -> None:
    """The filters run backwards: what x[n] has beyond its past is b₀ σ e[n], with σ as it varies."""
    recording = simulate("linear-twin", 64)
    truth = linear_truth(recording)
    y, speed, force = (recording[name].samples for name in ("acceleration", "speed", "force"))
    b, a = HIGHPASS
    x = lfilter(b, a, y)
    innovation = lfilter(np.convolve(a, truth.denominator), b, x)  # zeros on the circle: no forgetting
    infinite, window = one_step_bounds(truth, speed, force, b, a, 20)
    settled = slice(2000, None)
    assert np.mean(np.abs(b[0] * innovation[settled])) == pytest.approx(np.mean(infinite[settled]), rel=0.02)
    # The best predictor of 20 samples of the stationary process, on the stroke as it is: a varying σ costs it
    # next to nothing, which is what the bound assumes.
    noise = np.random.default_rng(1).standard_normal(500_000)
    stationary = lfilter(b, np.convolve(a, truth.denominator), noise)
    predictor, _ = least_squares(stationary, 20)
    error = lfilter([1, *-predictor], [1], x)
    assert np.mean(np.abs(error[settled])) == pytest.approx(np.mean(window[settled]), rel=0.02)


def test_a_longer_window_approaches_the_infinite_past_slowly() -> None:
    truth = linear_truth(simulate("linear-cloth", 1))
    infinite = one_step_bounds(truth, *ONE, *HIGHPASS, 20)[0]
    errors = [one_step_bounds(truth, *ONE, *HIGHPASS, window)[1] for window in (10, 20, 100, 400, 2000)]
    assert np.all(np.diff(np.array(errors), axis=0) < 0)
    # Each zero at z = 1 adds about 1/m to s_m²; the two together, which repel, 4/m, so 2/m to s_m.
    excess = np.array(errors) / infinite - 1
    assert excess[3] == pytest.approx(2 / 400, rel=0.1)
    assert excess[4] == pytest.approx(2 / 2000, rel=0.1)


def test_no_filter_leaves_the_autoregression() -> None:
    truth = linear_truth(simulate("linear-cloth", 1))
    one = np.array([1.0])
    infinite, window = one_step_bounds(truth, *ONE, one, one, 8)
    np.testing.assert_allclose(infinite, np.sqrt(2 / np.pi) * truth.sigma(*ONE))
    np.testing.assert_allclose(window, infinite, rtol=1e-9)


def test_what_has_no_truth_is_refused() -> None:
    with pytest.raises(ValueError, match="the texture 'jeans'"):
        linear_truth(simulate("jeans", 1))
    with pytest.raises(ValueError, match="no simulator"):
        linear_truth(dataclasses.replace(simulate("linear-hum", 1), simulation=None))
    truth = linear_truth(simulate("linear-hum", 1))
    with pytest.raises(ValueError, match="outside the unit circle"):
        one_step_bounds(truth, *ONE, np.array([1.0, -2.0]), np.array([1.0]), 20)
    with pytest.raises(ValueError, match="largest pole"):
        LinearParameters("unstable", (1.01,), 1.0)
