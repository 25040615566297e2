"""A training from end to end: what is written is reproducible, what is interrupted is playable and goes on."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from conftest import PLUS, config_of, sizes_with
from foten.models.foten.sizes import FotenSizes
from foten.models.foten_plus import fit as foten_plus
from foten.models.foten_plus import network as innovation
from foten.models.texture_file import Texture, texture_from_bytes
from foten.models.trainable import TRAINABLE, train
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.runtime.renderer import Renderer
from foten.simulation.simulate import simulate
from foten.training.checkpoint import Checkpoint, Progress
from foten.training.config import LoopConfig
from foten.training.job import ScaledBlocks, Trained, TrainingJob
from foten.training.loop import Monitor

SMALL = {"d_model": 8, "n_heads": 2, "n_layers": 2, "d_feedforward": 16, "head": (16, 8), "spectral_width": 8, **PLUS}
# A lattice of one set of reflection coefficients is fitted in a fraction of the time that a table takes.
QUICK = {"epochs": 2, "batch": 32, "threads": 1, "max_order": 20, "table": False, "tones": False}
SHORT = PreprocessConfig(trim_ms=0, block_ms=500)
SECONDS = PreprocessConfig(trim_ms=0, block_ms=1000)


@pytest.fixture(scope="module", autouse=True)
def brief() -> Any:
    """Fit networks for a few steps."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(innovation, "N_STEPS", 10)
        yield


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate("linear-twin", 12.0)


def job_of(recording: Recording, model: str = "foten-plus", **changed: Any) -> TrainingJob:
    """A quick job, with other settings of its training where they are given."""
    return TrainingJob(recording, model, sizes_with(model, SMALL), config_of(model, **(QUICK | changed)), SHORT)


@pytest.fixture(scope="module")
def trained(recording: Recording) -> Trained:
    return train(job_of(recording))


def rendered(texture: Texture) -> np.ndarray:
    """What a texture makes of a stroke."""
    n = np.arange(1500)
    return Renderer(texture, seed=3).render(100 + 60 * np.sin(n / 200), 1 + 0.3 * np.sin(n / 300))


def test_the_papers_network_learns(recording: Recording) -> None:
    config = config_of("foten", epochs=3, batch=128, learning_rate=2e-3, threads=1)
    trained = train(TrainingJob(recording, "foten", sizes_with("foten", SMALL), config, SHORT))
    errors = [line.validation_mae for line in trained.progress.epochs]
    assert min(errors) < 0.9 * errors[0]
    assert trained.texture.card["model"] == "foten"
    assert trained.texture.window == 12
    assert trained.linear_mae is None
    assert not trained.texture.has_excitation


def test_a_texture_is_playable_before_the_network_is_fitted(recording: Recording, trained: Trained) -> None:
    """It is the linear model, with a network that adds nothing; its proof and its level are already those of a texture."""
    happened: list[Any] = []
    monitor = Monitor(on_epoch=lambda line: happened.append(line.epoch), on_playable=happened.append)
    again = train(job_of(recording), monitor)
    assert isinstance(happened[0], Texture)
    *others, first, second, third = happened[1:]
    assert all(isinstance(one, Texture) for one in others)
    assert (first, second, third) == (0, 1, 2)
    playable = texture_from_bytes(happened[0].to_bytes())
    k = PLUS["n_components"]
    assert not playable.tensors["network.out.weight"][k : 2 * k].any()  # the means of its mixture
    metrics = playable.card["metrics"]
    assert metrics["validation_mae_scaled"] == metrics["validation_mae_scaled_lattice"] == again.linear_mae
    assert len(metrics["level_errors_db"]) == 3
    assert abs(metrics["level_errors_db"][-1]) < 1.0  # twelve seconds of a resonance tell no more of its level
    assert (metrics["best_epoch"], metrics["n_epochs"]) == (0, 0)
    assert rendered(playable).std() > 0
    assert playable.card["training"]["unfinished"] is True
    assert playable.unfinished
    assert "unfinished" not in again.texture.card["training"]
    assert not again.texture.unfinished
    assert again.texture.to_bytes() == trained.texture.to_bytes()


