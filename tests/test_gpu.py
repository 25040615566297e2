"""Training on a GPU; run with -m gpu where there is one."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from foten.architecture import FotenPlusArchitecture
from foten.runtime.engine import engine_for
from foten.train.train import train_texture

from foten.datasets.simulate import simulate
from foten.families.conditions import prove
from foten.recording.preprocess import PreprocessConfig
from foten.train.config import TrainConfig

pytestmark = [
    pytest.mark.gpu,
    pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU that PyTorch can use"),
]


def test_a_gpu_gives_the_same_file_twice_and_the_engine_proves_it() -> None:
    recording = simulate("linear-twin", 24.0)
    config = TrainConfig(epochs=2)
    files = [
        train_texture(
            recording, "foten-plus", FotenPlusArchitecture(), config, PreprocessConfig(block_ms=1000)
        ).texture
        for _ in range(2)
    ]
    assert files[0].to_bytes() == files[1].to_bytes()
    assert files[0].card["training"]["device"] == "cuda"
    prove(files[0], engine_for(files[0]))


def test_a_gpu_learns_what_a_cpu_learns(monkeypatch: pytest.MonkeyPatch) -> None:
    recording = simulate("towel", 24.0)
    config = TrainConfig(epochs=3)
    errors = []
    for available in (True, False):
        monkeypatch.setattr(torch.cuda, "is_available", lambda found=available: found)
        trained = train_texture(
            recording, "foten-plus", FotenPlusArchitecture(), config, PreprocessConfig(block_ms=1000)
        )
        errors.append(trained.texture.card["metrics"]["validation_mae_scaled"])
    # Sums in another order lead training along another path to much the same place.
    assert np.ptp(errors) < 0.05 * errors[1]
