"""A training from end to end: what is written is reproducible, what is interrupted is playable and goes on."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from conftest import PLUS, sizes_with
from foten.baselines.sizes import TRAINABLE
from foten.models.foten.sizes import FotenSizes
from foten.models.foten_plus import closed_loop_training as closed_loop_training
from foten.models.foten_plus import fit as foten_plus
from foten.models.texture_file import Texture, texture_from_bytes
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.runtime.renderer import Renderer
from foten.simulation.simulate import simulate
from foten.training.blocks import ScaledBlocks
from foten.training.config import TrainConfig
from foten.training.job import Trained, TrainingJob
from foten.training.loop import Epoch
from foten.training.pipeline import PREPARE, train

SMALL = {"d_model": 8, "n_heads": 2, "n_layers": 2, "d_feedforward": 16, "head": (16, 8), "spectral_width": 8, **PLUS}
# A lattice of one set of reflection coefficients is fitted in a fraction of the time that a table takes.
QUICK = TrainConfig(epochs=2, batch=32, threads=1, max_order=20, table=False, tones=False)
SHORT = PreprocessConfig(trim_ms=0, block_ms=500)


@pytest.fixture(scope="module", autouse=True)
def brief() -> Iterator[None]:
    """Train on own output for a few steps."""
    with pytest.MonkeyPatch.context() as patch:
        for module in (closed_loop_training, foten_plus):
            patch.setattr(module, "JUDGED_EVERY", 4)
        patch.setattr(closed_loop_training, "N_JUDGED", 2)
        yield


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate("linear-twin", 12.0)


def job_of(recording: Recording, model: str = "foten-plus", **changed: Any) -> TrainingJob:
    """Return a quick job, with other settings of its training where they are given."""
    config = dataclasses.replace(QUICK, **changed)
    return TrainingJob(recording, model, sizes_with(model, SMALL), config, SHORT)


@pytest.fixture(scope="module")
def trained(recording: Recording) -> Trained:
    return train(job_of(recording))


def rendered(texture: Texture) -> np.ndarray:
    """Return what a texture makes of one stroke."""
    n = np.arange(1500)
    return Renderer(texture, seed=3).render(100 + 60 * np.sin(n / 200), 1 + 0.3 * np.sin(n / 300))


def test_every_family_is_prepared() -> None:
    assert set(PREPARE) == set(TRAINABLE)


def test_the_network_starts_at_the_linear_part(recording: Recording) -> None:
    unfitted = train(job_of(recording, epochs=0))
    assert unfitted.progress.epochs[0].validation_mae == pytest.approx(unfitted.linear_mae, rel=1e-5)  # float32


@pytest.mark.parametrize("model", ["foten", "ten"])
def test_the_papers_networks_learn(recording: Recording, model: str) -> None:
    config = TrainConfig(epochs=4, batch=128, learning_rate=2e-3, threads=1)
    trained = train(TrainingJob(recording, model, sizes_with(model, SMALL), config, SHORT))
    errors = [line.validation_mae for line in trained.progress.epochs]
    assert min(errors) < 0.9 * errors[0]
    assert trained.texture.card["model"] == model
    assert trained.texture.window == 12
    assert trained.linear_mae is None
    assert not trained.texture.has_excitation


def test_a_texture_is_playable_before_the_network_is_fitted(recording: Recording, trained: Trained) -> None:
    """It is the linear part, with a network that adds nothing; its proof and its level are already those of a texture."""
    happened: list[Any] = []
    again = train(job_of(recording), on_epoch=lambda line: happened.append(line.epoch), on_playable=happened.append)
    assert isinstance(happened[0], Texture)
    assert happened[1:] == [0, 1, 2]
    playable = texture_from_bytes(happened[0].to_bytes())
    k = PLUS["n_components"]
    assert not playable.tensors["network.out.weight"][k : 2 * k].any()  # the means of its mixture
    metrics = playable.card["metrics"]
    assert metrics["validation_mae_scaled"] == metrics["validation_mae_scaled_lattice"] == again.linear_mae
    assert len(metrics["level_errors_db"]) == 3
    assert abs(metrics["level_errors_db"][-1]) < 0.5
    assert (metrics["best_epoch"], metrics["n_epochs"]) == (0, 0)
    assert rendered(playable).std() > 0
    assert again.texture.to_bytes() == trained.texture.to_bytes()


def test_where_the_network_gains_nothing_the_texture_renders_as_the_playable_one(recording: Recording) -> None:
    given: list[Texture] = []
    texture = train(job_of(recording, epochs=0), on_playable=given.append).texture
    np.testing.assert_array_equal(rendered(texture), rendered(given[0]))
    assert set(texture.tensors) == set(given[0].tensors)
    for name, tensor in given[0].tensors.items():
        np.testing.assert_array_equal(texture.tensors[name], tensor, name)
    assert texture.card["sizes"] == given[0].card["sizes"]


def interrupting(at: int) -> Any:
    def on_epoch(line: Epoch) -> None:
        if line.epoch == at:
            raise KeyboardInterrupt

    return on_epoch


def test_interrupted_training_keeps_the_best(recording: Recording) -> None:
    result = train(job_of(recording), interrupting(1))
    assert result.progress.interrupted
    assert [line.epoch for line in result.progress.epochs] == [0, 1]
    assert result.texture.has_excitation


def test_a_training_interrupted_before_its_first_epoch_has_given_a_playable_texture(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ctrl-C while the network is first validated: nothing was fitted, and the caller has a texture all the same."""

    def interrupted(*_: object) -> tuple[float, float]:
        raise KeyboardInterrupt

    monkeypatch.setattr("foten.models.foten_plus.likelihood.validated", interrupted)
    given: list[Texture] = []
    with pytest.raises(KeyboardInterrupt):
        train(job_of(recording), on_playable=given.append)
    (playable,) = given
    assert rendered(texture_from_bytes(playable.to_bytes())).std() > 0


