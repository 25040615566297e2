"""Users: simulated people with known thresholds, gains and likings are found, and a profile does to a texture what it says."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from conftest import exported
from foten.cli.command_line import _status
from foten.editing.describe import describe, rendered, spectrum
from foten.editing.envelope import STRENGTHS, EnvelopeCurve
from foten.editing.user import (
    MOVES,
    REFERENCE_HZ,
    TONES_HZ,
    UserProfile,
    adapted,
    equal_strength,
    read_user,
    write_user,
)
from foten.models.texture_file import read_texture
from foten.models.trainable import TRAINABLE
from foten.runtime.actuator import ActuatorProfile, write_profile
from foten.runtime.renderer import EXAMPLE
from foten_study.adapt_server import largest_tones_db, reachable
from foten_study.adapt_session import ABOVE_THRESHOLD_DB, ROOM_DB, Limits, Question, Session, answered_by

TOWEL = EXAMPLE.parent / "towel.foten"
GAINS = UserProfile("Ada", gain_db=(6.0, 3.0, 0.0, 0.0, -6.0), gain_sd_db=(1.0,) * 5)
WRONG = 0.1  # share of answers that are drawn


class Person:
    """A simulated user: thresholds and equal strengths [dB re full scale], and an ideal point of the moves."""

    def __init__(self, seed: int, n_moves: int = len(MOVES)) -> None:
        self._rng = np.random.default_rng([seed, 7])
        offset = self._rng.normal(-45, 8)
        self.threshold = {hertz: offset + self._rng.normal(0, 4) for hertz in TONES_HZ}
        gains = {hertz: self._rng.normal(0, 4) for hertz in TONES_HZ}
        self.equal = {hertz: self.threshold[hertz] + gains[hertz] - gains[160.0] for hertz in TONES_HZ}
        self.ideal = self._rng.uniform(-0.8, 0.8, n_moves)

    def __call__(self, question: Question) -> int:
        rng, shown = self._rng, question.shown
        if rng.random() < WRONG:
            return int(rng.integers(question.n_choices))
        if question.part == "detect":
            hertz, level, interval = shown
            felt = rng.random() < 1 - np.exp(-(10 ** (0.1 * (level - self.threshold[hertz]))))
            return int(interval) if felt else int(rng.integers(3))
        if question.part == "compare":
            first, second = (level - self.equal[hertz] for hertz, level in (shown[:2], shown[2:]))
            return int(rng.random() > 1 / (1 + np.exp(-0.5 * (first - second))))
        one, other = np.split(np.array(shown), 2)
        nearer = np.linalg.norm(other - self.ideal) - np.linalg.norm(one - self.ideal)
        return int(rng.random() > 1 / (1 + np.exp(-1.5 * nearer / 0.2)))


def test_people_are_found_though_some_answers_are_drawn() -> None:
    thresholds, gains, begun, left = [], [], [], []
    for seed in range(8):
        person = Person(seed)
        profile = answered_by(Session(UserProfile(), "felt", seed=seed), person)
        thresholds += [found - person.threshold[hz] for hz, found in zip(TONES_HZ, profile.threshold_db, strict=True)]
        equal = [person.equal[hz] - person.equal[160.0] for hz in TONES_HZ]
        gains += [found - true for found, true in zip(profile.gain_db, equal, strict=True)]
        begun.append(np.linalg.norm(person.ideal))
        left.append(np.linalg.norm(np.array(profile.moves) / list(MOVES.values()) - person.ideal))
        assert sum(part == "detect" for part, *_ in profile.answers) <= 60
        assert sum(part == "match:felt" for part, *_ in profile.answers) <= 25
    assert abs(np.mean(thresholds)) < 2
    assert np.std(thresholds) < 6
    assert abs(np.mean(gains)) < 1
    assert np.std(gains) < 3
    assert np.mean(left) < 0.4 * np.mean(begun)


def test_a_session_goes_on_where_it_ended() -> None:
    whole = answered_by(Session(UserProfile(), "felt", seed=3), Person(1))
    for n in (1, 30, 70, len(whole.answers) - 3):
        first = Session(UserProfile(), "felt", seed=3)
        for _, _, which in whole.answers[:n]:
            assert first.question is not None
            first.answer(first.question.n, which)
        session = Session(first.profile, "felt", seed=3)
        assert session.question is not None
        assert session.question == first.question
        for _, _, which in whole.answers[n:]:
            session.answer(session.question.n, which)
        assert session.question is None
        assert session.profile == whole
    again = Session(whole, "felt", seed=3)
    assert again.question is None
    assert again.profile == whole


def test_no_answer_is_lost_whatever_is_asked_next() -> None:
    """Parts of a session in any order, ended in the middle: what was given before is there, and is gone on with."""
    person = Person(1)
    whole = answered_by(Session(UserProfile(), "felt", seed=3), person)
    kept = set(whole.answers)
    tones = Session(whole, seed=3)  # without a texture
    assert tones.question is None
    assert set(tones.profile.answers) == kept
    denim = Session(whole, "denim", seed=4, feel=False)
    assert denim.question is not None
    for n in range(1, 9):
        denim.answer(denim.question.n, person(denim.question))
        profile = denim.profile
        assert set(profile.answers) > kept
        assert (profile.texture, profile.moves) == (whole.texture, whole.moves) or n == 8  # a few say nothing yet
    assert profile.texture == "denim"
    again = Session(profile, "denim", seed=4, feel=False)
    assert again.preference.n_answers == 8
    assert set(Session(profile, "felt", seed=3).profile.answers) == set(profile.answers)


def test_choices_without_the_gains_that_are_measured_later_do_not_count() -> None:
    first = answered_by(Session(UserProfile(), "felt", seed=3, feel=False), Person(1))
    later = Session(first, "felt", seed=3)
    assert later.n_dropped == len(first.answers)
    assert not later.profile.moves
    assert not later.profile.answers


def test_who_feels_nothing_has_no_gains_and_begins_anew() -> None:
    rng = np.random.default_rng(0)
    session = Session(UserProfile(), "felt")
    profile = answered_by(session, lambda question: int(rng.integers(question.n_choices)))
    assert session.silent
    assert (profile.threshold_db, profile.gain_db, profile.answers) == ((), (), ())
    question = Session(profile, "felt").question
    assert question is not None
    assert question.part == "detect"


def test_a_tone_that_the_output_cannot_make_strong_enough_has_a_gain_above_it() -> None:
    """40 Hz wanted 12 dB above the largest tone: the gain is not cut where the levels end; what is not felt is hardly known."""
    found, unfelt = [], []
    for seed in range(8):
        person = Person(seed)
        person.threshold = dict.fromkeys(TONES_HZ, -25.0) | {40.0: -9.0}
        person.equal = dict.fromkeys(TONES_HZ, -15.0) | {40.0: 5.0}
        session = Session(UserProfile(), seed=seed)
        profile = answered_by(session, person)
        found += [profile.gain_db[0]] if 40.0 not in session.unfelt_hz else []
        person.threshold[40.0] = 30.0
        unfelt.append(answered_by(Session(UserProfile(), seed=seed), person))
    assert len(found) >= 4
    assert np.mean(found) == pytest.approx(20.0, abs=3.0)
    unknown = [profile for profile in unfelt if profile.gain_sd_db[0] == 20.0]
    assert len(unknown) >= 5  # by chance some answers are right
    assert all(profile.gain_db[0] == profile.gain_db[1] for profile in unknown)
    assert all(profile.gain_db[0] > 10 for profile in unfelt if profile not in unknown)  # all others were stronger


def test_moves_stay_within_what_a_texture_reaches() -> None:
    """Towel can hardly be made smoother: the envelope is searched for from there upwards, and what hardly changes is left out."""
    ranges = reachable(towel := read_texture(TOWEL))
    low, high = ranges["rougher"]
    assert -0.3 < low < 0
    assert 0.3 < high <= 3
    roughness = EnvelopeCurve(towel).roughness_db
    zero = roughness[STRENGTHS.index(0.0)]
    assert (low, high) == (roughness[0] - zero, min(roughness[-1] - zero, MOVES["rougher"]))
    session = Session(UserProfile(), "towel", ranges, feel=False)
    assert session.moves(-np.ones(4))[3] == pytest.approx(low)
    assert session.moves(np.ones(4)) == pytest.approx([6.0, 0.75, 0.3, high])
    narrow = {name: ends for name, ends in ranges.items() if name != "rougher"}
    profile = answered_by(Session(UserProfile(), "jeans", narrow, feel=False), Person(3, n_moves=3))
    assert (profile.moves[3], profile.moves_sd[3]) == (0.0, 0.0)


def test_a_part_that_has_not_ended_says_nothing() -> None:
    session, person = Session(UserProfile(), "felt", limits=Limits(detect=(2, 2), compare=(2, 2))), Person(5)
    for _ in range(9):
        assert session.question is not None
        session.answer(session.question.n, person(session.question))
        assert not session.profile.threshold_db
    assert session.question is not None
    session.answer(session.question.n, person(session.question))
    assert session.question.part == "compare"
    assert len(session.profile.threshold_db) == 5
    felt = max(search.point for hertz, search in session.thresholds.items() if hertz not in session.unfelt_hz)
    above = max(ABOVE_THRESHOLD_DB[0], min(ABOVE_THRESHOLD_DB[1], -ROOM_DB - felt))
    assert session.reference_db == round(min(-ROOM_DB, session.thresholds[REFERENCE_HZ].point + above), 1)
    assert not session.profile.gain_db
    assert session.progress["detect"] == 1


def test_an_answer_to_another_question_is_refused() -> None:
    session = Session(UserProfile())
    with pytest.raises(ValueError, match="answer to question 1, expected one to 0"):
        session.answer(1, 0)
    with pytest.raises(ValueError, match="choice 3, expected 0 to 2"):
        session.answer(0, 3)
    session.answer(0, 2)
    with pytest.raises(ValueError, match="answer to question 0"):
        session.answer(0, 2)  # a second time


def test_the_largest_tone_is_that_of_the_actuator() -> None:
    """Above its resonance a tone's acceleration is the gain times 0.8 of the limit; at half of the resonance a third of it."""
    coil = ActuatorProfile(resonance_hz=80.0, damping=0.0, gain=10.0, limit=2.0)
    levels = largest_tones_db(coil)
    assert levels[0] == pytest.approx(20 * np.log10(16 / 3), abs=1e-9)
    assert levels[-1] == pytest.approx(20 * np.log10(16 / (1 - (80 / 250) ** 2)), abs=1e-9)
    assert largest_tones_db(None) == (0.0,) * 5


