"""Contacts and what plays them: textures that take over, volume, actuators, players that fail or fall behind."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
from numpy.typing import NDArray

from conftest import PLUS, exported
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.runtime.actuator import ActuatorProfile
from foten.runtime.live.live import LiveStatistics
from foten.runtime.renderer import EXAMPLE, Renderer
from foten.runtime.stylus import PressureCalibration, Stylus
from foten.studio import players
from foten.studio.levels import _conditions
from foten.studio.live_contact import Contact, limit
from foten.studio.players import OutputDevice, RoundRobinRenderer, white_noise
from test_studio_server import COIL


class HandTurnedPlayer:
    """A player that renders when a test says so."""

    def __init__(self, calibrated: bool = False, actuator: ActuatorProfile | None = None) -> None:
        self.rate_hz, self.running = 8000.0, True
        self.calibrated, self.actuator, self.statistics = calibrated, actuator, LiveStatistics()

    def start(self, render: Any) -> None:
        self.render = render

    def stop(self) -> None:
        pass

    def rendered(self, n: int) -> NDArray[np.float32]:
        out = np.zeros(n, dtype=np.float32)
        self.render(out)
        return out


def opened() -> tuple[Contact, HandTurnedPlayer]:
    player = HandTurnedPlayer()
    contact = Contact(player, lambda *_: None)
    contact.open(EXAMPLE.read_bytes(), PressureCalibration())
    return contact, player


@pytest.mark.parametrize("there", [True, False])
def test_an_actuator_is_driven_as_it_needs(there: bool) -> None:
    """One that is wired to this machine, at 0 dB as it was recorded, and not the page's; else the page's."""
    events = [(0.4 * k, 0.0, 0.5, 0.005 * k) for k in range(20)]
    renderer = Renderer(EXAMPLE, rate=8000.0, actuator=COIL)
    stylus = Stylus(renderer)
    player = HandTurnedPlayer(there, COIL if there else None)
    contact = Contact(player, lambda *_: None)
    contact.open(EXAMPLE.read_bytes(), PressureCalibration())
    contact.actuate(ActuatorProfile(resonance_hz=200.0, damping=0.1, gain=3.0) if there else COIL, full_scale=5.0)
    contact.set_volume(-6.0)
    contact.push(np.array(events))
    for one in events:
        stylus.push(*one)
    out, expected = player.rendered(800), stylus.render(800)
    scale = 1.0 if there else 1 / 5.0
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(out, expected * scale * 10 ** (-6 / 20), rtol=1e-5)
    assert contact.gain == pytest.approx(scale * 10 ** (-6 / 20))


def stroked(contact: Contact, player: HandTurnedPlayer, n: int, seconds: float) -> NDArray[np.float32]:
    """What a player is given for n events of a steady stroke at 80 mm/s and what follows, in blocks of 8 ms."""
    blocks = []
    for k in range(round(seconds / 0.008)):
        contact.push(np.array([[80 * t, 0.0, 0.5, t] for t in (0.008 * k, 0.008 * k + 0.004) if k < n]).reshape(-1, 4))
        blocks.append(player.rendered(64))
    return np.concatenate(blocks)


def test_a_texture_that_takes_over_in_a_stroke_makes_no_gap_and_no_click() -> None:
    contact, player = opened()
    before = stroked(contact, player, 100, 0.4)[-1600:]
    contact.open(EXAMPLE.read_bytes(), PressureCalibration(), seed=7)
    after = player.rendered(640)  # without another event: the last ones are known to the new one
    usual = np.abs(np.diff(before)).max()
    assert np.abs(np.diff(np.concatenate([before[-1:], after]))).max() < 1.5 * usual
    # Behind the fade, 85 samples, the new one sounds alone: the pen was moving when it came.
    assert np.sqrt(np.mean(after[90:200] ** 2)) > 0.05 * np.sqrt(np.mean(before**2))


def test_the_volume_moves_without_a_step_and_what_is_too_loud_is_bent() -> None:
    contact, player = opened()
    contact.set_volume(-20.0)
    soft = stroked(contact, player, 100, 0.4)[-800:]
    contact.set_volume(24.0)
    assert abs(player.rendered(64)[0]) < 10 * np.abs(soft).max()
    assert np.abs(player.rendered(20 * 64)).max() < 1.0
    samples = np.array([-3.0, -0.8, 0.0, 0.5, 0.9, 3.0], dtype=np.float32)
    limit(samples)
    np.testing.assert_allclose(samples[1:4], [-0.8, 0.0, 0.5])
    assert 0.8 < samples[4] < 0.9
    assert -1.0 <= samples[0] < -0.99


def test_a_texture_that_was_loaded_before_takes_over_as_any_other_and_its_volume_comes_with_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Nothing is loaded meanwhile, and one that was under the pen before begins again."""
    textures = [path.read_bytes() for path in sorted(EXAMPLE.parent.glob("*.foten"))[:2]]

    def sounds(load: bool) -> NDArray[np.float32]:
        player = HandTurnedPlayer()
        contact = Contact(player, lambda *_: None)
        if load:
            contact.load([(textures[0], 1), (textures[1], 2)])
            monkeypatch.setattr("foten.studio.live_contact.NativeTexture", None)
            monkeypatch.setattr("foten.studio.live_contact.Renderer", None)
        parts = []
        for k in (0, 1, 0):
            contact.open(textures[k], PressureCalibration(), k + 1, -20.0 * k)
            assert contact._volume == pytest.approx(10.0**-k)
            parts.append(stroked(contact, player, 40, 0.16))
        return np.concatenate(parts)

    expected = sounds(False)
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_array_equal(sounds(True), expected)


