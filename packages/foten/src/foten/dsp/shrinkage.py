"""Estimators that shrink: what little data say is taken as far as it is beyond chance."""

import numpy as np

from foten.dsp import Array

PRIOR_SDS = (0.0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6)  # tried in `empirical_bayes`, in units of the error
NEIGHBOURS = 10  # coefficients on each side from which `wiener_gain` estimates a variance
CHI_SQUARED_MEDIAN = 0.455  # of one degree of freedom
N_REGRESSIONS = 3  # in `regression_with_prior`, whose noise is what the slopes before leave


def james_stein(value: float, standard_error: float) -> float:
    """A value less the share of it that chance explains, 0 where that is all: the positive part of James & Stein (1961)."""
    return value * max(0.0, 1 - (standard_error / value) ** 2) if value else 0.0


def wiener_gain(value: Array, noise: Array) -> Array:
    """Factors of values (n,) in order: Wiener's τ²/(τ² + v), v the mean variance of a value and its neighbours, (n,).

    τ² is the excess of their squares over v. The first values, which are no chance, are taken whole.
    """
    gain = np.ones(len(value))
    for i in range(NEIGHBOURS, len(value)):
        near = slice(i - NEIGHBOURS, i + NEIGHBOURS + 1)
        variance = noise[near].mean()
        if variance > 0:
            # The median of squares, since one strong value says nothing of its neighbours.
            signal = max(0.0, np.median(np.square(value[near])) / CHI_SQUARED_MEDIAN - variance)
            gain[i] = signal / (signal + variance)
    return gain


def empirical_bayes(error: Array, slopes: Array) -> Array:
    """Posterior mean of the coefficients of a regression of errors (k, n) on slopes (k, n, p) over k blocks; (p,).

    Errors of near samples depend on each other: the noise of the coefficients is the sandwich estimate over blocks. All but the
    first have a normal prior about zero, of a common standard deviation in units of what they do to an error, which maximises
    the evidence: where blocks differ as much as the coefficients say, they are zero.
    """
    k, _, p = slopes.shape
    gram = np.einsum("bni,bnj->ij", slopes, slopes)
    inverse = np.linalg.pinv(gram)
    fitted = inverse @ np.einsum("bni,bn->i", slopes, error)
    scores = np.einsum("bni,bn->bi", slopes, error - slopes @ fitted)
    noise = inverse @ (scores.T @ scores) @ inverse * k / max(1, k - p)
    unit = np.diag(1 / np.maximum(np.square(slopes).mean(axis=(0, 1))[1:], 1e-12))
    coefficients, noise = fitted[1:], noise[1:, 1:] + 1e-9 * unit

    def evidence(sd: float) -> float:
        covariance = noise + sd**2 * unit
        return -float(np.linalg.slogdet(covariance)[1] + coefficients @ np.linalg.solve(covariance, coefficients))

    sd = max(PRIOR_SDS, key=evidence)
    shrunk = sd**2 * unit @ np.linalg.solve(noise + sd**2 * unit, coefficients)
    # The first goes with the others as the regression has it.
    return np.concatenate([[fitted[0] - gram[0, 1:] @ (shrunk - coefficients) / max(gram[0, 0], 1e-12)], shrunk])


def regression_with_prior(x: Array, y: Array, prior: Array) -> Array:
    """Posterior mean of slopes: x (n, k), y (n,), prior means and standard deviations (k, 2) → (k,).

    Near samples depend on each other: as many count as the correlation of the residuals leaves.
    """
    x, y = x - x.mean(axis=0), y - y.mean()
    precision = np.diag(1 / np.square(prior[:, 1]))
    slopes: Array = prior[:, 0]
    for _ in range(N_REGRESSIONS):
        residual = y - x @ slopes
        correlation = float(np.clip(residual[1:] @ residual[:-1] / max(float(residual @ residual), 1e-12), 0.0, 0.95))
        noise = float(np.square(residual).mean()) * (1 + correlation) / (1 - correlation) + 1e-12
        moment = x.T @ y / noise + precision @ prior[:, 0]
        slopes = np.asarray(np.linalg.solve(x.T @ x / noise + precision, moment), dtype=np.float64)
    return slopes
