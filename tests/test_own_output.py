"""Training on own output: roll-outs are the reference's closed loop, gradients are derivatives, and the score is proper."""

from __future__ import annotations

import copy
import dataclasses
from typing import Any

import numpy as np
import pytest
import torch
from scipy.stats import norm

from conftest import PLUS
from foten.dsp.bands import band_energies
from foten.dsp.lattice import analyse
from foten.models.definitions import model_of
from foten.models.foten_plus import closed_loop_training as closed_loop_training
from foten.models.foten_plus.closed_loop_training import Excerpts, excerpts_of, fit_own_output
from foten.models.foten_plus.fit import FotenPlusTask, prepare_foten_plus
from foten.models.foten_plus.innovation_network import Mixture
from foten.models.foten_plus.linear_model import phase_alone
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.recording.preprocess import PreprocessConfig
from foten.simulation.simulate import simulate
from foten.training import training_kernel as kernel
from foten.training.config import TrainConfig
from foten.training.envelope_loss import EnvelopeEnergyDistance, energies
from foten.training.job import TrainingJob
from foten.training.loop import Epoch, Progress
from foten.training.rollout import MAX_ADJOINT, PARTS, Beginning, Rollout, RolloutInputs, repeated
from foten.training.texture_builder import tensors_of

RATE = 1000.0


@pytest.fixture(scope="module", params=["artificial-grass", "steel-mesh-2"])
def task(request: pytest.FixtureRequest) -> FotenPlusTask:
    """A surface without tones and one with them, their networks as if trained."""
    config = TrainConfig(epochs=0, threads=1, max_order=20, table=False)
    job = TrainingJob(simulate(request.param, 34.0), "foten-plus", FotenPlusSizes(**PLUS), config, PreprocessConfig())
    made = prepare_foten_plus(job, lambda stage: None)
    torch.manual_seed(0)
    for network in made.networks.values():
        for parameter in network.parameters():
            parameter.data += 0.1 * torch.randn_like(parameter)
    return made


def excerpts(task: FotenPlusTask, n: int) -> Excerpts:
    name = "network" if task.phased is None else "rendering_network"
    part = task.phased or task.plain.part
    return dataclasses.replace(Excerpts(task.blocks, part, task.innovations[name], n, 5.0))


def drawing(task: FotenPlusTask) -> Any:
    return task.networks["network" if task.phased is None else "rendering_network"]


def test_a_roll_out_is_the_reference_s_closed_loop(task: FotenPlusTask) -> None:
    """Its samples, taken in by the reference after the same recorded window, are worth the innovations that were drawn.

    And with tones their phase is the reference's. To what float32 leaves of 60 steps.
    """
    of = excerpts(task, 60)
    part, network = of.part, drawing(task)
    block, start = of.draw(task.blocks.split.train, 4, np.random.default_rng(1))
    run, vibration = of.rolled_out(network, block, start, np.random.default_rng(2))
    weights = tensors_of(task.networks["network"], "network.") | tensors_of(network, "rendering_network.")
    excitation = tensors_of(task.plain.fitted.excitation, "excitation.")
    for name in ("out.weight", "out.bias", "power_law.weight"):
        excitation[f"excitation.{name}"] = np.zeros_like(excitation[f"excitation.{name}"])  # σ of 1
    sizes = dataclasses.replace(part.sizes, network_in_loop=True, window=closed_loop_training.WARM_UP)
    model = model_of(sizes, {**part.tensors, **weights, **excitation})
    rows, history = block[:, None], sizes.history
    windows = task.blocks.samples[rows, start[:, None] + np.arange(-history, 0)]
    stream: Any = model.start(windows)
    if part.phase is not None:  # the reference finds a phase of its own; here it is known
        stream.begin_path(model.tones, part.phase[block, start], part.phase[block, start])  # type: ignore[attr-defined]
        residual = windows[..., 0] - coefficients_tone(of, block, start, history)
        reflections, level = lattice_of(of, block, start, history)
        _, after = part.excited_lattice.gains(level)
        stream.states = analyse(residual / after, reflections)[2]
        inputs = of.of.inputs[rows, start[:, None] + np.arange(-closed_loop_training.WARM_UP, 0)]
        stream.hidden = np.zeros_like(stream.hidden)
        for i in range(inputs.shape[1]):
            stream.hidden = stream.network.push(stream.hidden, inputs[:, i])
        stream.inputs = inputs[:, -1]
    conditions = task.blocks.path_conditions()[rows, start[:, None] + np.arange(60)]
    for i in range(60):
        if part.phase is not None:
            np.testing.assert_allclose(stream.phase, run.phase[:, i], atol=1e-4)
        mixture = stream.network.mixture(stream.hidden, stream.inputs)
        innovation = copy.deepcopy(stream).analyse(vibration[:, i] - stream.tone)
        np.testing.assert_allclose(innovation, run.innovation[i], atol=2e-4)
        assert (np.abs(innovation - mixture.expected()) < 12 * mixture.sd()).all()
        stream.push(vibration[:, i], conditions[:, i], None)


