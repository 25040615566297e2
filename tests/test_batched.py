"""Networks that are fitted as one batched model become what they become one by one, but for rounding."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from foten.experiments.experiment import Experiment, Method, Run, recording_of
from foten.experiments.run import execute
from foten.experiments.sweep import _groups, _guarded
from foten.families import FAMILIES, TenSizes
from foten.networks import build
from foten.train.batched import BATCHED, fit_batched
from foten.train.config import RECIPES, TrainConfig
from foten.train.epochs import Progress
from foten.train.fit import TrainingWindows, fit, reproducible

SMALL = TenSizes(window=6, d_model=8, n_heads=2, d_feedforward=8, n_layers=1, head=(8, 4))
QUICK = TrainConfig(epochs=3, batch=16, threads=1, learning_rate=1e-4)


def some_windows(seed: int, n: int = 200, window: int = 6) -> TrainingWindows:
    rng = np.random.default_rng(seed)
    samples = rng.standard_normal((n, 3))
    samples[1:, 0] += 0.8 * samples[:-1, 0]
    numbers = np.arange(window, n)
    return TrainingWindows(samples, numbers[:120], numbers[120:], window)


def both(
    configs: list[TrainConfig], data: list[TrainingWindows]
) -> tuple[list[nn.Module], list[nn.Module], list[Progress]]:
    """Return networks fitted one by one and batched, from the same weights, and what came of the latter."""
    fitted = []
    for _ in range(2):
        networks: list[nn.Module] = []
        for config in configs:
            torch.manual_seed(config.seed)
            networks.append(build("ten", SMALL))
        fitted.append(networks)
    with reproducible():
        logs = [fit(one, of, config) for one, of, config in zip(fitted[0], data, configs, strict=True)]
        batched = fit_batched(fitted[1], data, configs)
    for alone, log in zip(logs, batched, strict=True):
        assert isinstance(log, Progress)
        assert len(log.epochs) == len(alone.epochs)
        np.testing.assert_allclose(
            [line.validation_loss for line in log.epochs], [line.validation_loss for line in alone.epochs], rtol=1e-4
        )
        np.testing.assert_allclose(
            [line.train_loss for line in log.epochs[1:]], [line.train_loss for line in alone.epochs[1:]], rtol=1e-4
        )
        assert [line.best for line in log.epochs] == [line.best for line in alone.epochs]
    return fitted[0], fitted[1], batched  # type: ignore[return-value]


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"dropout": 0.3},
        {"clip_norm": 0.05},
        {"schedule": "constant", "loss": "mse", "weight_decay": 0.0, "clip_norm": 0.0},
        {"batch": 50},  # and a last one of 20
    ],
)
def test_networks_are_fitted_as_if_alone(changed: dict[str, object]) -> None:
    configs = [dataclasses.replace(QUICK, seed=seed, **changed) for seed in (1, 2, 3)]
    alone, batched, _ = both(configs, [some_windows(seed) for seed in (1, 2, 3)])
    for one, other in zip(alone, batched, strict=True):
        assert not other.training
        for (name, expected), weights in zip(one.state_dict().items(), other.state_dict().values(), strict=True):
            torch.testing.assert_close(weights, expected, rtol=1e-3, atol=1e-5, msg=name)
    windows = torch.randn(4, 6, 3)
    assert not torch.allclose(batched[0](windows), batched[1](windows))


def test_a_network_that_gets_no_better_leaves_the_others_to_go_on() -> None:
    """Noise is not to be predicted: its network stops, the optimiser of the others keeps its moments."""
    noise = some_windows(5)
    rng = np.random.default_rng(0)
    noise.samples[:, 0] = 3 * rng.standard_normal(len(noise.samples))
    configs = [dataclasses.replace(QUICK, seed=seed, epochs=8, patience=1, learning_rate=2e-3) for seed in (1, 2, 3)]
    _, _, logs = both(configs, [some_windows(1), noise, some_windows(3)])
    lengths = [len(log.epochs) for log in logs]
    assert lengths[1] < max(lengths)


def test_where_one_generator_draws_an_epochs_masks_each_has_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """As on a GPU: `fit` draws from PyTorch's own generator there, seeded for each epoch."""
    for module in ("fit", "batched"):
        monkeypatch.setattr(f"foten.train.{module}.masks_of", lambda seed, device: None)
    configs = [dataclasses.replace(QUICK, seed=seed, dropout=0.3) for seed in (1, 2, 3)]
    both(configs, [some_windows(seed) for seed in (1, 2, 3)])


