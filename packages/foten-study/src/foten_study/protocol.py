"""What a participant's session does, without doing it: from a state and a message to the next state and its effects.

Nothing here has a server, a socket, a clock or a database: `session.Session` carries effects out.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from foten.studio.messages import CALIBRATION, PLAYING_FIELDS, Protocol, RefusedError
from foten_study.design import Design, Question
from foten_study.languages import Language
from foten_study.orders import Trial
from foten_study.tasks.kind import CHOICE, Rated
from foten_study.tasks.table import TASKS

MAX_ANSWER_LENGTH = 2000  # characters
CLOCK_TOLERANCE_S = 0.25  # by which a page's clock may be ahead of the server's
SIDES = ("virtual", "real")
PARTICIPANT = Protocol(
    {
        # A fresh code is drawn by the page of a new participant, where there is no operator.
        "join": ((), ("code", "fresh", "role", "rate_hz", "volume_db", "again", *CALIBRATION)),
        "done": (("step",), ("values", "seconds", "underruns", "answers")),
        "side": (("side",), ("interval",)),
        "count": (("step", "underruns"), ()),
    },
    {
        **PLAYING_FIELDS,
        "role": ("all", "stroke", "answer"),
        "side": SIDES,
        "interval": (0, max(len(kind.intervals) for kind in TASKS.values()) - 1),
        "again": (0, 1e7),
        "seconds": (0.0, 1e6),
        "underruns": (0, 1e6),
        "code": None,
        "fresh": None,
        "step": None,
    },
)

Step = dict[str, Any]  # with an `id` and a `kind`
Effect = tuple[str, dict[str, Any]]  # a method of `session.Session`, and its arguments


class NotYetError(RefusedError):
    """A good answer, which can be sent again as it is a little later."""


@dataclass(frozen=True)
class Moment:
    """A time [s] by two clocks: one that nobody sets, and the system's, which goes on when the server ends."""

    steady_s: float
    system_s: float


@dataclass(frozen=True)
class State:
    """Where a participant is."""

    steps: tuple[Step, ...]
    done: frozenset[str]  # ids of steps
    held: bool = False  # a trial waits until the operator lets it go on
    side: str = "virtual"
    interval: int = 0  # number of the virtual surface
    shown_at_s: float | None = None  # since when a trial is shown, by the steady clock
    n_switches: int = 0
    n_real: int = 0  # switches to the real surface
    n_underruns: int | None = None  # of the trial, as a tablet beside the screen of the answer said
    down: bool = False  # the pen, on a surface that is rendered

    @property
    def step(self) -> Step:
        """First step that is not completed."""
        return next((step for step in self.steps if step["id"] not in self.done), self.steps[-1])

    @property
    def trial(self) -> Trial | None:
        """Trial that is the present step."""
        trial: Trial | None = self.step.get("trial")
        return trial


@dataclass(frozen=True)
class Change:
    """What follows from a message."""

    state: State
    first: tuple[Effect, ...] = ()
    then: tuple[Effect, ...] = ()
    reply: Mapping[str, Any] | None = None  # to the page that sent the message


@dataclass(frozen=True)
class Measured:
    """What is known of a trial beside its answer."""

    contact_s: tuple[float, ...] = ()  # of each surface
    events_coming: bool = False  # a page still sends again what an outage kept, or may come back with it
    log: Mapping[str, Any] = field(default_factory=dict)


def begin(design: Design, trials: Sequence[Trial], done: set[str]) -> State:
    """State of a participant who has completed some steps."""
    return _arrived(design, State(tuple(steps_of(design, trials)), frozenset(done)))


def resumed(state: State, sides: Sequence[str], since_s: float | None, now: Moment) -> State:
    """A trial as it was before the server ended: switches so far, and since when it is shown by the system's clock."""
    state = replace(state, n_switches=len(sides), n_real=sides.count("real"))
    if since_s is None or state.held:
        return state
    return replace(state, shown_at_s=now.steady_s - max(0.0, now.system_s - since_s))  # 0 where the clock was set back


def _arrived(design: Design, state: State) -> State:
    """Beginning of a step: with an operator, a trial waits until the real sample lies there."""
    fresh = State(state.steps, state.done)
    return replace(fresh, held=fresh.trial is not None and design.setup.operator)


def showing(state: State, now: Moment) -> Change:
    """Count the time of a trial from when it is shown first; the end is completed once it is shown."""
    trial, step = state.trial, state.step
    if trial is not None and not state.held and state.shown_at_s is None:
        shown = _writing("add_shown", trial.number, now.system_s)
        return Change(replace(state, shown_at_s=now.steady_s), then=(_marker(trial, "trial"), shown))
    if step["kind"] == "end" and step["id"] not in state.done:
        return Change(replace(state, done=state.done | {step["id"]}), then=(_writing("take_step", step["id"]),))
    return Change(state)


