"""Training in the closed loop: its loss, roll-outs as the definition's, the averaged network validated on validation blocks."""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from conftest import PLUS, perturbed
from foten.dsp.bands import band_energies
from foten.dsp.lattice import analyse
from foten.dsp.tones import tone
from foten.models.definitions import model_of
from foten.models.excitation import Excitation
from foten.models.foten_plus import closed_loop_training
from foten.models.foten_plus.closed_loop_training import (
    EnvelopeEnergyDistance,
    Excerpts,
    energies,
    excerpts_of,
    fit_closed_loop,
)
from foten.models.foten_plus.definition import Tones
from foten.models.foten_plus.linear_model import LinearModel, fit_level, fit_linear_models
from foten.models.foten_plus.network import InnovationNetwork, innovations_of
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.foten_plus.tones_fit import fit_residual, tonal_model
from foten.recording.preprocess import PreprocessConfig
from foten.simulation.simulate import simulate
from foten.training.calibration import constant_scale
from foten.training.config import TrainConfig
from foten.training.job import ScaledBlocks, TrainingJob
from foten.training.loop import Monitor, Progress
from foten.training.texture_builder import tensors_of
from test_innovation_network import captured_loop

CONFIG = TrainConfig(epochs=2, threads=1, batch=8, max_order=20, table=False)
LIMIT, WARM_UP = 5.0, 12


@dataclass(frozen=True)
class Surface:
    """A surface fitted but for its network, which is as if trained."""

    blocks: ScaledBlocks
    model: LinearModel
    network: InnovationNetwork

    def excerpts(self, n: int) -> Excerpts:
        data = innovations_of(self.model, self.blocks, 22, residual=True)
        return Excerpts(self.blocks, self.model, data, n, LIMIT)


@pytest.fixture(scope="module", params=["artificial-grass", "steel-mesh-1"])
def surface(request: pytest.FixtureRequest) -> Surface:
    """One without tones, and one with them."""
    sizes, preprocess = FotenPlusSizes(**PLUS), PreprocessConfig(trim_ms=0, block_ms=1000)
    blocks = TrainingJob(simulate(request.param, 9.0), "foten-plus", sizes, CONFIG, preprocess).blocks()
    level, data = fit_level(blocks.flat[:, 0], sizes, blocks, CONFIG)
    linear = fit_linear_models(level, data, sizes, CONFIG)[0]
    residual = fit_residual(data, sizes, blocks, CONFIG)
    model = linear if residual is None else tonal_model(linear, residual, blocks.trace.rate_hz)
    assert (model.phase is None) == (request.param == "artificial-grass")
    torch.manual_seed(0)
    return Surface(blocks, model, perturbed(InnovationNetwork(model.sizes, model.sizes.n_rendering_inputs)))


without_tones = pytest.mark.parametrize("surface", ["artificial-grass"], indirect=True)


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """A few steps of a few excerpts, validated by one draw of them."""
    for name, value in {"N_STEPS": 3, "N_EXCERPTS": 6, "N_KNOWN": 40, "N_VALIDATIONS": 1}.items():
        monkeypatch.setattr(closed_loop_training, name, value)


def definition_of(surface: Surface) -> Any:
    """The model in NumPy, σ = 1, its network warmed up as an excerpt's is."""
    model, network = surface.model, surface.network
    excitation = Excitation(constant_scale(model.sizes.excitation_width, surface.blocks.scaling), (LIMIT, 1e6))
    torch.manual_seed(0)
    weights = tensors_of(InnovationNetwork(model.sizes), "network.") | tensors_of(network, "rendering_network.")
    sizes = replace(model.sizes, network_in_loop=True, window=closed_loop_training.WARM_UP)
    return model_of(sizes, {**model.tensors, **weights, **excitation.tensors()})


def start_on_path(stream: Any, definition: Any, of: Excerpts, block: np.ndarray, start: np.ndarray) -> None:
    """Give a stream the phase that is known of a recording, where the definition finds one of its own."""
    assert of.model.phase is not None
    phase = of.model.phase[block, start]
    stream.begin_phase(definition.tones, phase, phase)
    rows, at = block[:, None], start[:, None] + np.arange(-definition.sizes.history, 0)
    before = of.blocks.conditions_with_speed()[rows, at - 1].reshape(-1, 3)
    lattice, tones = of.model.excited_lattice, Tones(of.model.tensors, of.model.level)
    played = tone(tones.coefficients(before).reshape(*at.shape, -1), of.model.phase[rows, at])
    _, after = lattice.gains(lattice.level(before[:, :2]).reshape(at.shape))
    reflections = lattice.reflections(before[:, :2]).T.reshape(*at.shape, -1)
    stream.states = analyse((of.blocks.samples[rows, at, 0] - played) / after, reflections)[2]
    inputs = of.data.inputs[rows, start[:, None] + np.arange(-closed_loop_training.WARM_UP, 0)]
    stream.hidden_state = np.zeros_like(stream.hidden_state)
    for i in range(inputs.shape[1]):
        stream.hidden_state = stream.network.push(stream.hidden_state, inputs[:, i])
    stream.inputs = inputs[:, -1]


