"""What several tests need: textures of untrained networks with a known lattice, made in milliseconds."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import torch

from foten.architecture import (
    ARCHITECTURES,
    ArArchitecture,
    Architecture,
    GraphArchitecture,
    TenArchitecture,
)
from foten.recording.preprocess import PreprocessConfig
from foten.recording.scaling import Scaling
from foten.recording.split import Split
from foten.texture_file import Texture

if TYPE_CHECKING:
    from foten.train.export_local import LocalModels

torch.set_num_threads(1)  # small matrices only lose by more

SMALL: dict[str, Any] = {
    "d_model": 8,
    "n_heads": 2,
    "n_layers": 2,
    "d_feedforward": 12,
    "head": (10, 6),
    "spectral_width": 4,
}
"""Sizes of a network that is quick to run and has every part."""


def architecture_with(key: str, wanted: dict[str, Any]) -> Architecture:
    """Return a model's architecture with those of the sizes that it has."""
    has = {field.name for field in fields(ARCHITECTURES[key])}
    return ARCHITECTURES[key](**{name: value for name, value in wanted.items() if name in has})


SCALING = Scaling(mean=(0.1, 100.0, 1.0), sd=(2.0, 60.0, 0.5))
CARD: dict[str, Any] = {
    "rate_hz": 1000.0,
    "trained_range": {"speed": [8.0, 220.0], "force": [0.3, 2.5]},
    "beyond_exponents": {"speed": 0.7, "force": 0.4},
    "saturation": 12.0,
    "lowpass_hz": 20.0,
    "delay_ms": 11.3,
    "warm_start": {"asked": {"speed": 45.0, "force": 0.8}, "found": {"speed": 45.0, "force": 0.8}},
    "texture": "untrained",
    "tool": "",
    "sensors": "",
    "notes": "",
    "licence": "",
    "recording_sha256": "",
    "preprocess": asdict(PreprocessConfig()),
    "split": asdict(Split((0, 1, 2), (3,), (4,), 5, 2000, "regrouped", 0)),
    "split_sha256": "",
    "training": {},
    "metrics": {"validation_mae_scaled": 0.5, "validation_spectrum_db": 5.0},
}


def resonance(hz: float, radius: float, m: int, rate_hz: float = 1000.0) -> np.ndarray:
    """Return m taps, oldest first, of a stable AR(2) with poles at ±hz."""
    taps = np.zeros(m)
    taps[-2:] = -(radius**2), 2 * radius * np.cos(2 * np.pi * hz / rate_hz)
    return taps


def reflections_of(taps: np.ndarray) -> torch.Tensor:
    """Return the two reflections of an AR(2), taps oldest first."""
    second, first = -taps
    return torch.tensor([first / (1 + second), second])


def untrained(
    key: str, architecture: TenArchitecture | GraphArchitecture | None = None, seed: int = 0
) -> Any:
    """Return a seeded network whose every tensor matters; foten-plus resonates near 120 Hz through its lattice."""
    import torch

    from foten.models import build
    from foten.models.excited import Excited

    torch.manual_seed(seed)
    architecture = architecture or ARCHITECTURES[key]()
    network = build(key, architecture)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter += 0.1 * torch.randn_like(parameter)
        if architecture.excited and key != "foten-plus":
            network = Excited(network, architecture)
            network.excitation.swell.copy_(torch.tensor([0.98, 0.3]))
            scales = [network.excitation]
        elif key == "foten-plus":
            network.network.head_3.weight *= 0.1  # else the correction drowns the excitation
            scales = [network.excitation]
            network.excitation.swell.copy_(torch.tensor([0.98, 0.3]))
            for lattice in (network.lattice, *([network.rest] if architecture.n_tones else [])):
                lattice.reflections.copy_(0.02 * torch.randn_like(lattice.reflections))
                if lattice.reflections.shape[1] > 1:
                    lattice.reflections[:, :2] += reflections_of(resonance(120.0, 0.95, 2))
                lattice.speed_knots.copy_(torch.linspace(10.0, 200.0, len(lattice.speed_knots)))
                lattice.force_knots.copy_(torch.linspace(-1.0, 0.9, len(lattice.force_knots)))
                scales.append(lattice.level)
            if architecture.n_tones:
                network.tones.speed_knots.copy_(torch.linspace(10.0, 200.0, len(network.tones.speed_knots)))
                network.tones.force_knots.copy_(torch.linspace(-1.0, 0.9, len(network.tones.force_knots)))
                network.tones.values.copy_(torch.randn_like(network.tones.values))
                network.tones.motion.copy_(torch.tensor([2 * np.pi / 2.5 / 1000, 0.03, 2e-3]))
        if architecture.excited:
            for scale in scales:
                scale.mean.copy_(torch.tensor(SCALING.mean[1:]))
                scale.sd.copy_(torch.tensor(SCALING.sd[1:]))
                scale.out.weight *= 0.3
                scale.out.bias.fill_(0.0 if scale is network.excitation else float(np.log(0.3)))
                scale.power_law.weight.copy_(torch.tensor([[0.7, 0.4, 0.0, 0.0, 0.0]]))
    return network.eval()