def test_what_is_not_finite_is_the_error_of_that_texture_alone() -> None:
    bad = some_windows(2)
    bad.samples[150:, 0] = np.nan
    worse = some_windows(3)
    worse.samples[40, 0] = np.inf
    networks = [build("ten", SMALL) for _ in range(3)]
    configs = [dataclasses.replace(QUICK, seed=seed) for seed in (1, 2, 3)]
    good, first, second = fit_batched(networks, [some_windows(1), bad, worse], configs)
    assert isinstance(good, Progress)
    assert len(good.epochs) == 4
    for error in (first, second):
        assert isinstance(error, ValueError)
        assert "not finite" in str(error)


@pytest.mark.parametrize(
    ("change", "n"), [({"threads": 2}, 200), ({"clip_norm": 0.5}, 200), ({"batch": 8}, 200), ({}, 190)]
)
def test_what_cannot_be_fitted_as_one_model_is_refused(change: dict[str, object], n: int) -> None:
    other = some_windows(2, n)
    if n != 200:
        other = dataclasses.replace(other, train=other.train[:-1])
    configs = [QUICK, dataclasses.replace(QUICK, **change)]
    with pytest.raises(ValueError, match="fitted as one model by one recipe"):
        fit_batched([build("ten", SMALL) for _ in range(2)], [some_windows(1), other], configs)


def test_every_model_that_is_batched_can_be() -> None:
    for key in BATCHED:
        sizes = FAMILIES[key]()
        networks = [build(key, sizes) for _ in range(2)]
        m, data = sizes.window, []
        for seed in (1, 2):
            of = some_windows(seed, 4 * m, m)
            data.append(dataclasses.replace(of, train=of.train[:32], validation=of.train[:8]))
        config = dataclasses.replace(RECIPES["paper"], epochs=1)
        logs = fit_batched(networks, data, [config, config])
        assert all(isinstance(one, Progress) and np.isfinite(one.best_loss) for one in logs), key


ASKED = Experiment(
    title="batched",
    textures=("linear-cloth", "linear-twin"),
    methods=(
        Method("ten", sizes={"d_model": 8, "n_heads": 2, "d_feedforward": 8, "head": [8, 4]}),
        Method("fnn"),
        Method("dstn"),
    ),
    seconds=8,
    split_seeds=(1, 2),
    train={"epochs": 1},
    preprocess={"trim_ms": 0.0, "block_ms": 1000.0},
)


def test_runs_are_grouped_by_what_differs_between_them() -> None:
    waiting = [(index, run, Path(str(index))) for index, run in enumerate(ASKED.runs())]
    alone = _groups(waiting, 1)
    assert [len(one) for one in alone] == [1] * 12
    groups = _groups(waiting, 3)
    assert sorted((some[0][1].model, len(some)) for some in groups) == sorted(
        [("ten", 3), ("ten", 1), ("fnn", 3), ("fnn", 1), *[("dstn", 1)] * 4]
    )
    assert sorted(one[0] for some in groups for one in some) == list(range(12))
    assert all(len({json.dumps(one[1].sizes) for one in some}) == 1 for some in groups)


def test_batched_results_are_those_of_one_by_one_and_fail_alone() -> None:
    runs = [run for run in ASKED.runs() if run.model == "ten" and run.split_seed == 1]
    recordings = [recording_of(run) for run in runs]
    results = _guarded([asdict(run) for run in runs], *recordings)
    for run, recording, one in zip(runs, recordings, results, strict=True):
        assert one["n_batched"] == 2
        alone = execute(run, recording)
        assert Run(**one["run"]) == run
        assert one["evaluation"]["one_step"]["mae_scaled"] == pytest.approx(
            alone["evaluation"]["one_step"]["mae_scaled"], rel=1e-3
        )
        assert one["recording_sha256"] == alone["recording_sha256"]
    short = recording_of(dataclasses.replace(runs[0], seconds=3.0))
    good, failed = _guarded([asdict(run) for run in runs], recordings[0], short)
    assert "evaluation" in good
    assert "less than 5 blocks" in failed["failed"]


def test_a_group_that_cannot_be_fitted_leaves_those_of_another_length(monkeypatch: pytest.MonkeyPatch) -> None:
    runs = [run for run in ASKED.runs() if run.model == "fnn" and run.split_seed == 1]
    recordings = [recording_of(runs[0]), recording_of(dataclasses.replace(runs[1], seconds=12.0))]

    def full(networks: list[nn.Module], data: list[TrainingWindows], configs: list[TrainConfig]) -> object:
        if len(data[0].train) > 5000:
            raise RuntimeError("out of memory")
        return fit_batched(networks, data, configs)

    monkeypatch.setattr("foten.train.pipeline.fit_batched", full)
    good, failed = _guarded([asdict(run) for run in runs], *recordings)
    assert "evaluation" in good
    assert failed == {"failed": "RuntimeError: out of memory"}