def test_a_roll_out_is_the_definitions_closed_loop(surface: Surface) -> None:
    """Its samples, taken in by the definition after the same recorded window, are worth the innovations that were drawn.

    And with tones their phase is the definition's. To what float32 leaves of 60 steps.
    """
    of, definition = surface.excerpts(60), definition_of(surface)
    block, start = of.draw(surface.blocks.split.train, 4, np.random.default_rng(1))
    run, vibration = of.rollout(surface.network, block, start, np.random.default_rng(2))
    rows = block[:, None]
    stream = definition.start(surface.blocks.samples[rows, start[:, None] + np.arange(-definition.sizes.history, 0)])
    if surface.model.phase is not None:
        start_on_path(stream, definition, of, block, start)
    conditions = surface.blocks.conditions_with_speed()[rows, start[:, None] + np.arange(60)]
    for i in range(60):
        if surface.model.phase is not None:
            np.testing.assert_allclose(stream.phase, run.phase[:, i], atol=1e-4)
        mixture = stream.network.mixture(stream.hidden_state, stream.inputs)
        innovation = copy.deepcopy(stream).analyse(vibration[:, i] - stream.tone)
        np.testing.assert_allclose(innovation, run.innovation[i], atol=2e-4)
        assert (np.abs(innovation) < (np.abs(mixture.mean) + 12 * mixture.scale).max(axis=1)).all()
        stream.push(vibration[:, i], conditions[:, i], None)


def fitted(
    surface: Surface, rate: float, patch: pytest.MonkeyPatch, config: TrainConfig = CONFIG, **monitored: Any
) -> tuple[InnovationNetwork, Progress]:
    """A copy of the surface's network, trained, and how that went."""
    patch.setitem(closed_loop_training.RECIPE, "learning_rate", rate)
    network = copy.deepcopy(surface.network)
    return network, fit_closed_loop(network, surface.excerpts(320), WARM_UP, config, Monitor(**monitored))


def equal(network: torch.nn.Module, other: torch.nn.Module) -> bool:
    return all(map(torch.equal, network.parameters(), other.parameters()))


def test_what_does_not_gain_is_left_as_it_was(surface: Surface, monkeypatch: pytest.MonkeyPatch) -> None:
    worse, progress = fitted(surface, 30.0, monkeypatch)  # which leaves the network anywhere
    assert progress.best.epoch == 0
    assert progress.best_loss == progress.epochs[0].validation_loss
    assert equal(worse, surface.network)
    better, progress = fitted(surface, 2e-2, monkeypatch)  # of a network that nobody trained
    assert progress.best_loss < progress.epochs[0].validation_loss
    assert not equal(better, surface.network)
    assert equal(better, fitted(surface, 2e-2, monkeypatch)[0])
    # Some without a share.
    fitted(surface, 2e-2, monkeypatch, replace(CONFIG, threads=closed_loop_training.N_EXCERPTS + 2))


@without_tones
def test_the_averaged_network_is_what_is_validated(surface: Surface, monkeypatch: pytest.MonkeyPatch) -> None:
    networks: list[InnovationNetwork] = []

    def fit() -> Progress:
        network, progress = fitted(surface, 2e-2, monkeypatch)
        networks.append(network)
        return progress

    loop, progress = captured_loop(monkeypatch, "closed_loop_training", fit)
    assert loop.averaging > 0
    assert progress.best.epoch > 0
    assert loop.validate(networks[0])[0] == progress.best_loss
    assert loop.validate(surface.network)[0] == progress.epochs[0].validation_loss


@without_tones
@pytest.mark.parametrize("part", ["test", "validation", "train"])
def test_the_validation_blocks_have_a_say_and_the_test_blocks_none(
    surface: Surface, monkeypatch: pytest.MonkeyPatch, part: str
) -> None:
    """Samples of one of the three are others: of training the first loss is another too, whose unit they give."""
    network, progress = fitted(surface, 2e-2, monkeypatch)
    samples = surface.blocks.samples.copy()
    numbers = list(getattr(surface.blocks.split, part))
    samples[numbers, :, 0] = 3 * np.random.default_rng(0).standard_normal(samples[numbers, :, 0].shape)
    other = replace(surface, blocks=replace(surface.blocks, samples=samples))
    changed, again = fitted(other, 2e-2, monkeypatch)
    same_losses = [line.validation_loss for line in again.epochs] == [line.validation_loss for line in progress.epochs]
    same_training = [line.train_loss for line in again.epochs[1:]] == [line.train_loss for line in progress.epochs[1:]]
    assert same_losses == (part == "test")
    assert same_training == (part != "train")
    assert equal(changed, network) or part != "test"


