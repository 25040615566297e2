"""The judge: which blocks each figure may look at, what a truth adds, and what it says where there is none."""

from __future__ import annotations

from dataclasses import asdict
from itertools import product

import numpy as np
import pytest
from scipy.signal import lfilter

from conftest import SCALING, SMALL, exported, sizes_with
from foten.evaluate.evaluate import Judgement, evaluate
from foten.evaluate.free_run import synthesize_linear
from foten.evaluate.one_step import ORDERS, Linear, excitation_scores
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.models.texture_file import Texture, read_texture
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Channel, Recording
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.recording.windows import targets
from foten.runtime.native import NativeTexture
from foten.runtime.renderer import EXAMPLE
from foten.simulation.simulate import simulate

PREPROCESS = PreprocessConfig(trim_ms=0, block_ms=1000)
N_BLOCKS, BLOCK, FIRST = 16, 1000, 320
SPLIT = Split(tuple(range(8)), (8, 9, 10, 11), (12, 13, 14, 15), N_BLOCKS, BLOCK, "contiguous", 0)


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Recording that echoes after 30 samples in half of its training and in its test blocks, and nowhere else.

    So an order of 40 is best on the test blocks, and a lower one on the validation blocks.
    """
    rng = np.random.default_rng(3)
    n, blocks = (N_BLOCKS + 1) * BLOCK, np.arange((N_BLOCKS + 1) * BLOCK) // BLOCK
    echo = lfilter([1.0], np.append(np.eye(1, 30)[0], -0.9), rng.standard_normal(n))
    echoing = np.isin(blocks, (4, 5, 6, 7)) | (blocks >= 12)
    t = np.arange(n) / 1000
    channels = {
        "acceleration": np.where(echoing, echo, rng.standard_normal(n)),
        "speed": 100 + 50 * np.sin(7 * t),
        "force": 1 + 0.4 * np.sin(5 * t),
    }
    return Recording({name: Channel(samples, 1000.0) for name, samples in channels.items()}, texture="echo")


@pytest.fixture(scope="module")
def judged(recording: Recording) -> Judgement:
    texture = exported(
        "foten",
        sizes_with("foten", SMALL),
        split=asdict(SPLIT),
        preprocess=asdict(PREPROCESS),
        recording_sha256=recording.sha256(),
    )
    return evaluate(texture, recording)


@pytest.fixture(scope="module")
def trace(recording: Recording) -> Trace:
    trace = preprocess(recording, PREPROCESS)
    assert (trace.n_blocks, trace.block) == (N_BLOCKS, BLOCK)
    return trace


def design(block: np.ndarray, order: int, scheduled: bool) -> np.ndarray:
    """History, oldest first, and one, then both times speed and times force of the sample before; (BLOCK − order, …)."""
    rows = []
    for n in range(order, BLOCK):
        known = np.append(block[n - order : n, 0], 1.0)
        speed, force = block[n - 1, 1:]
        rows.append(np.concatenate([known, speed * known, force * known]) if scheduled else known)
    return np.array(rows)


def least_squares(trace: Trace, chosen: tuple[int, ...], order: int, scheduled: bool = False) -> Linear:
    """AR(order) by NumPy's least squares over whole blocks."""
    blocks = SCALING.scale(trace.stacked()).reshape(N_BLOCKS, BLOCK, 3)[list(chosen)]
    rows = np.concatenate([design(block, order, scheduled) for block in blocks])
    target = blocks[:, order:, 0].ravel()
    coefficients, *_ = np.linalg.lstsq(rows, target)
    missed = float(np.square(target - rows @ coefficients).mean())
    return Linear(coefficients.reshape(3, -1) if scheduled else coefficients, np.sqrt(missed))


def error(trace: Trace, chosen: tuple[int, ...], fitted: Linear) -> float:
    """Mean absolute one-step error over the scored samples of some blocks, scaled."""
    blocks = SCALING.scale(trace.stacked()).reshape(N_BLOCKS, BLOCK, 3)[list(chosen)]
    skipped = FIRST - fitted.window
    missed = [
        block[FIRST:, 0] - (design(block, fitted.window, fitted.scheduled) @ fitted.coefficients.ravel())[skipped:]
        for block in blocks
    ]
    return float(np.abs(missed).mean())


def test_ar_20_is_fitted_on_the_training_blocks_alone(judged: Judgement, trace: Trace) -> None:
    """Oracle: NumPy's least squares. With the test blocks beside it, it would be another."""
    mae = judged.document["references"]["ar"]["mae_scaled"]
    assert mae == pytest.approx(error(trace, SPLIT.test, least_squares(trace, SPLIT.train, 20)), rel=1e-6)
    for more in (SPLIT.validation, SPLIT.test):
        other = error(trace, SPLIT.test, least_squares(trace, SPLIT.train + more, 20))
        assert abs(other - mae) > 1e-4 * mae
    scheduled = judged.document["references"]["ar_scheduled"]["mae_scaled"]
    expected = error(trace, SPLIT.test, least_squares(trace, SPLIT.train, 20, scheduled=True))
    assert scheduled == pytest.approx(expected, rel=1e-6)
    expected = error(trace, SPLIT.test, Linear(np.array([1.0, 0.0]), 1.0))
    assert judged.document["references"]["persistence"]["mae_scaled"] == pytest.approx(expected, rel=1e-6)


