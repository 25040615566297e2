"""Free runs of whole blocks from the stored and from a synthesised window."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from conftest import exported, resonance
from foten.evaluate.one_step import Linear
from foten.evaluate.warm_start import over_time, stored_window, synthesised_window, warm_start_runs, warm_start_scores
from foten.models.texture_file import Texture
from foten.recording.trace import Trace
from foten.runtime.native import NativeTexture

RATE_HZ, BLOCK = 1000.0, 2000


def noise(seed: int, n: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal((n, BLOCK))


def scores(recorded: np.ndarray, stored: np.ndarray, synthesised: np.ndarray | None = None) -> dict[str, Any]:
    runs = {"stored": stored[None]} | ({} if synthesised is None else {"synthesised": synthesised[None]})
    return warm_start_scores(recorded, runs, RATE_HZ, sd=2.0)


def test_silence_has_its_own_error_and_another_realisation_has_the_root_of_two_times_it() -> None:
    """E|x| of a normal number is √(2/π), of the difference of two √2 times that; 2 blocks of 2000 are within 3 %."""
    recorded = noise(0)
    silent, other = scores(recorded, np.zeros_like(recorded)), scores(recorded, noise(1))
    assert silent["silence_mae_scaled"] == pytest.approx(np.sqrt(2 / np.pi) / 2, rel=0.03)
    assert silent["stored"]["mae_scaled"] == silent["silence_mae_scaled"]
    assert (silent["stored"]["gfc"], silent["stored"]["level_db"]) == (0, -300)
    assert other["stored"]["mae_scaled"] == pytest.approx(np.sqrt(2) * silent["silence_mae_scaled"], rel=0.03)
    assert other["stored"]["gfc"] == pytest.approx(np.pi / 4, abs=0.01)  # two Rayleigh amplitudes


def test_the_first_100_ms_and_what_follows_are_apart() -> None:
    recorded = noise(0)
    run = recorded.copy()
    run[:, :100] = 0
    found = scores(recorded, run)["stored"]
    errors = found["error_to_silence_0_100_ms"], found["error_to_silence_100_400_ms"]
    assert (*errors, found["level_db"]) == (1, 0, 0)
    assert scores(recorded[:, :399], run[:, :399])["stored"]["error_to_silence_100_400_ms"] is None


@pytest.mark.parametrize(("last", "forgotten_ms"), [(0, 0), (150, 150), (BLOCK, None)])
def test_a_start_is_forgotten_when_runs_stay_the_same(last: int, forgotten_ms: float | None) -> None:
    run = noise(2)
    other = run.copy()
    other[:, :last] += 0.1
    other[:, :50] = run[:, :50]  # alike for a while is not forgotten
    assert scores(noise(0), run, other)["forgotten_ms"] == forgotten_ms
    assert scores(noise(0), run)["forgotten_ms"] is None
    assert scores(noise(0), 1e-3 * run, 1e-3 * other)["forgotten_ms"] is None  # silent


def test_error_and_level_over_time_are_of_frames_of_10_ms() -> None:
    """By a loop over frames, blocks and seeds."""
    recorded, run = noise(0), np.stack([noise(1), 0.5 * noise(2)])
    errors, levels = over_time(recorded, run, RATE_HZ)
    assert errors.shape == levels.shape == (40,)
    for k in (0, 7, 39):
        part = slice(10 * k, 10 * k + 10)
        differences = [abs(run[s, b, part] - recorded[b, part]) for s in range(2) for b in range(3)]
        powers = [run[s, b, part] ** 2 for s in range(2) for b in range(3)]
        assert errors[k] == pytest.approx(np.mean(differences) / np.mean(abs(recorded[:, part])))
        assert levels[k] == pytest.approx(10 * np.log10(np.mean(powers) / np.mean(recorded[:, part] ** 2)))


@pytest.fixture(scope="module")
def trace() -> Trace:
    """Noise as loud as it is fast, m/s² for 10 mm/s, under slow sweeps of speed and force."""
    t = np.arange(24 * BLOCK) / RATE_HZ
    speed, force = 90 - 70 * np.cos(0.7 * t), 1 - 0.5 * np.cos(0.9 * t)
    return Trace(speed / 10 * noise(3, 1)[0][np.arange(len(t)) % BLOCK], speed, force, RATE_HZ, BLOCK)


def test_a_synthesised_window_has_the_level_of_slow_light_strokes(texture: Texture, trace: Trace) -> None:
    linear, train = Linear(np.zeros(21), 1.0), tuple(range(20))
    window = synthesised_window(linear, trace, train, texture)
    assert [len(channel) for channel in window] == [texture.window] * 3
    assert (set(window[1]), set(window[2])) == ({45.0}, {0.8})
    # The samples near 45 mm/s vary by some mm/s.
    assert np.sqrt(np.square(window[0]).mean()) == pytest.approx(4.5, rel=0.1)
    loud = dataclasses.replace(trace, acceleration=2 * trace.acceleration)
    assert np.allclose(synthesised_window(linear, loud, train, texture)[0], 2 * window[0])
    by_force = dataclasses.replace(trace, acceleration=trace.force * trace.acceleration)
    light = synthesised_window(linear, by_force, train, texture)[0]
    assert light[-1] / window[0][-1] == pytest.approx(0.8, rel=0.05)  # of the same samples, whose forces vary by 0.05 N


def test_a_synthesised_window_rings_as_the_filter_does(texture: Texture, trace: Trace) -> None:
    """A resonance at 120 Hz, taps oldest first: reversed or of the other sign they would ring elsewhere, or grow."""
    long = dataclasses.replace(texture, card={**texture.card, "window": 480})
    linear = Linear(np.append(resonance(120.0, 0.99, 20), 0.0), 1.0)
    spectrum = np.abs(np.fft.rfft(synthesised_window(linear, trace, tuple(range(20)), long)[0]))
    assert np.argmax(spectrum) / 480 * RATE_HZ == pytest.approx(120, abs=5)


def test_runs_of_whole_blocks_begin_from_each_window_and_draw_the_same_noise(texture: Texture, trace: Trace) -> None:
    kernel, blocks = NativeTexture(texture.to_bytes()), (3, 5)
    m = texture.window
    loud, silent = ([np.full(m, level), np.full(m, 45.0), np.full(m, 0.8)] for level in (3.0, 0.0))
    runs = warm_start_runs(texture, kernel, trace, blocks, loud, seed=0)
    assert {name: run.shape for name, run in runs.items()} == dict.fromkeys(("stored", "synthesised"), (2, 2, BLOCK))
    other = warm_start_runs(texture, kernel, trace, blocks, silent, seed=0)
    assert np.array_equal(runs["stored"], other["stored"])
    assert not np.allclose(runs["synthesised"][..., 0], other["synthesised"][..., 0])
    # The resonator forgets.
    assert np.allclose(runs["synthesised"][..., -100:], other["synthesised"][..., -100:], atol=1e-6)
    assert list(warm_start_runs(texture, kernel, trace, blocks, None, seed=0)) == ["stored"]


def test_the_stored_window_is_what_a_run_begins_from_with_an_excitation_too(texture: Texture, trace: Trace) -> None:
    """A rendering with one begins from a drawn state: given no window, every texture would begin alike whatever it stores."""
    kernel, blocks = NativeTexture(texture.to_bytes()), (3, 5)
    window = stored_window(texture)
    scaled = texture.scaling.scale(np.stack(window, axis=1))
    np.testing.assert_allclose(scaled, texture.tensors["warm_start"], atol=1e-12)
    stored = warm_start_runs(texture, kernel, trace, blocks, None, seed=0)["stored"]
    given = warm_start_runs(texture, kernel, trace, blocks, window, seed=0)["synthesised"]
    np.testing.assert_array_equal(stored, given)


def test_a_model_of_noise_has_one_run_and_no_window(trace: Trace) -> None:
    texture = exported("gan")
    runs = warm_start_runs(
        texture, NativeTexture(texture.to_bytes()), trace, (3,), [np.zeros(texture.window)] * 3, seed=0
    )
    assert list(runs) == ["stored"]
