"""How well simulated people are known after how many answers: thresholds, equal strength, and what is preferred.

    python docs/make/users.py [--people 200]

Thresholds: one of three places holds a tone; people's thresholds have a standard deviation of 8 dB. Equal strength: which of two
tones is the stronger; people's points have one of 6 dB. Preference: an ideal point of level, centroid, width and roughness, ±1
being five just noticeable differences; of two textures the nearer one is chosen, the more surely the nearer. Every tenth answer
is drawn. `random` shows levels and pairs at random; `grid` shows levels in turn, 8 dB apart, and walks along one dimension after
the other, keeping the better. The last row is the whole session of `foten adapt`. Means ± standard errors over people.
"""

from collections.abc import Callable

import numpy as np

from csv_records import RESULTS, parser_of
from foten.dsp import Array
from foten.dsp.inference import standard_error
from foten.editing.user import MOVES, TONES_HZ, UserProfile
from foten.reporting.table import Table
from foten_study.adapt_session import Question, Session, answered_by
from foten_study.adaptive import Comparison, Detection, LevelSearch, PreferenceSearch

WRONG = 0.1
JND = 0.2  # of half of a range
N_DIMENSIONS = len(MOVES)
ANSWERS = (8, 12, 16, 25)
STEPS = np.linspace(-0.8, 0.8, 5)  # of the grid
GRID_DB = 8.0
PROCEDURES = ("adaptive", "random", "grid")
SECONDS = {"detect": 2.9, "compare": 2.3}  # of a question on the page, with one second to answer

Answers = dict[int, list[float]]


def errors_of_levels(answers: Detection | Comparison, sd_db: float, procedure: str, n_people: int) -> Answers:
    """Errors of a point [dB] after so many answers."""
    errors: Answers = {n: [] for n in ANSWERS}
    slope, guess = (0.2, answers.guess) if isinstance(answers, Detection) else (0.5, 0.5)
    for person in range(n_people):
        rng, of_answers = np.random.default_rng([person, 1]), np.random.default_rng([person, 4])
        point = rng.normal(-30, sd_db)
        search = LevelSearch(-60.0, 0.0, answers, (-30.0, 1.5 * sd_db))
        grid = search.levels[:: round(GRID_DB / 2)]
        for n in range(1, max(ANSWERS) + 1):
            shown = {"adaptive": search.stimulus(), "random": rng.choice(search.levels), "grid": grid[n % len(grid)]}
            level = float(shown[procedure])
            yes = of_answers.random() < float(answers(level, np.array(point), np.array(slope), np.array(0.0)))
            drawn = of_answers.random() < WRONG
            search.answer(level, bool(of_answers.random() < guess if drawn else yes))
            if n in errors:
                errors[n].append(search.point - point)
    return errors


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


def preferences(procedure: str, n_people: int) -> Answers:
    """Distances from ideal points [JND] after so many choices; after none at 0."""
    found: Answers = {}
    for person in range(n_people):
        ideal = np.random.default_rng([person, 2]).uniform(-0.8, 0.8, N_DIMENSIONS)
        rng = np.random.default_rng([person, 3])
        chooses = person_of(ideal, rng)
        points = by_grid(chooses) if procedure == "grid" else by_search(chooses, rng, procedure == "adaptive")
        for n, point in {0: np.zeros(N_DIMENSIONS), **points}.items():
            found.setdefault(n, []).append(float(np.linalg.norm(point - ideal)) / JND)
    return found


def session_of(person: int) -> tuple[UserProfile, Array, Array, Array]:
    """A person's profile by the session of the page, with her thresholds, equal strengths and ideal point."""
    rng = np.random.default_rng([person, 5])
    threshold = rng.normal(-45, 8) + rng.normal(0, 4, len(TONES_HZ))
    equal = threshold + rng.normal(0, 4, len(TONES_HZ))
    ideal = rng.uniform(-0.8, 0.8, N_DIMENSIONS)
    at = {hertz: i for i, hertz in enumerate(TONES_HZ)}
    chooses = person_of(ideal, rng)

    def answer(question: Question) -> int:
        shown = question.shown
        if question.part == "match":
            return int(not chooses(*np.split(np.array(shown), 2)))
        if rng.random() < WRONG:
            return int(rng.integers(question.n_choices))
        if question.part == "detect":
            felt = rng.random() < 1 - np.exp(-(10 ** (0.1 * (shown[1] - threshold[at[shown[0]]]))))
            return int(shown[2]) if felt else int(rng.integers(question.n_choices))
        first, second = (level - equal[at[hertz]] for hertz, level in (shown[:2], shown[2:]))
        return int(rng.random() > 1 / (1 + np.exp(-0.5 * (first - second))))

    return answered_by(Session(UserProfile(), "felt", seed=person), answer), threshold, equal, ideal


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--people", type=int, default=200)
    n_people = parser.parse_args().people
    cells = []

    def row(what: str, procedure: str, answers: float, errors: Array, signed: bool) -> None:
        size = np.abs(errors)  # (people,), or (people, tones)
        spread = [f"{errors.mean():.3f}", f"{errors.std(ddof=1):.3f}"] if signed else ["", ""]
        se = standard_error(size.reshape(len(errors), -1).mean(axis=1))
        cells.append([what, procedure, f"{answers:g}", *spread, f"{size.mean():.3f}", f"{se:.3f}"])

    for what, kind, sd_db in (("threshold [dB]", Detection(), 8.0), ("equal strength [dB]", Comparison(), 6.0)):
        for procedure in PROCEDURES:
            for n, errors in errors_of_levels(kind, sd_db, procedure, n_people).items():
                row(what, procedure, n, np.array(errors), signed=True)
    for procedure in PROCEDURES:
        for n, distances in preferences(procedure, n_people).items():
            if n or procedure == "adaptive":
                row("preference [JND]", procedure if n else "none", n, np.array(distances), signed=False)
    people = [session_of(person) for person in range(n_people)]
    answers = {
        part: np.array([sum(key.startswith(part) for key, *_ in profile.answers) for profile, *_ in people])
        for part in ("detect", "compare", "match")
    }
    reference = TONES_HZ.index(160.0)
    thresholds = np.array([np.array(profile.threshold_db) - true for profile, true, *_ in people])
    gains = np.array(
        [np.delete(np.array(profile.gain_db) - (true - true[reference]), reference) for profile, _, true, _ in people]
    )
    points = [np.array(profile.moves) / list(MOVES.values()) - ideal for profile, *_, ideal in people]
    n = {part: round(float(each.mean()), 1) for part, each in answers.items()}
    minutes = sum(SECONDS[part] * answers[part] for part in SECONDS) / 60
    row("session: thresholds [dB]", "", n["detect"], thresholds, signed=True)
    row("session: equal strength [dB]", "", n["compare"], gains, signed=True)
    row("session: time of these two, a second an answer [min]", "", n["detect"] + n["compare"], minutes, signed=False)
    row("session: preference [JND]", "", n["match"], np.linalg.norm(points, axis=1) / JND, signed=False)
    table = Table.of(["what", "procedure", "answers", "bias", "spread", "distance", "distance_se"], cells)
    table.write(RESULTS / "users.csv")
    print("\n".join(table.text()))


if __name__ == "__main__":
    main()