def turn(design: Design, state: State, now: Moment, side: str, marked_by: str, interval: int | None = None) -> Change:
    """Go over to another surface; the page learns it first, however long the rest takes: that might tell methods apart."""
    names, trial = design.kind.intervals, state.trial
    interval = state.interval if interval is None else int(interval)
    if side == "real" and design.real_side == "none":
        raise RefusedError("this study has no real surface")
    if not 0 <= interval < design.n_surfaces:
        raise RefusedError(f"side: interval is {interval}, expected one of {len(names)}")
    if trial is None or state.held or (side, interval) == (state.side, state.interval):
        return Change(state)
    lifted = lift(state)
    then = [*lifted.then, ("show", {})]
    if side == "real":
        then.append(("lift", {}))
    if interval != state.interval:
        then.append(("put_under_pen", {}))
    named = f"virtual {names[interval]}" if side == "virtual" and names else side
    then.append(_writing("add_switch", trial.number, named, marked_by, now.system_s))
    n_switches, n_real = state.n_switches + 1, state.n_real + (side == "real")
    after = replace(lifted.state, side=side, interval=interval, n_switches=n_switches, n_real=n_real)
    return Change(after, then=tuple(then))


def hold(state: State, held: bool) -> Change:
    """Hold the trial that is shown, or let it go on."""
    held = held and state.trial is not None
    ends: tuple[Effect, ...] = (("end_contact", {}),) if held else ()
    return Change(replace(state, held=held), then=(*ends, ("show", {})))


def pen(state: State, down: bool) -> Change:
    """The pen is on the surface now, or off it."""
    assert state.trial is not None
    if not down:
        return lift(state)
    surface = {"surface": state.interval + 1}
    marks = () if state.down else (_marker(state.trial, "contact", **surface),)
    return Change(replace(state, down=True), then=marks)


def lift(state: State) -> Change:
    """The pen has left the surface that it was on."""
    trial = state.trial
    marks = (_marker(trial, "lift", surface=state.interval + 1),) if state.down and trial is not None else ()
    return Change(replace(state, down=False), then=marks)


def count_underruns(state: State, step_id: str, n: int) -> State:
    """Take how many under-runs a trial has had so far."""
    return replace(state, n_underruns=n) if step_id == state.step["id"] else state


def _marker(trial: Trial, event: str, **about: Any) -> Effect:
    return "mark", {"trial": trial, "event": event, **about}


def _writing(what: str, *values: Any) -> Effect:
    """Effect of a method of the store that stores something of the participant."""
    return "write", {"what": what, "values": values}


def finish(
    design: Design, state: State, step_id: str, message: Mapping[str, Any], measured: Measured, now: Moment
) -> Change:
    """Take the answers of a step and go on; a completed step is left as it is.

    RefusedError where it is not this step's turn, or an answer is wrong; NotYetError where it may be sent again as it is.
    """
    step, trial = state.step, state.trial
    if step_id in state.done:  # sent again by a page that did not learn that it was taken
        return Change(state)
    if step_id != step["id"]:
        raise RefusedError(f"it is the turn of {step['id']}, not of {step_id[:40]!r}")
    if step["kind"] == "end":
        return Change(state)
    after = _arrived(design, replace(state, done=state.done | {step_id}))
    if trial is not None:
        _check_trial_may_end(design, state, measured, now)
        values = checked_values(design, message.get("values"))
        rated = trial.number, _rated(design, state, values, measured, message)
        first: tuple[Effect, ...] = (
            ("save_strokes", {}),
            ("store", {"step": step_id, "rated": rated}),
            ("end_contact", {}),
        )
        then = _marker(trial, "answer", values=message["values"])
        return Change(after, first, (then,), _feedback(design, trial, values))
    answers: dict[str, Any] = {}
    if step["kind"] == "consent":
        answers["consent"] = step["text"]
    elif step["kind"] == "questions":
        public, private = checked_answers(step["questions"], message.get("answers", {}), design.language)
        answers = {"answers": public, "private": private}
    return Change(after, (("store", {"step": step_id, **answers}),))


def _check_trial_may_end(design: Design, state: State, measured: Measured, now: Moment) -> None:
    say, min_s = design.language.say, design.task.min_seconds
    if state.held:
        raise NotYetError(say("operator_holds"))
    if measured.events_coming:
        raise NotYetError(say("one_moment"))
    shown_s = 0.0 if state.shown_at_s is None else now.steady_s - state.shown_at_s
    if shown_s < min_s - CLOCK_TOLERANCE_S:  # by this clock: a page could say anything
        raise RefusedError(say("wait" if design.real_side == "none" else "explore_first", s=math.ceil(min_s)))
    if min_s and not all(measured.contact_s):
        raise RefusedError(say("stroke_first" if design.n_surfaces == 1 else "stroke_each"))
    if lacks_real(design, state):
        raise RefusedError(say("touch_real", real=say("real_surface")))


def lacks_real(design: Design, state: State) -> bool:
    """Whether nobody has said in this trial that the real surface is touched, where that is asked for."""
    return design.setup.real_checked and design.real_side != "none" and not state.n_real