@pytest.mark.parametrize("chosen", [0, -1])
def test_the_first_linear_model_is_playable_before_it_is_compared(
    chosen: int, recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And what is chosen takes its place before the network is fitted."""
    happened: list[str] = []
    fitted, best = foten_plus.fit_linear_models, foten_plus.best_candidate

    def two_alike(*arguments: Any) -> list[Any]:
        first = fitted(*arguments)[0]
        return [first, replace(first)]

    def compared(candidates: Any) -> Any:
        happened.append("compared")
        return best([candidates[chosen]])

    monkeypatch.setattr(foten_plus, "fit_linear_models", two_alike)
    monkeypatch.setattr(foten_plus, "best_candidate", compared)
    train(job_of(recording, epochs=0), Monitor(on_playable=lambda texture: happened.append("playable")))
    assert happened == ["playable", "compared", "playable"]


def test_where_the_network_gains_nothing_the_texture_renders_as_the_playable_one(recording: Recording) -> None:
    """The network starts at the linear model, to what float32 leaves."""
    playable: list[Texture] = []
    unfitted = train(job_of(recording, epochs=0), Monitor(on_playable=playable.append))
    assert unfitted.progress.epochs[0].validation_mae == pytest.approx(unfitted.linear_mae, rel=1e-5)
    texture = unfitted.texture
    np.testing.assert_array_equal(rendered(texture), rendered(playable[-1]))
    assert texture.card["sizes"] == playable[-1].card["sizes"]
    assert set(texture.tensors) == set(playable[-1].tensors)
    for name, tensor in playable[-1].tensors.items():
        np.testing.assert_array_equal(texture.tensors[name], tensor, name)


class InterruptedCheckpoint(Checkpoint):
    """One after an epoch of a loop somebody presses Ctrl-C."""

    def __init__(self, path: Path, config: LoopConfig, loop: str, n: int = 1) -> None:
        super().__init__(path, config)
        self._loop, self._n = loop, n
        self.saved = list[str]()

    def save(self, name: str, parts: Any, progress: Progress) -> None:
        super().save(name, parts, progress)
        self.saved.append(name)
        if self.saved.count(self._loop) == self._n:
            raise KeyboardInterrupt


def test_a_training_goes_on_where_it_was_interrupted(recording: Recording, trained: Trained, tmp_path: Path) -> None:
    """Ctrl-C keeps the best, is reported, and the resumed run ends with the same bytes."""
    assert not trained.progress.interrupted
    job, path = job_of(recording), tmp_path / "checkpoint.pt"
    checkpoint = InterruptedCheckpoint(path, job.config, "network")
    interrupted = train(job, Monitor(checkpoint=checkpoint))
    assert interrupted.progress.interrupted
    assert rendered(interrupted.texture).std() > 0
    assert interrupted.texture.to_bytes() != trained.texture.to_bytes()
    again = train(job, Monitor(checkpoint=Checkpoint(path, job.config, resume=True)))
    assert again.texture.to_bytes() == trained.texture.to_bytes()
    assert not again.progress.interrupted
    assert [line.epoch for line in again.progress.epochs] == [0, 1, 2]


@pytest.fixture(scope="module")
def of_student(recording: Recording) -> Texture:
    return train(job_of(recording, "ldhtd", batch=256)).texture


@pytest.mark.parametrize(("loop", "n"), [("teacher", 1), ("teacher", 2), ("network", 1)])
def test_a_student_goes_on_with_the_teacher_that_it_had(
    recording: Recording, of_student: Texture, loop: str, n: int, tmp_path: Path
) -> None:
    """Also where the teacher was just done, whose training the student's initial weights come after."""
    job, path, shown = job_of(recording, "ldhtd", batch=256), tmp_path / "checkpoint.pt", list[int]()
    checkpoint = InterruptedCheckpoint(path, job.config, loop, n)
    with suppress(KeyboardInterrupt):  # there is no texture before there is a student
        assert train(job, Monitor(checkpoint=checkpoint)).progress.interrupted
    assert checkpoint.saved == (["teacher"] * n if loop == "teacher" else ["teacher", "teacher", "network"])
    again = Checkpoint(path, job.config, resume=True)
    resumed = train(job, Monitor(on_epoch=lambda line: shown.append(line.epoch), checkpoint=again))
    assert resumed.texture.to_bytes() == of_student.to_bytes()
    assert shown == [0, 1, 2] * 2


def test_a_teacher_and_its_student_say_what_they_do(recording: Recording) -> None:
    """Stages in turn, and the notes of both: neither gains enough in its first epoch."""
    stages = list[str]()
    job = job_of(recording, "ldhtd", batch=256, trial_epochs=1, min_gain=0.99)
    notes = train(job, Monitor(on_stage=stages.append)).progress.notes
    assert stages[:2] == ["training the teacher, hapinf", "training the student, ldhtd"]
    assert [note.endswith("its training stops there") for note in notes] == [True, True]


def test_the_card_says_how_it_came_about(trained: Trained) -> None:
    """Statistics are of the training blocks."""
    card, trace, split = trained.texture.card, trained.trace, trained.split
    assert card["split_sha256"] == split.sha256()
    assert card["recording_sha256"] == trace.recording_sha256
    assert card["training"]["seed"] == 0
    metrics = card["metrics"]
    assert metrics["validation_mae_scaled"] <= metrics["validation_mae_scaled_lattice"] * 1.001
    assert texture_from_bytes(trained.texture.to_bytes()).card == json.loads(json.dumps(card))
    blocks = trace.blocks(trace.acceleration)
    assert trained.texture.scaling.sd[0] == pytest.approx(blocks[list(split.train)].std(), rel=1e-12)
    assert trained.texture.scaling.sd[0] != pytest.approx(blocks.std(), rel=1e-6)


def test_blocks_shorter_than_five_windows_are_refused(recording: Recording) -> None:
    preprocess = PreprocessConfig(trim_ms=0, block_ms=40)
    with pytest.raises(ValueError, match="longer --block or a shorter --window"):
        train(TrainingJob(recording, "foten", FotenSizes(), config_of("foten", **QUICK), preprocess))


@pytest.mark.parametrize("model", ["foten-plus", "ar", "fnn", "dftnet"])
def test_the_test_blocks_have_no_say(recording: Recording, monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    """Their samples are others, a hundred times as loud, under another hand: the texture is the same to the last digit.

    And only foten-plus is playable before a network is fitted.
    """
    sizes = sizes_with(model, SMALL) if model == "foten-plus" else TRAINABLE[model].sizes()
    job = TrainingJob(recording, model, sizes, config_of(model, **(QUICK | {"epochs": 1})), SECONDS)
    playable: list[Texture] = []
    expected = train(job, Monitor(on_playable=playable.append)).texture
    assert bool(playable) == (model == "foten-plus")
    blocks_of = TrainingJob.blocks

    def spoilt(job: TrainingJob) -> ScaledBlocks:
        blocks = blocks_of(job)
        samples, trace, rng = blocks.samples.copy(), blocks.trace, np.random.default_rng(0)
        other = {name: trace.blocks(getattr(trace, name)).copy() for name in ("acceleration", "speed", "force")}
        for number in blocks.split.test:
            samples[number] = 100 * rng.standard_normal(samples[number].shape)
            for name, value in {"acceleration": 100.0, "speed": 300.0, "force": 9.0}.items():
                other[name][number] = value
        trace = replace(trace, **{name: channel.ravel() for name, channel in other.items()})
        return replace(blocks, trace=trace, samples=samples)

    monkeypatch.setattr(TrainingJob, "blocks", spoilt)
    assert train(job).texture.to_bytes() == expected.to_bytes()
