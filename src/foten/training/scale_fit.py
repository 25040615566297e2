"""A standard deviation over speed and force, fitted by maximum likelihood: levels, and the scale of an excitation."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import minimize

from foten.dsp import Array
from foten.models.excitation import MAX_SIGMA, N_FEATURES, N_POWERS, Scale, powers
from foten.recording.scaling import Scaling

SHAPE_SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the fitted shape of log σ, that validation chooses from
FLOOR = (2.0, 0.05)  # mm/s and N, that a logarithm starts from
# Penalty of the squares of the network's weights, beside the likelihood [nat]: σ is smooth where a hand hardly went.
WEIGHT_PENALTY = 1e-4
MAX_ITERATIONS = 60


def fit_scale(width: int, condition: Array, residual: Array, n_train: int, scaling: Scaling, seed: int) -> Scale:
    """The scale of a vibration or of residuals over speed and force, by Gaussian maximum likelihood.

    The shape of log σ is fitted on the training samples; how much of it is taken, from none to all, is chosen by the likelihood
    of the validation samples: in a recording of two seconds the differences between blocks are mostly chance.

    Args:
        condition: speed and force that go with each residual, scaled, the training, then the validation samples, (n, 2).
        residual: of which the scale is, (n,).
        n_train: number of training samples.
    """
    squared = np.square(residual) + 1e-12
    start = _initial(width, scaling, float(0.5 * np.log(squared[:n_train].mean())), np.random.default_rng(seed))
    features = np.concatenate([condition, start.logarithms(condition)], axis=1)
    terms = powers(features[:, 2:])
    fitted = _minimised(start, features[:n_train], terms[:n_train], squared[:n_train])
    shape = np.log(fitted(condition)) - fitted.out_bias
    likelihoods = []
    for share in SHAPE_SHARES:
        # The factor that maximises the likelihood of a given shape, in closed form.
        factor = math.sqrt((squared[:n_train] * np.exp(-2 * share * shape[:n_train])).mean())
        nll = _likelihood(math.log(factor) + share * shape[n_train:], squared[n_train:])
        likelihoods.append((nll, share, math.log(factor)))
    _, share, log_factor = min(likelihoods)
    chosen = _with(fitted, out_weight=share * fitted.out_weight, exponents=share * fitted.exponents)
    chosen = _with(chosen, out_bias=np.array([log_factor])).bounded(condition[:n_train])
    return Scale.of(chosen.tensors(""), "")  # in float32, as the file has it


def constant_scale(width: int, scaling: Scaling) -> Scale:
    """σ = 1 at every speed and force; 1 is its largest too, and so part of the bound that is proven of a file."""
    parts = {"hidden_weight": np.zeros((width, N_FEATURES)), "hidden_bias": np.zeros(width)}
    return _with(_initial(width, scaling, 0.0, np.random.default_rng(0)), **parts, sigma_max=np.ones(1))


def _initial(width: int, scaling: Scaling, log_sigma: float, rng: np.random.Generator) -> Scale:
    bound = 1 / math.sqrt(N_FEATURES)
    return Scale(
        hidden_weight=rng.uniform(-bound, bound, (width, N_FEATURES)),
        hidden_bias=rng.uniform(-bound, bound, width),
        out_weight=np.zeros((1, width)),
        out_bias=np.array([log_sigma]),
        exponents=np.zeros(N_POWERS),
        sigma_max=np.array([MAX_SIGMA]),
        mean=np.array(scaling.mean[1:]),
        sd=np.array(scaling.sd[1:]),
        floor=np.array(FLOOR),
    )


def _with(scale: Scale, **parts: Array) -> Scale:
    return Scale(**{**vars(scale), **parts})


def _likelihood(log_sigma: Array, squared: Array) -> float:
    """Mean Gaussian negative log-likelihood [nat] of squared residuals, (n,) each."""
    return float((log_sigma + 0.5 * squared * np.exp(-2 * log_sigma)).mean() + 0.5 * math.log(2 * math.pi))


_FITTED = ("hidden_weight", "hidden_bias", "out_weight", "out_bias", "exponents")


def _minimised(start: Scale, features: Array, terms: Array, squared: Array) -> Scale:
    """The scale of the greatest likelihood, from features (n, 4), powers (n, 5) and squared residuals (n,)."""
    shapes = {name: getattr(start, name).shape for name in _FITTED}
    ends = np.cumsum([math.prod(shape) for shape in shapes.values()])

    def parts(x: Array) -> dict[str, Array]:
        pieces = np.split(x, ends[:-1])
        return {name: piece.reshape(shape) for (name, shape), piece in zip(shapes.items(), pieces, strict=True)}

    def loss(x: Array) -> tuple[float, Array]:
        w = parts(x)
        hidden = np.tanh(features @ w["hidden_weight"].T + w["hidden_bias"])
        log_sigma = hidden @ w["out_weight"][0] + w["out_bias"] + terms @ w["exponents"]
        by_sigma = (1 - squared * np.exp(-2 * log_sigma)) / len(squared)
        by_hidden = by_sigma[:, None] * w["out_weight"] * (1 - hidden * hidden)
        gradient = [
            by_hidden.T @ features + 2 * WEIGHT_PENALTY * w["hidden_weight"],
            by_hidden.sum(axis=0),
            by_sigma @ hidden + 2 * WEIGHT_PENALTY * w["out_weight"],
            by_sigma.sum(keepdims=True),
            by_sigma @ terms,
        ]
        rough = WEIGHT_PENALTY * (np.square(w["hidden_weight"]).sum() + np.square(w["out_weight"]).sum())
        return _likelihood(log_sigma, squared) + float(rough), np.concatenate([part.ravel() for part in gradient])

    x = np.concatenate([getattr(start, name).ravel() for name in _FITTED])
    options = {"maxiter": MAX_ITERATIONS, "maxcor": 20, "ftol": 1e-10}
    return _with(start, **parts(minimize(loss, x, jac=True, method="L-BFGS-B", options=options).x))
