"""How well simulated people are known after how many answers: detection thresholds, and what is preferred.

    python docs/make/users.py [--people 200]

Thresholds: one of three places holds a vibration; people's thresholds have a standard deviation of 8 dB, and every tenth answer
is drawn. Preference: an ideal point in level, centroid and width, ±1 being five just noticeable differences; of two textures the
nearer one is chosen, the more surely the nearer, but for every tenth choice. `random` shows pairs at random, `grid` walks along
one dimension after the other and keeps the better. Means ± standard errors over people.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np

from foten.dsp import Array
from foten.dsp.adaptive import PreferenceSearch, ThresholdSearch, detected
from foten.reporting.table import Table

CSV = Path(__file__).resolve().parents[1] / "results" / "users.csv"
WRONG = 0.1
JND = 0.2  # of half of a range
N_DIMENSIONS = 3
ANSWERS = (10, 15, 20, 25)
STEPS = np.linspace(-0.8, 0.8, 5)  # of the grid


def threshold_errors(n_people: int) -> dict[int, Array]:
    """Errors [dB] after so many answers, (n_people,)."""
    errors: dict[int, list[float]] = {n: [] for n in ANSWERS}
    for person in range(n_people):
        rng = np.random.default_rng([person, 1])
        threshold = rng.normal(-20, 8)
        search = ThresholdSearch(-60.0, 20.0, expected=(-20.0, 12.0))
        for n in range(1, max(ANSWERS) + 1):
            level = search.stimulus()
            right = rng.random() < float(detected(level, np.array(threshold), np.array(0.2), np.array(0.0), 1 / 3))
            search.answer(level, bool(rng.random() < 1 / 3 if rng.random() < WRONG else right))
            if n in errors:
                errors[n].append(search.threshold - threshold)
    return {n: np.array(each) for n, each in errors.items()}


def person_of(ideal: Array, rng: np.random.Generator) -> Callable[[Array, Array], bool]:
    """Whether a person chooses the first of two points."""

    def chooses(first: Array, second: Array) -> bool:
        nearer = np.linalg.norm(second - ideal) - np.linalg.norm(first - ideal)
        prefers = rng.random() < 1 / (1 + np.exp(-1.5 * nearer / JND))
        return bool(rng.random() < 0.5 if rng.random() < WRONG else prefers)

    return chooses


def by_search(chooses: Callable[[Array, Array], bool], rng: np.random.Generator, adaptive: bool) -> dict[int, Array]:
    """What is thought to be ideal after so many choices."""
    search, found = PreferenceSearch(N_DIMENSIONS, JND, int(rng.integers(2**31))), {}
    for n in range(1, max(ANSWERS) + 1):
        first, second = search.pair() if adaptive else rng.uniform(-1, 1, (2, N_DIMENSIONS))
        search.answer(first, second, chooses(first, second))
        if n in ANSWERS:
            found[n] = search.point
    return found


def by_grid(chooses: Callable[[Array, Array], bool]) -> dict[int, Array]:
    """The better of two neighbours, dimension after dimension, over and over."""
    best, found, n = np.zeros(N_DIMENSIONS), {}, 0
    while n < max(ANSWERS):
        for axis in range(N_DIMENSIONS):
            for step in STEPS:
                other = best.copy()
                other[axis] = step
                if n >= max(ANSWERS) or np.allclose(other, best):
                    continue
                best = other if chooses(other, best) else best
                n += 1
                if n in ANSWERS:
                    found[n] = best.copy()
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--people", type=int, default=200)
    n_people = parser.parse_args().people
    heads = ["what", "procedure", "answers", "bias", "spread", "distance", "distance_se"]
    cells = [heads]
    for n, errors in threshold_errors(n_people).items():
        size = np.abs(errors)
        figures = errors.mean(), errors.std(ddof=1), size.mean(), size.std(ddof=1) / np.sqrt(n_people)
        cells.append(["threshold [dB]", "adaptive", str(n), *(f"{x:.3f}" for x in figures)])
    found: dict[tuple[str, int], list[float]] = {}
    begun = []
    for person in range(n_people):
        ideal = np.random.default_rng([person, 2]).uniform(-0.8, 0.8, N_DIMENSIONS)
        begun.append(float(np.linalg.norm(ideal)) / JND)
        for kind in ("adaptive", "random", "grid"):
            rng = np.random.default_rng([person, 3])
            chooses = person_of(ideal, rng)
            points = by_grid(chooses) if kind == "grid" else by_search(chooses, rng, kind == "adaptive")
            for n, point in points.items():
                found.setdefault((kind, n), []).append(float(np.linalg.norm(point - ideal)) / JND)
    for (kind, n), each in {("none", 0): begun, **found}.items():
        distance = np.array(each)
        se = distance.std(ddof=1) / np.sqrt(n_people)
        cells.append(["preference [JND]", kind, str(n), "", "", f"{distance.mean():.3f}", f"{se:.3f}"])
    Table.of(cells[0], cells[1:]).write(CSV)
    print("\n".join(Table.of(cells[0], cells[1:]).text()))


if __name__ == "__main__":
    main()
