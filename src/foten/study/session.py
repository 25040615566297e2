"""One participant while the study runs: the steps, the pages that show the present one, and the contact of its trial."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from foten.runtime.live.devices import SOUND_RATE_HZ
from foten.runtime.live.live import LiveStatistics, Timing
from foten.runtime.native import NativeTexture
from foten.runtime.renderer import Renderer
from foten.runtime.stylus import PressureCalibration, Stylus
from foten.studio.live_contact import Contact
from foten.studio.messages import RefusedError
from foten.studio.players import BLOCK_MS
from foten.study.design import CHOICE, CHOICES, Design, Question
from foten.study.languages import Language
from foten.study.orders import Trial
from foten.study.schema import now
from foten.study.store import Rated, Stroked
from foten.study.thresholds import gain_db, level_search

if TYPE_CHECKING:
    from foten.study.page_sockets import ParticipantPage
    from foten.study.study_server import StudyServer

MAX_ANSWER_LENGTH = 2000  # characters
SAVE_STROKES_S = 1.0  # between two writings of a stroke
CLOCK_TOLERANCE_S = 0.25  # by which a page's clock may be ahead of the server's
MAX_MISSED = 20 * 60 * 1000  # events of a trial that are sent again: 20 minutes of the fastest pen
COME_BACK_S = 5.0  # for the tablet of two screens, before an answer is taken without it
RETURNED = 4003  # code of the end of a WebSocket whose place was returned
MAX_APART_S = 0.25  # of two events of one contact: a pen at rest sends few
INTERVALS = {"rating": (), "paired": ("A", "B"), "abx": ("A", "B", "X"), "oddity": ("1", "2", "3")}
INTERVALS["threshold"] = INTERVALS["oddity"]
SEED_STEP = 10_000_000  # between the noise of two surfaces
NO_CONDITIONS: NDArray[np.float64] = np.zeros((0, 2))
PLACES = {"all": ("stroke", "answer"), "stroke": ("stroke",), "answer": ("answer",)}  # that a page of a role takes
MIN_CONTACT_N = 0.01  # of force, below which the pen does not count as in contact


Step = dict[str, Any]  # with an `id` and a `kind`


class NotYetError(RefusedError):
    """A good answer, which can be sent again as it is a little later."""


class Session:
    """A participant of a study that runs.

    A step that was answered is in the database before the next is shown; where a participant is, the database knows.
    """

    def __init__(self, server: StudyServer, number: int, code: str, trials: Sequence[Trial], done: set[str]) -> None:
        self.server, self.number, self.code = server, number, code
        self.steps, self.done = steps_of(server.design, trials), done
        self.pages: set[ParticipantPage] = set()
        self.asking: dict[int, ParticipantPage] = {}  # to go on where another device was, by the number of the request
        self.contact: Contact | None = None
        self._page: ParticipantPage | None = None  # that the contact plays for
        self._unsaved: dict[int, Unsaved] = {}  # by trial, also of those that were rated while the disk was full
        self._n_missed: dict[int, int] = {}  # events that were sent again, by trial
        # Events by trial, as the page counts them: stored, unsaved, or left out.
        self._n_taken: dict[int, int] = {}
        self._alone_since = time.monotonic()  # without a page to stroke on, where there is none
        self._refused: list[Callable[[], Any]] = []  # other changes that the disk had no room for, in their order
        self._writing = asyncio.Lock()
        self._saved_at = 0.0
        self.trouble = ""  # for the operator: why the last answer was not stored, or nothing plays
        self._changing = asyncio.Lock()
        # Where an operator gives out the codes, a place waits for its first page.
        self.last_message_at = math.inf if server.design.setup.operator else time.monotonic()
        self._log = TrialLog()
        self._arrive()
        step = self.step
        if step["kind"] == "trial":  # as it was before the server ended
            sides = server.store.switches(number, step["trial"].number)
            self.n_switches, self.n_real = len(sides), sides.count("real")
            stroked = server.store.parts(number, step["trial"].number)
            self._log.earlier = np.concatenate([NO_CONDITIONS, *(part.conditions for part in stroked)])
            self._log.events = [(part.interval, part.events) for part in stroked]
            self._n_taken[step["trial"].number] = sum(len(part.events) for part in stroked)
            since = server.store.shown(number, step["trial"].number)
            if since is not None and not self.held:
                self.shown_at = time.monotonic() - max(0.0, time.time() - since)  # 0 where the clock was set back

    @property
    def step(self) -> Step:
        """First step that is not completed."""
        return next((step for step in self.steps if step["id"] not in self.done), self.steps[-1])

    async def return_place(self) -> None:
        """Let the next one have the number and its order; RefusedError where a step was completed, OSError of the disk."""
        async with self._changing:  # not between an answer and its being stored
            if self.done or self.server.sessions.get(self.number) is not self:
                raise RefusedError(f"participant {self.number} has answered, or is gone: nothing is returned")
            await self.server.on_disk(partial(self.server.store.return_place, self.number))
            del self.server.sessions[self.number]
        self.server.admitted.drop(f"{self.code} ")
        for page in [*self.pages, *self.asking.values()]:
            page.end(RETURNED, "the place was returned")

    def _arrive(self) -> None:
        """Begin a step: with an operator, a trial waits until the real sample lies there."""
        self.held = self.step["kind"] == "trial" and self.server.design.setup.operator
        self.side, self.interval, self.shown_at = "virtual", 0, 0.0
        self.n_switches = self.n_real = 0  # to the real surface
        self._log = TrialLog()
        self._n_underruns: int | None = None  # of the trial, as a tablet beside the screen of the answer said
        self._down = False  # the pen, on a surface that is rendered
        self._level_db: float | None = None  # of a threshold's trial, once it is stroked

    def is_open_to(self, device: str | None, role: str) -> bool:
        """Whether a device may take a role without being allowed: it had it last, or none had it yet."""
        admitted, places = self.server.admitted, self._places(role)
        return device is None or all(not admitted.has(place) or admitted.knows(device, place) for place in places)

    def give(self, device: str | None, role: str) -> None:
        """Let a device be the last that had a role, also for the next server."""
        if device is not None:
            for place in self._places(role):
                self.server.admitted.put(place, device)

    def _places(self, role: str) -> list[str]:
        return [f"{self.code} {place}" for place in PLACES[role]]

    def shown(self) -> Step:
        """The step as a participant's page gets it: nothing of methods."""
        step, design = self.step, self.server.design
        shown: Step = {name: value for name, value in step.items() if name not in ("trial", "questions")}
        shown |= {"simulated": self.server.store.simulated, "held": self.held}
        if step["kind"] == "questions":
            shown["questions"] = [
                {name: getattr(q, name) for name in ("key", "text", "kind", "options", "required", "low", "high")}
                for q in step["questions"]
            ]
        if step["kind"] == "trial":
            trial: Trial = step["trial"]
            texture, task, setup = design.textures[trial.texture], design.task, design.setup
            shown |= {"practice": trial.practice, "real_side": design.real_side, "screens": setup.screens}
            shown |= {"task": task.kind, "question": task.question, "scales": [asdict(scale) for scale in design.asked]}
            shown |= {"intervals": INTERVALS[task.kind], "choices": CHOICES.get(task.kind, ())}
            touched = [i for i in range(self._n_intervals) if self._log.contact_s(i)]
            shown |= {"interval": self.interval, "touched": touched}
            shown |= {"min_s": task.min_seconds, "side": self.side, "stored": self._n_taken.get(trial.number, 0)}
            shown |= {"lacks_real": self.lacks_real}
            if setup.show_names:
                shown |= {"name": texture.name, "picture": f"pictures/{trial.texture}" if texture.picture else None}
        return shown

    def _mark(self, event: str, **about: Any) -> None:
        """Send a marker of the present trial, where somebody asked for them."""
        if self.server.markers is not None:
            trial: Trial = self.step["trial"]
            texture = self.server.design.textures[trial.texture].key
            self.server.markers.send(event, participant=self.number, trial=trial.number, texture=texture, **about)

    def _mark_lift(self) -> None:
        """Mark that the pen left the surface that it was on."""
        if self._down:
            self._mark("lift", surface=self.interval + 1)
        self._down = False

    async def show(self) -> None:
        """Show the step on all pages."""
        for page in list(self.pages):
            await page.show()

    async def begin_showing(self) -> None:
        """Count the time of a trial from when it is shown first; the end is completed once it is shown."""
        step, store = self.step, self.server.store
        if step["kind"] == "trial" and not self.held and not self.shown_at:
            self.shown_at = time.monotonic()
            self._mark("trial")
            await self._write(partial(store.add_shown, self.number, step["trial"].number, time.time()))
        elif step["kind"] == "end" and step["id"] not in self.done:
            self.done.add(step["id"])
            await self._write(partial(store.take_step, self.number, step["id"]))

    async def _write(self, *changes: Callable[[], Any]) -> None:
        """Write changes, and those before that the disk refused: a full disk does not stop a hand, the answer will say it."""
        async with self._writing:
            waiting, self._refused = [*self._refused, *changes], []
            try:
                while waiting:
                    await self.server.on_disk(waiting[0])
                    del waiting[0]
            except OSError:
                self._refused = waiting

    async def finish(self, step_id: str, message: Mapping[str, Any]) -> dict[str, Any] | None:
        """Take the answers of a step, into the database, and go on; a completed step is left as it is.

        Returns:
            Whether the answer was right, and what would have been, where the study says so; otherwise None.

        Raises:
            RefusedError: it is not this step's turn, or an answer is missing or wrong, or cannot be stored.
        """
        async with self._changing:
            if step_id in self.done:
                return None  # sent again by a page that did not learn that it was taken
            if self.server.sessions.get(self.number) is not self:  # its place was returned
                raise RefusedError(self.server.design.language.say("no_such_code"))
            step = self.step
            if step_id != step["id"]:
                raise RefusedError(f"it is the turn of {step['id']}, not of {step_id[:40]!r}")
            if step["kind"] == "end":
                return None
            await self._store(step, message)
            if step["kind"] == "trial":
                self._mark_lift()
                self._mark("answer", values=message["values"])
            self.done.add(step_id)
            await self.end_contact()
            self._arrive()
            return self._feedback(step, message)

    def _feedback(self, step: Step, message: Mapping[str, Any]) -> dict[str, Any] | None:
        task = self.server.design.task
        if step["kind"] != "trial" or task.kind not in ("abx", "oddity", "threshold"):
            return None
        trial: Trial = step["trial"]
        if task.feedback == "none" or (task.feedback == "practice" and not trial.practice):
            return None
        right = message["values"][CHOICE] == trial.target
        return {"right": right, "was": CHOICES[task.kind][trial.target]}

    async def _store(self, step: Step, message: Mapping[str, Any]) -> None:
        store, number = self.server.store, self.number
        answers: dict[str, Any] = {}
        if step["kind"] == "consent":
            answers["consent"] = step["text"]
        elif step["kind"] == "questions":
            answers["answers"], answers["private"] = checked_answers(
                step["questions"], message.get("answers", {}), self.server.design.language
            )
        elif step["kind"] == "trial":
            self._check_trial_may_end()
            values = checked_values(self.server.design, message.get("values"))
            await self.save_strokes()
            level_db = await self._level(step["trial"]) if self.server.design.task.kind == "threshold" else None
            answers["rated"] = step["trial"].number, self._rated(values, level_db, message)
        try:
            await self.server.on_disk(lambda: store.take_step(number, step["id"], **answers))
        except OSError as error:
            self.trouble = str(error)
            raise NotYetError(self.server.design.language.say("not_stored")) from error
        self.trouble = ""

    @property
    def lacks_real(self) -> bool:
        """Whether nobody has said in this trial that the real surface is touched, where that is asked for."""
        design = self.server.design
        return design.setup.real_checked and design.real_side != "none" and not self.n_real

    def _check_trial_may_end(self) -> None:
        design = self.server.design
        language, task = design.language, design.task
        if self.held:
            raise NotYetError(language.say("operator_holds"))
        if self._strokes_are_coming():
            raise NotYetError(language.say("one_moment"))
        min_s = task.min_seconds
        shown_s = time.monotonic() - self.shown_at if self.shown_at else 0.0
        if shown_s < min_s - CLOCK_TOLERANCE_S:  # by this clock: a page could say anything
            raise RefusedError(
                language.say("wait" if design.real_side == "none" else "explore_first", s=math.ceil(min_s))
            )
        if min_s and not all(self._log.contact_s(interval) for interval in range(self._n_intervals)):
            raise RefusedError(language.say("stroke_first" if self._n_intervals == 1 else "stroke_each"))
        if self.lacks_real:
            raise RefusedError(language.say("touch_real", real=language.say("real_surface")))

    def _strokes_are_coming(self) -> bool:
        """Whether a page still sends again what an outage kept, or may come back with it."""
        if stroking := [page for page in self.pages if page.strokes]:
            return any(page.n_again > 0 for page in stroking)
        return self.server.design.setup.screens > 1 and time.monotonic() - self._alone_since < COME_BACK_S

    def _rated(self, values: Mapping[str, float], level_db: float | None, message: Mapping[str, Any]) -> Rated:
        log = self._log.summary()
        if (n_intervals := len(INTERVALS[self.server.design.task.kind])) > 1:
            log |= {f"contact_s_{i + 1}": round(self._log.contact_s(i), 3) for i in range(n_intervals)}
        if level_db is not None:
            log["level_db"] = level_db
        if self.server.output is None:  # the sound runs dry in the tablet, if anywhere, and its page counts that
            log["n_underruns"] = message.get("underruns", self._n_underruns)
        page = next((page for page in self.pages if page.strokes), None)
        if page is not None:
            curve = page.calibration
            log |= {"volume_db": page.volume_db, "rate_hz": page.rate_hz, "newtons": curve.a, "steepness": curve.b}
        return Rated(values, message.get("seconds"), self.n_switches, log)

    async def turn(self, side: str, marked_by: str, interval: int | None = None) -> None:
        """Go over to the real surface, or to a virtual one, of several by its number; on the real one the virtual are silent.

        The page is told at once, however long the rest takes: that might tell methods apart.
        """
        async with self._changing:  # an answer or a hold that came now would end the contact
            step, design = self.step, self.server.design
            intervals = INTERVALS[design.task.kind]
            interval = self.interval if interval is None else int(interval)
            if side == "real" and design.real_side == "none":
                raise RefusedError("this study has no real surface")
            if not 0 <= interval < self._n_intervals:
                raise RefusedError(f"side: interval is {interval}, expected one of {len(intervals)}")
            if step["kind"] != "trial" or self.held or (side, interval) == (self.side, self.interval):
                return
            self._mark_lift()
            moved, self.side, self.interval = interval != self.interval, side, interval
            self.n_switches += 1
            self.n_real += side == "real"
            trial: Trial = step["trial"]
            named = f"virtual {intervals[interval]}" if side == "virtual" and intervals else side
            at = now()
            await self.show()
            if self.contact is not None and side == "real":
                self.contact.lift()
            if self.contact is not None and moved and self._page is not None:
                await self._put_under_pen(self.contact, self._page, trial)
            await self._write(partial(self.server.store.add_switch, self.number, trial.number, named, marked_by, at=at))

    def count_underruns(self, step_id: str, n: int) -> None:
        """Take how many under-runs a trial has had so far."""
        if step_id == self.step["id"]:
            self._n_underruns = n

    async def hold(self, held: bool) -> None:
        """Hold the trial that is shown, or let it go on."""
        async with self._changing:
            self.held = held and self.step["kind"] == "trial"
            if self.held:
                await self.end_contact()
            await self.show()

    async def push(self, page: ParticipantPage, events: NDArray[np.float64]) -> None:
        """Take in events of the pen; the first of a trial make its texture ready."""
        step = self.step
        if step["kind"] != "trial":
            return
        if self.held or self.side == "real":  # they were on their way
            self._count(step["trial"].number, len(events))
            return
        if self.contact is None:
            async with self._changing:
                if self.contact is None and self.step is step:
                    await self._open(page, step["trial"])
        if self.contact is not None and not self.contact.player.running:
            await self._end_stopped(self.contact)
        if self.contact is not None:
            self.contact.push(events)
            down = bool(events[-1, 2] > 0)
            if down and not self._down:
                self._mark("contact", surface=self.interval + 1)
            elif not down:
                self._mark_lift()
            self._down = down
            self._of_trial(step["trial"]).events.append((self.interval, events))
            self._log.events.append((self.interval, events))
            self._count(step["trial"].number, len(events))
            if time.monotonic() - self._saved_at > SAVE_STROKES_S:
                await self.save_strokes()

    def _count(self, trial: int, n_events: int) -> None:
        self._n_taken[trial] = self._n_taken.get(trial, 0) + n_events

    async def push_missed(
        self, page: ParticipantPage, number: int, interval: int, first: int, events: NDArray[np.float64]
    ) -> None:
        """Take in events that a server did not store before it was killed, or that fell into its absence: not rendered.

        Those of a trial that was answered meanwhile are stored, and are not in its rating's measures.

        Args:
            number: of their trial.
            first: number of the first one in the trial, as the page counts: what was taken is not taken twice.
        """
        present = self.step["id"]
        trial = next((step["trial"] for step in self.steps if step["id"] == f"trial:{number}"), None)
        if trial is None or f"trial:{number}" not in (present, *self.done):
            raise RefusedError(f"events of trial {number}, which was not shown")
        log = self._log if present == f"trial:{number}" else TrialLog()  # of now: the trial may end meanwhile
        methods = trial.intervals(self.server.design.task.kind)
        if not interval < len(methods):
            raise RefusedError(f"events of surface {interval + 1}, expected one of {len(methods)}")
        n_missed = self._n_missed.get(trial.number, 0) + len(events)
        if n_missed > MAX_MISSED:
            raise RefusedError(f"more than {MAX_MISSED} events of trial {trial.number} that are sent again")
        self._n_missed[trial.number] = n_missed
        if number not in self._n_taken:
            parts = await self.server.on_disk(lambda: self.server.store.parts(self.number, number))
            self._n_taken[number] = sum(len(part.events) for part in parts)
        events = events[max(0, self._n_taken[number] - first) :]
        if not len(events):
            return
        texture = self.server.stimuli.bytes_of[trial.texture, methods[interval]]
        conditions = await asyncio.to_thread(conditions_of, events, texture, page.calibration)
        unsaved = self._of_trial(trial)
        unsaved.events.append((interval, events))
        unsaved.conditions.extend((interval, *condition) for condition in conditions)
        log.conditions.extend(conditions)
        log.events.append((interval, events))
        self._n_taken[number] = max(self._n_taken[number], first) + len(events)
        if time.monotonic() - self._saved_at > SAVE_STROKES_S:
            await self.save_strokes()

    async def _open(self, page: ParticipantPage, trial: Trial) -> None:
        server = self.server
        plays_in_page, log = server.output is None, self._log

        def on_block(samples: NDArray[np.float32], speed: float, force: float) -> None:
            log.conditions.append((speed, force))
            self._of_trial(trial).conditions.append((self.interval, speed, force))
            if plays_in_page:
                page.blocks.put(samples * np.float32(contact.gain), speed, force)  # the page bends what is too loud

        try:
            player = await asyncio.to_thread(server.player, page.rate_hz if plays_in_page else SOUND_RATE_HZ)
        except (OSError, ValueError) as error:
            raise self._unplayable(error) from error
        contact = Contact(player, on_block)
        try:
            await asyncio.to_thread(contact.load, [self._surface(trial, i) for i in range(self._n_intervals)])
            await self._put_under_pen(contact, page, trial)
        except BaseException as error:  # a device that stays open refuses the next event too
            with contextlib.suppress(OSError, ValueError, RuntimeError):
                await asyncio.to_thread(contact.close)
            if isinstance(error, OSError | ValueError) and not isinstance(error, RefusedError):
                raise self._unplayable(error) from error
            raise
        self._log.contacts.append(player.statistics)
        self.contact, self._page, self._saved_at = contact, page, time.monotonic()

    async def _end_stopped(self, contact: Contact) -> None:
        """Refuse an event of a contact whose output ended by itself; the next one begins another."""
        async with self._changing:
            if self.contact is not contact:  # it was ended meanwhile
                return
            self.contact = None
            self._log.n_stopped += 1
            try:
                await asyncio.to_thread(contact.close)
            except (OSError, ValueError, RuntimeError) as error:
                raise self._unplayable(error) from error
            raise self._unplayable(OSError("the output ended by itself"))

    async def _put_under_pen(self, contact: Contact, page: ParticipantPage, trial: Trial) -> None:
        """Let a contact render the surface that is stroked, at its level."""
        server, task = self.server, self.server.design.task
        volume_db = server.design.output.volume_db
        volume_db += server.gains[trial.texture, trial.intervals(task.kind)[self.interval]]
        if task.kind == "threshold":
            volume_db += gain_db(task, await self._level(trial), self.interval == trial.target)
        texture, seed = self._surface(trial, self.interval)
        try:
            await asyncio.to_thread(contact.open, texture, page.calibration, seed, volume_db)
        except (OSError, ValueError) as error:
            raise self._unplayable(error) from error
        self.trouble = ""

    @property
    def _n_intervals(self) -> int:
        return max(1, len(INTERVALS[self.server.design.task.kind]))

    def _surface(self, trial: Trial, interval: int) -> tuple[bytes, int]:
        """Texture file of a surface of a trial, and the seed of its noise, of which no two have the same."""
        method = trial.intervals(self.server.design.task.kind)[interval]
        seed = 1000 * self.number + trial.number + 500 + SEED_STEP * interval
        return self.server.stimuli.bytes_of[trial.texture, method], seed

    def _unplayable(self, error: Exception) -> RefusedError:
        self.trouble = f"nothing can be played: {error}"
        return RefusedError(self.server.design.language.say("cannot_play"))

    async def _level(self, trial: Trial) -> float:
        """Level of a threshold's trial, which the answers before it lead to [dB]."""
        if self._level_db is None:
            store, task, of = self.server.store, self.server.design.task, (self.number, trial.texture, trial.method)
            if trial.practice:
                self._level_db = task.high_db
            else:
                answers = await self.server.on_disk(lambda: store.levels(*of))
                self._level_db = level_search(task, answers).stimulus()
        return self._level_db

    def _of_trial(self, trial: Trial) -> Unsaved:
        return self._unsaved.setdefault(trial.number, Unsaved())

    async def save_strokes(self) -> None:
        """Write what is not in the database yet; where the disk has no room, it is kept and tried again."""
        self._saved_at = time.monotonic()
        await self._write()
        for trial, unsaved in list(self._unsaved.items()):
            if not unsaved.events and not unsaved.conditions:
                continue
            self._unsaved[trial] = Unsaved()
            parts = unsaved.parts()
            try:
                await self.server.on_disk(partial(self.server.store.add_strokes, self.number, trial, parts))
            except OSError:
                later = self._unsaved[trial]
                self._unsaved[trial] = Unsaved(unsaved.events + later.events, unsaved.conditions + later.conditions)
                continue
            n_stored = self._n_taken[trial] - sum(len(events) for _, events in self._unsaved[trial].events)
            for page in [page for page in self.pages if page.strokes]:
                page.say({"stored": n_stored, "trial": f"trial:{trial}"})

    @property
    def n_unsaved(self) -> int:
        """Events, of the pen and others, that the disk has had no room for."""
        present = self.step["trial"].number if self.step["kind"] == "trial" else None
        strokes = [events for trial, one in self._unsaved.items() if trial != present for _, events in one.events]
        return len(self._refused) + sum(map(len, strokes))

    async def end_contact(self) -> None:
        """End playing, and save the strokes."""
        self._mark_lift()
        await self.save_strokes()
        contact, self.contact = self.contact, None
        if contact is not None:
            with contextlib.suppress(OSError, ValueError, RuntimeError):
                await asyncio.to_thread(contact.close)

    async def leave(self, page: ParticipantPage) -> None:
        """Go on without a page: its strokes are saved, and its trial stays where it is."""
        self.pages.discard(page)
        if page.strokes:
            self._alone_since = time.monotonic()
        async with self._changing:
            if self._page is page:
                await self.end_contact()
                self._page = None

    def for_operator(self) -> dict[str, Any]:
        """What the operator's page gets: the texture, and nothing of the method."""
        step = self.step
        done = [s["id"] in self.done for s in self.steps if s["kind"] == "trial" and s["n"] > 0]
        shown: dict[str, Any] = {"number": self.number, "code": self.code, "step": step["id"], "kind": step["kind"]}
        shown |= {"n": sum(done), "of": len(done), "held": self.held, "answered": bool(self.done)}
        shown |= {
            "pages": sorted(page.role for page in self.pages),
            "side": self.side,
            "real_side": self.server.design.real_side,
            "switches": self.n_switches,
        }
        if step["kind"] == "trial":
            texture = self.server.design.textures[step["trial"].texture]
            shown |= {"texture": texture.name, "real": texture.real, "practice": step["trial"].practice}
        if n := self.n_unsaved:
            shown["n_unsaved"] = n
        if self.asking:
            shown["asks"] = min(self.asking)
        if self.trouble:
            shown["trouble"] = self.trouble
        if self.contact is not None:
            live = self.contact.player.statistics  # how long a block takes would tell methods apart
            shown |= {"n_missed": live.n_missed, "n_underruns": live.n_underruns}
        return shown


