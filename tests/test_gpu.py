"""Training on a GPU; run with -m gpu where there is one."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from foten.datasets.simulate import simulate
from foten.families import FotenPlusSizes
from foten.recording.preprocess import PreprocessConfig
from foten.runtime.renderer import Renderer
from foten.train.config import TrainConfig
from foten.train.job import NetworkTask, TrainingJob
from foten.train.pipeline import prepare, train

pytestmark = [pytest.mark.gpu, pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU that PyTorch can use")]


def job(texture: str, epochs: int) -> TrainingJob:
    preprocess = PreprocessConfig(block_ms=1000)
    return TrainingJob(simulate(texture, 24.0), "foten-plus", FotenPlusSizes(), TrainConfig(epochs=epochs), preprocess)


def test_what_is_playable_before_leaves_the_network_on_the_gpu() -> None:
    task = prepare(job("linear-twin", 0))
    assert isinstance(task, NetworkTask)
    assert task.playable is not None
    assert next(task.network.parameters()).device.type == "cuda"


def test_a_gpu_gives_the_same_file_twice_and_the_kernel_proves_it() -> None:
    files = [train(job("linear-twin", 2)).texture for _ in range(2)]
    assert files[0].to_bytes() == files[1].to_bytes()
    assert files[0].card["training"]["device"] == "cuda"
    assert np.isfinite(Renderer(files[0]).render(100.0, 1.0, 500)).all()


def test_a_gpu_learns_what_a_cpu_learns(monkeypatch: pytest.MonkeyPatch) -> None:
    errors = []
    for available in (True, False):
        monkeypatch.setattr(torch.cuda, "is_available", lambda known=available: known)
        errors.append(train(job("towel", 3)).texture.card["metrics"]["validation_mae_scaled"])
    # Sums in another order lead training along another path to much the same place.
    assert np.ptp(errors) < 0.05 * errors[1]