def local_models(architecture: ArArchitecture) -> LocalModels:
    """Return seeded local models, silent at rest, over a fan of triangles; the first stands in the middle."""
    from foten.train.export_local import LocalModels

    rng = np.random.default_rng(2)
    n, p, q = architecture.n_models, architecture.order, architecture.ma
    turn = 2 * np.pi * np.arange(n - 1) / (n - 1)
    rim = np.stack([110 + 109 * np.cos(turn), 1.3 + 1.2 * np.sin(turn)], axis=1)
    lsf, ma_lsf = (np.pi * (np.arange(1, k + 1) + rng.uniform(-0.4, 0.4, (n, k))) / (k + 1) for k in (p, q))
    variance = rng.uniform(0.01, 0.2, n)
    variance[-1] = 0.0
    fan = np.array([[0, 1 + i, 1 + (i + 1) % (n - 1)] for i in range(n - 1)])
    return LocalModels(
        np.concatenate([[[110.0, 1.3]], rim]),
        lsf,
        variance,
        fan[: architecture.n_triangles],
        np.array([60.0, 0.5]),
        ma_lsf,
        rng.uniform(0.5, 1.5, n) if q else np.ones(n),
    )


def exported(key: str, architecture: Architecture | None = None, **card: Any) -> Texture:
    """Return an untrained network, or local models that nobody fitted, as a proved texture."""
    from foten.train.export import export
    from foten.train.export_local import export_local

    if key == "ar":
        architecture = architecture or ARCHITECTURES[key](n_models=9, n_triangles=8)
        assert isinstance(architecture, ArArchitecture)
        return export_local(local_models(architecture), SCALING, {**CARD, **card})
    architecture = architecture or ARCHITECTURES[key]()
    assert not isinstance(architecture, ArArchitecture)
    rng = np.random.default_rng(1)
    windows = rng.standard_normal((64, architecture.history, 3))
    warm_start = 0.5 * rng.standard_normal((architecture.history, 3))
    return export(
        untrained(key, architecture), key, architecture, SCALING, windows, warm_start, {**CARD, **card}
    )


@pytest.fixture(scope="session")
def texture() -> Texture:
    """Return a foten-plus texture: rings at 120 Hz, excited, trained for 8–220 mm/s and 0.3–2.5 N."""
    return exported(
        "foten-plus",
        ARCHITECTURES["foten-plus"](**{**SMALL, "n_layers": 1, "order": 6, "n_speed": 3, "n_force": 2}),
    )


@pytest.fixture(scope="session")
def plain_texture() -> Texture:
    """Return a texture of the paper's network, without excitation."""
    return exported("foten", ARCHITECTURES["foten"](**SMALL))


TINY = """
title = "Two methods"
seconds = 8
textures = ["linear-cloth", "linear-twin"]
methods = [{model = "fnn", name = "FNN [13]"}, {model = "fnn", name = "excited", sizes = {excitation = true}}]
[train]
epochs = 1
[preprocess]
trim_ms = 0
block_ms = 1000
"""


def experiment(folder: Path, text: str = TINY) -> Path:
    """Return the path of an experiment, written to a folder."""
    path = folder / "experiment.toml"
    path.write_text(text)
    return path
