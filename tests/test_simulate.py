from __future__ import annotations

import dataclasses
import hashlib
import json
import time
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt, welch

from foten.recording.recording import AXES, Recording
from foten.simulation import stroking as stroking_module
from foten.simulation.contact_mechanics import CONTACT
from foten.simulation.linear_family import LINEAR_FAMILY, OTHER_LINEAR
from foten.simulation.simulate import (
    GRID_MM,
    TEXTURES,
    VERSION,
    _roughness,
    second_realisation,
    sensor_channels,
    simulate,
    vibration,
)
from foten.simulation.stroking import Stroking, stepped_stroking, stroking
from foten.simulation.two_mass_contact import TWO_MASS

GRAVITY = 9.81


def test_parameters_are_those_of_the_version() -> None:
    """All results are of these surfaces and strokes: other ones need another `VERSION`."""
    families = [LINEAR_FAMILY, OTHER_LINEAR, TEXTURES, CONTACT, TWO_MASS]
    tables: list[object] = [{key: dataclasses.asdict(one) for key, one in family.items()} for family in families]
    tables.append({name: value for name, value in vars(stroking_module).items() if name.isupper()})
    text = json.dumps(tables, sort_keys=True, default=lambda array: np.round(array, 6).tolist())
    assert (VERSION, hashlib.sha256(text.encode()).hexdigest()[:12]) == (2, "6ec374a36c81")


def steady(speed: float, force: float, seconds: float = 8.0) -> Stroking:
    """Stroke at constant speed [mm/s] and force [N], on a very long plate."""
    n = round(seconds * 10_000)
    position = np.column_stack([np.arange(n) * speed / 10_000, np.zeros(n)])
    return Stroking(10_000.0, position, np.tile([speed, 0.0], (n, 1)), np.full(n, force), np.zeros((n, 2)))


def level(samples: np.ndarray) -> float:
    """Rms of three axes together, after the first 0.2 s."""
    return float(np.sqrt(np.mean(np.sum(samples[2000:] ** 2, axis=1))))


def vibrations(recording: Recording) -> np.ndarray:
    """Recorded axes from 20 Hz up [m/s²], shape (n, 3)."""
    samples = np.stack([channel.samples for channel in recording.axes("acceleration")], axis=1)
    rate_hz = recording["acceleration_x"].rate_hz
    return np.asarray(sosfiltfilt(butter(4, 20, "high", fs=rate_hz, output="sos"), samples, axis=0))


@pytest.mark.parametrize("key", [*TEXTURES, *LINEAR_FAMILY, *OTHER_LINEAR])
def test_a_seed_is_a_recording(key: str) -> None:
    first, again, other = simulate(key, 2, seed=3), simulate(key, 2, seed=3), simulate(key, 2, seed=4)
    assert first.sha256() == again.sha256() != other.sha256()
    assert json.loads(json.dumps(dict(first.simulation or {}))) == first.simulation
    assert first.duration_s == pytest.approx(2, abs=0.01)


def test_a_tool_that_leans_at_rest_reads_all_of_gravity() -> None:
    stroke = dataclasses.replace(steady(0.0, 1.0, 1.0), tilt=np.full((10_000, 2), 0.3))
    read = sensor_channels(np.zeros((10_000, 3)), stroke.force, 0.3, stroke, 1, np.random.default_rng(0))
    mean = [read[f"acceleration_{axis}"].samples.mean() for axis in AXES]  # of noise of 0.14 m/s²
    assert np.linalg.norm(mean) == pytest.approx(GRAVITY, abs=0.01)


@pytest.mark.parametrize("key", TEXTURES)
def test_a_texture_is_raw_sensors(key: str) -> None:
    recording = simulate(key, 12, seed=1)
    expected = {"acceleration": 10_000, "force": 10_000, "position": 120}
    assert {name: recording[name].rate_hz for name in recording.channels} == {
        f"{quantity}_{axis}": rate_hz for quantity, rate_hz in expected.items() for axis in AXES
    }
    acceleration = np.stack([channel.samples for channel in recording.axes("acceleration")])
    assert np.abs(acceleration).max() <= 3 * GRAVITY
    assert np.mean(np.abs(acceleration) == 3 * GRAVITY) < 1e-3  # clipping is rare
    assert acceleration[2].mean() == pytest.approx(GRAVITY, abs=0.2)
    speed = stroking(12, 1, 10_000.0).speed
    signal = vibrations(recording)[2000:-2000]
    moving, resting = speed[2000:-2000] > 80, speed[2000:-2000] < 5
    rms_moving, rms_resting = (np.sqrt(np.mean(np.sum(signal[m] ** 2, axis=1))) for m in (moving, resting))
    assert 0.3 < rms_moving < 8
    assert rms_resting < 0.3  # mostly the sensor's noise, 0.15
    frequency_hz, power = welch(signal[moving], 10_000, axis=0, nperseg=4096)
    total = power.sum(axis=1)
    assert total[(frequency_hz > 20) & (frequency_hz < 450)].sum() > 0.7 * total.sum()