@dataclass(frozen=True)
class Unsaved:
    """What of a trial is not in the database yet, each with the number of its surface."""

    events: list[tuple[int, NDArray[np.float64]]] = field(default_factory=list)
    conditions: list[tuple[int, float, float]] = field(default_factory=list)

    def parts(self) -> list[Stroked]:
        """Events in their order, and behind them the conditions of each surface."""
        runs = groupby(self.events, lambda one: one[0])
        parts = [Stroked(interval, np.concatenate([events for _, events in run])) for interval, run in runs]
        conditions = np.array(list(self.conditions)).reshape(-1, 3)
        for interval in np.unique(conditions[:, 0]):
            of_interval = conditions[conditions[:, 0] == interval, 1:]
            parts.append(Stroked(int(interval), np.zeros((0, 4)), of_interval))
        return parts


@dataclass
class TrialLog:
    """A trial through all its contacts: a lost connection or a hold begins another contact."""

    events: list[tuple[int, NDArray[np.float64]]] = field(default_factory=list)  # of the pen, by surface
    conditions: list[tuple[float, float]] = field(default_factory=list)  # speed [mm/s], force [N] at each block's end
    contacts: list[LiveStatistics] = field(default_factory=list)
    n_stopped: int = 0  # times that the output ended by itself
    earlier: NDArray[np.float64] = field(default_factory=lambda: NO_CONDITIONS)  # conditions before the server began

    def contact_s(self, interval: int) -> float:
        """Seconds in contact with one of the surfaces."""
        runs = groupby(self.events, lambda one: one[0])
        return sum(contact_s(np.concatenate([part for _, part in run])) for number, run in runs if number == interval)

    def summary(self) -> dict[str, Any]:
        """Seconds in contact, by the pen's own clock; of its blocks the 10th, 50th and 90th percentile of speed [mm/s] and
        force [N]; p99 of a block's rendering [ms], blocks that came late, under-runs, and times that the output ended.
        """
        block = Timing()
        for contact in self.contacts:
            block.counts += contact.block.counts
            block.largest_s = max(block.largest_s, contact.block.largest_s)
        every = np.concatenate([self.earlier, np.array(list(self.conditions)).reshape(-1, 2)])
        in_contact = every[every[:, 1] > MIN_CONTACT_N]
        result: dict[str, Any] = {"contact_s": round(sum(map(self.contact_s, {i for i, _ in self.events})), 3)}
        for name, values in zip(("speed_mm_s", "force_n"), in_contact.T, strict=True):
            for percent in (10, 50, 90):
                result[f"{name}_p{percent}"] = round(float(np.percentile(values, percent)), 4) if values.size else None
        p99_ms = 1000 * block.percentile_s(99.0)
        return {
            **result,
            "block_p99_ms": round(p99_ms, 4) if math.isfinite(p99_ms) else None,
            "n_missed": sum(contact.n_missed for contact in self.contacts),
            "n_underruns": sum(contact.n_underruns for contact in self.contacts),
            "n_stopped": self.n_stopped,
            "n_contacts": len(self.contacts) + bool(len(self.earlier)),
        }


