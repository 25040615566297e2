"""A recording to local linear models: what is known of a linear process is recovered, and the command says what it made."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from foten.cli.command_line import _status
from foten.cli.simulator_reference import reference_for
from foten.datasets.hdf5 import write_recording
from foten.dsp.ar import MIN_GAP_RAD
from foten.dsp.segmentation import MAX_ORDER
from foten.evaluate.evaluate import evaluate
from foten.models.piecewise_ar.fit import ORDERS, local_models
from foten.models.piecewise_ar.sizes import PiecewiseArSizes
from foten.models.texture_file import read_texture
from foten.models.trainable import train
from foten.recording.preprocess import PreprocessConfig, preprocess
from foten.recording.recording import Channel, Recording
from foten.recording.split import split_blocks
from foten.runtime.loops import predict_blocks
from foten.runtime.native import NativeState, NativeTexture
from foten.simulation.simulate import simulate
from foten.training.config import TrainConfig
from foten.training.job import Trained, TrainingJob, scaled_blocks

SHORT = PreprocessConfig(trim_ms=0, block_ms=1000)


def learned(recording: Recording, preprocess: PreprocessConfig = SHORT) -> Trained:
    return train(TrainingJob(recording, "ar", PiecewiseArSizes(), TrainConfig(), preprocess, split_seed=1))


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate("linear-cloth", 24.0, seed=1)


@pytest.fixture(scope="module")
def trained(recording: Recording) -> Trained:
    return learned(recording)


def test_it_predicts_like_a_linear_predictor(recording: Recording, trained: Trained) -> None:
    """Beside AR(20) by least squares on the same blocks, and the least that any predictor can reach."""
    document = evaluate(trained.texture, recording, reference_for(recording, trained.texture)).document
    error, references = document["one_step"]["mae_scaled"], document["references"]
    assert error < 1.05 * references["ar"]["mae_scaled"]
    assert error > 0.97 * references["bound"]["mae_scaled"]
    assert 0.8 < document["one_step"]["standardised_sd"] < 1.25
    # Its level follows the hand, which that of AR(20) with white noise does not.
    assert document["free_run"]["level_error_db"] < 0.6 * document["free_run_ar"]["level_error_db"]
    assert document["free_run"]["level_corr"] > 0.9
    assert references["lattice"]["mae_scaled"] is None


def test_the_order_is_the_best_of_those_tried(trained: Trained) -> None:
    """By the one-step error on the validation blocks, which the judge's own predictor gives too."""
    metrics = trained.texture.card["metrics"]
    errors = {int(order): error for order, error in metrics["validation_mae_scaled_by_order"].items()}
    assert sorted(errors) == sorted(ORDERS)
    best = min(errors, key=lambda order: errors[order])
    assert trained.texture.card["sizes"]["order"] == best
    assert metrics["validation_mae_scaled"] == errors[best]
    blocks = scaled_blocks(trained.trace, trained.split)
    recorded = blocks.samples[list(trained.split.validation)]
    window, first = trained.texture.window, MAX_ORDER + 1
    predicted = predict_blocks(NativeTexture(trained.texture.to_bytes()), recorded).sample
    error = predicted[:, first - window :] - recorded[:, first:, 0]
    assert np.abs(error).mean() == pytest.approx(errors[best], rel=1e-9)


def test_the_mesh_covers_what_was_trained_and_is_silent_without_motion(trained: Trained) -> None:
    texture = trained.texture
    points, variance = texture.tensors["piecewise_ar.points"], texture.tensors["piecewise_ar.variance"]
    ends = [texture.trained_range(channel)[1] for channel in ("speed", "force")]
    np.testing.assert_allclose(points.max(axis=0), ends)
    assert (points.min(axis=0) == 0).all()
    assert (variance[(points == 0).any(axis=1)] == 0).all()
    assert (variance[(points > 0).all(axis=1)] > 0).all()
    corners = (points / texture.tensors["piecewise_ar.scale"])[texture.tensors["piecewise_ar.triangles"].astype(int)]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).sum() / 2
    assert area == pytest.approx(np.prod(ends / texture.tensors["piecewise_ar.scale"]), rel=1e-6)


def moving(acceleration: np.ndarray) -> Recording:
    """A recording at 1 kHz of a hand between 40 and 160 mm/s and 0.5 and 1.5 N."""
    t = np.arange(acceleration.size) / 1000
    channels = {"acceleration": acceleration, "speed": 100 + 60 * np.sin(1.3 * t), "force": 1 + 0.5 * np.sin(0.7 * t)}
    return Recording({name: Channel(samples, 1000.0) for name, samples in channels.items()}, texture="noise")


