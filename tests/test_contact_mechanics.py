"""The mechanics of contact: what theory says of a ball on a flat, on a wave, in flight, and held by friction."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from foten.simulation import contact_mechanics
from foten.simulation.contact_mechanics import (
    CONTACT,
    GRID_MM,
    LOOP_MM,
    SUBSTEPS,
    ContactParameters,
    contact_vibration,
    profile,
    surface_of,
)
from foten.simulation.simulate import realisations, second_realisation, simulate
from foten.simulation.stroking import Stroking, stroking

RATE_HZ = 10_000.0
OFTEN = ("sandpaper-coarse", "leather", "rubber-sheet")  # of the textures, the others at night
FLAT = replace(
    CONTACT["ribbed-plastic"],
    roughness_um=0.0,
    depth_um=0.0,
    grains_per_mm=0.0,
    friction=0.0,
    stick=0.0,
    hand_damping_n_s_m=6.0,
)


def steady(speed: float, force: float, seconds: float = 1.0) -> Stroking:
    n = round(seconds * RATE_HZ)
    velocity = np.column_stack([np.full(n, speed), np.zeros(n)])
    return Stroking(RATE_HZ, np.cumsum(velocity, axis=0) / RATE_HZ, velocity, np.full(n, force), np.zeros((n, 2)))


def forces(
    parameters: ContactParameters, surface: np.ndarray, speeds: list[float], force: float, seconds: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Contact force and friction of one long piece at each speed over a surface [mm], (k, n) each."""
    n = round(seconds * RATE_HZ)
    speed = np.repeat(np.array(speeds)[:, None], n, axis=1)
    place = speed * np.arange(1, n + 1) / RATE_HZ
    both = contact_mechanics._integrate(parameters, surface, RATE_HZ, place, speed, np.full_like(speed, force))
    return both[1], both[0]


def wave(amplitude_um: float, wavelength_mm: float) -> np.ndarray:
    n = round(200 * wavelength_mm / GRID_MM)
    return 1e-3 * amplitude_um * np.sin(2 * np.pi * np.arange(n) * GRID_MM / wavelength_mm)


def test_a_ramp_rises_evenly_from_step_to_step() -> None:
    """Two pieces at 100 and 50 mm/s over a slope of 0.2: the steps of a sample lie between it and the one before."""
    surface = 0.2 * GRID_MM * np.arange(20_000)
    places = 1.0 + np.arange(50)[:, None] * np.array([0.1, 0.05])  # mm, at 1 kHz
    passed = list(contact_mechanics.passed(surface, places, 1e-3 / SUBSTEPS))
    heights, rates = (np.concatenate(part) for part in zip(*passed, strict=True))
    rising = np.broadcast_to([0.02, 0.01], rates[SUBSTEPS:].shape)  # m/s: slope times speed
    np.testing.assert_allclose(rates[SUBSTEPS:], rising, atol=1e-9)  # of heights near 1e-3 m, over 0.25 ms
    np.testing.assert_allclose(heights[SUBSTEPS - 1 :: SUBSTEPS], 0.2e-3 * places, atol=1e-12)
    assert not rates[:SUBSTEPS].any()  # nothing is known before the first


def test_a_tip_that_follows_a_wave_is_pushed_with_mass_times_its_acceleration() -> None:
    """F − P = m z̈ + c ż, of z that follows the surface: amplitudes A √((m ω²)² + (c ω)²)."""
    amplitude_um, wavelength_mm = 5.0, 1.0
    omega = 2 * np.pi * np.array([20.0, 60.0])
    force, _ = forces(FLAT, wave(amplitude_um, wavelength_mm), (omega / (2 * np.pi) * wavelength_mm).tolist(), 1.0)
    expected = 1e-6 * amplitude_um * np.hypot(FLAT.mass_kg * omega**2, FLAT.hand_damping_n_s_m * omega)
    settled = force[:, 3000:]
    # A contact of 1.3 MN/m gives by some thousandths of that; kinks of the grid of 10 µm are smoothed by the mass.
    np.testing.assert_allclose(np.sqrt(2) * settled.std(axis=1), expected, rtol=0.03)
    np.testing.assert_allclose(settled.mean(axis=1), 1.0, atol=0.01)