def checked_values(design: Design, values: Any) -> dict[str, float]:
    """Answer of a trial: a number for each scale, or which surface was chosen.

    Raises:
        RefusedError: a value is missing, or out of range.
    """
    choices = CHOICES.get(design.task.kind, ())
    keys = [scale.key for scale in design.asked] or [CHOICE]
    highest = len(choices) - 1 if choices else 100
    if not isinstance(values, dict) or set(values) != set(keys):
        raise RefusedError(f"done: values are {values!r:.60}, expected {', '.join(keys)}")
    for key, value in values.items():
        if type(value) not in (int, float) or not 0 <= value <= highest or (choices and value != int(value)):
            raise RefusedError(f"done: {key[:40]} is {value!r:.40}, expected 0 to {highest}")
    return {key: float(values[key]) for key in keys}


def contact_s(events: NDArray[np.float64]) -> float:
    """Seconds that a pen was on the surface: between events (n, 4) that are no further apart than those of a pen."""
    apart = np.diff(events[:, 3])
    return float(apart[(events[:-1, 2] > 0) & (apart > 0) & (apart <= MAX_APART_S)].sum())


def conditions_of(
    events: NDArray[np.float64], texture: bytes, calibration: PressureCalibration
) -> list[tuple[float, float]]:
    """Speed [mm/s] and force [N] at the end of each block of events (n, 4), as a rendering of them would have had.

    What lies further apart than events of one contact is moved together: a page may send any times.
    """
    renderer = Renderer(_native_texture(texture))
    stylus, per_block = Stylus(renderer, calibration), max(1, round(BLOCK_MS / 1000 * renderer.texture_rate))
    times = np.append(0.0, np.cumsum(np.clip(np.diff(events[:, 3]), 0.0, MAX_APART_S)))
    conditions, n = [], 0
    for k in range(math.ceil(float(times[-1]) / BLOCK_MS * 1000) + 1):
        while n < len(events) and times[n] <= k * BLOCK_MS / 1000:
            x, y, pressure = events[n, :3].tolist()
            stylus.push(x, y, pressure, float(times[n]))
            n += 1
        conditions.append([stylus.next_condition() for _ in range(per_block)][-1])
    return conditions