@pytest.mark.parametrize("key", ["steel-mesh-1", "steel-mesh-2", "plastic-mesh"])
@pytest.mark.parametrize("speed", [120.0, 240.0])
def test_the_tone_of_a_mesh_moves_with_speed(key: str, speed: float) -> None:
    parameters = TEXTURES[key]
    samples = vibration(parameters, steady(speed, 1.0), np.random.default_rng(0))[:, 2]
    frequency_hz, power = welch(samples, 10_000, nperseg=20_000)
    tone_hz = speed / parameters.wavelength_mm
    near = np.abs(frequency_hz / tone_hz - 1) < 0.5
    peak_hz = frequency_hz[near][np.argmax(power[near])]
    # The length of some 400 to 1600 cells of 5 % jitter is known to 0.3 %, the frequency to half a line.
    assert peak_hz == pytest.approx(tone_hz, rel=0.03)


@pytest.mark.parametrize("key", ["steel-mesh-1", "jeans"])
def test_the_waveform_of_a_cell_is_that_of_the_texture_in_every_realisation(key: str) -> None:
    parameters = TEXTURES[key]
    regular = dataclasses.replace(parameters, lattice_share=1.0, period_jitter=0.0)

    def coupling(seed: int) -> complex:
        """Phase of the second harmonic against that of the first, on which no start depends."""
        path_mm = 400 * parameters.wavelength_mm
        roughness = _roughness(regular, path_mm, np.random.default_rng(seed))[: round(path_mm / GRID_MM)]
        turns = np.arange(roughness.size) * GRID_MM / parameters.wavelength_mm
        first, second = (np.mean(roughness * np.exp(-2j * np.pi * order * turns)) for order in (1, 2))
        return complex(second / first**2 / abs(second / first**2))

    expected = np.exp(1j * (parameters.phases[1] - 2 * parameters.phases[0]))
    # Linear interpolation between the edges of cells leaves 1e-3 of one harmonic in another.
    assert [coupling(seed) for seed in range(5)] == pytest.approx([expected] * 5, abs=0.01)
    assert TEXTURES["steel-mesh-1"].phases != TEXTURES["jeans"].phases


@pytest.mark.parametrize("key", TEXTURES)
def test_the_level_rises_with_speed_and_force_and_standstill_is_silent(key: str) -> None:
    parameters = TEXTURES[key]

    def at(speed: float, force: float) -> float:
        return level(vibration(parameters, steady(speed, force, 4.0), np.random.default_rng(0)))

    levels = [at(speed, 1.0) for speed in (0.0, 2.0, 30.0, 100.0, 300.0)]
    assert levels[0] == 0
    assert levels[1] < 0.05 * levels[4]
    assert np.all(np.diff(levels) > 0)
    assert at(100.0, 3.0) > 1.15 * at(100.0, 0.3)


def test_textures_are_in_the_order_of_roughness_that_their_names_promise() -> None:
    stroke = steady(100.0, 1.0)
    levels = {key: level(vibration(row, stroke, np.random.default_rng(0))) for key, row in TEXTURES.items()}
    assert min(levels, key=levels.__getitem__) == "smooth-rubber"
    assert levels["steel-mesh-1"] > 5 * levels["smooth-rubber"]
    assert levels["towel"] > 2 * levels["soft-fabric"]


def test_grass_crackles_and_cardboard_hisses() -> None:
    def kurtosis(key: str) -> float:
        samples = vibration(TEXTURES[key], steady(100.0, 1.0), np.random.default_rng(0))[2000:, 2]
        return float(np.mean(samples**4) / np.mean(samples**2) ** 2)

    assert kurtosis("artificial-grass") > 6
    assert kurtosis("styrofoam") > 4
    assert kurtosis("cardboard") == pytest.approx(3, abs=0.5)