@pytest.mark.parametrize(("model", "n"), [("foten-plus", 1), ("ar", 1), ("fnn", 0)])
def test_only_what_needs_no_network_is_playable_before(recording: Recording, model: str, n: int) -> None:
    given: list[Texture] = []
    config = TrainConfig(epochs=0, threads=1, max_order=10, table=False, tones=False)
    sizes = sizes_with(model, SMALL) if model == "foten-plus" else TRAINABLE[model]()
    preprocess = PreprocessConfig(trim_ms=0, block_ms=1000)
    train(TrainingJob(recording, model, sizes, config, preprocess), on_playable=given.append)
    assert len(given) == n


def test_resumed_training_gives_the_same_bytes(recording: Recording, trained: Trained, tmp_path) -> None:
    checkpoint = tmp_path / "checkpoint.pt"
    train(job_of(recording), interrupting(2), checkpoint)
    assert checkpoint.exists()
    again = train(job_of(recording), checkpoint=checkpoint, resume=True)
    assert again.texture.to_bytes() == trained.texture.to_bytes()


def test_another_seed_gives_another_texture(recording: Recording, trained: Trained) -> None:
    other = train(job_of(recording, seed=1))
    assert other.texture.to_bytes() != trained.texture.to_bytes()


def test_the_card_says_how_it_came_about(trained: Trained) -> None:
    card = trained.texture.card
    assert card["split_sha256"] == trained.split.sha256()
    assert card["recording_sha256"] == trained.trace.recording_sha256
    assert card["training"]["seed"] == 0
    metrics = card["metrics"]
    assert metrics["validation_mae_scaled"] <= metrics["validation_mae_scaled_lattice"] * 1.001
    assert texture_from_bytes(trained.texture.to_bytes()).card == json.loads(json.dumps(card))


def test_statistics_come_from_the_training_blocks_only(trained: Trained) -> None:
    trace, split = trained.trace, trained.split
    blocks = trace.blocks(trace.acceleration)
    assert trained.texture.scaling.sd[0] == pytest.approx(blocks[list(split.train)].std(), rel=1e-12)
    assert trained.texture.scaling.sd[0] != pytest.approx(blocks.std(), rel=1e-6)


def test_blocks_shorter_than_five_windows_are_refused(recording: Recording) -> None:
    preprocess = PreprocessConfig(trim_ms=0, block_ms=40)
    with pytest.raises(ValueError, match="longer --block or a shorter --window"):
        train(TrainingJob(recording, "foten", FotenSizes(), QUICK, preprocess))


@pytest.mark.parametrize("model", ["foten-plus", "ar", "fnn", "dftnet"])
def test_the_test_blocks_have_no_say(recording: Recording, monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    """Their samples are others, a hundred times as loud, under another hand: the texture is the same to the last digit."""
    config = dataclasses.replace(QUICK, epochs=1)
    sizes = sizes_with(model, SMALL) if model == "foten-plus" else TRAINABLE[model]()
    job = TrainingJob(recording, model, sizes, config, PreprocessConfig(trim_ms=0, block_ms=1000))
    expected = train(job).texture
    blocks_of = TrainingJob.blocks

    def spoilt(job: TrainingJob) -> ScaledBlocks:
        blocks = blocks_of(job)
        samples, trace, rng = blocks.samples.copy(), blocks.trace, np.random.default_rng(0)
        acceleration, speed, force = (
            trace.blocks(channel).copy() for channel in (trace.acceleration, trace.speed, trace.force)
        )
        for number in blocks.split.test:
            samples[number] = 100 * rng.standard_normal(samples[number].shape)
            acceleration[number], speed[number], force[number] = 100.0, 300.0, 9.0
        channels = {"acceleration": acceleration, "speed": speed, "force": force}
        other = dataclasses.replace(trace, **{name: channel.ravel() for name, channel in channels.items()})
        return dataclasses.replace(blocks, trace=other, samples=samples)

    monkeypatch.setattr(TrainingJob, "blocks", spoilt)
    assert train(job).texture.to_bytes() == expected.to_bytes()
