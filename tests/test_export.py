"""From tensors to a texture: the warm start is a recorded window, and what the kernel does not reproduce is refused."""

from __future__ import annotations

import numpy as np
import pytest

from conftest import CARD, SCALING, SMALL, sizes_with, untrained, untrained_tensors
from foten.models.definitions import model_of
from foten.models.model_sizes import ModelSizes
from foten.models.texture_file import CLOSED_LOOP_TOLERANCE, Texture
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.recording.windows import first_scored, windows
from foten.runtime.loops import render_streams
from foten.runtime.native import NativeTexture
from foten.runtime.proof import proved
from foten.training.job import ScaledBlocks, scaled_blocks
from foten.training.texture_builder import N_GOLDEN, TextureBuilder, pick_warm_start
from foten.training.window_fit import one_step_windows


@pytest.fixture(scope="module")
def speeding_up() -> ScaledBlocks:
    """Noise under a hand that speeds up through 45 mm/s; a burst ends where it is at 45."""
    rng = np.random.default_rng(0)
    n = 12_000
    speed, force = np.linspace(20.0, 75.0, n) + 1e-4 * rng.standard_normal(n), np.full(n, 0.8)
    force += 1e-4 * rng.standard_normal(n)
    acceleration = rng.standard_normal(n)
    nearest = int(np.abs(speed - 45.0).argmin())
    acceleration[nearest - 9 : nearest + 1] *= 30.0
    assert 100 < nearest % 1000 < 900
    trace = Trace(acceleration, speed, force, 1000.0, 1000)
    return scaled_blocks(trace, Split(tuple(range(2, 10)), (0, 11), (1, 10), 12, 1000, "contiguous", 0))


