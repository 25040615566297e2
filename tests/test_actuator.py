"""An actuator out: filter times actuator is flat, the limit is never reached, and a measured sweep gives the figures back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import bilinear, lfilter

from foten.models.texture_file import Texture
from foten.runtime.actuator import ActuatorProfile, identify, read_profile, sweep, write_profile
from foten.runtime.renderer import Renderer


def driven(texture: Texture, profile: ActuatorProfile, rate: float, n: int) -> tuple[np.ndarray, np.ndarray]:
    """What is rendered without and with an actuator, shapes (n,), under one hand and noise."""
    return tuple(
        Renderer(texture, rate=rate, seed=5, actuator=actuator).render(100.0, 1.0, n).astype(float)
        for actuator in (None, profile)
    )


@pytest.mark.parametrize("rate", [4000.0, 8000.0, 48_000.0])
@pytest.mark.parametrize(("resonance", "damping"), [(40.0, 0.1), (70.0, 0.25), (150.0, 0.5), (250.0, 0.2)])
def test_filter_times_actuator_is_flat(texture: Texture, rate: float, resonance: float, damping: float) -> None:
    """Physics: ±0.3 dB over 40 to 400 Hz, of the analogue resonator on what is played; `foten.h` says so."""
    profile = ActuatorProfile(resonance_hz=resonance, damping=damping, gain=-3.0)
    n = round(4 * rate)
    wanted, drive = driven(texture, profile, rate, n)
    window = np.hanning(n)
    hertz = np.fft.rfftfreq(n, 1 / rate)
    s, w = 2j * np.pi * hertz, 2 * np.pi * resonance
    resonator = profile.gain * s**2 / (s**2 + 2 * damping * w * s + w**2)
    played, asked = np.fft.rfft(drive * window) * resonator, np.fft.rfft(wanted * window)
    crossed, power = (
        np.convolve(part, np.ones(9), mode="same") for part in (played * asked.conj(), np.abs(asked) ** 2)
    )
    ratio = (crossed / power)[(hertz > 40) & (hertz < 400)]
    assert np.abs(20 * np.log10(np.abs(ratio))).max() < 0.3
    assert np.real(ratio).min() > 0.5  # the wires are the right way round again


def test_the_limit_is_never_reached_and_small_drives_are_left_alone(texture: Texture) -> None:
    profile = ActuatorProfile(resonance_hz=70.0, gain=1.0)
    _, free = driven(texture, profile, 8000.0, 8000)
    limit = 0.5 * np.abs(free).max()
    renderer = Renderer(texture, rate=8000, seed=5, actuator=ActuatorProfile(resonance_hz=70.0, gain=1.0, limit=limit))
    bent = renderer.render(100.0, 1.0, 8000)
    small = np.abs(free) <= 0.8 * limit
    assert np.abs(bent).max() < limit
    np.testing.assert_array_equal(bent[small], free[small].astype(np.float32))
    assert renderer.stats.n_limited == (~small).sum() > 0


@pytest.mark.parametrize("limit", [0.1, 0.3, 1.0])
def test_an_overdrive_does_not_reach_the_limit_either(texture: Texture, limit: float) -> None:
    """Hundred times too loud; as a float 0.1 is more than 0.1."""
    wanted = Renderer(texture, seed=5).render(100.0, 1.0, 2000).astype(float)
    profile = ActuatorProfile(gain=wanted.std() / (100 * limit), limit=limit)
    drive = Renderer(texture, seed=5, actuator=profile).render(100.0, 1.0, 2000).astype(float)
    assert 0.999999 * limit < np.abs(drive).max() < limit


def test_without_a_resonance_the_drive_is_acceleration_over_gain(texture: Texture) -> None:
    wanted, drive = driven(texture, ActuatorProfile(gain=4.0), 1000.0, 500)
    np.testing.assert_allclose(drive, wanted / 4, rtol=1e-6)


def test_figures_that_cannot_be_are_refused(texture: Texture) -> None:
    for figures in ({"gain": 0.0}, {"damping": -1.0}, {"resonance_hz": float("nan")}, {"limit": "5"}, {"unit": 3}):
        with pytest.raises(ValueError, match="actuator"):
            ActuatorProfile(**figures)
    for rate, resonance in ((2000.0, 70.0), (4000.0, 300.0)):
        with pytest.raises(ValueError, match="4000 Hz"):
            Renderer(texture, rate=rate, actuator=ActuatorProfile(resonance_hz=resonance))
    with pytest.raises(ValueError, match="figures"):
        Renderer(texture, rate=8000, actuator=ActuatorProfile(resonance_hz=70.0, gain=1e-310))


def test_new_figures_go_on_from_what_the_filter_remembers(texture: Texture) -> None:
    """Figures that are set again change nothing, and other ones make no step: from rest the filter would ring for 100 ms."""
    profile = ActuatorProfile(resonance_hz=70.0, gain=1.0)
    same, set_again = (Renderer(texture, rate=8000, seed=5, actuator=profile) for _ in range(2))
    at_once = same.render(100.0, 1.0, 4000)
    before = set_again.render(100.0, 1.0, 2000)
    set_again.native_state.set_actuator(profile.native())
    np.testing.assert_array_equal(np.concatenate([before, set_again.render(100.0, 1.0, 2000)]), at_once)


def test_refused_figures_change_nothing(texture: Texture) -> None:
    """They were taken over before they were looked at, and muted the rendering."""
    renderers = [Renderer(texture, rate=2000, seed=5) for _ in range(2)]
    with pytest.raises(ValueError, match="4000 Hz"):
        renderers[0].native_state.set_actuator(ActuatorProfile(resonance_hz=300.0).native())
    one, other = (renderer.render(100.0, 1.0, 500) for renderer in renderers)
    assert np.abs(one).max() > 0
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("resonance", "damping", "gain", "delay"),
    [(85.0, 0.18, 3.2, 24), (55.0, 0.4, -0.7, 0), (85.0, 0.18, 3.2, 640), (85.0, 0.18, 3.2, -40)],
)
def test_a_measured_sweep_gives_the_figures_back(resonance: float, damping: float, gain: float, delay: int) -> None:
    rate, w = 8000.0, 2 * np.pi * resonance
    rng = np.random.default_rng(0)
    drive = sweep(4.0, rate)
    b, a = bilinear([gain, 0, 0], [1, 2 * damping * w, w * w], rate)
    answer = np.concatenate([np.zeros(max(0, delay)), lfilter(b, a, drive)])
    measured = np.resize(answer[max(0, -delay) :], drive.size + 800)[: drive.size]
    measured[answer.size + min(0, delay) :] = 0.0
    measured += 0.02 * abs(gain) * rng.standard_normal(drive.size)
    found, residual = identify(drive, measured, rate, name="test")
    assert found.resonance_hz == pytest.approx(resonance, rel=0.02)
    assert found.damping == pytest.approx(damping, rel=0.03)
    assert found.gain == pytest.approx(gain, rel=0.02)
    assert found.delay_ms == pytest.approx(max(0, 1000 * delay / rate), abs=0.1)
    assert residual < 1e-3


def test_a_sweep_of_something_else_says_so() -> None:
    rng = np.random.default_rng(0)
    drive = sweep(2.0, 4000.0)
    with pytest.raises(ValueError, match="no resonator explains"):
        identify(drive, drive**2 + 0.1 * rng.standard_normal(drive.size), 4000.0)
    with pytest.raises(ValueError, match="no resonator explains"):
        identify(drive, rng.standard_normal(drive.size), 4000.0)
    with pytest.raises(ValueError, match="silent"):
        identify(drive, np.zeros_like(drive), 4000.0)
    with pytest.raises(ValueError, match="shape"):
        identify(drive, drive[:-1], 4000.0)
    spoiled = np.where(np.arange(drive.size) == 7, np.nan, drive)
    for pair in ((drive, spoiled), (spoiled, drive)):
        with pytest.raises(ValueError, match="NaN"):
            identify(*pair, 4000.0)
    with pytest.raises(ValueError, match="expected to lie"):
        sweep(1.0, 800.0)
    for seconds in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="expected positive"):
            sweep(seconds, 4000.0)


def test_a_profile_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "coil.json"
    profile = ActuatorProfile("coil", 70.0, 0.25, 2.5, "V", 5.0, 20.0, 3.0)
    write_profile(profile, path)
    assert read_profile(path) == profile
    good = json.loads(path.read_text())
    for change, message in (
        ({"format": "x"}, "not an actuator's profile"),
        ({"version": 9}, "version 9"),
        ({"colour": 1}, "'colour'"),
        ({"gain": 0}, "gain"),
    ):
        path.write_text(json.dumps({**good, **change}))
        with pytest.raises(ValueError, match=message):
            read_profile(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "nested more than"),
        ('{"format":' * 100 + "1" + "}" * 100, "nested more than"),
        ("{", "is not JSON"),
        ("9" * 5000, "is not JSON"),
        ("\xff", "is not JSON"),
        ('{"format": "foten-actuator", "version": 1, "gain": %s}' % ("9" * 400), "not below 2.63, in 'gain'"),
        ('{"format": "foten-actuator", "version": 1, "gain": 1e999}', "p.json holds a number that is not fin.*'gain'"),
        ('{"format": "foten-actuator", "version": 1, "limit": [null]}', "limit of the actuator is"),
        ('{"format": "foten-actuator", "version": 1, "damping": 1180591620717411303424}', "in 'damping'"),
    ],
)
def test_a_hostile_profile_is_a_value_error(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "p.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ValueError, match=message) as refusal:
        read_profile(path)
    assert len(str(refusal.value)) < 300
