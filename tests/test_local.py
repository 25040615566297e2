"""A recording to local linear models: what is known of a linear process is found, and the command says what it made."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from foten.cli import _status
from foten.datasets.hdf5 import write_recording
from foten.datasets.simulate import simulate
from foten.dsp.lsf import LEAST_GAP
from foten.evaluate.evaluate import evaluate
from foten.experiments.truth import truth_for
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Channel, Recording
from foten.render.native import NativeTexture
from foten.texture_file import read_texture
from foten.train.local import ORDERS, LocallyTrained, fitted, train_local

SHORT = PreprocessConfig(trim_ms=0, block_ms=1000)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate("linear-cloth", 24.0, seed=1)


@pytest.fixture(scope="module")
def trained(recording: Recording) -> LocallyTrained:
    return train_local(recording, SHORT, split_seed=1)


def test_it_predicts_like_a_linear_predictor(recording: Recording, trained: LocallyTrained) -> None:
    """Beside AR(20) by least squares on the same blocks, and the least that any predictor can reach."""
    document = evaluate(trained.texture, recording, truth_for(recording, trained.texture)).document
    error, references = document["one_step"]["mae_scaled"], document["references"]
    assert error < 1.05 * references["ar"]["mae_scaled"]
    assert error > 0.97 * references["bound"]["mae_scaled"]
    assert 0.8 < document["one_step"]["standardised_sd"] < 1.25
    # Its level follows the hand, which that of AR(20) with white noise does not.
    assert document["free_run"]["level_error_db"] < 0.6 * document["free_run_ar"]["level_error_db"]
    assert document["free_run"]["level_corr"] > 0.9
    assert references["lattice"]["mae_scaled"] is None


def test_the_order_is_the_best_of_those_tried(trained: LocallyTrained) -> None:
    assert tuple(trained.errors) == ORDERS
    best = min(trained.errors, key=lambda order: trained.errors[order])
    assert trained.texture.card["sizes"]["order"] == best
    assert trained.texture.card["metrics"]["validation_mae_scaled"] == trained.errors[best]


def test_the_mesh_covers_what_was_trained_and_is_silent_at_rest(trained: LocallyTrained) -> None:
    texture = trained.texture
    points, variance = texture.tensors["local.points"], texture.tensors["local.variance"]
    ends = [texture.trained_range(channel)[1] for channel in ("speed", "force")]
    np.testing.assert_allclose(points.max(axis=0), ends)
    assert (points.min(axis=0) == 0).all()
    assert (variance[(points == 0).any(axis=1)] == 0).all()
    assert (variance[(points > 0).all(axis=1)] > 0).all()
    corners = (points / texture.tensors["local.scale"])[texture.tensors["local.triangles"].astype(int)]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = np.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]).sum() / 2
    assert area == pytest.approx(np.prod(ends / texture.tensors["local.scale"]), rel=1e-6)


def test_models_in_one_place_are_one(recording: Recording) -> None:
    from foten.recording.preprocess import preprocess
    from foten.recording.split import split_blocks
    from foten.train.prepared import prepare

    trace = preprocess(recording, SHORT)
    prepared = prepare(trace, split_blocks(trace, "regrouped", 1))
    rng = np.random.default_rng(0)

    def piece(speed: float, force: float, loud: float) -> np.ndarray:
        return np.stack(
            [loud * rng.standard_normal(4000), np.full(4000, speed), np.full(4000, force)], axis=1
        )

    models = fitted(
        [piece(50, 1, 1.0), piece(50.01, 1, 2.0), piece(150, 2, 1.0), piece(80, 1.5, 1.0)], prepared, 4
    )
    (both,) = np.flatnonzero(np.abs(models.points - [50.005, 1]).sum(axis=1) < 0.01)
    assert models.variance[both] == pytest.approx(2.5, rel=0.05)
    np.testing.assert_allclose(models.lsf[both], np.pi * np.arange(1, 5) / 5, atol=0.05)
    assert np.diff(models.lsf, axis=1).min() >= 0.99 * LEAST_GAP


def test_a_hand_that_hardly_moves_is_refused() -> None:
    rng = np.random.default_rng(0)
    channels = {
        name: Channel(level + 0.01 * rng.standard_normal(20_000), 1000.0)
        for name, level in (("acceleration", 0.0), ("speed", 2.0), ("force", 1.0))
    }
    with pytest.raises(
        ValueError, match="hold 0 pieces of 100 samples or more above 5 mm/s, expected 3 or more"
    ):
        train_local(Recording(channels, texture="still"), SHORT)


def test_the_command_makes_a_file_that_everything_takes(
    recording: Recording, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    record, file = tmp_path / "r.h5", tmp_path / "t.foten"
    write_recording(recording, record)
    assert (
        _status(
            [
                "train",
                str(record),
                "-o",
                str(file),
                "--model",
                "ar",
                "--trim",
                "0",
                "--block",
                "1000",
                "--json",
            ]
        )
        == 0
    )
    found = json.loads(capsys.readouterr().out)
    assert found["sha256"] == read_texture(file).sha256()
    assert found["validation_mae_scaled_by_order"]["20"] > 0
    assert _status(["info", str(file)]) == 0
    told = capsys.readouterr().out
    assert "models" in told
    assert f"of order {read_texture(file).card['sizes']['order']}" in told
    sound = tmp_path / "s.wav"
    assert (
        _status(["render", str(file), "--speed", "80", "--force", "0.8", "--seconds", "1", "-o", str(sound)])
        == 0
    )
    assert sound.stat().st_size > 1000
    assert NativeTexture(file.read_bytes()).info.model == "ar"


@pytest.mark.parametrize(
    "option", [["--loss", "mse"], ["--window", "30"], ["--set", "order=4"], ["--resume"]]
)
def test_what_is_for_networks_is_refused(
    recording: Recording, tmp_path: Path, option: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    record, file = tmp_path / "r.h5", tmp_path / "t.foten"
    write_recording(recording, record)
    assert _status(["train", str(record), "-o", str(file), "--model", "ar", *option]) == 2
    assert f"{option[0]} is for networks" in capsys.readouterr().err
    assert not file.exists()
