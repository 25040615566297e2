"""Fit of the equaliser: free runs as strong as the recording in every band, however speed moves."""

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.equaliser import N_TERMS, Equaliser, in_bands
from foten.dsp.level import BAND_FRAME_MS, ENERGY_FLOOR, N_BANDS, band_energies, framed
from foten.models.excitation import Excitation
from foten.training.calibration import ClosedLoop

STREAM = 3 * 2**32  # of the noise: other than what it is calibrated or judged by
N_RUNS = 6  # free runs of a block
N_STEPS = 3  # of the gains: neighbouring bands overlap
N_FOLDS = 8  # of blocks, by which the penalty is chosen
MIN_BLOCKS = 8
PENALTIES = (30.0, 100.0, 300.0, 1e3, 3e3, 1e4, 3e4, 1e5)  # of squared weights, in frames, tried


def fit_equaliser(loop: ClosedLoop, excitation: Excitation, seed: int) -> Equaliser | None:
    """The equaliser after which free runs have the recording's band levels; None where it is not borne out, or blocks are few.

    Free runs of the training and validation blocks are compared with the recording: by how much their log energies in bands and
    frames (`dsp.level`) are too low on the mean of runs is regressed on the terms of speed and force, with a penalty of squared
    weights. It is the one that predicts blocks best that were left out, the same for all bands; of no equaliser too. The gains
    are found in `N_STEPS`, each with the last one's in effect.
    """
    trace, known, skipped = loop.blocks.trace, loop.blocks.known, loop.first_scored - loop.history
    frame = round(BAND_FRAME_MS * trace.rate_hz / 1000)
    if len(known) < MIN_BLOCKS or trace.block - loop.first_scored < 2 * frame:
        return None
    first = -(-skipped // frame)  # frame that counts
    runs = loop.heard_runs(excitation, known, seed, STREAM, N_RUNS)
    recorded = loop.blocks.samples[list(known), loop.history :, 0]
    phi = loop.terms(known)
    # Shapes are (…, k, n_frames) from here on, and bands come first.
    terms = framed(phi, BAND_FRAME_MS, trace.rate_hz).mean(axis=-1)[..., first:]
    moving = framed(loop.blocks.moving()[list(known), loop.history :], BAND_FRAME_MS, trace.rate_hz)
    counted = np.asarray(moving.all(axis=-1))[:, first:]
    if not counted.any():
        return None

    def energies(signals: Array) -> Array:
        return np.moveaxis(band_energies(signals, trace.rate_hz), -2, 0)[..., first:]

    of_recording = energies(recorded)
    floor = ENERGY_FLOOR * of_recording.mean(axis=(1, 2), keepdims=True)
    truth = 0.5 * np.log(of_recording + floor)
    equaliser = Equaliser.of_weights(np.zeros((N_BANDS, N_TERMS)), trace.rate_hz)
    bands = in_bands(runs, equaliser.filters)
    penalty: float | None = None
    for _ in range(N_STEPS):
        levels = 0.5 * np.log(energies(equaliser.mixed(runs, bands, phi)) + floor[:, None])
        wanted = truth - levels.mean(axis=1) + equaliser.log_gains(terms)
        if penalty is None:
            penalty = best_penalty(terms, wanted, counted)
            if penalty is None:
                return None
        weights = regression(terms[:, counted], wanted[:, counted], penalty)
        equaliser = Equaliser.of_weights(weights, trace.rate_hz)
    return equaliser


def best_penalty(terms: Array, wanted: Array, counted: NDArray[np.bool_]) -> float | None:
    """The penalty with which blocks that are left out are predicted best; None where no gain at all predicts them better.

    Terms (p, k, f) of k blocks, gains that are wanted (N_BANDS, k, f), and the frames that count (k, f).
    """
    unit = np.square(wanted[:, counted]).mean(axis=1, keepdims=True)
    errors = np.zeros(len(PENALTIES) + 1)
    fold = np.arange(len(counted)) % N_FOLDS
    for k in range(N_FOLDS):
        learned, left_out = counted & (fold != k)[:, None], counted & (fold == k)[:, None]
        x, y = terms[:, left_out], wanted[:, left_out]
        for i, penalty in enumerate(PENALTIES):
            weights = regression(terms[:, learned], wanted[:, learned], penalty)
            errors[i] += (np.square(y - weights @ x) / unit).sum()
        errors[-1] += (np.square(y) / unit).sum()
    best = int(np.argmin(errors))
    return PENALTIES[best] if best < len(PENALTIES) else None


def regression(terms: Array, wanted: Array, penalty: float) -> Array:
    """Weights (b, p) of a ridge regression of (b, n) on terms (p, n), whose penalty is in frames of terms of unit mean square."""
    size = np.sqrt(np.square(terms).mean(axis=1, keepdims=True)) + 1e-12
    unit = terms / size
    return np.asarray(np.linalg.solve(unit @ unit.T + penalty * np.eye(len(unit)), unit @ wanted.T).T / size.T)
