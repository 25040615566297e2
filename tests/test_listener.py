"""The listener on signals whose answer is known: what cannot be told apart, and what can by one property alone."""

from __future__ import annotations

import csv
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import butter, freqz_sos, lfilter
from scipy.stats import spearmanr

from foten.dsp.distance import area_under_curve, earth_mover_octaves, log_spectral_distance
from foten.dsp.level import N_BANDS, envelope_edges
from foten.dsp.perception import THRESHOLD_M_S2, internal_noise_db
from foten.evaluate.listener import listener_scores, long_stroke, vibrations
from foten.recording.trace import Trace

pytest.importorskip("torch")

from foten.evaluate import listener_network as networks
from foten.evaluate.listener_network import EXCERPT, HOP, Limits, felt, listener_auc

PENS = Path(__file__).parents[1].parent / "shared" / "data" / "pen-triplets"
RATE_HZ, SECONDS = 1000.0, 60
N = round(SECONDS * RATE_HZ)


def hand(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    speed, force = (
        np.interp(np.arange(N), np.arange(0, N + 500, 500), rng.uniform(*ends, N // 500 + 1))
        for ends in ((20, 200), (0.4, 2.4))
    )
    return speed, force


def stroke(acceleration: np.ndarray, pieces: int = 1) -> Trace:
    return Trace(acceleration, *hand(), RATE_HZ, N // pieces)


def hiss(seed: int) -> np.ndarray:
    """Coloured Gaussian noise whose level follows the speed."""
    return lfilter([1.0], [1.0, -0.9, 0.5], np.random.default_rng(seed).standard_normal(N)) * hand()[0] / 100


def crackle(seed: int) -> np.ndarray:
    """The same spectrum and level, of 50 impacts a second."""
    rng = np.random.default_rng(seed)
    impacts = np.where(rng.random(N) < 0.05, rng.standard_normal(N) / np.sqrt(0.05), 0.0)
    return lfilter([1.0], [1.0, -0.9, 0.5], impacts) * hand()[0] / 100


def auc(first: np.ndarray, second: np.ndarray, kind: str = "") -> float:
    return listener_auc(*vibrations(stroke(first), stroke(second))[kind], seed=0)


def step(decibels: float, bands: slice = slice(None)) -> np.ndarray:
    """White noise of 1 m/s² that is stronger in some bands."""
    spectrum = np.fft.rfft(np.random.default_rng(7).standard_normal(N))
    gains = np.zeros(N_BANDS)
    gains[bands] = decibels
    place = np.searchsorted(envelope_edges(RATE_HZ), np.fft.rfftfreq(N, 1 / RATE_HZ))
    return np.fft.irfft(spectrum * 10 ** (np.r_[0.0, gains, 0.0][place] / 20), N)


ONE = slice(6, 7)  # wide enough for its level to vary by no more than 0.5 dB from one half second to another


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest) -> None:
    """A third of the budget is enough for what is plain."""
    if not request.node.get_closest_marker("slow"):
        monkeypatch.setattr(networks, "N_STEPS", 150)


def test_two_realisations_cannot_be_told_apart() -> None:
    # 120 excerpts of each that overlap by three quarters count as about 40: an area scatters by 0.29/√20 = 0.065.
    assert auc(hiss(1), hiss(2)) == pytest.approx(0.5, abs=0.16)


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(lambda: 1.6 * hiss(2), id="4 dB louder"),
        pytest.param(lambda: crackle(2), id="impacts under the same spectrum"),
        pytest.param(lambda: lfilter([1.0, 0.6], [1.4], hiss(2)), id="another colour"),
        pytest.param(lambda: hiss(2) / np.maximum(hand()[0] / 100, 0.1), id="a level that does not follow the hand"),
    ],
)
def test_one_property_is_enough(other: Callable[[], np.ndarray]) -> None:
    assert auc(hiss(1), other()) > 0.9


def test_only_the_waveform_tells_a_vibration_from_its_mirror_image() -> None:
    """Impacts of one sign, and of the other: the same energies at every moment."""
    one_sided = lfilter([1.0], [1.0, -0.9, 0.5], np.where(np.random.default_rng(3).random(N) < 0.05, 5.0, 0.0))
    other = -lfilter([1.0], [1.0, -0.9, 0.5], np.where(np.random.default_rng(4).random(N) < 0.05, 5.0, 0.0))
    assert auc(one_sided, other) < 0.7
    assert auc(one_sided, other, "_waveform") > 0.9


@pytest.mark.parametrize(
    "bands", [pytest.param(ONE, id="one band", marks=pytest.mark.slow), pytest.param(slice(None), id="all bands")]
)
def test_a_person_notices_a_just_noticeable_step_of_level_in_three_of_four_pairs(bands: slice) -> None:
    """The area is the share of pairs in which the louder of two is named; by 480 excerpts of each it scatters by 0.02.

    A vibration's own level varies too, and a listener that learns is no ideal one, which costs up to 0.06 in one band.
    """
    assert auc(step(0.0), step(2.3, bands), "_person") == pytest.approx(0.73, abs=0.06)
    assert auc(step(0.0), step(6.0, bands), "_person") > 0.88  # Φ(2.49/√2) = 0.96


def test_a_person_cannot_tell_what_is_equal() -> None:
    assert auc(step(0.0), step(0.0), "_person") == pytest.approx(0.5, abs=0.06)  # three times 0.02


def test_internal_noise_moves_an_excerpt_as_one_and_silence_does_not_give_it_away() -> None:
    """A network takes the noise off again where silent frames are moved as loud ones are: 0.98 for a step of 2.3 dB."""
    import torch

    levels = torch.full((3000, N_BANDS, EXCERPT), 12.0)
    levels[:, :, ::2] = -20.0
    sd = internal_noise_db(N_BANDS) * np.log(10) / 10
    moved = felt(levels, Limits(sd, np.zeros((N_BANDS, 1)), np.ones((N_BANDS, 1)))).double().numpy()
    silent, loud = moved[:, :, 0], moved[:, :, 1]
    np.testing.assert_allclose(moved[:, :, 3::2], loud[:, :, None].repeat(EXCERPT // 2 - 1, axis=2), atol=1e-4)
    # Of 3000 draws: 1/√3000 = 0.018 of a correlation, and as much of a variance times √2.
    np.testing.assert_allclose(np.cov(loud.T), sd**2 * (np.eye(N_BANDS) + 1.0), atol=0.12 * 2 * sd**2)
    assert np.abs(np.corrcoef(loud.T, silent.T)[:N_BANDS, N_BANDS:]).max() < 0.09


@pytest.mark.slow
def test_a_person_does_not_notice_what_is_below_threshold_where_the_unit_is_known() -> None:
    faint, louder = (0.1 * THRESHOLD_M_S2 * step(decibels) for decibels in (0.0, 6.0))  # of all bands: 30 dB in each
    assert auc(faint, louder, "_person") == pytest.approx(0.5, abs=0.06)
    in_any_unit = vibrations(stroke(faint), stroke(louder), in_m_s2=False)["_person"]
    assert listener_auc(*in_any_unit, seed=0) > 0.88


@pytest.mark.skipif(not PENS.is_dir(), reason="the pens of ../shared/data are not here")
def test_a_person_s_band_levels_say_which_of_two_pens_people_find_nearer_to_a_third() -> None:
    """As often as the log-spectral distance does. Eight pens and triplets that depend: one in twelve either way means nothing."""
    hertz = np.arange(10.0, 500.0, 2.0)
    edges = envelope_edges(RATE_HZ)
    filters = [butter(2, band, "bandpass", fs=RATE_HZ, output="sos") for band in pairwise(edges)]
    weights = np.abs([freqz_sos(sos, hertz, fs=RATE_HZ)[1] for sos in filters]) ** 2
    spectra = {name: np.square(pen.astype(float)).mean(axis=0) for name, pen in np.load(PENS / "pens.npz").items()}
    precision = np.linalg.inv(internal_noise_db(N_BANDS) ** 2 * (np.eye(N_BANDS) + 1.0))

    def d_prime(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        """Of half seconds of two pens, by condition: the noise is a person's, and the pens' levels do not vary."""
        steps = 10 * np.log10(one @ weights.T) - 10 * np.log10(other @ weights.T)
        return np.sqrt(np.einsum("ci,ij,cj->c", steps, precision, steps))

    with (PENS / "triplets.csv").open(encoding="utf-8") as file:
        rows = list(csv.reader(file))[1:]
    shares = np.array([int(first) / (int(first) + int(second)) for *_, first, second in rows])
    decided = shares != 0.5
    clear = np.abs(shares - 0.5) > 0.19
    assert (len(rows), decided.sum(), clear.sum()) == (84, 83, 55)

    def agreement(distance: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> tuple[float, float, float]:
        """Shares of decided and of clear triplets in which a distance sides with the majority, and rank correlation."""
        further = np.array(
            [
                distance(spectra[second], spectra[middle]).mean() - distance(spectra[first], spectra[middle]).mean()
                for first, middle, second, *_ in rows
            ]
        )
        agrees = (further > 0) == (shares > 0.5)
        return agrees[decided].mean(), agrees[clear].mean(), spearmanr(further, shares).statistic

    person, spectral = agreement(d_prime), agreement(log_spectral_distance)
    mover = agreement(lambda one, other: earth_mover_octaves(hertz, one, other))
    assert person == pytest.approx((0.72, 0.84, 0.67), abs=0.006)
    assert spectral == pytest.approx((0.72, 0.85, 0.53), abs=0.006)
    assert mover == pytest.approx((0.84, 0.95, 0.78), abs=0.006)


def test_what_is_at_rest_is_hidden() -> None:
    speed = np.where(np.arange(N) % 2000 < 600, 0.0, hand()[0])
    still = speed == 0
    sensor = np.where(still, 0.2 * np.random.default_rng(5).standard_normal(N), 0.0)
    moving = np.where(still, 0.0, hiss(1))
    one, other = (Trace(a, speed, hand()[1], RATE_HZ, N) for a in (moving, moving + sensor))
    first, second = vibrations(one, other)["_waveform"]
    frames = still.reshape(-1, 8).any(axis=1)
    np.testing.assert_array_equal(first.frames[:8, frames], 0.0)
    np.testing.assert_array_equal(second.frames[:8, frames], 0.0)
    np.testing.assert_array_equal(second.waveform[frames], 0.0)
    assert np.abs(second.frames[:8, ~frames]).min() > 0.0


@pytest.mark.parametrize("pieces", [1, 30])
def test_excerpts_lie_within_a_piece_and_none_is_both_learned_and_scored(pieces: int) -> None:
    one, other = vibrations(stroke(hiss(1), pieces), stroke(hiss(2), pieces))[""]
    n_frames = one.frames.shape[1]
    per_piece = n_frames // pieces
    for starts in (one.train, one.test):
        np.testing.assert_array_equal(starts // per_piece, (starts + EXCERPT - 1) // per_piece)
    assert one.train.max() + EXCERPT <= 0.6 * n_frames
    assert one.test.min() >= 0.7 * n_frames - 1
    assert one.test.max() + EXCERPT <= n_frames
    np.testing.assert_array_equal(one.test, other.test)
    assert len(one.test) > 0.3 * n_frames / HOP / 2


def test_the_area_is_the_share_of_pairs() -> None:
    """Oracle: all pairs, directly."""
    rng = np.random.default_rng(6)
    first, second = rng.integers(0, 20, 60).astype(float), rng.integers(5, 25, 45).astype(float)
    pairs = second[:, None] - first[None]
    assert area_under_curve(first, second) == pytest.approx(((pairs > 0) + 0.5 * (pairs == 0)).mean(), abs=1e-12)
    assert area_under_curve(first, first) == pytest.approx(0.5, abs=1e-12)
    assert area_under_curve(np.zeros(3), np.ones(4)) == 1.0


@pytest.mark.slow
def test_the_same_seed_gives_the_same_area_whatever_was_drawn_before() -> None:
    import torch

    pair = vibrations(stroke(hiss(1)), stroke(1.1 * hiss(2)))[""]
    threads = torch.get_num_threads()
    first = listener_auc(*pair, seed=1)
    torch.rand(3)
    assert listener_auc(*pair, seed=1) == first
    assert listener_auc(*pair, seed=2) != first
    assert torch.get_num_threads() == threads


def test_every_listener_has_a_rendering_of_its_own_and_the_control_a_true_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(networks, "N_STEPS", 2)
    recorded, asked, stages = stroke(hiss(1)), [], list[str]()

    def rendered(seed: int) -> np.ndarray:
        asked.append(seed)
        return hiss(10 + seed)

    scores = listener_scores(recorded, rendered, [stroke(hiss(2))], 4, stages.append)
    assert (asked, stages[::3]) == ([4, 5, 6], ["listener 1 of 3", "listener 2 of 3", "listener 3 of 3"])
    for kind in ("", "_waveform", "_person"):
        assert 0 <= scores[f"listener_auc{kind}"] <= 1
        assert 0 <= scores[f"listener_auc{kind}_control"] <= 1
    assert scores["listener_control_of"] == "other realisations of the same stroke"
    assert scores["listener_s"] == SECONDS


def test_two_halves_of_a_recording_are_not_paired_by_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are two strokes, also where they are as long as one another; a rendering is under the recorded one."""
    monkeypatch.setattr("foten.evaluate.listener.MIN_LISTENED_S", 20.0)
    paired: list[bool] = []
    monkeypatch.setattr(networks, "listener_auc", lambda *_, seed, same_stroke=True: paired.append(same_stroke) or 0.5)
    listener_scores(stroke(hiss(1), 30), lambda seed: hiss(20 + seed))
    assert paired == [True, False] * 9
    paired.clear()
    listener_scores(stroke(hiss(1)), lambda seed: hiss(20 + seed), [stroke(hiss(2))])
    assert paired == [True, True] * 9


def test_a_recording_needs_enough_for_a_listener_and_twice_that_for_a_control(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(networks, "N_STEPS", 2)
    blocks = stroke(hiss(1), 30)
    with pytest.raises(ValueError, match="38 s to listen to, expected at least 40"):
        listener_scores(long_stroke(blocks, range(19)), lambda seed: hiss(seed))
    with pytest.raises(ValueError, match="pieces of 480 ms to listen to, expected at least 496 ms"):
        listener_scores(Trace(hiss(1), *hand(), RATE_HZ, round(0.48 * RATE_HZ)), lambda seed: hiss(seed))
    alone = listener_scores(blocks, lambda seed: hiss(20 + seed))
    assert alone["listener_auc_control"] is None
    monkeypatch.setattr("foten.evaluate.listener.MIN_LISTENED_S", 30.0)
    halves = listener_scores(blocks, lambda seed: hiss(20 + seed))
    assert halves["listener_control_of"] == "every other block of the recording"
    assert halves["listener_auc_control"] is not None


def test_a_hand_at_rest_says_nothing() -> None:
    still = Trace(hiss(1), np.zeros(N), np.ones(N), RATE_HZ, N)
    with pytest.raises(ValueError, match="the hand is at rest where a listener is to learn"):
        vibrations(still, still)
