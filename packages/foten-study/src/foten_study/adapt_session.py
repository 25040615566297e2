"""The questions of `foten adapt`, one after another, and the profile that their answers make.

    detect   one of three flashes is a tone: which?        five frequencies, to a threshold
    compare  two tones: which is stronger?                  four frequencies, to equal strength with 160 Hz
    match    two textures beside a real surface: which is nearer?   up to 25 choices

A session goes on from the answers in a profile, as if it had not ended.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from foten.dsp import Array
from foten.editing.user import MOVES, REFERENCE_HZ, TONES_HZ, Answer, UserProfile
from foten_study.adaptive import Comparison, Detection, LevelSearch, PreferenceSearch

LOWEST_DB = -84.0  # re the largest tone that the output has
FIRST_EXPECTED_DB = (-45.0, 15.0)  # threshold at the first frequency, mean and standard deviation
NEXT_SD_DB = 9.0  # of a threshold about that at the frequency before
ABOVE_THRESHOLD_DB = (6.0, 15.0)  # of the tone that others are compared with: at least, and where there is room
COMPARED_SD_DB = 6.0  # of equal strength about equal height above threshold
UNFELT_DB = -6.0  # a threshold above this cannot be told from nothing at all
ROOM_DB = 3.0  # that the tones of equal strength are expected to leave below the largest
SEARCHED_ABOVE_DB = 24.0  # the largest tone, for equal strength; half of it for thresholds
UNKNOWN_SD_DB = 20.0  # of a gain at a frequency that was not felt
STEPS_OF_RANGE = 5  # just noticeable differences in half of `MOVES`, as is assumed
N_INTERVALS = 3
ORDER_HZ = (160.0, 100.0, 250.0, 63.0, 40.0)  # the one that is felt best first
FULL_RANGES: Mapping[str, tuple[float, float]] = {name: (-limit, limit) for name, limit in MOVES.items()}


@dataclass(frozen=True)
class Limits:
    """How many answers each part takes, and when it knows enough."""

    detect: tuple[int, int] = (6, 12)  # at least and at most, a frequency
    detect_sd_db: float = 3.5
    compare: tuple[int, int] = (4, 9)
    compare_sd_db: float = 1.75
    match: tuple[int, int] = (8, 25)
    match_sd: float = 0.75  # of each move, just noticeable differences


@dataclass(frozen=True)
class Question:
    """What is shown, and between how many an answer chooses.

    shown: `detect`: hertz, level [dB], interval of the tone; `compare`: hertz and level of each of the two; `match`: the moves of
    each, −1 to 1 of their ranges.
    """

    n: int
    part: str
    shown: tuple[float, ...]

    @property
    def n_choices(self) -> int:
        return N_INTERVALS if self.part == "detect" else 2


class Session:
    """The state of a user's session; `question` is the one that is open, None at the end.

    Args:
        profile: of an earlier session, whose answers are taken over; or one without answers. Its `max_db` are the largest tones.
        texture: its name, to be matched; empty for none.
        ranges: moves that change it, from where to where in the units of `MOVES`.
        feel: whether thresholds and gains are measured.
        seed: of the order of intervals and of the pairs.
    """

    def __init__(
        self,
        profile: UserProfile,
        texture: str = "",
        ranges: Mapping[str, tuple[float, float]] = FULL_RANGES,
        feel: bool = True,
        limits: Limits = Limits(),
        seed: int = 0,
    ) -> None:
        self.limits, self.texture, self._feel, self._seed = limits, texture, feel, seed
        self._ranges = dict(ranges)
        self._max_db = dict(zip(TONES_HZ, profile.max_db, strict=True))
        self.thresholds: dict[float, LevelSearch] = {}
        self.gains: dict[float, LevelSearch] = {}
        low, high = np.array(list(self._ranges.values())).T
        self._centre, self._half = (low + high) / 2, (high - low) / 2
        self._jnd = np.array([MOVES[name] / STEPS_OF_RANGE for name in self._ranges]) / self._half
        self.preference = PreferenceSearch(len(self._half), self._jnd, seed)
        self.answers: list[Answer] = []
        self.silent, self._enough, self.n_dropped = False, False, 0
        if feel and not profile.gain_db:
            before = profile.answers
            kept = tuple(answer for answer in before if not answer[0].startswith("match:"))
            self.n_dropped = len(before) - len(kept)
            profile = replace(profile, answers=kept, texture="", moves=(), moves_sd=())
        self._before = profile
        self._stored: dict[str, list[Answer]] = {}
        for answer in profile.answers:
            self._stored.setdefault(answer[0], []).append(answer)
        self._questions = self._asked()
        self.question: Question | None = next(self._questions, None)
        self._take_over()

    def _key(self, part: str) -> str:
        """What answers of a part are stored under."""
        return f"match:{self.texture}" if part == "match" else part

    def _take_over(self) -> None:
        """Give stored answers again, as long as there are some of the part that is asked."""
        while self.question is not None and (stored := self._stored.get(self._key(self.question.part))):
            _, shown, which = stored.pop(0)
            if len(shown) == len(self.question.shown):  # else of a texture that moved otherwise
                self._take(Question(self.question.n, self.question.part, shown), which)
                self.question = next(self._questions, None)

    def answer(self, n: int, which: int) -> None:
        """Take in the number of what was chosen, from 0; ValueError where another question is open, or it is no choice."""
        question = self.question
        if question is None or n != question.n:
            raise ValueError(f"answer to question {n}, expected one to {question.n if question else 'none'}")
        if not 0 <= which < question.n_choices:
            raise ValueError(f"choice {which}, expected 0 to {question.n_choices - 1}")
        self._take(question, which)
        self.question = next(self._questions, None)
        self._take_over()

    def stop(self) -> None:
        """Have the match end here: enough was chosen."""
        self._enough = True
        if self.question is not None and self.question.part == "match":
            self.question = None

    def _take(self, question: Question, which: int) -> None:
        self.answers.append((self._key(question.part), question.shown, which))
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
            if self.silent:
                return
            yield from self._comparisons(n)
        if self.texture:
            low, high = self.limits.match
            while self.preference.n_answers < high and not self._enough:
                if self.preference.n_answers >= low and (self.preference.sd / self._jnd).max() < self.limits.match_sd:
                    break
                first, second = self.preference.pair()
                yield Question(next(n), "match", (*first.tolist(), *second.tolist()))

    def _detections(self, n: Iterator[int]) -> Iterator[Question]:
        expected, kind = FIRST_EXPECTED_DB, Detection(1 / N_INTERVALS)
        for hertz in ORDER_HZ:
            search = self.thresholds[hertz] = LevelSearch(LOWEST_DB, 0.0, kind, expected, SEARCHED_ABOVE_DB / 2)
            low, high = self.limits.detect
            while search.n_answers < low or (search.n_answers < high and search.sd > self.limits.detect_sd_db):
                number = next(n)
                interval = np.random.default_rng([self._seed, number]).integers(N_INTERVALS)
                yield Question(number, "detect", (hertz, search.stimulus(), float(interval)))
            if hertz == REFERENCE_HZ and search.point > UNFELT_DB:
                self.silent = True
                return
            expected = min(search.point, UNFELT_DB), float(np.hypot(NEXT_SD_DB, search.sd))

    def _comparisons(self, n: Iterator[int]) -> Iterator[Question]:
        reference_db = self.reference_db
        above = reference_db - self.thresholds[REFERENCE_HZ].point
        for hertz in (hertz for hertz in ORDER_HZ if hertz != REFERENCE_HZ and hertz not in self.unfelt_hz):
            threshold = self.thresholds[hertz]
            expected = threshold.point + above, float(np.hypot(COMPARED_SD_DB, threshold.sd))
            search = self.gains[hertz] = LevelSearch(LOWEST_DB, 0.0, Comparison(), expected, SEARCHED_ABOVE_DB)
            low, high = self.limits.compare
            while search.n_answers < low or (search.n_answers < high and search.sd > self.limits.compare_sd_db):
                number = next(n)
                tones = [(hertz, search.stimulus()), (REFERENCE_HZ, reference_db)]
                if np.random.default_rng([self._seed, number]).integers(2):
                    tones.reverse()
                yield Question(number, "compare", (*tones[0], *tones[1]))

    @property
    def unfelt_hz(self) -> tuple[float, ...]:
        """Frequencies whose threshold lies near the largest tone, or above."""
        return tuple(hertz for hertz in TONES_HZ if self.thresholds[hertz].point > UNFELT_DB)

    @property
    def reference_db(self) -> float:
        """Level of the tone that others are compared with, such that these have room [dB re the largest]."""
        felt = [self.thresholds[hertz].point for hertz in TONES_HZ if hertz not in self.unfelt_hz]
        least, wanted = ABOVE_THRESHOLD_DB
        above = max(least, min(wanted, -ROOM_DB - max(felt)))
        return round(min(-ROOM_DB, self.thresholds[REFERENCE_HZ].point + above), 1)

    @property
    def progress(self) -> dict[str, float]:
        """Share of each part that is done, as far as it can be known."""

        def share(searches: Mapping[float, LevelSearch], n: int, high: int, enough: float) -> float:
            return sum(1.0 if one.sd <= enough else min(1.0, one.n_answers / high) for one in searches.values()) / n

        parts = {}
        if self._feel:
            detect, compare = self.limits.detect[1], self.limits.compare[1]
            parts["detect"] = share(self.thresholds, len(TONES_HZ), detect, self.limits.detect_sd_db)
            parts["compare"] = share(self.gains, len(TONES_HZ) - 1, compare, self.limits.compare_sd_db)
        if self.texture:
            parts["match"] = self.preference.n_answers / self.limits.match[1]
        order, part = list(parts), self.question.part if self.question else ""
        is_done = {name: not part or order.index(name) < order.index(part) for name in order}
        return {name: 1.0 if is_done[name] else min(done, 1.0) for name, done in parts.items()}

    @property
    def profile(self) -> UserProfile:
        """What is known so far: a part that has not ended is left as it was before."""
        out = replace(self._before, answers=self._all_answers())
        part = self.question.part if self.question else "end"
        if self._feel and part != "detect" and not self.silent:
            searches = [self.thresholds[hertz] for hertz in TONES_HZ]
            levels = [one.point + self._max_db[hertz] for one, hertz in zip(searches, TONES_HZ, strict=True)]
            out = replace(out, threshold_db=_rounded(levels), threshold_sd_db=_rounded([one.sd for one in searches]))
        if self._feel and part in ("match", "end") and not self.silent:
            gains, sds = zip(*map(self._gain, TONES_HZ), strict=True)
            out = replace(out, gain_db=_rounded(gains), gain_sd_db=_rounded(sds))
        if self.texture and self.preference.n_answers >= self.limits.match[0]:
            point, sd = self.preference.point, self.preference.sd
            spread = dict(zip(self._ranges, (sd * self._half).tolist(), strict=True))
            moves, moves_sd = self.moves(point), [spread.get(name, 0.0) for name in MOVES]
            out = replace(out, texture=self.texture, moves=_rounded(moves, 3), moves_sd=_rounded(moves_sd, 3))
        return out

    def _all_answers(self) -> tuple[Answer, ...]:
        """Those that were taken in and those still stored, in order of their parts; none of tones that were not felt."""
        every = [*self.answers, *(answer for stored in self._stored.values() for answer in stored)]
        if self.silent:
            every = [answer for answer in every if answer[0].startswith("match:")]
        parts = {"detect": 0, "compare": 1}
        return tuple(sorted(every, key=lambda answer: parts.get(answer[0], len(parts))))

    def _gain(self, hertz: float) -> tuple[float, float]:
        """Gain [dB] by which a tone, or the nearest that was felt, is as strong as the reference, and its standard deviation."""
        if hertz == REFERENCE_HZ:
            return 0.0, 0.0
        if (search := self.gains.get(hertz)) is None:
            felt = [other for other in TONES_HZ if other == REFERENCE_HZ or other in self.gains]
            return self._gain(min(felt, key=lambda other: abs(np.log(other / hertz))))[0], UNKNOWN_SD_DB
        equal = self.reference_db + self._max_db[REFERENCE_HZ]
        return search.point + self._max_db[hertz] - equal, search.sd

    def moves(self, point: Array) -> list[float]:
        """Moves in their units, in the order of `MOVES`, at a point of the searched box."""
        at = dict(zip(self._ranges, (self._centre + point * self._half).tolist(), strict=True))
        return [at.get(name, 0.0) for name in MOVES]

    def set_volume(self, volume_db: float) -> None:
        """Take in the volume of the page [dB] that the texture is matched at."""
        self._before = replace(self._before, volume_db=volume_db)


def _rounded(values: tuple[float, ...] | list[float], digits: int = 2) -> tuple[float, ...]:
    return tuple(round(float(value), digits) for value in values)


def answered_by(session: Session, person: Callable[[Question], int]) -> UserProfile:
    """The profile of a person who answers until nothing is asked: a simulated one, in tests and in the documents' figures."""
    while (question := session.question) is not None:
        session.answer(question.n, person(question))
    return session.profile