def test_the_envelope_needs_a_second_of_what_is_scored(judged: Judgement) -> None:
    """Of blocks of 1000 ms, 800 ms are scored, and "blocks under 1 s" was the reason."""
    assert judged.document["ceiling"]["modulation_db"] is None
    assert judged.document["reasons"]["ceiling.modulation_db"] == "less than 1 s of a block is scored"


def test_the_free_run_of_ar_20_is_that_of_the_training_blocks(judged: Judgement, trace: Trace) -> None:
    fitted = least_squares(trace, SPLIT.train, 20)
    expected = synthesize_linear(fitted, trace, SPLIT.test, SCALING, 0)
    np.testing.assert_allclose(judged.synthesized["free_run_ar"], expected, atol=1e-6)
    other = synthesize_linear(least_squares(trace, SPLIT.train + SPLIT.test, 20), trace, SPLIT.test, SCALING, 0)
    assert np.abs(other - expected).max() > 1e-2


def test_the_best_ar_is_chosen_on_the_validation_blocks(judged: Judgement, trace: Trace) -> None:
    """Oracle: every order and kind by least squares. On the test blocks another would be the best."""
    orders = [order for order in ORDERS if order <= 40]  # of longer ones 8 blocks tell the coefficients worse still
    kinds = {
        (order, scheduled): least_squares(trace, SPLIT.train, order, scheduled)
        for order, scheduled in product(orders, (False, True))
    }
    chosen, tempting = (
        min(kinds, key=lambda kind: error(trace, blocks, kinds[kind])) for blocks in (SPLIT.validation, SPLIT.test)
    )
    assert chosen[0] < 40 == tempting[0]
    best = judged.document["references"]["ar_best"]
    assert (best["order"], best["scheduled"]) == chosen
    assert best["mae_scaled"] == pytest.approx(error(trace, SPLIT.test, kinds[chosen]), rel=1e-6)
    assert best["mae_scaled"] > 1.1 * error(trace, SPLIT.test, kinds[tempting])


def test_no_recorded_window_is_scored_as_a_free_run() -> None:
    """It is longer than a fifth of a short block, which scored the recording itself."""
    texture = read_texture(EXAMPLE.with_name("towel.foten"))
    judged = evaluate(texture, simulate("towel", 3.0, seed=1), trim_ms=0, block_ms=200)
    assert texture.window > round(0.2 * judged.trace.block)
    recorded = judged.trace.picked(judged.blocks)[0][:, judged.scored]
    assert recorded.shape[1] == judged.trace.block - texture.window
    assert not (judged.synthesized["free_run"][..., judged.scored] == recorded).any()
    missed = np.abs(judged.synthesized["free_run"][..., judged.scored] - recorded).mean()
    figures = judged.document["free_run"]
    assert figures["mae_scaled"] == pytest.approx(missed / texture.scaling.sd[0])
    shorter = evaluate(texture, simulate("towel", 3.0, seed=1), trim_ms=0, block_ms=100)
    assert shorter.document["free_run"]["lsd_db"] is None
    assert "too short for a spectrum, which takes 64 samples after the first" in shorter.document["reasons"]["free_run"]


def test_the_excitation_is_scored_where_the_tool_moves_and_touches(recording: Recording, texture: Texture) -> None:
    """Lifted and moving, or pressed and at rest, a recording is its sensor's noise: neither is scored."""
    t = np.arange(recording["speed"].samples.size) / 1000
    hand = {"speed": np.where(t % 1 < 0.6, 80.0, 0.0), "force": np.where(t % 1 > 0.4, 1.0, 0.0)}
    half = Recording({**recording.channels, **{name: Channel(samples, 1000.0) for name, samples in hand.items()}})
    judged = evaluate(texture, half, trim_ms=0, block_ms=1000)
    samples, n = (
        texture.scaling.scale(judged.trace.stacked()),
        targets(judged.blocks, BLOCK, FIRST).reshape(-1, BLOCK - FIRST),
    )
    moving, touching = judged.trace.speed[n] >= MOVING_SPEED, judged.trace.force[n] >= MOVING_FORCE
    scored, more = (
        excitation_scores(NativeTexture(texture.to_bytes()), samples, n, counted)["nll"]
        for counted in (moving & touching, moving | touching)
    )
    assert judged.document["one_step"]["nll"] == pytest.approx(scored)
    assert abs(more - scored) > 0.01