@pytest.mark.parametrize("dropout", ["nothing", "one value", "a tone", None])
def test_a_sensor_that_drops_out_is_left_out(dropout: str | None) -> None:
    """Noise of one level; for seconds none, one value, or a tone of mains: as loud as it was everywhere in its range."""
    x = np.random.default_rng(0).standard_normal(24_000)
    instead = {"nothing": np.zeros(2500), "one value": np.ones(2500), "a tone": np.sin(0.1 * np.pi * np.arange(2500))}
    if dropout is not None:
        x[6000:8500], x[15_000:17_200] = instead[dropout], instead[dropout][:2200]
    texture = learned(moving(x)).texture
    assert (texture.card["metrics"]["n_pieces_left_out"] > 0) == (dropout is not None)
    native = NativeTexture(texture.to_bytes())
    for speed, force in ((41, 0.51), (41, 1.49), (60, 0.7), (100, 1.0), (150, 1.0), (159, 0.51)):
        state = NativeState(native, seed=1)
        played = state.render_stroke(np.full(20_000, speed, np.float32), np.full(20_000, force, np.float32))
        assert 10 * np.log10(played.var()) == pytest.approx(0.0, abs=1.0), (speed, force)
        assert state.statistics.n_saturated == 0


def test_models_in_one_place_are_one(recording: Recording) -> None:
    trace = preprocess(recording, SHORT)
    blocks = scaled_blocks(trace, split_blocks(trace, "regrouped", 1))
    rng = np.random.default_rng(0)

    def piece(speed: float, force: float, loud: float) -> np.ndarray:
        return np.stack([loud * rng.standard_normal(4000), np.full(4000, speed), np.full(4000, force)], axis=1)

    models = local_models([piece(50, 1, 1.0), piece(50.01, 1, 2.0), piece(150, 2, 1.0), piece(80, 1.5, 1.0)], blocks, 4)
    (both,) = np.flatnonzero(np.abs(models.points - [50.005, 1]).sum(axis=1) < 0.01)
    assert models.variance[both] == pytest.approx(2.5, rel=0.05)
    np.testing.assert_allclose(models.lsf[both], np.pi * np.arange(1, 5) / 5, atol=0.05)
    assert np.diff(models.lsf, axis=1).min() >= 0.99 * MIN_GAP_RAD


@pytest.mark.parametrize(
    ("channel", "level", "block_ms", "message"),
    [
        ("speed", 2.0, 1000, "hold 0 pieces of 100 samples or more above 5 mm"),
        ("force", 0.0, 1000, "hold 0 pieces"),
        ("force", 1.0, 20, "a block of 20 samples is too short for filters of order 20"),
    ],
)
def test_what_cannot_be_fitted_is_one_line(channel: str, level: float, block_ms: float, message: str) -> None:
    rng = np.random.default_rng(0)
    noise = moving(rng.standard_normal(12_000))
    channels = {**noise.channels, channel: Channel(level + 0.01 * np.abs(rng.standard_normal(12_000)), 1000.0)}
    with pytest.raises(ValueError, match=message):
        learned(Recording(channels), PreprocessConfig(trim_ms=0, block_ms=block_ms))


def test_the_command_reports_the_orders_and_the_models(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, file = tmp_path / "r.h5", tmp_path / "t.foten"
    write_recording(recording, record)
    assert (
        _status(["train", str(record), "-o", str(file), "--model", "ar", "--trim", "0", "--block", "1000", "--json"])
        == 0
    )
    document = json.loads(capsys.readouterr().out)
    assert document["sha256"] == read_texture(file).sha256()
    assert document["validation_mae_scaled_by_order"]["20"] > 0
    assert _status(["info", str(file)]) == 0
    assert f"of order {read_texture(file).card['sizes']['order']}" in capsys.readouterr().out


@pytest.mark.parametrize(
    "option",
    [["--loss", "mse"], ["--window", "30"], ["--set", "order=4"], ["--resume"], ["--seed", "1"], ["--recipe", "paper"]],
)
def test_what_is_for_networks_is_refused(
    recording: Recording, tmp_path: Path, option: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    record, file = tmp_path / "r.h5", tmp_path / "t.foten"
    write_recording(recording, record)
    assert _status(["train", str(record), "-o", str(file), "--model", "ar", *option]) == 2
    assert f"{option[0]} is for networks" in capsys.readouterr().err
    assert not file.exists()