@without_tones
@pytest.mark.parametrize(("epochs", "n"), [(1, 1), (12, 8)])
def test_a_short_training_is_short_in_its_closed_loop_too(
    surface: Surface, monkeypatch: pytest.MonkeyPatch, epochs: int, n: int
) -> None:
    """And a long one has eight epochs at most, whether they gain or not, and none on trial."""
    monkeypatch.setattr(closed_loop_training, "N_STEPS", 1)
    stages: list[str] = []
    config = replace(CONFIG, epochs=epochs, patience=1, trial_epochs=1)
    _, progress = fitted(surface, 1e-9, monkeypatch, config, on_stage=stages.append)
    assert [line.epoch for line in progress.epochs] == list(range(n + 1))
    assert [stage.split(": ")[1] for stage in stages] == [f"{100 * line.epoch // n} %" for line in progress.epochs]


@without_tones
@pytest.mark.parametrize(("rate_hz", "block", "n"), [(1e3, 1000, 512), (1e3, 500, None), (1e4, 8000, None)])
def test_blocks_too_short_or_too_fine_are_not_rolled_out(
    surface: Surface, rate_hz: float, block: int, n: int | None
) -> None:
    of = surface.excerpts(0)
    trace = replace(surface.blocks.trace, rate_hz=rate_hz, block=block)
    excerpts = excerpts_of(replace(surface.blocks, trace=trace), of.model, of.data, LIMIT)
    assert (None if excerpts is None else excerpts.n) == n


RATE = 1000.0


def test_energies_are_those_of_the_listener() -> None:
    """But for a thousandth of a unit of power that still rings in the lowest band when the transform comes round."""
    signal = np.random.default_rng(6).standard_normal((2, 1000))
    ours = energies(torch.from_numpy(signal).float(), RATE).numpy()
    np.testing.assert_allclose(ours, band_energies(signal, RATE), atol=1e-3)


def bursts(rng: np.random.Generator, n: int, deep: float) -> np.ndarray:
    """Noise whose loudness goes up and down over some 50 ms, by so much."""
    slow = np.repeat(rng.standard_normal((n, 16)), 48, axis=1)
    return rng.standard_normal((n, 768)) * np.exp(deep * slow)


@pytest.mark.parametrize("wrong", [0.0, 0.3, 1.0])
def test_the_score_is_lowest_for_the_distribution_that_was_recorded(wrong: float) -> None:
    rng = np.random.default_rng(7)
    recorded, moving = bursts(rng, 300, 0.6), np.ones((300, 96), dtype=bool)
    distance = EnvelopeEnergyDistance(recorded, moving, RATE)

    def score(deep: float) -> float:
        both, prefix = np.stack([bursts(rng, 300, deep), bursts(rng, 300, deep)]), np.zeros((300, 0))
        drawn, truth, before = (torch.from_numpy(part).float() for part in (both, recorded, prefix))
        return float(distance(drawn, truth, before, torch.from_numpy(moving)))

    assert score(0.6) < score(wrong) - 0.01


def test_what_is_at_rest_does_not_count() -> None:
    """A sensor's noise at rest moves the score of nothing, and an excerpt at rest adds nothing to it.

    Changed are the last 30 frames, of which the last 24 rest: what a band-pass rings is after what it is given.
    """
    rng = np.random.default_rng(8)
    recorded, moving = bursts(rng, 60, 0.6), np.ones((60, 96), dtype=bool)
    moving[:, 72:] = False
    moving[50:] = False
    distance = EnvelopeEnergyDistance(recorded, moving, RATE)
    drawn, noisy = (torch.from_numpy(bursts(rng, 120, 0.6)).float().unflatten(0, (2, 60)) for _ in range(2))
    at_rest = drawn.clone()
    at_rest[:, :, 72 * 8 :] = 10 * noisy[:, :, 72 * 8 :]
    at_rest[:, 50:] = 10 * noisy[:, 50:]

    def score(of: Tensor, counted: Tensor) -> float:
        return float(distance(of, torch.from_numpy(recorded).float(), torch.zeros(60, 0), counted))

    strokes = torch.from_numpy(moving)
    # Of the transform that comes round a thousandth of the power is left, a hundred times as much here.
    assert score(at_rest, strokes) == pytest.approx(score(drawn, strokes), rel=2e-2)
    everywhere = torch.ones_like(strokes)
    assert score(at_rest, everywhere) > 1.2 * score(drawn, everywhere)