@lru_cache(maxsize=4)
def _native_texture(texture: bytes) -> NativeTexture:
    """Texture in bytes, loaded: strokes of an outage come in many messages."""
    return NativeTexture(texture)


def steps_of(design: Design, trials: Sequence[Trial]) -> list[Step]:
    """Steps of a participant with these trials, in order."""
    steps: list[Step] = []
    if design.consent.strip():
        steps.append({"id": "consent", "kind": "consent", "text": design.consent})
    steps += _questions(design.questions, "start")
    steps.append({"id": "instructions", "kind": "instructions", "text": design.instructions})
    counted = sum(not trial.practice for trial in trials)
    for trial in trials:
        n = trial.number
        steps.append({"id": f"trial:{n}", "kind": "trial", "n": n, "of": counted, "trial": trial})
        if n < 1 or n == counted:
            continue
        steps += _questions(design.questions, n)
        if design.break_every and n % design.break_every == 0:
            steps.append({"id": f"break:{n}", "kind": "break", "n": n, "of": counted})
    return [*steps, *_questions(design.questions, "end"), {"id": "end", "kind": "end"}]


def _questions(questions: Sequence[Question], at: str | int) -> list[Step]:
    chosen = [question for question in questions if question.at == at]
    return [{"id": f"questions:{at}", "kind": "questions", "questions": chosen}] if chosen else []


