"""The session of a participant without a socket: what follows from a message, what is written, what is played."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")

from foten.runtime.renderer import EXAMPLE
from foten.runtime.stylus import PressureCalibration
from foten.studio.messages import RefusedError
from foten.studio.players import RoundRobinRenderer
from foten_study import protocol
from foten_study.design import Design, Setup, Texture
from foten_study.orders import Trial
from foten_study.participant_store import ParticipantStore
from foten_study.protocol import Measured, Moment, NotYetError, State
from foten_study.strokes import TrialSound
from foten_study.study_file import FullError
from foten_study.tasks.kind import Task

FILES = {"ar": Path("a"), "foten": Path("b")}
NOON = Moment(100.0, 1e9)
RATED = {"values": {"similarity": 40.0}, "seconds": 2.5}


def design_of(kind: str = "rating", **settings: Any) -> Design:
    task = Task(kind, "how?", "low", "high", **settings)
    return Design("Surfaces", (Texture("mesh", "Mesh", FILES),), task=task, instructions="stroke")


def at_trial(design: Design, trials: Sequence[Trial] = (Trial(1, 0, 1), Trial(2, 0, 0))) -> State:
    state = protocol.begin(design, trials, {"instructions"})
    return protocol.showing(state, NOON).state


def later(seconds: float) -> Moment:
    return Moment(NOON.steady_s + seconds, NOON.system_s + seconds)


def names(effects: Sequence[protocol.Effect]) -> list[str]:
    return [about.get("what", about.get("event", name)) for name, about in effects]


def test_an_answer_is_stored_before_the_step_is_done_and_the_next_begins_afresh() -> None:
    design = design_of()
    state = protocol.turn(design, at_trial(design), NOON, "real", "participant").state
    change = protocol.finish(design, state, "trial:1", RATED, Measured((1.0,), log={"contact_s": 1.0}), later(9))
    assert names(change.first) == ["save_strokes", "store", "end_contact"]
    number, rated = change.first[1][1]["rated"]
    assert (number, rated.values, rated.switches, rated.response_s) == (1, {"similarity": 40.0}, 1, 2.5)
    assert rated.log == {"contact_s": 1.0, "n_underruns": None}
    assert names(change.then) == ["answer"]
    assert change.state == State(state.steps, state.done | {"trial:1"})
    assert "trial:1" not in state.done  # frozen: where the disk refuses, nothing has changed


def test_an_answer_that_comes_again_or_out_of_turn_changes_nothing() -> None:
    design = design_of()
    state = at_trial(design)
    assert protocol.finish(design, state, "instructions", {}, Measured(), NOON) == protocol.Change(state)
    with pytest.raises(RefusedError, match="it is the turn of trial:1, not of 'trial:2'"):
        protocol.finish(design, state, "trial:2", RATED, Measured(), NOON)


@pytest.mark.parametrize(
    ("kind", "setup", "seconds", "measured", "why", "again"),
    [
        ("rating", Setup(operator=True), 9, Measured((1.0,)), "operator_holds", True),
        ("rating", Setup(), 9, Measured((1.0,), events_coming=True), "one_moment", True),
        ("rating", Setup(), 1, Measured((1.0,)), "explore_first", False),
        ("abx", Setup(), 1, Measured((1.0, 1.0, 1.0)), "wait", False),  # there is no real surface
        ("rating", Setup(), 9, Measured((0.0,)), "stroke_first", False),
        ("abx", Setup(), 9, Measured((1.0, 0.0, 1.0)), "stroke_each", False),
        ("rating", Setup(real_checked=True), 9, Measured((1.0,)), "touch_real", False),
    ],
)
def test_a_trial_may_not_end_before(
    kind: str, setup: Setup, seconds: float, measured: Measured, why: str, again: bool
) -> None:
    design = replace(design_of(kind, min_seconds=3.0), setup=setup)
    say = design.language.say
    with pytest.raises(RefusedError) as refused:
        protocol.finish(design, at_trial(design, [Trial(1, 0, 1, 0)]), "trial:1", RATED, measured, later(seconds))
    assert str(refused.value) == say(why, **{"s": 3, "real": say("real_surface")})
    assert isinstance(refused.value, NotYetError) == again


def test_a_hand_that_goes_over_is_shown_first_and_written_last() -> None:
    design = design_of("abx")
    state = protocol.pen(at_trial(design, [Trial(1, 0, 0, 1)]), down=True).state
    change = protocol.turn(design, state, later(2), "virtual", "participant", 2)
    assert names(change.then) == ["lift", "show", "put_under_pen", "add_switch"]
    assert change.then[-1][1]["values"] == (1, "virtual X", "participant", NOON.system_s + 2)
    assert protocol.turn(design, change.state, NOON, "virtual", "participant", 2) == protocol.Change(change.state)
    for side, interval, why in (("real", None, "no real surface"), ("virtual", 3, "expected one of 3")):
        with pytest.raises(RefusedError, match=why):
            protocol.turn(design, state, NOON, side, "participant", interval)


def test_markers_come_in_pairs() -> None:
    state = at_trial(design_of())
    down = protocol.pen(state, down=True)
    assert names(down.then) == ["contact"]
    assert names(protocol.pen(down.state, down=True).then) == []
    assert names(protocol.lift(down.state).then) == ["lift"]
    assert names(protocol.lift(state).then) == []


def test_a_trial_goes_on_after_a_restart_by_the_systems_clock_unless_that_was_set_back() -> None:
    state = protocol.begin(design_of(), [Trial(1, 0, 1)], {"instructions"})
    resumed = protocol.resumed(state, ["real", "virtual"], NOON.system_s - 7, NOON)
    assert (resumed.shown_at_s, resumed.n_switches, resumed.n_real) == (NOON.steady_s - 7, 2, 1)
    assert protocol.resumed(state, [], NOON.system_s + 3600, NOON).shown_at_s == NOON.steady_s


def test_feedback_is_of_practice_unless_the_study_says_otherwise() -> None:
    trials = [Trial(0, 0, 0, 1, 1), Trial(1, 0, 0, 1, 1)]
    for feedback, n in (("none", 0), ("practice", 1), ("all", 2)):
        design = design_of("abx", feedback=feedback)
        state, replies = at_trial(design, trials), []
        for trial in trials:
            answer = {"values": {"choice": 0}}
            change = protocol.finish(design, state, f"trial:{trial.number}", answer, Measured((1.0,) * 3), NOON)
            state, replies = change.state, replies + [change.reply] * (change.reply is not None)
        assert replies == n * [{"feedback": {"right": False, "was": "B"}}]


def test_what_the_disk_refuses_is_written_once_in_its_order() -> None:
    written: list[Any] = []
    full = True

    def write(what: Any) -> None:
        if full:
            raise FullError("the disk is full")
        written.append(what)

    async def on_disk(work: Callable[[], Any]) -> Any:
        return work()

    async def scenario() -> list[int]:
        nonlocal full
        store = SimpleNamespace(
            add_strokes=lambda number, trial, parts: write((trial, sum(len(p.events) for p in parts)))
        )
        kept = ParticipantStore(store, 1, on_disk, lambda trial, n: written.append(("stored", trial, n)))  # type: ignore[arg-type]
        kept.logs[1].events.append((0, np.zeros((5, 4))))
        kept.n_taken[1] += 5
        await kept.write(lambda: write("first"), lambda: write("second"))
        await kept.save()
        counts = [kept.n_unsaved(None)]
        full = False
        await kept.save()
        await kept.save()
        return [*counts, kept.n_unsaved(None)]

    assert asyncio.run(scenario()) == [7, 0]
    assert written == ["first", "second", (1, 5), ("stored", 1, 5)]


def test_a_trial_sounds_at_the_gain_of_its_surface_and_a_level_follows_the_answers() -> None:
    design, opened = design_of("threshold"), list[float]()
    study: Any = SimpleNamespace(design=design, plays_in_page=True, player=RoundRobinRenderer().player)
    study.gains, study.bytes_of = {(0, 1): -3.0}, {(0, 1): EXAMPLE.read_bytes()}

    async def scenario() -> None:
        sound, trial = TrialSound(study, 1), Trial(0, 0, 1, None, 2)  # of practice, at the highest level
        await sound.open(8000.0, PressureCalibration(), trial, 2, lambda *block: None)
        assert sound.contact is not None
        contact, set_volume = sound.contact, sound.contact.set_volume
        contact.set_volume = lambda db: (opened.append(db), set_volume(db))[1]  # type: ignore[method-assign]
        await sound.put_under_pen(trial, 2)
        await sound.put_under_pen(trial, 0)
        assert not sound.has_stopped
        await sound.close()
        assert sound.contact is None

    asyncio.run(scenario())
    assert opened == [design.task.high_db - 3.0, -243.0]