def test_another_noise_seed_is_the_same_stroke_over_another_piece() -> None:
    first = simulate("jeans", 20, seed=2)
    second = second_realisation(first, 77)
    assert second.simulation is not None
    assert second.simulation["noise_seed"] == 77
    assert second.sha256() == simulate("jeans", 20, seed=2, noise_seed=77).sha256()
    assert second_realisation(first, 2).sha256() == first.sha256()
    for name in ("position_x", "position_y", "force_z"):
        difference = first[name].samples - second[name].samples
        noise = 0.02 if name.startswith("position") else 0.01
        assert difference.std() == pytest.approx(np.sqrt(2) * noise, rel=0.1)
    one, other = vibrations(first), vibrations(second)
    assert level(one) == pytest.approx(level(other), rel=0.05)
    for axis in range(3):
        assert abs(np.corrcoef(one[:, axis], other[:, axis])[0, 1]) < 0.05  # about 2000 independent samples


def test_a_stored_recording_keeps_its_own_parameters() -> None:
    recording = simulate("towel", 2)
    simulation = json.loads(json.dumps(dict(recording.simulation or {})))
    assert second_realisation(dataclasses.replace(recording, simulation=simulation), 0).sha256() == recording.sha256()
    simulation["parameters"]["level"] *= 2
    louder = second_realisation(dataclasses.replace(recording, simulation=simulation), 0)
    assert level(vibrations(louder)) > 1.8 * level(vibrations(recording))


