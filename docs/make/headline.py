"""What an error of 0.149 and a GFC of 92 % could be: the same predictor in other units, bands and regimes.

    python docs/make/headline.py [--csv docs/results/headline.csv] [--recordings DIR]

The paper states neither unit nor regime of its figures, nor what its accelerometer and filters leave of the band. AR(20) by least
squares on the twelve simulated textures of Table I, split and scored as there: one step and free run, with white noise; beside
silence, and a second realisation of the same stroke. The acceleration as it is, and behind a causal low-pass of order 4.

With --recordings nothing is measured: recordings of three of the textures behind the first low-pass are written, on which
`foten sweep table-1-350hz --recordings DIR` trains networks.
"""

import os
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from csv_records import RESULTS, parser_of
from foten.cli.simulator_reference import SEED_STEP
from foten.datasets.hdf5 import write_recording
from foten.dsp import Array
from foten.dsp.filters import butterworth, filter_recorded
from foten.evaluate.free_run import synthesize_linear
from foten.evaluate.metrics import goodness_of_fit
from foten.evaluate.one_step import fit_linear
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Recording
from foten.recording.scaling import fit_scaling
from foten.recording.split import split_blocks
from foten.recording.trace import Trace
from foten.recording.windows import first_scored, targets
from foten.reporting.table import Table
from foten.simulation.simulate import second_realisation
from foten_lab.experiment import experiment_path, read_experiment, recording_of

ORDER = 20  # of the predictor, as long as the paper's window
FILTER_ORDER = 4  # of the low-pass
BANDS_HZ = (None, 350.0, 250.0)  # cutoffs of a further low-pass of the acceleration
WRITTEN = ("steel-mesh-1", "jeans", "towel")  # those of Fig. 5 here


def below(trace: Trace, cutoff_hz: float | None) -> Trace:
    """A trace with its acceleration behind a causal low-pass."""
    if cutoff_hz is None:
        return trace
    sections = butterworth("lowpass", cutoff_hz, trace.rate_hz, FILTER_ORDER)
    return replace(trace, acceleration=filter_recorded(sections, trace.acceleration))


def judge(trace: Trace, other: Trace, seed: int) -> dict[str, float]:
    """Errors and fits of AR(20) on the test blocks, beside silence and another realisation."""
    split = split_blocks(trace, seed=seed)
    scaling = fit_scaling(trace, split.train)
    samples = scaling.scale(trace.stacked())
    linear = fit_linear(samples, split.train, trace.block, ORDER)
    assert linear is not None
    sd, extent = scaling.sd[0], float(np.ptp(trace.acceleration))
    n = targets(split.test, trace.block, first_scored(trace.block)).reshape(len(split.test), -1)
    recorded, of_other = trace.acceleration[n], other.acceleration[n]
    predicted = scaling.unscale_acceleration(linear.predict(samples, n))
    free = synthesize_linear(linear, trace, split.test, scaling, n_seeds=1)[0][:, first_scored(trace.block) :]

    def error(run: Array) -> float:
        return float(np.abs(run - recorded).mean())

    def fit(run: Array) -> float:
        return float(100 * goodness_of_fit(recorded, run).mean())

    return {
        "silence [sd]": error(np.zeros_like(recorded)) / sd,
        "one step [sd]": error(predicted) / sd,
        "one step [m/s²]": error(predicted),
        "one step [of the range]": error(predicted) / extent,
        "one-step GFC [%]": fit(predicted),
        "free run [sd]": error(free) / sd,
        "free run's GFC [%]": fit(free),
        "second realisation [sd]": error(of_other) / sd,
        "second realisation's GFC [%]": fit(of_other),
    }


def smoothed(recording: Recording, config: PreprocessConfig, cutoff_hz: float) -> Recording:
    """A recording whose trace has its acceleration behind that low-pass, at the sensor's own rate; it has no truth then."""
    from scipy import signal

    sections = butterworth("lowpass", cutoff_hz, config.rate_hz, FILTER_ORDER)
    sos = np.array([[b0, b1, b2, 1.0, a1, a2] for b0, b1, b2, a1, a2 in sections])
    channels = dict(recording.channels)
    for name, channel in recording.channels.items():
        if name.startswith("acceleration"):
            n = len(channel.samples)
            frequencies = np.fft.rfftfreq(n, 1 / channel.rate_hz)
            _, response = signal.sosfreqz(sos, worN=frequencies, fs=config.rate_hz)
            response[frequencies >= config.rate_hz / 2] = 0.0  # as at half the rate itself
            channels[name] = replace(channel, samples=np.fft.irfft(response * np.fft.rfft(channel.samples), n))
    done = f"acceleration behind a low-pass of {cutoff_hz:g} Hz, order {FILTER_ORDER} at {config.rate_hz:g} Hz"
    return replace(recording, channels=channels, simulation=None, history=(*recording.history, done))


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--csv", type=Path, default=RESULTS / "headline.csv", metavar="FILE")
    parser.add_argument(
        "--recordings", type=Path, metavar="DIR", help="write recordings behind a low-pass there instead"
    )
    arguments = parser.parse_args()
    runs = [run for run in read_experiment(experiment_path("table-1")).runs() if run.model == "ar"]
    if arguments.recordings:
        arguments.recordings.mkdir(parents=True, exist_ok=True)
        cutoff_hz = BANDS_HZ[1]
        assert cutoff_hz is not None
        for run in (run for run in runs if run.texture in WRITTEN):
            path = arguments.recordings / f"{run.texture}-{cutoff_hz:g}hz.h5"
            write_recording(smoothed(recording_of(run), PreprocessConfig(**run.preprocess), cutoff_hz), path)
            print(path)
        return
    rows: list[tuple[str, ...]] = []
    for run in runs:
        recording, config = recording_of(run), PreprocessConfig(**run.preprocess)
        assert recording.simulation is not None
        second = second_realisation(recording, int(recording.simulation["noise_seed"]) + SEED_STEP)
        trace, other = (preprocess(one, config) for one in (recording, second))
        for cutoff_hz in BANDS_HZ:
            figures = judge(below(trace, cutoff_hz), below(other, cutoff_hz), run.split_seed)
            band = "as it is" if cutoff_hz is None else f"below {cutoff_hz:g} Hz"
            rows.append((run.texture, band, *(f"{value:.4g}" for value in figures.values())))
    Table.of(("texture", "band", *figures), rows).write(arguments.csv, "csv")


if __name__ == "__main__":
    main()