def coefficients_tone(of: Excerpts, block: np.ndarray, start: np.ndarray, n: int) -> np.ndarray:
    from foten.dsp.tones import tone
    from foten.models.excitation import Scale
    from foten.models.foten_plus.definition import Tones

    at = start[:, None] + np.arange(-n, 0)
    tones = Tones(of.part.tensors, Scale(of.part.tensors, "lattice.level."))
    before = of.blocks.path_conditions()[block[:, None], at - 1].reshape(-1, 3)
    assert of.part.phase is not None
    return np.asarray(tone(tones.coefficients(before).reshape(*at.shape, -1), of.part.phase[block[:, None], at]))


def lattice_of(of: Excerpts, block: np.ndarray, start: np.ndarray, n: int) -> tuple[np.ndarray, np.ndarray]:
    at = start[:, None] + np.arange(-n, 0)
    before = of.blocks.samples[block[:, None], at - 1, 1:].reshape(-1, 2)
    lattice = of.part.excited_lattice
    return lattice.reflections(before).T.reshape(*at.shape, -1), lattice.level(before).reshape(at.shape)


def around(s: int, n: int, p: int, rng: np.random.Generator, gain_before: bool) -> tuple[RolloutInputs, Beginning]:
    def single(values: np.ndarray) -> np.ndarray:
        return values.astype(np.float32)

    reflections = single(rng.uniform(-0.7, 0.7, (s, n, p)))
    level, logs = single(rng.uniform(0.5, 2.0, (s, n))), single(rng.standard_normal((s, n, 2)))
    begin = Beginning(
        *(single(rng.standard_normal(shape)) for shape in ((s, p), (s, 6), (s, 5)))  # type: ignore[arg-type]
    )
    return RolloutInputs(reflections, level, logs, gain_before, 50.0), begin