@pytest.mark.parametrize("m", [5, 30])
def test_validation_is_on_the_samples_that_a_test_scores(speeding_up: ScaledBlocks, m: int) -> None:
    """Whatever the window; training takes every window of its blocks."""
    windows = one_step_windows(speeding_up, m)
    assert len(windows.train) == 8 * (1000 - m)
    assert set(windows.validation // 1000) == set(speeding_up.split.validation)
    assert set(windows.validation % 1000) == set(range(first_scored(1000), 1000))


def test_the_warm_start_is_a_training_window_near_45_mm_s_whose_end_is_neither_loud_nor_soft(
    speeding_up: ScaledBlocks,
) -> None:
    blocks, m = speeding_up, 30
    speed, force = blocks.trace.speed, blocks.trace.force
    window, condition = pick_warm_start(blocks, m)
    ends = blocks.targets(m)[0]
    mean, sd = np.array([45.0, 0.8]), np.array(blocks.scaling.sd[1:])
    away = np.hypot(*((np.stack([speed, force])[:, ends - 1].T - mean) / sd).T)
    near = ends[np.argsort(away)[: len(ends) // 100]]
    all_windows = windows(blocks.flat, near, m)
    (chosen,) = np.flatnonzero((all_windows == window).all(axis=(1, 2)))
    assert condition["asked"] == {"speed": 45.0, "force": 0.8}
    assert condition["recorded"] == {"speed": speed[near[chosen] - 1], "force": force[near[chosen] - 1]}
    power = np.square(all_windows[:, -20:, 0]).mean(axis=1)
    assert abs(int((power < power[chosen]).sum()) - int((power > power[chosen]).sum())) <= 1
    assert power.max() > 50 * power[chosen]  # the burst was among them


def test_the_warm_start_is_from_the_training_blocks_even_where_others_are_nearer(speeding_up: ScaledBlocks) -> None:
    """The hand is at 45 mm/s in a block that is for validation now; the nearest training windows are a block away."""
    at_45 = int(np.abs(speeding_up.trace.speed - 45.0).argmin()) // 1000
    train = tuple(k for k in range(2, 10) if k != at_45)
    split = Split(train, (at_45,), (0, 1, 10, 11), 12, 1000, "contiguous", 0)
    blocks = scaled_blocks(speeding_up.trace, split)
    _, condition = pick_warm_start(blocks, 30)
    number = int(np.abs(blocks.trace.speed - condition["recorded"]["speed"]).argmin()) // 1000
    assert number in (at_45 - 1, at_45 + 1)


def test_a_draft_goes_on_from_its_warm_start_and_is_proved_on_validation_windows(speeding_up: ScaledBlocks) -> None:
    blocks, sizes = speeding_up, sizes_with("foten", SMALL)
    tensors = untrained_tensors("foten", sizes, untrained("foten", sizes))
    card = {name: value for name, value in CARD.items() if name not in ("warm_start", "metrics")}
    texture = TextureBuilder("foten", blocks, card, model_of).texture(sizes, tensors, CARD["metrics"]).texture
    window, condition = pick_warm_start(blocks, sizes.window)
    assert texture.card["warm_start"] == condition
    np.testing.assert_allclose(texture.tensors["warm_start"], window, rtol=1e-6)
    golden = texture.tensors["golden.windows"]
    assert len(golden) == N_GOLDEN
    validation = windows(blocks.flat, blocks.targets(sizes.window)[1], sizes.window)
    for one in golden[:-2]:
        assert np.abs(validation - one).max(axis=(1, 2)).min() < 1e-6
    assert not golden[-2].any()
    # The deterministic loop that the file proves begins at the warm start.
    np.testing.assert_allclose(closed_loop(texture), texture.tensors["golden.closed_loop"], atol=1e-4)


def closed_loop(texture: Texture) -> np.ndarray:
    """The kernel's deterministic loop from the warm start under the golden condition."""
    start, condition = (texture.tensors[name].astype(float) for name in ("warm_start", "golden.condition"))
    path = np.maximum(condition[:, :1] * texture.scaling.sd[1] + texture.scaling.mean[1], 0.0)
    kernel = NativeTexture(texture.to_bytes())
    return render_streams(kernel, start[None], np.concatenate([condition, path], axis=1)[None], None)[0]


@pytest.fixture(scope="module")
def chaotic() -> Texture:
    """A network that amplifies in its closed loop, which begins at the first golden window."""
    sizes, rng = sizes_with("foten", SMALL), np.random.default_rng(0)
    tensors = untrained_tensors("foten", sizes, untrained("foten", sizes))
    golden = rng.standard_normal((8, sizes.window, 3))
    tensors["head_3.weight"] = 20 * tensors["head_3.weight"]
    return proved("foten", sizes, tensors, SCALING, golden, golden[0], CARD).texture


def test_what_the_kernel_does_not_reproduce_is_refused() -> None:
    """A reference that is wrong by a thousandth of a standard deviation, ten times what a file may be off."""
    sizes, rng = sizes_with("foten", SMALL), np.random.default_rng(0)
    tensors = untrained_tensors("foten", sizes, untrained("foten", sizes))

    class Wrong:
        def __init__(self, sizes: ModelSizes, tensors: dict[str, np.ndarray]) -> None:
            self._model = model_of(sizes, tensors)
            self.start = self._model.start

        def predict(self, windows: np.ndarray) -> np.ndarray:
            return self._model.predict(windows) + 1e-3

    golden = rng.standard_normal((8, sizes.window, 3))
    proved("foten", sizes, tensors, SCALING, golden, golden[0], CARD)
    with pytest.raises(ValueError, match=r"golden|proof|reproduce"):
        proved("foten", sizes, tensors, SCALING, golden, golden[0], CARD, definition=Wrong)


def test_a_chaotic_loop_is_proved_though_rounding_leads_elsewhere(chaotic: Texture) -> None:
    """Its own steps are far from the golden ones; each step from those is within the tolerance."""
    NativeTexture(chaotic.to_bytes())
    assert np.abs(closed_loop(chaotic) - chaotic.tensors["golden.closed_loop"]).max() > 1


@pytest.mark.parametrize("i", [0, 2, 33, 63])
def test_every_step_of_a_chaotic_loop_is_held_to_the_tolerance(chaotic: Texture, i: int) -> None:
    wrong = chaotic.tensors["golden.closed_loop"].copy()
    wrong[i] += 3 * CLOSED_LOOP_TOLERANCE * max(1.0, abs(wrong[i]))
    with pytest.raises(ValueError, match="proof: 64 closed-loop steps"):
        NativeTexture(Texture(chaotic.card, {**chaotic.tensors, "golden.closed_loop": wrong}).to_bytes())


def test_a_silence_after_a_sample_is_proved() -> None:
    """Every bin of a constant but for its first sample lies on the real axis: rounding must not choose between π and −π."""
    sizes, rng = sizes_with("foten", SMALL), np.random.default_rng(0)
    tensors = untrained_tensors("foten", sizes, untrained("foten", sizes))
    golden = np.repeat(rng.uniform(-0.01, 0.01, (20, 1, 3)), sizes.window, axis=1)
    golden[:, 0, 0] -= rng.uniform(1e-4, 0.01, 20)
    proved("foten", sizes, tensors, SCALING, golden, rng.standard_normal((sizes.window, 3)), CARD)
