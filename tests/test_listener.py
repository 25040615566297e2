"""The listener on signals whose answer is known: what cannot be told apart, and what can by one property alone."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from foten.evaluate.listener import listener_scores, long_stroke, vibrations
from foten.recording.trace import Trace

pytest.importorskip("torch")

from foten.evaluate import listener_network as networks
from foten.evaluate.listener_network import EXCERPT, HOP, area_under_curve, listener_auc

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
    recorded, asked = stroke(hiss(1)), []

    def rendered(seed: int) -> np.ndarray:
        asked.append(seed)
        return hiss(10 + seed)

    scores = listener_scores(recorded, rendered, [stroke(hiss(2))], seed=4)
    assert asked == [4, 5, 6]
    for kind in ("", "_waveform", "_person"):
        assert 0 <= scores[f"listener_auc{kind}"] <= 1
        assert 0 <= scores[f"listener_auc{kind}_control"] <= 1
    assert scores["listener_control_of"] == "other realisations of the same stroke"
    assert scores["listener_s"] == SECONDS


def test_two_halves_of_a_recording_are_not_paired_by_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    """They are two strokes, also where they are as long as one another; a rendering is under the recorded one."""
    monkeypatch.setattr("foten.evaluate.listener.MIN_LISTENED_S", 20.0)
    paired: list[bool] = []
    monkeypatch.setattr(
        networks, "listener_auc", lambda *two, seed, same_stroke=True: paired.append(same_stroke) or 0.5
    )
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
