"""What a free run on the real four can reach at all: log-spectral distances of plain signals, and of some that cheat.

    python benchmarks/limits.py [--recordings DIR] [--rate 10000] [--save FILE]
    python benchmarks/limits.py --orders [--recordings DIR] [--rate 10000]

All on the test blocks of five splits, scored as the judge does (`free_run`): AR(20) with white noise, the anchor; Gaussian
noise with the mean spectrum of all training and validation blocks; the same, smoothed over five bins (98 Hz at 10 kHz); as loud
as speed and force predict, by least squares of the known blocks' levels on their logarithms; with the mean of their log spectra,
which this figure favours; the other blocks themselves, which are the real texture; and three that cheat: the noise as loud as
each test block, noise with the mean spectrum of the test blocks, and with each test block's own.

With --orders instead: the one-step error on the test blocks of linear predictors by least squares, longer than the longest of
the judge too, over that of its longest.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import ndimage, signal

from foten.atomic_write import atomic_write
from foten.dsp.distance import log_spectral_distance, scored_bins, segment_length, welch
from foten.evaluate.free_run import scored, synthesize_linear
from foten.evaluate.one_step import FIRST_SCORED, ORDERS, first_scored, fit_linear
from foten.recording.preprocess import preprocess
from foten.recording.scaling import fit_scaling
from foten.recording.split import split_blocks
from foten.recording.windows import targets
from main_table import REAL, SEEDS, mean_and_error, recording_of

N_RUNS = 20
SMOOTHED = 5  # bins
ANCHOR = "AR(20) with white noise"


def noise_like(
    blocks: np.ndarray, n: int, rate_hz: float, rng: np.random.Generator, of_logs: bool = False, smoothed: bool = False
) -> np.ndarray:
    """Return Gaussian noise with the mean spectrum of blocks (k, any), or with that of log spectra, shape (N_RUNS, n)."""
    hertz, density = signal.welch(blocks, rate_hz, nperseg=min(512, blocks.shape[1]), axis=-1)
    if smoothed:
        weights = signal.windows.hann(SMOOTHED + 2)[1:-1]
        density = ndimage.convolve1d(density, weights / weights.sum(), axis=-1, mode="nearest")
    bins = np.fft.rfftfreq(4 * n, 1 / rate_hz)
    usual = np.exp(np.log(density + 1e-30).mean(axis=0)) if of_logs else density.mean(axis=0)
    shape = np.sqrt(np.interp(bins, hertz, usual) * rate_hz / 2)
    white = np.fft.rfft(rng.standard_normal((N_RUNS, 4 * n)), axis=1)
    return np.fft.irfft(white * shape, 4 * n, axis=1)[:, :n]


def judge(texture: str, rate_hz: float, seed: int, recordings: Path) -> dict[str, float]:
    """Return the distances of one texture and split [dB]."""
    recording, config = recording_of(texture, rate_hz, seed, recordings)
    trace = preprocess(recording, config)
    split = split_blocks(trace, "regrouped", seed)
    scaling = fit_scaling(trace, split.train)
    linear = fit_linear(scaling.scale(trace.stacked()), split.train, trace.block, 20)
    assert linear is not None
    part, rng = scored(trace.block), np.random.default_rng(seed)
    blocks = trace.blocks(trace.acceleration)[:, part]
    test, known = blocks[list(split.test)], blocks[[*split.train, *split.validation]]
    n_segment = segment_length(trace.block)
    frequencies, recorded = welch(test, rate_hz, n_segment)
    bins = scored_bins(frequencies, rate_hz)

    def distance(runs: np.ndarray) -> float:
        _, played = welch(runs, rate_hz, n_segment)
        return float(log_spectral_distance(recorded[None, :, bins], played[..., bins]).mean())

    def noise(of: list[np.ndarray], **kind: bool) -> np.ndarray:
        return np.stack([noise_like(source, test.shape[1], rate_hz, rng, **kind) for source in of], axis=1)

    def unit_noise() -> np.ndarray:
        white = noise([known] * len(test))
        return white / white.std(axis=(0, 2), keepdims=True)

    level = test.std(axis=1)[None, :, None]
    hand = np.stack(
        [np.ones(trace.n_blocks)]
        + [np.log(trace.blocks(channel)[:, part].mean(axis=1)) for channel in (trace.speed, trace.force)],
        axis=1,
    )
    of_known = [*split.train, *split.validation]
    terms = np.linalg.lstsq(hand[of_known], np.log(known.std(axis=1)), rcond=None)[0]
    predicted = np.exp(hand[list(split.test)] @ terms)[None, :, None]
    anchor = synthesize_linear(linear, trace, split.test, scaling, seed, N_RUNS)[:, :, part]
    return {
        ANCHOR: distance(anchor),
        "noise like all known blocks": distance(noise([known] * len(test))),
        "noise like all known, smoothed": distance(noise([known] * len(test), smoothed=True)),
        "noise like all known, as loud as the hand foretells": distance(predicted * unit_noise()),
        "noise like the mean of their log spectra": distance(noise([known] * len(test), of_logs=True)),
        "the known blocks themselves": distance(np.repeat(known[:, None], len(test), axis=1)),
        "cheating: noise like all known, as loud as each": distance(level * unit_noise()),
        "cheating: noise like all test blocks": distance(noise([test] * len(test))),
        "cheating: noise like each test block": distance(noise([block[None] for block in test])),
    }


def over_anchor(distances: dict[str, list[dict[str, float]]], name: str) -> tuple[float, float]:
    """Return a distance over the anchor's as the tables have it: ratios of splits, their mean, mean over textures; its error."""
    mean, error = mean_and_error([split[name] / split[ANCHOR] for split in splits] for splits in distances.values())
    return mean, error or 0.0


