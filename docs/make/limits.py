"""What a free run on the real four can reach at all: log-spectral distances of plain signals, and of some that cheat.

    python docs/make/limits.py --recordings DIR [--rate 10000]

All on the test blocks of five splits, scored as the judge does (`free_run`): AR(20) with white noise, the anchor; Gaussian
noise with the mean spectrum of all training and validation blocks; the same, smoothed over five bins (98 Hz at 10 kHz); as loud
as speed and force predict, by least squares of the known blocks' levels on their logarithms; with the mean of their log spectra,
which this figure favours; the other blocks themselves, which are the real texture; and three that cheat: the noise as loud as
each test block, noise with the mean spectrum of the test blocks, and with each test block's own.
"""

import os
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy import ndimage, signal

from csv_records import REAL, RESULTS, parser_of
from foten.datasets.hdf5 import load_recording
from foten.dsp.distance import log_spectral_distance, scored_bins, segment_length, welch
from foten.evaluate.free_run import scored, synthesize_linear
from foten.evaluate.one_step import fit_linear
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.scaling import fit_scaling
from foten.recording.split import split_blocks
from foten.reporting.table import Table

SEEDS = (1, 2, 3, 4, 5)

N_RUNS = 20
SMOOTHED = 5  # bins
ANCHOR = "AR(20) with white noise"


def noise_like(
    blocks: np.ndarray, n: int, rate_hz: float, rng: np.random.Generator, of_logs: bool = False, smoothed: bool = False
) -> np.ndarray:
    """Gaussian noise with the mean spectrum of blocks (k, any), or with that of log spectra, shape (N_RUNS, n)."""
    hertz, density = signal.welch(blocks, rate_hz, nperseg=min(512, blocks.shape[1]), axis=-1)
    if smoothed:
        weights = signal.windows.hann(SMOOTHED + 2)[1:-1]
        density = ndimage.convolve1d(density, weights / weights.sum(), axis=-1, mode="nearest")
    bins = np.fft.rfftfreq(4 * n, 1 / rate_hz)
    usual = np.exp(np.log(density + 1e-30).mean(axis=0)) if of_logs else density.mean(axis=0)
    shape = np.sqrt(np.interp(bins, hertz, usual) * rate_hz / 2)
    white = np.fft.rfft(rng.standard_normal((N_RUNS, 4 * n)), axis=1)
    return np.fft.irfft(white * shape, 4 * n, axis=1)[:, :n]


def judge(path: Path, rate_hz: float, seed: int) -> tuple[tuple[int, ...], dict[str, float]]:
    """Numbers of the test blocks of one texture and split, and distances [dB]."""
    trace = preprocess(load_recording(path), PreprocessConfig(rate_hz=rate_hz, trim_ms=0, block_ms=200))
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
        _, rendered = welch(runs, rate_hz, n_segment)
        return float(log_spectral_distance(recorded[None, :, bins], rendered[..., bins]).mean())

    def noise(of: list[np.ndarray], **kind: bool) -> np.ndarray:
        return np.stack([noise_like(source, test.shape[1], rate_hz, rng, **kind) for source in of], axis=1)

    def unit_noise() -> np.ndarray:
        white = noise([known] * len(test))
        return white / white.std(axis=(0, 2), keepdims=True)

    level = test.std(axis=1)[None, :, None]
    conditions = np.stack(
        [np.ones(trace.n_blocks)]
        + [np.log(trace.blocks(channel)[:, part].mean(axis=1)) for channel in (trace.speed, trace.force)],
        axis=1,
    )
    of_known = [*split.train, *split.validation]
    terms = np.linalg.lstsq(conditions[of_known], np.log(known.std(axis=1)), rcond=None)[0]
    predicted = np.exp(conditions[list(split.test)] @ terms)[None, :, None]
    anchor = synthesize_linear(linear, trace, split.test, scaling, seed, N_RUNS)[:, :, part]
    return split.test, {
        ANCHOR: distance(anchor),
        "noise like all known blocks": distance(noise([known] * len(test))),
        "noise like all known, smoothed": distance(noise([known] * len(test), smoothed=True)),
        "noise like all known, as loud as speed and force predict": distance(predicted * unit_noise()),
        "noise like the mean of their log spectra": distance(noise([known] * len(test), of_logs=True)),
        "the known blocks themselves": distance(np.repeat(known[:, None], len(test), axis=1)),
        "cheating: noise like all known, as loud as each": distance(level * unit_noise()),
        "cheating: noise like all test blocks": distance(noise([test] * len(test))),
        "cheating: noise like each test block": distance(noise([block[None] for block in test])),
    }


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument(
        "--recordings", type=Path, required=True, metavar="DIR", help="of copper.h5 and the other three"
    )
    parser.add_argument("--rate", type=float, default=10_000.0)
    arguments = parser.parse_args()
    cells: list[list[str]] = []
    for texture in REAL:
        for seed in SEEDS:
            test, distances = judge(arguments.recordings / f"{texture}.h5", arguments.rate, seed)
            blocks = " ".join(map(str, test))
            cells.append([texture, str(seed), blocks, *(f"{value:.4f}" for value in distances.values())])
    Table.of(["texture", "split", "test blocks", *distances], cells).write(RESULTS / "limits.csv")


if __name__ == "__main__":
    main()
