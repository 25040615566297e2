"""The questions of `foten adapt`, one after another, and the profile that their answers make.

    detect   one of three flashes is a tone: which?        five frequencies, to a threshold
    compare  two tones: which is stronger?                  four frequencies, to equal strength with 160 Hz
    match    two textures beside a real surface: which is nearer?   up to 25 choices

A session goes on from the answers in a profile, as if it had not ended.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from foten.dsp import Array
from foten.dsp.adaptive import Comparison, Detection, LevelSearch, PreferenceSearch
from foten.editing.user import MOVES, REFERENCE_HZ, TONES_HZ, UserProfile

LOWEST_DB = -84.0  # re the largest tone that the output has
FIRST_EXPECTED_DB = (-45.0, 15.0)  # threshold at the first frequency, mean and standard deviation
NEXT_SD_DB = 9.0  # of a threshold about that at the frequency before
ABOVE_THRESHOLD_DB = 15.0  # of the tone that others are compared with
COMPARED_SD_DB = 6.0  # of equal strength about equal height above threshold
N_INTERVALS = 3
ORDER_HZ = (160.0, 100.0, 250.0, 63.0, 40.0)  # the one that is felt best first


@dataclass(frozen=True)
class Limits:
    """How many answers each part takes, and when it knows enough."""

    detect: tuple[int, int] = (6, 12)  # at least and at most, a frequency
    detect_sd_db: float = 2.5
    compare: tuple[int, int] = (4, 9)
    compare_sd_db: float = 1.75
    match: tuple[int, int] = (8, 25)
    match_sd: float = 0.15  # of each move, of half of its range


@dataclass(frozen=True)
class Question:
    """What is shown, and between how many an answer chooses.

    shown: `detect`: hertz, level [dB], interval of the tone; `compare`: hertz and level of each of the two; `match`: the moves of
    each, −1 to 1.
    """

    n: int
    part: str
    shown: tuple[float, ...]

    @property
    def n_choices(self) -> int:
        return N_INTERVALS if self.part == "detect" else 2


class Session:
    """The state of a user's session.

    Args:
        profile: of an earlier session, whose answers are taken over; or an empty one.
        max_db: level of the largest tone at `TONES_HZ`, in the profile's unit [dB].
        texture: its name, to be matched; empty for none.
        moves: which of `MOVES` it can be moved by.
        feel: whether thresholds and gains are measured.
        seed: of the order of intervals and of the pairs.
    """

    def __init__(
        self,
        profile: UserProfile,
        max_db: tuple[float, ...] = (0.0,) * len(TONES_HZ),
        texture: str = "",
        moves: tuple[str, ...] = tuple(MOVES),
        feel: bool = True,
        limits: Limits = Limits(),
        seed: int = 0,
    ) -> None:
        self.limits, self.texture, self._names, self._feel, self._seed = limits, texture, moves, feel, seed
        self._max_db = dict(zip(TONES_HZ, max_db, strict=True))
        self.thresholds: dict[float, LevelSearch] = {}
        self.gains: dict[float, LevelSearch] = {}
        self.preference = PreferenceSearch(len(moves), seed=seed)
        self._before, self.answers = profile, list[tuple[str, tuple[float, ...], int]]()
        self._enough = False
        self._questions = self._asked()
        self.question: Question | None = next(self._questions, None)
        self._take_over(profile)

    def _take_over(self, profile: UserProfile) -> None:
        """Give the answers of a profile again, those of parts that are asked here."""
        for part, shown, which in profile.answers:
            question = self.question
            if question is None or question.part != part or (part == "match" and profile.texture != self.texture):
                continue  # of a part that is left out now, or of another texture
            self.question = Question(question.n, part, shown)
            self.answer(question.n, which)

    def answer(self, n: int, which: int) -> None:
        """Take in the answer to question n: the number of what was chosen, from 0.

        Raises:
            ValueError: another question is open, or there is no such choice.
        """
        question = self.question
        if question is None or n != question.n:
            raise ValueError(f"answer to question {n}, expected one to {question.n if question else 'none'}")
        if not 0 <= which < question.n_choices:
            raise ValueError(f"choice {which}, expected 0 to {question.n_choices - 1}")
        self.answers.append((question.part, question.shown, which))
        self._take(question, which)
        self.question = next(self._questions, None)

    def stop(self) -> None:
        """Have the match end here: enough was chosen."""
        self._enough = True
        if self.question is not None and self.question.part == "match":
            self.question = None

    def _take(self, question: Question, which: int) -> None:
        shown = question.shown
        if question.part == "detect":
            self.thresholds[shown[0]].answer(shown[1], which == int(shown[2]))
        elif question.part == "compare":
            second = shown[0] == REFERENCE_HZ  # what is compared may come first or second
            hertz, level = shown[2:] if second else shown[:2]
            self.gains[hertz].answer(level, which == int(second))
        else:
            first, other = np.split(np.array(shown), 2)
            self.preference.answer(first, other, chose_first=which == 0)

    def _asked(self) -> Iterator[Question]:
        """The questions; each answer is taken in before the next is asked."""
        n = iter(range(1000))
        if self._feel:
            yield from self._detections(n)
            yield from self._comparisons(n)
        if self.texture:
            low, high = self.limits.match
            while self.preference.n_answers < high and not self._enough:
                if self.preference.n_answers >= low and self.preference.sd.max() < self.limits.match_sd:
                    break
                first, second = self.preference.pair()
                yield Question(next(n), "match", (*first.tolist(), *second.tolist()))

    def _detections(self, n: Iterator[int]) -> Iterator[Question]:
        expected = FIRST_EXPECTED_DB
        for hertz in ORDER_HZ:
            search = self.thresholds[hertz] = LevelSearch(LOWEST_DB, 0.0, Detection(1 / N_INTERVALS), expected)
            low, high = self.limits.detect
            while search.n_answers < low or (search.n_answers < high and search.sd > self.limits.detect_sd_db):
                number = next(n)
                interval = np.random.default_rng([self._seed, number]).integers(N_INTERVALS)
                yield Question(number, "detect", (hertz, search.stimulus(), float(interval)))
            expected = search.point, float(np.hypot(NEXT_SD_DB, search.sd))

    def _comparisons(self, n: Iterator[int]) -> Iterator[Question]:
        reference_db = self.reference_db
        above = reference_db - self.thresholds[REFERENCE_HZ].point
        for hertz in (hertz for hertz in ORDER_HZ if hertz != REFERENCE_HZ):
            threshold = self.thresholds[hertz]
            expected = min(0.0, threshold.point + above), float(np.hypot(COMPARED_SD_DB, threshold.sd))
            search = self.gains[hertz] = LevelSearch(LOWEST_DB, 0.0, Comparison(), expected)
            low, high = self.limits.compare
            while search.n_answers < low or (search.n_answers < high and search.sd > self.limits.compare_sd_db):
                number = next(n)
                tones = [(hertz, search.stimulus()), (REFERENCE_HZ, reference_db)]
                if np.random.default_rng([self._seed, number]).integers(2):
                    tones.reverse()
                yield Question(number, "compare", (*tones[0], *tones[1]))

    @property
    def reference_db(self) -> float:
        """Level of the tone that others are compared with [dB re the largest]."""
        return round(min(-6.0, self.thresholds[REFERENCE_HZ].point + ABOVE_THRESHOLD_DB), 1)

    @property
    def progress(self) -> dict[str, float]:
        """Share of each part that is done, as far as it can be known."""

        def share(searches: dict[float, LevelSearch], n: int, limit: tuple[int, int], enough: float) -> float:
            done = sum(
                min(1.0, search.n_answers / limit[1]) if search.sd > enough else 1.0 for search in searches.values()
            )
            return done / n

        parts = {}
        if self._feel:
            detect, compare = self.limits.detect, self.limits.compare
            parts["detect"] = share(self.thresholds, len(TONES_HZ), detect, self.limits.detect_sd_db)
            parts["compare"] = share(self.gains, len(TONES_HZ) - 1, compare, self.limits.compare_sd_db)
        if self.texture:
            parts["match"] = self.preference.n_answers / self.limits.match[1]
        part = self.question.part if self.question else ""
        order = list(parts)
        return {
            name: 1.0 if not part or order.index(name) < order.index(part) else done for name, done in parts.items()
        }

    @property
    def profile(self) -> UserProfile:
        """What is known so far: a part that has not ended is left as it was before."""
        left_out = {"detect", "compare"} if not self._feel else set() if self.texture else {"match"}
        others = [answer for answer in self._before.answers if answer[0] in left_out]
        out = replace(self._before, answers=(*others, *self.answers))
        part = self.question.part if self.question else "end"
        if self._feel and part != "detect":
            found = [self.thresholds[hertz] for hertz in TONES_HZ]
            levels = [search.point + self._max_db[hertz] for search, hertz in zip(found, TONES_HZ, strict=True)]
            out = replace(out, threshold_db=_rounded(levels), threshold_sd_db=_rounded([one.sd for one in found]))
        if self._feel and part in ("match", "end"):
            equal = self.reference_db + self._max_db[REFERENCE_HZ]
            gains, sds = [], []
            for hertz in TONES_HZ:
                search = self.gains.get(hertz)
                gains.append(0.0 if search is None else search.point + self._max_db[hertz] - equal)
                sds.append(0.0 if search is None else search.sd)
            out = replace(out, gain_db=_rounded(gains), gain_sd_db=_rounded(sds))
        if self.texture and self.preference.n_answers:
            found_moves = self.moves(self.preference.point)
            sds = [self.preference.sd[self._names.index(name)] if name in self._names else 0.0 for name in MOVES]
            spread = [sd * most for sd, most in zip(sds, MOVES.values(), strict=True)]
            out = replace(out, texture=self.texture, moves=_rounded(found_moves, 3), moves_sd=_rounded(spread, 3))
        return out

    def moves(self, point: Array) -> list[float]:
        """Moves in their units at a point of the searched box."""
        at = dict(zip(self._names, point.tolist(), strict=True))
        return [at.get(name, 0.0) * most for name, most in MOVES.items()]


def _rounded(values: list[float], digits: int = 2) -> tuple[float, ...]:
    return tuple(round(float(value), digits) for value in values)


def answered_by(session: Session, person: Callable[[Question], int]) -> UserProfile:
    """The profile of a person who answers until nothing is asked: a simulated one, in tests and in the documents' figures."""
    while (question := session.question) is not None:
        session.answer(question.n, person(question))
    return session.profile