def checked_answers(
    questions: Sequence[Question], answers: Any, language: Language
) -> tuple[dict[str, str], dict[str, str]]:
    """Answers of a questionnaire by question, those that are not private and those that are.

    Raises:
        RefusedError: an answer is missing, or is none to its question.
    """
    public: dict[str, str] = {}
    private: dict[str, str] = {}
    if not isinstance(answers, dict):
        raise RefusedError("answers are no object")
    for question in questions:
        answer = answers.get(question.key, "")
        if not isinstance(answer, str) or len(answer) > MAX_ANSWER_LENGTH or not _is_text(answer):
            raise RefusedError(f"{question.text}: expected up to {MAX_ANSWER_LENGTH} characters of text")
        answer = answer.strip()
        if not answer:
            if question.required:
                raise RefusedError(language.say("answer_missing", question=question.text))
            continue
        if question.kind in ("number", "slider"):
            if not _is_number(answer):
                raise RefusedError(language.say("not_a_number", question=question.text))
            low, high = (0, 100) if question.kind == "slider" else (question.low, question.high)
            if not low <= float(answer) <= high:
                raise RefusedError(language.say("not_a_number", question=f"{question.text} ({low:g}–{high:g})"))
        if question.kind == "choice" and answer not in question.options:
            raise RefusedError(f"{question.text}: {answer[:40]!r} is none of the choices")
        (private if question.private else public)[question.key] = answer
    return public, private


def _is_text(text: str) -> bool:
    """Whether a text can be stored: half of a surrogate pair cannot."""
    try:
        text.encode()
    except UnicodeEncodeError:
        return False
    return True


def _is_number(text: str) -> bool:
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False