def test_gains_are_those_of_the_spectrum_and_the_level_stays() -> None:
    texture = read_texture(TOWEL)
    out = equal_strength(texture, GAINS)
    hz, before = spectrum(rendered(texture, 100.0, 0.7, 120.0), texture.rate_hz)
    _, after = spectrum(rendered(out, 100.0, 0.7, 120.0), texture.rate_hz)
    ratio = {
        f: 10 * np.log10(after[np.abs(hz - f) < 8].mean() / before[np.abs(hz - f) < 8].mean()) for f in (40, 100, 250)
    }
    assert ratio[40] - ratio[100] == pytest.approx(6.0, abs=1.2)  # bands of 15 Hz under a slope, an estimate of 120 s
    assert ratio[250] - ratio[100] == pytest.approx(-6.0, abs=1.2)
    assert describe(out).level_db == pytest.approx(describe(texture).level_db, abs=0.01)
    assert out.evidence == "for the user Ada: a filter, not measured"


def test_moves_are_those_of_an_edit() -> None:
    texture = read_texture(EXAMPLE.parent / "artificial-grass.foten")
    profile = replace(GAINS, moves=(3.0, 0.25, 0.0, 0.5), moves_sd=(1.0, 0.1, 0.1, 0.2), texture="towel")
    before, after = describe(equal_strength(texture, profile)), describe(adapted(texture, profile))
    assert after.level_db - before.level_db == pytest.approx(3.0, abs=0.01)
    assert np.log2(after.centroid_hz / before.centroid_hz) == pytest.approx(0.25, abs=0.05)
    assert after.roughness_db - before.roughness_db == pytest.approx(0.5, abs=0.25)
    assert adapted(texture, profile).evidence == (
        "for the user Ada: a filter, level +3 dB, centroid +0.25 octaves, roughness +0.5 dB, not measured"
    )


