"""Free runs of whole blocks from the stored and from a synthesised window."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from foten.evaluate.one_step import Linear
from foten.evaluate.warm_start import synthesised_window, warm_start_runs, warm_start_scores
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
    assert (found["mae_100_ms"], found["mae_400_ms"], found["level_db"]) == (1, 0, 0)
    assert scores(recorded[:, :90], run[:, :90])["stored"]["mae_400_ms"] is None


@pytest.mark.parametrize(("last", "forgotten_ms"), [(0, 0), (150, 150), (BLOCK, None)])
def test_a_start_is_forgotten_when_runs_stay_the_same(last: int, forgotten_ms: float | None) -> None:
    run = noise(2)
    other = run.copy()
    other[:, :last] += 0.1
    other[:, :50] = run[:, :50]  # alike for a while is not forgotten
    assert scores(noise(0), run, other)["forgotten_ms"] == forgotten_ms
    assert scores(noise(0), run)["forgotten_ms"] is None


@pytest.fixture(scope="module")
def trace() -> Trace:
    """Noise as loud as it is fast, m/s² for 10 mm/s, under slow sweeps of speed and force."""
    t = np.arange(24 * BLOCK) / RATE_HZ
    speed, force = 90 - 70 * np.cos(0.7 * t), 1 - 0.5 * np.cos(0.9 * t)
    return Trace(speed / 10 * noise(3, 1)[0][np.arange(len(t)) % BLOCK], speed, force, RATE_HZ, BLOCK)


def test_a_synthesised_window_has_the_level_of_slow_light_strokes(texture: Texture, trace: Trace) -> None:
    linear, train = Linear(np.append(np.zeros(20), 0.0), 1.0), tuple(range(20))
    window = synthesised_window(linear, trace, train, texture)
    assert [len(channel) for channel in window] == [texture.window] * 3
    assert (set(window[1]), set(window[2])) == ({45.0}, {0.8})
    assert np.sqrt(np.square(window[0]).mean()) == pytest.approx(
        4.5, rel=0.1
    )  # the samples near 45 mm/s vary by some mm/s
    loud = dataclasses.replace(trace, acceleration=2 * trace.acceleration)
    assert np.allclose(synthesised_window(linear, loud, train, texture)[0], 2 * window[0])


def test_runs_of_whole_blocks_begin_from_each_window_and_draw_the_same_noise(texture: Texture, trace: Trace) -> None:
    kernel, blocks = NativeTexture(texture.to_bytes()), (3, 5)
    m = texture.window
    loud, silent = ([np.full(m, level), np.full(m, 45.0), np.full(m, 0.8)] for level in (3.0, 0.0))
    runs = warm_start_runs(texture, kernel, trace, blocks, loud, seed=0)
    assert {name: run.shape for name, run in runs.items()} == dict.fromkeys(("stored", "synthesised"), (2, 2, BLOCK))
    other = warm_start_runs(texture, kernel, trace, blocks, silent, seed=0)
    assert np.array_equal(runs["stored"], other["stored"])
    assert not np.allclose(runs["synthesised"][..., 0], other["synthesised"][..., 0])
    assert np.allclose(
        runs["synthesised"][..., -100:], other["synthesised"][..., -100:], atol=1e-6
    )  # the resonator forgets
    assert list(warm_start_runs(texture, kernel, trace, blocks, None, seed=0)) == ["stored"]