def checked_values(design: Design, values: Any) -> dict[str, float]:
    """Answer of a trial: a number for each scale, or the surface that was chosen; RefusedError for anything else."""
    choices = design.kind.choices
    keys = [scale.key for scale in design.asked] or [CHOICE]
    highest = len(choices) - 1 if choices else 100
    if not isinstance(values, dict) or set(values) != set(keys):
        raise RefusedError(f"done: values are {values!r:.60}, expected {', '.join(keys)}")
    for key, value in values.items():
        if type(value) not in (int, float) or not 0 <= value <= highest or (choices and value != int(value)):
            raise RefusedError(f"done: {key[:40]} is {value!r:.40}, expected 0 to {highest}")
    return {key: float(values[key]) for key in keys}


def checked_answers(
    questions: Sequence[Question], answers: Any, language: Language
) -> tuple[dict[str, str], dict[str, str]]:
    """Answers by question, public and private; RefusedError where one is missing, or is none to its question."""
    public: dict[str, str] = {}
    private: dict[str, str] = {}
    if not isinstance(answers, dict):
        raise RefusedError("answers are no object")
    for question in questions:
        answer = answers.get(question.key, "")
        if (
            not isinstance(answer, str)
            or len(answer) > MAX_ANSWER_LENGTH
            or answer.encode(errors="replace").decode() != answer
        ):
            raise RefusedError(f"{question.text}: expected up to {MAX_ANSWER_LENGTH} characters of text")
        answer = answer.strip()
        if not answer:
            if question.required:
                raise RefusedError(language.say("answer_missing", question=question.text))
            continue
        if question.kind in ("number", "slider"):
            number = math.nan
            with suppress(ValueError):
                number = float(answer)
            if not math.isfinite(number):
                raise RefusedError(language.say("not_a_number", question=question.text))
            low, high = (0, 100) if question.kind == "slider" else (question.low, question.high)
            if not low <= number <= high:
                raise RefusedError(language.say("not_a_number", question=f"{question.text} ({low:g}–{high:g})"))
        if question.kind == "choice" and answer not in question.options:
            raise RefusedError(f"{question.text}: {answer[:40]!r} is none of the choices")
        (private if question.private else public)[question.key] = answer
    return public, private


def _rated(
    design: Design, state: State, values: Mapping[str, float], measured: Measured, message: Mapping[str, Any]
) -> Rated:
    """Outcome of a trial."""
    log = dict(measured.log)
    if design.n_surfaces > 1:
        log |= {f"contact_s_{i + 1}": round(seconds, 3) for i, seconds in enumerate(measured.contact_s)}
    if design.output.to == "page":  # the sound runs dry in the tablet, if anywhere, and its page counts that
        log["n_underruns"] = message.get("underruns", state.n_underruns)
    return Rated(values, message.get("seconds"), state.n_switches, log)


def _feedback(design: Design, trial: Trial, values: Mapping[str, float]) -> dict[str, Any] | None:
    """Whether the answer was right, and what would have been, where the study says so."""
    when = design.task.feedback
    if not design.kind.order.n_targets or when == "none" or (when == "practice" and not trial.practice):
        return None
    right = values[CHOICE] == trial.target
    return {"feedback": {"right": right, "was": design.kind.choices[trial.target]}}


def shown(design: Design, state: State, touched: Sequence[int], n_stored: Mapping[int, int]) -> Step:
    """The step as a participant's page gets it: nothing of methods; with surfaces touched, and events stored by trial."""
    step, trial = state.step, state.trial
    page: Step = {name: value for name, value in step.items() if name not in ("trial", "questions")}
    page["held"] = state.held
    if step["kind"] == "questions":
        names = ("key", "text", "kind", "options", "required", "low", "high")
        page["questions"] = [{name: getattr(question, name) for name in names} for question in step["questions"]]
    if trial is not None:
        texture, task, setup, kind = design.textures[trial.texture], design.task, design.setup, design.kind
        page |= {"practice": trial.practice, "real_side": design.real_side, "screens": setup.screens}
        page |= {"task": task.kind, "form": kind.form, "question": task.question}
        page |= {"scales": [asdict(scale) for scale in design.asked]}
        page |= {"intervals": kind.intervals, "choices": kind.choices, "interval": state.interval, "touched": touched}
        page |= {"min_s": task.min_seconds, "side": state.side, "stored": n_stored[trial.number]}
        page |= {"lacks_real": lacks_real(design, state)}
        if setup.show_names:
            page |= {"name": texture.name, "picture": f"pictures/{trial.texture}" if texture.picture else None}
    return page


def described(design: Design, state: State) -> dict[str, Any]:
    """The state as the operator's page gets it: the texture, and nothing of the method."""
    step, trial = state.step, state.trial
    done = [s["id"] in state.done for s in state.steps if s["kind"] == "trial" and s["n"] > 0]
    page: dict[str, Any] = {"step": step["id"], "kind": step["kind"], "n": sum(done), "of": len(done)}
    page |= {"held": state.held, "answered": bool(state.done), "side": state.side, "switches": state.n_switches}
    page |= {"real_side": design.real_side}
    if trial is not None:
        texture = design.textures[trial.texture]
        page |= {"texture": texture.name, "real": texture.real, "practice": trial.practice}
    return page


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
