"""What 1 and 2.5 kHz carry of each texture, of all power and of what a hand feels, under two readings of touch; seconds.

    python benchmarks/rates.py [--recordings DIR] [--page docs/fidelity.md]

Of the real four as recorded at 10 kHz, and of sixteen seconds of each simulated texture. `dsp.perception` takes a hand to feel
acceleration above 250 Hz less by 24 dB an octave; how steep that is, is an assumption, so that the shares are given for half
of it as well.
"""

from __future__ import annotations

import argparse
import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.signal import welch

from foten.datasets.simulate import TEXTURES, simulate
from foten.dsp.distance import HIGHEST_HZ
from foten.dsp.perception import MOST_SENSITIVE_HZ, USABLE_BAND, carried, smallest_rate
from foten.recording.recording import Recording
from main_table import REAL, between, recording_of

RATE_HZ, SHOWN_HZ = 10_000.0, (1000.0, 2500.0)
SECONDS = 16.0


def densities(recordings: Path) -> dict[str, dict[str, tuple[np.ndarray, np.ndarray]]]:
    """Return frequency [Hz] and power density of each axis of each texture."""
    by_texture = {}
    for texture in REAL:
        try:
            by_texture[texture] = spectra(recording_of(texture, RATE_HZ, 0, recordings)[0])
        except FileNotFoundError as error:
            print(f"{texture}: skipped, no {error.filename}", file=sys.stderr)
    return by_texture | {texture: spectra(simulate(texture, SECONDS, seed=0)) for texture in TEXTURES}


def spectra(recording: Recording) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return frequency [Hz] and power density of each axis of acceleration."""
    return {
        name: welch(channel.samples, channel.rate_hz, nperseg=1024)
        for name, channel in recording.channels.items()
        if name.startswith("acceleration")
    }


def gentler(hertz: np.ndarray, density: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a density in which 24 dB an octave above 250 Hz count as 12."""
    return hertz, density * np.maximum(np.minimum(hertz, HIGHEST_HZ) / MOST_SENSITIVE_HZ, 1.0) ** 4


def table(recordings: Path) -> str:
    """Return the shares as Markdown."""
    head = ["texture"]
    for kind in ("felt", "felt at 12 dB an octave", "all power"):
        head += [f"{kind}: {rate / 1000:g} kHz" for rate in SHOWN_HZ]
    head += ["recommended", "at 12 dB"]
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for texture, axes in densities(recordings).items():
        perceived, milder = (
            carried(axes, RATE_HZ),
            carried({name: gentler(*axis) for name, axis in axes.items()}, RATE_HZ),
        )
        total = sum(density.sum() for _, density in axes.values())
        plain = [
            sum(density[hertz <= USABLE_BAND * rate].sum() for hertz, density in axes.values()) / total
            for rate in SHOWN_HZ
        ]
        shares = [*(perceived[rate] for rate in SHOWN_HZ), *(milder[rate] for rate in SHOWN_HZ), *plain]
        cells = [texture, *(f"{100 * share:.1f} %" for share in shares)]
        cells += [f"{smallest_rate(kind) / 1000:g} kHz" for kind in (perceived, milder)]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recordings", type=Path, default=Path("recordings"))
    parser.add_argument("--page", type=Path, metavar="FILE", help="put the table between its markers in this file")
    arguments = parser.parse_args()
    between(arguments.page, "rates", table(arguments.recordings))


if __name__ == "__main__":
    main()
