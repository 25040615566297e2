"""What a free run on the real four can reach at all: log-spectral distances of plain signals, and of some that cheat.

    python benchmarks/limits.py [--recordings DIR] [--rate 10000] [--save FILE]

All on the test blocks of five splits, scored as the judge does (`free_run`): AR(20) with white noise, the anchor; Gaussian
noise with the mean spectrum of all training and validation blocks, all that a stationary Gaussian model can know of their power;
the same with the mean of their log spectra, which this figure favours; the other blocks themselves, which are the real texture;
and three that cheat: the same noise as loud as each test block, noise with the mean spectrum of the test blocks, and with
each test block's own.
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import signal

from foten.evaluate import metrics
from foten.evaluate.free_run import scored, synthesize_linear
from foten.evaluate.references import fit_linear
from foten.recording.preprocess import preprocess
from foten.recording.scaling import fit_scaling
from foten.recording.split import split_blocks
from foten.whole_file import whole_file
from main_table import REAL, SEEDS, recording_of

N_RUNS = 20
ANCHOR = "AR(20) with white noise"


def noise_like(
    blocks: np.ndarray, n: int, rate_hz: float, rng: np.random.Generator, of_logs: bool = False
) -> np.ndarray:
    """Return Gaussian noise with the mean spectrum of blocks (k, any), or with that of log spectra, shape (N_RUNS, n)."""
    hertz, density = signal.welch(blocks, rate_hz, nperseg=min(512, blocks.shape[1]), axis=-1)
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
    n_segment = metrics.segment_length(trace.block)
    frequencies, recorded = metrics.welch(test, rate_hz, n_segment)
    bins = metrics.scored_bins(frequencies, rate_hz)

    def distance(runs: np.ndarray) -> float:
        _, played = metrics.welch(runs, rate_hz, n_segment)
        return float(metrics.log_spectral_distance(recorded[None, :, bins], played[..., bins]).mean())

    def noise(of: list[np.ndarray], of_logs: bool = False) -> np.ndarray:
        return np.stack([noise_like(source, test.shape[1], rate_hz, rng, of_logs) for source in of], axis=1)

    level = test.std(axis=1)[None, :, None]
    anchor = synthesize_linear(linear, trace, split.test, scaling, seed, N_RUNS)[:, :, part]
    return {
        ANCHOR: distance(anchor),
        "noise like all known blocks": distance(noise([known] * len(test))),
        "noise like the mean of their log spectra": distance(noise([known] * len(test), of_logs=True)),
        "the known blocks themselves": distance(np.repeat(known[:, None], len(test), axis=1)),
        "cheating: noise like all known, as loud as each": distance(
            level * noise([known] * len(test)) / noise([known] * len(test)).std(axis=(0, 2), keepdims=True)
        ),
        "cheating: noise like all test blocks": distance(noise([test] * len(test))),
        "cheating: noise like each test block": distance(noise([block[None] for block in test])),
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--recordings", type=Path, default=Path("recordings"))
    parser.add_argument("--rate", type=float, default=10_000.0)
    parser.add_argument("--save", type=Path, metavar="FILE", help="keep the figures as JSON there")
    arguments = parser.parse_args()
    found = {
        texture: [judge(texture, arguments.rate, seed, arguments.recordings) for seed in SEEDS]
        for texture in REAL
    }
    if arguments.save is not None:
        with whole_file(arguments.save) as part:
            part.write_text(json.dumps(found, indent=1) + "\n")
    names = list(found[REAL[0]][0])
    print("| LSD [dB], mean over splits | " + " | ".join(REAL) + " | mean | ÷ AR(20) |\n|" + "---|" * 7)
    means = {name: [np.mean([row[name] for row in found[texture]]) for texture in REAL] for name in names}
    for name, row in means.items():
        cells = [f"{value:.2f}" for value in (*row, np.mean(row))]
        print(f"| {name} | {' | '.join(cells)} | {np.mean(row) / np.mean(means[ANCHOR]):.3f} |")


if __name__ == "__main__":
    main()