def weights(k: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    shapes = [(18, 5), (18, 6), (18,), (18,), (7, 11), (7,), (3 * k, 7), (3 * k,)]
    return {
        name: (0.4 * rng.standard_normal(shape)).astype(np.float32) for name, shape in zip(PARTS, shapes, strict=True)
    }


@pytest.mark.parametrize("gain_before", [False, True])
@pytest.mark.parametrize("p", [1, 2, 9])
@pytest.mark.parametrize("of_isa", ["portable", kernel.isa()])
def test_gradients_are_those_of_finite_differences(
    of_isa: str, p: int, gain_before: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of one Gaussian, whose draw μ + s z moves with the weights; of a mixture the draw's own derivative is below.

    In float32 a central difference of 1e-2 is good to a per cent of the largest.
    """
    monkeypatch.setattr(kernel, "_function", lambda name: getattr(kernel.training_library(), f"{name}_{of_isa}"))
    rng = np.random.default_rng(3)
    given, begin = around(3, 12, p, rng, gain_before)
    at, of = weights(1, rng), rng.standard_normal((3, 12)).astype(np.float32)

    def loss(changed: dict[str, np.ndarray]) -> float:
        return float((Rollout(changed, given, begin, np.random.default_rng(4)).residual.astype(float) * of).sum())

    gradients = Rollout(at, given, begin, np.random.default_rng(4)).gradients(of, np.inf)
    for name, gradient in gradients.items():
        largest = float(np.abs(gradient).max())
        for number in rng.choice(gradient.size, min(6, gradient.size), replace=False):
            ends = []
            for step in (-1e-2, 1e-2):
                changed = {**at, name: at[name].copy()}
                changed[name].flat[number] += step
                ends.append(loss(changed))
            assert float(gradient.flat[number]) == pytest.approx((ends[1] - ends[0]) / 2e-2, abs=0.02 * largest + 1e-3)


def test_a_chaotic_stream_does_not_drown_the_others() -> None:
    """Weights eight times as large let a difference grow with each sample; held, a gradient is of the size of one sample's."""
    rng = np.random.default_rng(8)
    given, begin = around(3, 400, 2, rng, False)
    at = {name: 8 * one for name, one in weights(1, rng).items()}
    of = np.ones((3, 400), np.float32)
    free, held = (
        float(max(np.abs(one).max() for one in Rollout(at, given, begin, drawn).gradients(of, most).values()))
        for most, drawn in ((np.inf, np.random.default_rng(1)), (MAX_ADJOINT, np.random.default_rng(1)))
    )
    assert free > 1e6
    assert held < 1e4


def test_a_draw_moves_as_its_quantile_does() -> None:
    """∂e/∂θ at one probability, against the reference's quantile at the same z."""
    rng = np.random.default_rng(5)
    given, begin = around(40, 1, 3, rng, False)
    run = Rollout(weights(4, rng), given, begin, rng)
    derivative, out = run._of_draws()[0], run._out[0].astype(float)

    def mixture(raw: np.ndarray) -> Mixture:
        logit, mean, log_scale = np.split(raw, 3, axis=1)
        weight = np.exp(logit)
        return Mixture(weight / weight.sum(axis=1, keepdims=True), mean, np.exp(6 * np.tanh(log_scale / 6)))

    now = mixture(out)
    below = (now.weight * norm.cdf((run.innovation[0][:, None] - now.mean) / now.scale)).sum(axis=1)
    z = norm.ppf(below)
    for column in range(out.shape[1]):
        step = np.zeros_like(out)
        step[:, column] = 1e-5
        expected = (mixture(out + step).quantile(z) - mixture(out - step).quantile(z)) / 2e-5
        np.testing.assert_allclose(derivative[:, column], expected, rtol=2e-3, atol=2e-4)


def test_draws_are_distributed_as_the_network_says() -> None:
    """Kolmogorov and Smirnov's distance of 20,000 draws from one mixture of four; 1.95 / √n is its 0.1 % quantile."""
    n, rng = 20_000, np.random.default_rng(9)
    given, begin = around(1, 1, 1, rng, False)
    run = Rollout(weights(4, rng), repeated(given, n), repeated(begin, n), rng)
    logit, mean, raw = np.split(run._out[0, 0].astype(float), 3)
    weight, scale = np.exp(logit) / np.exp(logit).sum(), np.exp(6 * np.tanh(raw / 6))
    assert 1 - (weight**2).sum() > 0.5  # which no component alone is
    drawn = np.sort(run.innovation[0].astype(float))
    below = (weight * norm.cdf((drawn[:, None] - mean) / scale)).sum(axis=1)
    assert np.abs(below - (np.arange(n) + 0.5) / n).max() < 1.95 / np.sqrt(n)


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
    recorded = bursts(rng, 300, 0.6)
    moving = np.ones((300, 96), dtype=bool)
    likeness = EnvelopeEnergyDistance(recorded, moving, RATE)

    def score(deep: float) -> float:
        first, second, prefix = bursts(rng, 300, deep), bursts(rng, 300, deep), np.zeros((300, 0))
        drawn, truth, before = (torch.from_numpy(one).float() for one in (np.stack([first, second]), recorded, prefix))
        return float(likeness(drawn, truth, before, torch.from_numpy(moving)))

    assert score(0.6) < score(wrong) - 0.01


def test_what_is_at_rest_does_not_count() -> None:
    """A sensor's noise at rest moves the score of nothing, and an excerpt at rest adds nothing to it.

    Changed are the last 30 frames, of which the last 24 rest: what a band-pass rings is after what it is given.
    """
    rng = np.random.default_rng(8)
    recorded = bursts(rng, 60, 0.6)
    moving = np.ones((60, 96), dtype=bool)
    moving[:, 72:] = False
    moving[50:] = False
    likeness = EnvelopeEnergyDistance(recorded, moving, RATE)
    drawn, noisy = (torch.from_numpy(bursts(rng, 120, 0.6)).float().unflatten(0, (2, 60)) for _ in range(2))
    truth, before = torch.from_numpy(recorded).float(), torch.zeros(60, 0)
    at_rest = drawn.clone()
    at_rest[:, :, 72 * 8 :] = 10 * noisy[:, :, 72 * 8 :]
    at_rest[:, 50:] = 10 * noisy[:, 50:]
    rests = torch.from_numpy(moving)
    # Of the transform that comes round a thousandth of the power is left, a hundred times as much here.
    assert float(likeness(at_rest, truth, before, rests)) == pytest.approx(
        float(likeness(drawn, truth, before, rests)), rel=2e-2
    )
    everywhere = torch.ones_like(rests)
    assert float(likeness(at_rest, truth, before, everywhere)) > 1.2 * float(likeness(drawn, truth, before, everywhere))


def test_what_does_not_gain_is_left_as_it_was(task: FotenPlusTask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(closed_loop_training, "JUDGED_EVERY", 3)
    monkeypatch.setattr(closed_loop_training, "N_JUDGED", 1)
    of, network = excerpts_of(task.blocks, (task.phased or task.plain.part), excerpts(task, 0).of, 5.0), drawing(task)
    assert of is not None

    def fitted(rate: float) -> tuple[Any, Any]:
        monkeypatch.setattr(closed_loop_training, "RATE", rate)
        changed = copy.deepcopy(network)
        return changed, fit_own_output(changed, of, lambda one, rng: sum(p.sum() * 0 for p in one.parameters()), 3, 0)

    worse, result = fitted(30.0)  # which leaves the network anywhere
    assert not result.gained
    assert result.after == result.before
    for ours, theirs in zip(worse.parameters(), network.parameters(), strict=True):
        assert torch.equal(ours, theirs)
    better, result = fitted(2e-2)  # of a network that nobody trained
    assert result.gained
    again, _ = fitted(2e-2)
    for ours, theirs in zip(better.parameters(), again.parameters(), strict=True):
        assert torch.equal(ours, theirs)


@pytest.mark.parametrize(("epochs", "steps"), [(1, 25), (2, 50), (12, 200)])
def test_a_short_training_is_short_on_own_output_too(
    task: FotenPlusTask, monkeypatch: pytest.MonkeyPatch, epochs: int, steps: int
) -> None:
    asked: list[int] = []
    monkeypatch.setattr("foten.models.foten_plus.fit.fit_own_output", lambda *given: asked.append(given[3]))
    job = dataclasses.replace(task.job, config=dataclasses.replace(task.job.config, epochs=epochs))
    of = excerpts(task, 0)
    dataclasses.replace(task, job=job)._on_own_output(drawing(task), of.of, of.part, 5.0, lambda stage: None)
    assert asked == [steps]


@pytest.mark.parametrize("gained", [True, False])
def test_the_level_is_settled_only_where_own_output_gained_nothing(
    task: FotenPlusTask, monkeypatch: pytest.MonkeyPatch, gained: bool
) -> None:
    """Settled once more, ribbed plastic was told apart in 0.91 and not 0.87."""
    monkeypatch.setattr("foten.models.foten_plus.fit.MIN_GAIN_NAT", -1e3)
    result = closed_loop_training.ClosedLoopResult(1.0, 0.5 if gained else 1.0)
    monkeypatch.setattr(FotenPlusTask, "_on_own_output", lambda self, *given: result)
    texture = task.finish(Progress([Epoch(1, 1.0, 1.0, 1.0, 1.0, True)]), lambda stage: None)
    errors = texture.card["metrics"]["renderings"]["with network"]["level_errors_db"]
    assert len(errors) == (0 if gained else 3)


def test_interrupted_what_is_best_so_far_is_kept(task: FotenPlusTask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(closed_loop_training, "N_JUDGED", 1)
    monkeypatch.setattr(closed_loop_training, "JUDGED_EVERY", 2)
    monkeypatch.setattr(closed_loop_training, "RATE", 2e-2)
    of, network = excerpts_of(task.blocks, (task.phased or task.plain.part), excerpts(task, 0).of, 5.0), drawing(task)
    assert of is not None

    def stopped(step: int) -> None:
        if step == 2:
            raise KeyboardInterrupt

    likelihood = lambda one, rng: sum(p.sum() * 0 for p in one.parameters())  # noqa: E731
    changed = copy.deepcopy(network)
    result = fit_own_output(changed, of, likelihood, 200, 0, stopped)
    assert result.interrupted
    assert result.gained
    assert not torch.equal(changed.out.weight, network.out.weight)


@pytest.mark.parametrize("interrupted", [False, True])
def test_a_training_that_was_interrupted_on_own_output_says_so(
    task: FotenPlusTask, monkeypatch: pytest.MonkeyPatch, interrupted: bool
) -> None:
    """A sweep would take it for done else, and a checkpoint would be deleted."""
    monkeypatch.setattr("foten.models.foten_plus.fit.MIN_GAIN_NAT", -1e3)
    result = closed_loop_training.ClosedLoopResult(1.0, 0.5, interrupted)
    monkeypatch.setattr(FotenPlusTask, "_on_own_output", lambda self, *given: result)
    progress = Progress([Epoch(1, 1.0, 1.0, 1.0, 1.0, True)])
    task.finish(progress, lambda stage: None)
    assert progress.interrupted == interrupted


def test_blocks_too_short_or_too_fine_are_not_rolled_out(task: FotenPlusTask) -> None:
    of = excerpts(task, 0)
    assert excerpts_of(task.blocks, of.part, of.of, 5.0) is not None
    short = dataclasses.replace(task.blocks.trace, block=500)
    assert excerpts_of(dataclasses.replace(task.blocks, trace=short), of.part, of.of, 5.0) is None


def test_a_phase_alone_has_the_plain_part_s_innovations(task: FotenPlusTask) -> None:
    """Silent tones leave all of the vibration to the plain lattice."""
    if task.phased is None:
        pytest.skip("of a surface that repeats")
    plain = dataclasses.replace(
        task.plain.part, phase=None, sizes=dataclasses.replace(task.plain.part.sizes, n_tones=0)
    )
    part = phase_alone(plain, task.phased)
    for ours, theirs in zip(part.innovations(task.blocks, residual=True), plain.innovations(task.blocks), strict=True):
        np.testing.assert_allclose(ours, theirs, atol=1e-9)
    assert {name: tensor.shape for name, tensor in part.tensors.items() if name.startswith(("tones", "residual"))} == {
        name: shape for name, shape in part.sizes.tensor_shapes().items() if name.startswith(("tones", "residual"))
    }