def test_an_empty_profile_is_refused() -> None:
    with pytest.raises(ValueError, match="profile is empty"):
        adapted(read_texture(TOWEL), UserProfile())
    with pytest.raises(ValueError, match="expected one of foten-plus"):
        adapted(read_texture(EXAMPLE.parent / "steel-mesh-1_ar.foten"), GAINS)


def test_a_profile_comes_back_from_its_file(tmp_path: Path) -> None:
    whole = answered_by(Session(UserProfile("Ada", "coil", "m/s²"), texture="felt", seed=3), Person(1))
    write_user(whole, tmp_path / "ada.json")
    assert read_user(tmp_path / "ada.json") == whole


@pytest.mark.parametrize(
    ("change", "line"),
    [
        ({"format": "foten-tool"}, "is not a user's profile of 'foten adapt'"),
        ({"version": 2}, "has version 2, expected 1"),
        ({"gain_db": [1.0]}, "gain_db of the user has 1 figures, expected 5"),
        ({"gain_db": [1e9] * 5}, "a gain of the user is beyond 60 dB"),
        ({"gain_db": [None] * 5}, "a figure of gain_db"),
        ({"moves": [99.0, 0, 0, 0]}, "level of the user is 99, expected -6 to 6"),
        ({"tones_hz": [1.0]}, "is of other frequencies, expected 40, 63, 100, 160, 250 Hz"),
        ({"colour": 1}, "is no user's profile"),
        ({"answers": 3}, "is no user's profile"),
        ({"answers": [["detect", [41, -45, 0], 0]]}, "an answer of the user is ('detect', (41.0"),
        ({"answers": [["detect", [160], 0]]}, "which is none to any question"),
        ({"answers": [["match:a", [0.1, 0.2], 2]]}, "which is none to any question"),
        ({"max_db": []}, "max_db of the user has 0 figures, expected 5"),
        ({"answers": [["detect", [160, -45, 0], 1e999]]}, "u.json holds a number that is not finite"),
        ({"volume_db": None}, "volume_db of the user is no finite number"),
        ({"answers": [["detect", [160, -45, 0], 0]] * 10_001}, "it has 10001 answers, expected 10000 at most"),
        ({"name": 3}, "name, actuator, unit and texture of the user are text"),
    ],
)
def test_a_bad_profile_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict[str, object], line: str
) -> None:
    path, out = tmp_path / "u.json", tmp_path / "t.wav"
    write_user(replace(GAINS, moves=(1.0, 0.0, 0.0, 0.0), moves_sd=(0.0,) * 4), path)
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    stroke = ["--speed", "80", "--force", "0.8", "--seconds", "1"]
    assert _status(["render", str(TOWEL), *stroke, "--user", str(path), "-o", str(out)]) == 2
    err = capsys.readouterr().err
    assert line in err
    assert err.count("\n") == 1
    assert not out.exists()


