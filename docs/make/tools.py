"""What a tool's filter is worth: pens on paper, and two simulated tools over six surfaces.

    python docs/make/tools.py [--pens FILE]

Simulated: a sphere of 0.5 to 1 mm, and one 1.6 times as large on 0.6 of the mass. The transfer is measured on one surface, 24 s
under a moving hand, and applied to textures of five others, learned from 64 s of the first tool without a network; judged against
the second tool at six steady conditions. `own` is learned from the second tool. With --pens, spectra of eight pens at 15
conditions, twice: measured at 100 mm/s and 1.5 N, judged at the others in the other repeat, over all pairs. Means ± standard
errors, by leaving out a pen or a surface with all its pairs; dB.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations
from pathlib import Path

import numpy as np

from csv_records import RESULTS, parser_of
from extrapolation import FULL_SECONDS, compared, learned, steady
from foten.dsp import Array
from foten.editing.edit import with_level
from foten.editing.tool import PER_OCTAVE, fitted_transfer, transferred
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Recording
from foten.reporting.table import Table
from foten.simulation.contact_mechanics import (
    CONTACT,
    RATE_HZ,
    ContactParameters,
    contact_vibration,
    profile,
    under_ball,
)
from foten.simulation.simulate import sensor_channels
from foten.simulation.stroking import Stroking, stroking

SURFACES = ("sawn-wood", "sandpaper-coarse", "ribbed-plastic", "canvas", "leather", "cork")
CONDITIONS = ((50.0, 0.5), (50.0, 1.5), (100.0, 0.5), (100.0, 1.5), (200.0, 0.5), (200.0, 1.5))
MEASURED_SECONDS, JUDGED_SECONDS = 24.0, 8.0
AT = 5  # of a pen's conditions: 100 mm/s, 1.5 N
Case = tuple[str, str, str, float, float]
"""Two surfaces or pens, method, level error and log-spectral distance [dB]."""


def other_tool(tool: ContactParameters) -> ContactParameters:
    """A larger and lighter tip."""
    return replace(tool, tip_mm=1.6 * tool.tip_mm, tip_mass_g=0.6 * tool.tip_mass_g)


def recorded(key: str, other: bool, stroke: Stroking, seed: int) -> Recording:
    """What a tool's sensors record on a surface."""
    tool = other_tool(CONTACT[key]) if other else CONTACT[key]
    rng = np.random.default_rng([seed, other, *key.encode()])
    surface = under_ball(profile(CONTACT[key], key), tool.tip_mm)
    acceleration, force = contact_vibration(tool, surface, stroke, rng)
    channels = sensor_channels(acceleration, force, tool.friction, stroke, 1, rng)
    return Recording(channels, texture=key, tool="b" if other else "a")


def simulated(measured_on: str) -> Iterator[Case]:
    """Cases of each other surface."""
    cut = PreprocessConfig(trim_ms=0.0)
    strokes = [stroking(MEASURED_SECONDS, seed, RATE_HZ) for seed in (20, 21)]
    both = [preprocess(recorded(measured_on, bool(other), stroke, 1), cut) for other, stroke in enumerate(strokes)]
    transfer = fitted_transfer(both[:1], both[1:])
    gain_db = float(20 * np.log10(both[1].acceleration.std() / both[0].acceleration.std()))
    for key in SURFACES:
        if key == measured_on:
            continue
        texture, own = (
            learned(recorded(key, other, stroking(FULL_SECONDS, 100 + other, RATE_HZ), 2)) for other in (False, True)
        )
        strokes = [steady(*at, JUDGED_SECONDS, 7, RATE_HZ) for at in CONDITIONS]
        truths = [preprocess(recorded(key, True, stroke, 9), cut) for stroke in strokes]
        for method, one in {
            "untreated": texture,
            "gain alone": with_level(texture, gain_db),
            "transfer": transferred(texture, transfer),
            "own recording": own,
        }.items():
            figures = compared(one, truths)
            print(measured_on, key, method, {name: round(value, 2) for name, value in figures.items()}, flush=True)
            yield measured_on, key, method, figures["level_error_db"], figures["lsd_db"]


def smoothed(density: Array, hz: Array) -> Array:
    """Spectra (…, k) averaged over a sixth of an octave around each bin."""
    half = 2 ** (0.5 / PER_OCTAVE)
    parts = [density[..., (hz >= one / half) & (hz <= one * half)].mean(axis=-1) for one in hz]
    return np.stack(parts, axis=-1)


def pens(path: Path) -> Iterator[Case]:
    """Cases of each ordered pair of pens."""
    arrays = np.load(path)
    density = {name: np.square(arrays[name].astype(np.float64)) for name in arrays.files}
    hz, others = 10.0 + 2.0 * np.arange(245), np.arange(15) != AT
    for first, second in permutations(density, 2):
        for fitted, judged in ((0, 1), (1, 0)):
            a, b = density[first], density[second]
            ratio = smoothed(b[fitted, AT], hz) / smoothed(a[fitted, AT], hz)
            gain = b[fitted, AT].sum() / a[fitted, AT].sum()
            truth = smoothed(b[judged][others], hz)
            for method, ours in {
                "untreated": a[fitted][others],
                "gain alone": gain * a[fitted][others],
                "transfer": ratio * a[fitted][others],
                "own recording": b[fitted][others],
            }.items():
                error = 10 * np.log10(smoothed(ours, hz) / truth)
                level = 10 * np.log10(ours.sum(axis=1) / b[judged][others].sum(axis=1))
                distance = float(np.sqrt(np.square(error).mean(axis=1)).mean())
                yield first, second, method, float(np.abs(level).mean()), distance


def standard_error(pairs: list[tuple[str, str]], figures: Array) -> Array:
    """Of the means of (n, k) figures of pairs: jackknife that leaves out one member of the pairs, with all its pairs."""
    members = sorted({member for pair in pairs for member in pair})
    means = np.array([figures[[member not in pair for pair in pairs]].mean(axis=0) for member in members])
    return np.sqrt((len(members) - 1) * np.square(means - means.mean(axis=0)).mean(axis=0))


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--pens", type=Path, help="spectra of pens on paper")
    parser.add_argument(
        "--surfaces", type=lambda text: text.split(","), default=["sawn-wood", "canvas"], help="measured on"
    )
    arguments = parser.parse_args()
    cells = []
    rows = {"simulated": [row for key in arguments.surfaces for row in simulated(key)]}
    rows |= {"pens on paper": list(pens(arguments.pens))} if arguments.pens else {}
    for kind, each in rows.items():
        for method in dict.fromkeys(row[2] for row in each):
            of_method = [row for row in each if row[2] == method]
            figures = np.array([row[3:] for row in of_method])
            error = standard_error([row[:2] for row in of_method], figures)
            values = [f"{x:.3f}" for pair in zip(figures.mean(axis=0), error, strict=True) for x in pair]
            cells.append([kind, method, str(len(figures)), *values])
    table = Table.of(["tools", "method", "cases", "level_error_db", "level_se", "lsd_db", "lsd_se"], cells)
    table.write(RESULTS / "tools.csv")
    print("\n".join(table.text()))


if __name__ == "__main__":
    main()