def test_contact_is_lost_where_the_surface_falls_away_faster_than_the_hand_presses() -> None:
    """A tip leaves where m A ω² and c A ω exceed P: here from √((m ω²)² + (c ω)²) = 17 kN/m on, which is 129 mm/s."""
    surface = wave(60.0, 1.0)
    shares = np.mean(forces(FLAT, surface, [100.0, 160.0, 280.0], 1.0, seconds=0.8)[0][:, 3000:] == 0.0, axis=1)
    assert shares[0] == 0.0
    assert 0.02 < shares[1] < shares[2] < 0.9


def test_a_flying_tip_comes_down_by_the_hands_force_alone() -> None:
    """Over a step down of h it flies √(2 h m / P) s, without damping by the hand."""
    p = replace(FLAT, hand_damping_n_s_m=0.0)
    drop_mm, force_n = 0.5, 0.5
    n_points = 40_000
    surface = np.where(np.arange(n_points) < 1000, 0.0, -drop_mm)  # met at 10 mm
    force = forces(p, surface, [100.0], force_n, seconds=0.3)[0][0]
    aloft = np.flatnonzero(force == 0.0)
    landed = aloft[0] + np.flatnonzero(force[aloft[0] :] > 0)[0]
    expected_s = np.sqrt(2 * drop_mm * 1e-3 * p.mass_kg / force_n)
    # Four samples, and it starts from 2 µm inside.
    assert (landed - aloft[0]) / RATE_HZ == pytest.approx(expected_s, abs=4e-4)
    assert force[landed : landed + 40].max() > 10 * force_n  # and it lands with an impact


def test_a_bounce_loses_what_its_damping_says() -> None:
    surface = np.where(np.arange(40_000) < 1000, 0.0, -0.3)

    def impacts(damping: float) -> int:
        parameters = replace(FLAT, hand_damping_n_s_m=0.0, damping_s_m=damping)
        force = forces(parameters, surface, [100.0], 0.5, seconds=0.4)[0][0]
        return int(np.sum((force[1:] > 0) & (force[:-1] == 0)))

    assert impacts(0.2) > impacts(2.0) >= 1


def test_a_contact_pushes_and_never_pulls() -> None:
    """However fast a tip leaves: Hunt and Crossley's damping alone would pull it back from 1/D on, here 0.1 m/s."""
    surface = np.where(np.arange(40_000) < 1000, 0.0, 0.5)  # a step up, from which it is thrown
    force, _ = forces(replace(FLAT, hand_damping_n_s_m=0.0, damping_s_m=10.0), surface, [100.0], 0.5, seconds=0.3)
    assert force.min() == 0.0
    assert force.max() > 5.0


def test_friction_is_coulombs_while_it_slides_and_what_holds_while_it_sticks() -> None:
    p = replace(FLAT, friction=0.5, stick=0.0, shaft_damping=0.3)
    force, (slides, holds) = forces(p, np.zeros(4000), [100.0, 0.0], 0.8, seconds=0.6)
    np.testing.assert_allclose(slides[5000:], -0.5 * 0.8, rtol=1e-6)  # μ P, against the motion
    np.testing.assert_array_equal(holds, 0.0)  # at rest nothing pulls
    assert force[1] == pytest.approx(0.8)


def test_a_sticky_surface_squeals_when_slow_and_not_when_fast() -> None:
    """Friction that falls with speed feeds the tip's spring; above the fall it damps. It squeals near the spring's own tone."""
    p = replace(FLAT, friction=0.8, stick=0.6, shaft_damping=0.05, shaft_hz=90.0)
    slow, fast = forces(p, np.zeros(4000), [8.0, 200.0], 1.0, seconds=1.5)[1][:, 10_000:]
    assert slow.std() > 0.05
    assert fast.std() < 0.001
    hertz = np.fft.rfftfreq(slow.size, 1 / RATE_HZ)[np.abs(np.fft.rfft(slow - slow.mean())).argmax()]
    assert 30.0 < hertz < 100.0  # slower than the spring by the time it sticks