def test_commands_take_a_user(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path, texture = tmp_path / "u.json", tmp_path / "towel-ada.foten"
    write_user(GAINS, path)
    assert _status(["edit", str(TOWEL), "--user", str(path), "-o", str(texture)]) == 0
    assert read_texture(texture).evidence == "for the user Ada: a filter, not measured"
    stroke = ["--speed", "80", "--force", "0.8", "--seconds", "1"]
    for arguments, name in (([str(TOWEL), "--user", str(path)], "a.csv"), ([str(texture)], "b.csv")):
        assert _status(["render", *arguments, *stroke, "-o", str(tmp_path / name)]) == 0
    columns = [np.loadtxt(tmp_path / name, delimiter=",", skiprows=1, comments="#") for name in ("a.csv", "b.csv")]
    np.testing.assert_array_equal(*columns)
    capsys.readouterr()


@pytest.mark.parametrize(
    ("arguments", "line"),
    [
        (["-o", "me.txt"], "a user's profile is written as .json, got -o me.txt"),
        (["--no-feel", "-o", "me.json"], "nothing to measure"),
        (["-o", "missing/me.json", "--actuator", "missing.json"], "there is no folder"),
        ([str(EXAMPLE.parent / "steel-mesh-1_ar.foten"), "-o", "me.json"], "expected foten-plus"),
    ],
)
def test_what_cannot_be_adapted_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], arguments: list[str], line: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert _status(["adapt", *arguments]) == 2
    assert line in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_another_actuator_or_user_needs_another_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    me, coil = str(tmp_path / "me.json"), str(tmp_path / "coil.json")
    write_user(UserProfile("Ada", "coil", "m/s²"), Path(me))
    assert _status(["adapt", "-o", me]) == 2
    assert "with the actuator coil: continue in the same way, or give another -o" in capsys.readouterr().err
    write_profile(ActuatorProfile("coil", gain=3.0, limit=2.0), Path(coil))
    assert _status(["adapt", "-o", me, "--actuator", coil]) == 2
    assert "with the actuator coil, whose profile was different then" in capsys.readouterr().err
    write_user(UserProfile("Ada"), Path(me))
    assert _status(["adapt", "-o", me, "--name", "Bea"]) == 2
    assert "is the profile of Ada, not of Bea" in capsys.readouterr().err


def test_a_response_is_not_taken_off_twice(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    me, coil = str(tmp_path / "me.json"), str(tmp_path / "coil.json")
    write_user(GAINS, Path(me))
    write_profile(ActuatorProfile("coil", gain=3.0, limit=2.0), Path(coil))
    command = ["play", str(TOWEL), "--user", me, "--actuator", coil, "--to", str(tmp_path / "a.wav"), "--seconds", "1"]
    assert _status(command) == 2
    assert "was measured without --actuator, so it holds the actuator's response" in capsys.readouterr().err
    mine = adapted(read_texture(TOWEL), GAINS)
    with pytest.raises(ValueError, match="one for a user already"):
        adapted(mine, GAINS)


def test_a_texture_of_noise_is_adapted_too() -> None:
    sizes = TRAINABLE["foten-plus"].sizes(window=12, n_hidden=6, head_width=5, n_components=3, order=6)
    out = adapted(exported("foten-plus", sizes), replace(GAINS, moves=(2.0, 0.0, 0.0, 0.3), moves_sd=(0.0,) * 4))
    assert out.card["sizes"]["recorded"] is False