def test_a_contact_that_is_closed_while_it_opens_does_not_play() -> None:
    player = HandTurnedPlayer()
    contact = Contact(player, lambda *_: None)
    contact.close()
    with pytest.raises(OSError, match="the page has left"):
        contact.open(EXAMPLE.read_bytes(), PressureCalibration())
    assert not hasattr(player, "render")


def test_an_output_that_cannot_be_is_refused() -> None:
    with pytest.raises(ValueError, match="say with --gain how many volts 1 m/s² is"):
        OutputDevice("daq:Dev1/ao0")
    with pytest.raises(ValueError, match="a page plays in real time"):
        OutputDevice("stroke.wav")
    with pytest.raises(ValueError, match="--device and --channel are a sound card's"):
        OutputDevice("null", device="3").check()
    assert OutputDevice("daq:Dev1/ao0", gain=0.5).calibrated
    assert not OutputDevice().calibrated


def test_what_rendering_dies_of_is_raised_by_stop_and_ends_no_other_page() -> None:
    turns, rendered = RoundRobinRenderer(), threading.Event()

    def fails(_out: Any) -> None:
        raise ValueError("no more")

    broken, sound = turns.player(48_000.0), turns.player(48_000.0)
    broken.start(fails)
    sound.start(lambda _out: rendered.set())
    for _ in range(2):
        assert rendered.wait(5.0)
        rendered.clear()
    sound.stop()
    with pytest.raises(ValueError, match="no more"):
        broken.stop()


def test_turns_that_were_left_out_are_missed() -> None:
    turns, after = RoundRobinRenderer(), threading.Event()
    player, n = turns.player(48_000.0), iter(range(10**6))

    def stands_still(_out: Any) -> None:
        k = next(n)
        if k == 1:
            time.sleep(0.5)
        if k == 4:
            after.set()

    player.start(stands_still)
    assert after.wait(5.0)
    player.stop()
    assert player.statistics.n_missed >= 0.9 * 0.5 / turns.block_s


def test_levels_are_compared_where_all_textures_were_recorded() -> None:
    """At a quarter, a half and three quarters of what 10 to 90 and 50 to 130 mm/s have in common, and of 1 to 2 N."""
    ranges = [{"speed": [10.0, 90.0], "force": [0.0, 2.0]}, {"speed": [50.0, 130.0], "force": [1.0, 4.0]}]
    renderers = [Renderer(exported("foten-plus", FotenPlusSizes(**PLUS), trained_range=one)) for one in ranges]
    expected = [(speed, force) for speed in (60.0, 70.0, 80.0) for force in (1.25, 1.5, 1.75)]
    np.testing.assert_allclose(_conditions(renderers), expected)


def test_white_noise_has_its_level_and_is_white(monkeypatch: pytest.MonkeyPatch) -> None:
    blocks: list[NDArray[np.float32]] = []
    sinks: list[Any] = []

    class Sink:
        rate_hz, n_at_once, failed = 48_000.0, 480, None

        def __init__(self, *options: Any) -> None:
            sinks.append(options)

        def start(self, read: Any) -> None:
            for _ in range(20):
                blocks.append(np.zeros(480, dtype=np.float32))
                time.sleep(0.005)
                read(blocks[-1])

        def stop(self) -> None:
            pass

    monkeypatch.setattr(players, "sink_of", Sink)
    with white_noise(-30.0, "3"):
        pass
    assert (sinks[0][0], sinks[0][3]) == ("sound", "3")
    noise = np.concatenate([block for block in blocks if block.any()]).astype(float)
    assert noise.size > 5000
    assert 20 * np.log10(noise.std()) == pytest.approx(-30.0, abs=0.5)
    assert abs(np.corrcoef(noise[:-1], noise[1:])[0, 1]) < 0.05