@pytest.mark.parametrize("height_um", [10.0, -10.0])
def test_grains_that_overlap_do_not_grow_through_each_other(height_um: float) -> None:
    """Ten caps of 1 mm in every mm, all of one height: the highest of each place stands, not their sum."""
    p = replace(FLAT, grains_per_mm=10.0, grain_um=height_um, grain_spread=0.0, grain_mm=1.0)
    grown = contact_mechanics._with_grains(np.zeros(100_000), p, np.random.default_rng(0)) / (height_um * 1e-3)
    assert grown.max() == pytest.approx(1.0, rel=1e-12)
    assert grown.mean() > 0.9  # they lie everywhere


def test_a_ball_bridges_what_is_narrower_than_itself() -> None:
    """Oracle: the dilation by its definition, at every hundredth point."""
    p = CONTACT["sandpaper-fine"]
    surface, lifted = profile(p, "sandpaper-fine"), surface_of(p, "sandpaper-fine")
    u = np.arange(-40, 41)
    for i in range(100, 40_000, 997):
        expected = (surface[i + u] - (u * GRID_MM) ** 2 / (2 * p.tip_mm)).max()
        assert lifted[i] == pytest.approx(expected, abs=1e-12)
    assert (lifted >= surface).all()
    assert np.diff(lifted).std() < 0.5 * np.diff(surface).std()


@pytest.mark.parametrize("key", CONTACT)
def test_a_profile_is_the_textures_and_closed_to_a_loop(key: str) -> None:
    p = CONTACT[key]
    surface = profile(p, key)
    assert surface.shape == (round(LOOP_MM / GRID_MM),)
    assert surface.mean() == pytest.approx(0.0, abs=1e-9)
    assert abs(surface[0] - surface[-1]) < 12 * np.abs(np.diff(surface)).std() + 1e-4
    profile.cache_clear()
    np.testing.assert_array_equal(profile(p, key), surface)


@pytest.mark.parametrize("key", ["ribbed-plastic", "wire-mesh", "canvas"])
def test_periods_are_where_they_are_said_to_be(key: str) -> None:
    p = CONTACT[key]
    surface = profile(p, key)
    cycles = np.fft.rfftfreq(surface.size, GRID_MM)
    power = np.abs(np.fft.rfft(surface)) ** 2
    above = cycles > 0.8 / p.wavelength_mm  # below are pairs of periods
    assert cycles[above][power[above].argmax()] * p.wavelength_mm == pytest.approx(1.0, rel=0.03)
    pairs = power[np.abs(cycles * p.wavelength_mm - 0.5) < 0.05].sum()
    assert (pairs > 0.002 * power[above].sum()) == (p.alternating > 0)