def orders(rate_hz: float, recordings: Path) -> str:
    """Return the table of one-step errors by order."""
    tried = (*ORDERS, 280, FIRST_SCORED)
    lines = [f"| ÷ AR({ORDERS[-1]}) | " + " | ".join(map(str, tried)) + " |", "|" + "---|" * (1 + len(tried))]
    for texture in REAL:
        errors = []
        for seed in SEEDS:
            recording, config = recording_of(texture, rate_hz, seed, recordings)
            trace = preprocess(recording, config)
            split = split_blocks(trace, "regrouped", seed)
            samples = fit_scaling(trace, split.train).scale(trace.stacked())
            n = targets(split.test, trace.block, first_scored(trace.block)).reshape(len(split.test), -1)
            fitted = [fit_linear(samples, split.train, trace.block, order) for order in tried]
            assert None not in fitted
            errors.append([np.abs(one.predict(samples, n) - samples[n, 0]).mean() for one in fitted if one is not None])
        ratios = np.array(errors) / np.array(errors)[:, [len(ORDERS) - 1]]
        mean, error = ratios.mean(axis=0), ratios.std(axis=0, ddof=1) / np.sqrt(len(SEEDS))
        lines.append(
            f"| {texture} | " + " | ".join(f"{a:.4f} ± {b:.4f}" for a, b in zip(mean, error, strict=True)) + " |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, default=Path("recordings"))
    parser.add_argument("--rate", type=float, default=10_000.0)
    parser.add_argument("--save", type=Path, metavar="FILE", help="keep the figures as JSON there")
    parser.add_argument("--orders", action="store_true", help="one-step errors by order instead")
    arguments = parser.parse_args()
    if arguments.orders:
        print(orders(arguments.rate, arguments.recordings))
        return
    distances = {
        texture: [judge(texture, arguments.rate, seed, arguments.recordings) for seed in SEEDS] for texture in REAL
    }
    if arguments.save is not None:
        with atomic_write(arguments.save) as part:
            part.write_text(json.dumps(distances, indent=1) + "\n")
    print("| LSD [dB], mean over splits | " + " | ".join(REAL) + " | mean | ÷ AR(20) |\n|" + "---|" * 7)
    for name in distances[REAL[0]][0]:
        row = [np.mean([split[name] for split in distances[texture]]) for texture in REAL]
        cells = [f"{value:.2f}" for value in (*row, np.mean(row))]
        ratio, error = over_anchor(distances, name)
        print(f"| {name} | {' | '.join(cells)} | {ratio:.3f} ± {error:.3f} |")


if __name__ == "__main__":
    main()