def test_the_slow_accelerometer_has_its_own_anti_alias_filter() -> None:
    fast, slow = simulate("styrofoam", 20), simulate("styrofoam", 20, accelerometer_hz=1000)
    assert slow["acceleration_x"].rate_hz == 1000
    assert slow["force_z"].rate_hz == 10_000
    power = []
    for recording in (fast, slow):
        rate_hz = recording["acceleration_z"].rate_hz
        frequency_hz, density = welch(recording["acceleration_z"].samples, rate_hz, nperseg=int(rate_hz) // 5)
        power.append(density[(frequency_hz >= 50) & (frequency_hz <= 350)])
    # One realisation through two filters: equal below the cutoff. Without a filter, folds would raise it.
    np.testing.assert_allclose(10 * np.log10(power[1] / power[0]), 0, atol=0.3)


def test_friction_opposes_the_motion() -> None:
    recording, stroke = simulate("textured-rubber", 10), stroking(10, 0, 10_000.0)
    fast = stroke.speed > 50
    along = np.sum(np.stack([recording[f"force_{axis}"].samples for axis in "xy"], axis=1) * stroke.velocity, axis=1)
    ratio = along[fast] / (stroke.speed * stroke.force)[fast]
    assert np.median(ratio) == pytest.approx(-TEXTURES["textured-rubber"].friction, rel=0.08)


def test_a_minute_takes_less_than_five_seconds() -> None:
    simulate("steel-mesh-1", 1)  # imports
    start_s = time.process_time()
    simulate("steel-mesh-1", 60)
    assert time.process_time() - start_s < 5


@pytest.mark.parametrize(
    ("key", "seconds", "accelerometer_hz", "message"),
    [
        ("sandpaper", 1, None, r"unknown texture 'sandpaper', expected one of steel-mesh-1.*linear-cloth"),
        ("jeans", 1, 3000, "divided by a whole number"),
        ("linear-hum", 1, 20_000, "expected 100 to 10000"),
        ("jeans", 0, None, "expected 1 to 3600"),
    ],
)
def test_bad_input_is_named(key: str, seconds: float, accelerometer_hz: float | None, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        simulate(key, seconds, accelerometer_hz=accelerometer_hz)


def test_the_command_writes_what_the_function_returns(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from foten.cli.command_line import _status
    from foten.datasets.hdf5 import load_recording

    path = tmp_path / "rec.h5"
    assert _status(["simulate", "linear-hum", "--seconds", "2", "--seed", "3", "-o", str(path)]) == 0
    expected = simulate("linear-hum", 2, seed=3)
    stored = load_recording(path)
    assert stored.sha256() == expected.sha256()
    assert stored.simulation == expected.simulation
    capsys.readouterr()
    assert _status(["simulate", "--list"]) == 0
    kinds = (TEXTURES, CONTACT, TWO_MASS, LINEAR_FAMILY, OTHER_LINEAR)
    assert len(capsys.readouterr().out.splitlines()) == sum(len(kind) for kind in kinds)


@pytest.mark.parametrize("key", ["jeans", "linear-hum"])
@pytest.mark.parametrize(
    "spoil",
    [
        lambda s: s.update(seconds="long"),
        lambda s: s.update(seconds=1e9),
        lambda s: s.update(seed=None),
        lambda s: s.update(version=99),
        lambda s: s.pop("stroke_seed"),
        lambda s: s["parameters"].update(level=[None]),
        lambda s: s["parameters"].update(level=1e300),
        lambda s: s["parameters"].update({"rest_share": 0.1}),  # of an earlier version
        lambda s: s["parameters"].update(harmonics=[1.0] * 1000, coefficients=[0.0] * 1000),
    ],
)
def test_parameters_that_cannot_be_are_a_value_error(key: str, spoil) -> None:
    """A recording's file holds them, and anyone may have written it."""
    recording = simulate(key, 1)
    simulation = json.loads(json.dumps(recording.simulation))
    spoil(simulation)
    with pytest.raises(ValueError, match=r"."):
        second_realisation(dataclasses.replace(recording, simulation=simulation), 1)


SEEDS = range(4)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_hand_stays_on_the_plate_and_in_contact(seed: int) -> None:
    stroke = stroking(64, seed, 1000.0)
    assert stroke.position.min() > 0
    assert stroke.position.max() < 100
    assert stroke.force.min() > 0.1
    assert stroke.force.max() < 4.0
    assert stroke.speed.max() <= 350


def test_a_minute_covers_speed_and_force() -> None:
    medians = []
    for seed in SEEDS:
        stroke = stroking(64, seed, 1000.0)
        medians.append(np.median(stroke.speed))
        cells = np.histogram2d(stroke.speed, stroke.force, [[0, 60, 120, 180, 240], [0.1, 0.5, 1, 2, 3]])[0]
        assert cells.min() > 0  # ms in each of 16 cells
        assert (stroke.speed < 5).mean() < 0.1  # no long pauses
    assert np.mean(medians) == pytest.approx(100, rel=0.15)


def test_reversals_pass_through_standstill() -> None:
    stroke = stroking(64, 0, 1000.0)
    resting = stroke.speed < 2
    stops = np.flatnonzero(resting[1:] & ~resting[:-1])
    assert stops.size > 20
    directions = stroke.velocity / np.maximum(stroke.speed, 1e-9)[:, None]
    inner = stops[(stops > 100) & (stops < len(resting) - 200)]
    cosine = np.sum(directions[inner - 100] * directions[inner + 200], axis=1)
    assert (cosine < -0.5).sum() > 5  # back the way it came, at least sometimes


def test_velocity_is_the_derivative_of_position() -> None:
    stroke = stroking(10, 1, 10_000.0)
    derivative = np.gradient(stroke.position, axis=0) * 10_000
    # Central difference: h²/6 of the third derivative, which the shortest fast movements put near 1e6 mm/s³.
    np.testing.assert_allclose(derivative[1:-1], stroke.velocity[1:-1], atol=0.01)


def test_speed_and_force_leave_the_texture_band_alone() -> None:
    stroke = stroking(64, 2, 1000.0)
    for signal in (stroke.speed, stroke.force):
        frequency_hz, power = welch(signal, 1000, nperseg=4000)
        assert power[frequency_hz > 20].sum() < 1e-3 * power.sum()


def test_the_rate_samples_one_and_the_same_motion() -> None:
    fine, coarse = stroking(20, 3, 10_000.0), stroking(20, 3, 1000.0)
    np.testing.assert_allclose(fine.position[::10], coarse.position, atol=1e-9)
    np.testing.assert_allclose(fine.force[::10], coarse.force, atol=1e-9)
    np.testing.assert_allclose(fine.tilt[::10], coarse.tilt, atol=1e-9)


def test_a_stepped_stroke_goes_through_its_knots_on_straight_lines() -> None:
    knots = [
        (0.0, 40.0, 1.0),
        (0.5, 40.0, 1.0),
        (0.51, 200.0, 1.0),
        (0.8, 200.0, 1.0),
        (0.83, -200.0, 0.0),
        (1.0, -200.0, 2.0),
    ]
    stroke = stepped_stroking(knots, 10_000.0)
    for at, velocity, force in knots[:-1]:
        assert stroke.velocity[round(at * 10_000)] == pytest.approx([velocity, 0.0], abs=1e-6)
        assert stroke.force[round(at * 10_000)] == pytest.approx(force)
    assert stroke.speed[8150] == pytest.approx(0.0, abs=1e-6)  # half of the way back
    assert stroke.force[9150] == pytest.approx(1.0)
    # Areas under the lines: 20, 1.2, 58, 0 and −34 mm.
    assert stroke.position[-1] == pytest.approx([45.2, 0.0], abs=0.05)


@pytest.mark.parametrize("times", [(0.1, 0.2), (0.0, 0.0)])
def test_knots_that_do_not_rise_from_zero_are_refused(times: tuple[float, float]) -> None:
    with pytest.raises(ValueError, match="expected 0 and rising times"):
        stepped_stroking([(time_s, 100.0, 1.0) for time_s in times], 1000.0)