@pytest.mark.parametrize("key", [key if key in OFTEN else pytest.param(key, marks=pytest.mark.slow) for key in CONTACT])
def test_a_realisation_is_another_place_of_the_same_profile(key: str) -> None:
    recording = simulate(key, 6, seed=3)
    again, other = second_realisation(recording, 3), second_realisation(recording, 4)
    assert again.sha256() == recording.sha256() != other.sha256()
    one, two = (r["acceleration_z"].samples[10_000:] for r in (recording, other))
    assert one.std() == pytest.approx(two.std(), rel=0.35)  # of five seconds
    assert abs(np.corrcoef(one, two)[0, 1]) < 0.3
    assert np.abs(recording["acceleration_z"].samples).max() <= 3 * 9.81
    speed = stroking(6, 3, RATE_HZ).speed
    assert 0.05 < (one - one.mean())[speed[10_000:] > 60].std() < 15
    assert recording["force_z"].samples.mean() == pytest.approx(stroking(6, 3, RATE_HZ).force.mean(), rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("key", ["sawn-wood", "varnish"])
def test_realisations_at_once_are_those_one_by_one_and_the_same_where_they_are_needed(key: str) -> None:
    """Of either contact, to the bit; in a span, once filters have settled, to what float64 leaves of a decay."""
    recording = simulate(key, 8, seed=3)
    several = realisations(recording, [5, 6, 7])
    assert [one.sha256() for one in several] == [second_realisation(recording, seed).sha256() for seed in (5, 6, 7)]
    assert [one.simulation["noise_seed"] for one in several] == [5, 6, 7]  # type: ignore[index]
    for whole, part in zip(several, realisations(recording, [5, 6, 7], spans_s=[(1.0, 3.0), (6.0, 7.0)]), strict=True):
        for name, channel in whole.channels.items():
            at = channel.times
            inside = ((at >= 2.0) & (at < 3.0)) | ((at >= 6.9) & (at < 7.0))
            theirs = part.channels[name].samples
            np.testing.assert_allclose(theirs[inside], channel.samples[inside], 1e-6, 1e-6 * channel.samples.std())
        changed = part["force_z"].samples != whole["force_z"].samples
        assert not changed[10_000:30_000].any()
        assert changed[35_000:55_000].all()


def test_pieces_side_by_side_are_one_long_integration() -> None:
    """Where contact is kept nothing is chaotic, and a settled piece does not know where it began."""
    p, key = CONTACT["leather"], "leather"
    stroke = steady(80.0, 1.0, seconds=0.7)
    place = 7.0 + np.cumsum(stroke.speed) / RATE_HZ

    def integrate(*piece: np.ndarray) -> np.ndarray:
        return contact_mechanics._integrate(p, surface_of(p, key), RATE_HZ, *piece)

    (pieces,) = contact_mechanics.joined_pieces(integrate, place[None], stroke)
    long_piece = integrate(place[None], stroke.speed[None], stroke.force[None])
    for joined, expected in zip(pieces, long_piece, strict=True):
        apart = np.abs(joined - expected[0])[3000:]
        assert apart.max() < 0.02 * expected[0].std()


def test_a_piece_takes_over_evenly_from_the_one_before() -> None:
    """Each piece gives its number: over 10 ms, of 100 samples, that rises from the one to the next."""

    def numbered(places: np.ndarray, *_: np.ndarray) -> np.ndarray:
        return np.broadcast_to(np.floor(places[:, 1500:1501]), places.shape)[None]  # after 0.15 s of settling

    (joined,) = contact_mechanics.joined_pieces(numbered, np.arange(7500)[None] / 2500, steady(80.0, 1.0, 0.75))
    np.testing.assert_allclose(joined[0, [2499, 2500, 2550, 2599, 2600]], [0, 0.005, 0.505, 0.995, 1], atol=1e-12)


def test_a_ball_meets_no_seam_in_a_loop() -> None:
    height = np.random.default_rng(0).normal(0, 0.01, 400)
    turned = contact_mechanics.under_ball(np.roll(height, 100), 0.5)
    np.testing.assert_array_equal(turned, np.roll(contact_mechanics.under_ball(height, 0.5), 100))


def test_more_force_keeps_the_tip_down_and_more_speed_throws_it_off() -> None:
    p, key = CONTACT["sandpaper-coarse"], "sandpaper-coarse"

    def lost(speed: float, force: float) -> float:
        stroke, rng = steady(speed, force), np.random.default_rng(0)
        return float(np.mean(contact_vibration(p, surface_of(p, key), stroke, rng)[1][2000:] == 0.0))

    assert lost(150.0, 0.3) > lost(150.0, 2.5) + 0.1
    assert lost(250.0, 1.0) > lost(60.0, 1.0) + 0.1


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"tip_mm": 0.0}, "tip_mm is 0.0, expected 0.001 to 10"),
        ({"friction": -0.1}, "friction is -0.1, expected 0 to 100000"),
        ({"grain_mm": 6.0}, "grain_mm is 6.0, expected 0.04 to 5"),
        ({"grain_mm": 0.02}, "grain_mm is 0.02, expected 0.04 to 5"),
        ({"modulus_mpa": 90_000.0, "tip_mass_g": 0.5}, "is too stiff for steps of 25 µs"),
        ({"tip_mm": float("nan")}, "tip_mm is nan, expected 0.001 to 10"),
    ],
)
def test_parameters_that_cannot_be_are_refused(changed: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        ContactParameters(**{**asdict(CONTACT["canvas"]), **changed})
