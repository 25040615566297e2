"""The innovation network: its likelihood, its layers as PyTorch's, and what it makes of known processes."""

from __future__ import annotations

import copy
import dataclasses
import math

import numpy as np
import pytest
import torch
from scipy.special import logsumexp
from scipy.stats import norm

from conftest import PLUS, untrained, untrained_tensors
from foten.models.foten_plus import network as innovation
from foten.models.foten_plus.config import FotenPlusConfig
from foten.models.foten_plus.definition import NetworkDefinition, innovation_inputs
from foten.models.foten_plus.linear_model import LinearModel
from foten.models.foten_plus.network import (
    CHUNK,
    Batches,
    Chunks,
    InnovationNetwork,
    Innovations,
    NextInnovation,
    asymmetry,
    fit_innovation_network,
    innovations_of,
    mean_share,
    negative_log_likelihood,
    with_mean_share,
)
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.training.checkpoint import Progress
from foten.training.job import ScaledBlocks, scaled_blocks
from foten.training.loop import Loop, Monitor, run_loop
from foten.training.texture_builder import tensors_of

SIZES = FotenPlusSizes(**PLUS)


def test_the_unit_and_its_head_are_pytorchs() -> None:
    """Seam: PyTorch in float64 on the same tensors, sample by sample, and as a graph would be asked."""
    network = untrained("foten-plus", SIZES).double()
    inputs = 2 * np.random.default_rng(0).standard_normal((3, 30, 5))
    definition, hidden = NetworkDefinition(tensors_of(network), ""), np.zeros((3, SIZES.n_hidden))
    with torch.no_grad():
        states = network.recurrent(torch.from_numpy(inputs))[0].numpy()
        log_weight, mean, log_scale = (part.numpy() for part in network(torch.from_numpy(inputs)))
        last = NextInnovation(network)(torch.from_numpy(inputs)).numpy()
    expected = (np.exp(log_weight) * mean).sum(axis=2)
    for i in range(30):
        hidden = definition.push(hidden, inputs[:, i])
        np.testing.assert_allclose(hidden, states[:, i], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(definition.expected(hidden, inputs[:, i]), expected[:, i], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(last, np.concatenate([part[:, -1] for part in (log_weight, mean, log_scale)], axis=1))


def test_the_likelihood_is_that_of_a_mixture_of_normals() -> None:
    """Oracle: SciPy's normal density, of components near and far, sharp and wide."""
    rng = np.random.default_rng(0)
    weight, innovation = rng.dirichlet(np.full(4, 0.5), 40) + 1e-9, 3 * rng.standard_normal(40)
    log_weight, mean = np.log(weight / weight.sum(axis=1, keepdims=True)), 3 * rng.standard_normal((40, 4))
    log_scale = rng.uniform(-5, 2, (40, 4))
    expected = -logsumexp(log_weight + norm.logpdf(innovation[:, None], mean, np.exp(log_scale)), axis=1)
    parts = tuple(torch.from_numpy(part) for part in (log_weight, mean, log_scale))
    nll = negative_log_likelihood(parts, torch.from_numpy(innovation))  # type: ignore[arg-type]
    np.testing.assert_allclose(nll, expected, rtol=1e-9)


CONFIG = FotenPlusConfig(epochs=2, threads=1, batch=32)
CPU = torch.device("cpu")


def process(kind: str, n_blocks: int = 24, block: int = 1000) -> tuple[ScaledBlocks, Innovations]:
    """Unit innovations of a known kind as what a network is fitted to, under a steady hand."""
    rng = np.random.default_rng(0)
    z = rng.standard_normal((n_blocks, block))
    if kind == "bursts":  # of 20 samples, ten times as large as what is between
        burst = np.repeat(rng.random((n_blocks, block // 20)) < 0.2, 20, axis=1)
        z = z * np.where(burst, 1.0, 0.1) / math.sqrt(0.2 + 0.8 * 0.01)
    elif kind == "skewed":
        z = rng.exponential(size=z.shape) - 1
    speed = np.linspace(20.0, 200.0, n_blocks * block)
    trace = Trace(z.ravel(), speed, np.ones(z.size), 1000.0, block)
    numbers = tuple(range(n_blocks))
    blocks = scaled_blocks(trace, Split(numbers[:16], numbers[16:20], numbers[20:], n_blocks, block, "contiguous", 0))
    inputs = innovation_inputs(z.ravel(), z.ravel(), np.zeros((z.size, 2))).reshape(n_blocks, block, 5)
    sign_symmetric = asymmetry(z[:16]) < 4.0
    return blocks, Innovations(inputs, z, np.ones_like(z), speed.reshape(z.shape), 20, sign_symmetric)


def new_network() -> InnovationNetwork:
    torch.manual_seed(0)
    return InnovationNetwork(FotenPlusSizes(n_hidden=16, head_width=16, window=20))


def fitted(blocks: ScaledBlocks, data: Innovations, config: FotenPlusConfig = CONFIG) -> Progress:
    return fit_innovation_network(new_network(), data, blocks, 20, config, Monitor())


def test_of_noise_nothing_is_learned_and_of_bursts_when_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gaussian noise has ½ log 2πe; bursts that are known have their own share of it, and 20 samples hide little."""
    monkeypatch.setattr(innovation, "N_STEPS", 50)
    gaussian = 0.5 * math.log(2 * math.pi * math.e)
    assert fitted(*process("noise")).best_loss == pytest.approx(gaussian, abs=0.03)
    known = gaussian + 0.8 * math.log(0.1) - 0.5 * math.log(0.2 + 0.8 * 0.01)
    blocks, data = process("bursts")
    nats = fitted(blocks, data).best_loss
    assert known - 0.02 < nats < known + 0.25  # the first samples of each burst come unannounced
    # Independent draws of the right kurtosis, all that an excitation without memory can be.
    x = data.innovation[16:20].ravel()
    loud, quiet = (norm.pdf(x, scale=size / math.sqrt(0.208)) for size in (1.0, 0.1))
    unaware = -float(np.log(0.2 * loud + 0.8 * quiet).mean())
    assert nats < unaware - 0.15


def test_only_the_training_blocks_are_learned_from(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of validation are ten times as large here: whoever learned from them would have a loss of 3.7 nat."""
    monkeypatch.setattr(innovation, "N_STEPS", 20)
    blocks, data = process("bursts")
    louder = data.innovation.copy()
    louder[16:20] *= 10
    assert fitted(blocks, dataclasses.replace(data, innovation=louder)).epochs[-1].train_loss < 1.5


def test_more_threads_than_a_batch_has_shares_for_learn_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten chunks for eight threads are five shares of two; sums of other shares differ by rounding, which steps amplify."""
    monkeypatch.setattr(innovation, "N_STEPS", 30)
    blocks, data = process("bursts")
    configs = [dataclasses.replace(CONFIG, epochs=1, batch=10, threads=n) for n in (1, 8, 8)]
    losses = [fitted(blocks, data, config).epochs[1] for config in configs]
    assert losses[1].train_loss == pytest.approx(losses[0].train_loss, rel=1e-3)
    assert losses[2].validation_loss == losses[1].validation_loss


def test_the_averaged_network_is_validated_on_the_validation_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Oracle: PyTorch's own unit over these blocks, in float64."""
    loops: list[Loop] = []

    def captured(loop: Loop, *arguments: object) -> Progress:
        loops.append(loop)
        return run_loop(loop, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(innovation, "run_loop", captured)
    monkeypatch.setattr(innovation, "N_STEPS", 20)
    blocks, data = process("bursts", block=300)
    data = dataclasses.replace(data, innovation_gain=3.0 * np.ones_like(data.innovation))
    progress = fitted(blocks, data)
    (loop,) = loops
    assert loop.averaging > 0
    assert progress.best.epoch > 0
    other = untrained("foten-plus", FotenPlusSizes(n_hidden=16, head_width=16, window=20))
    for network in (loop.network, other):
        follows = torch.from_numpy(data.innovation[16:20, 21:])
        with torch.no_grad():
            mixture = copy.deepcopy(network).double()(torch.from_numpy(data.inputs[16:20, 20:-1]))
        nats = negative_log_likelihood(mixture, follows)[:, 20:].mean()
        errors = 3 * (follows - (mixture[0].exp() * mixture[1]).sum(dim=-1)).abs()[:, 20:].mean()
        assert loop.validate(network) == pytest.approx((float(nats), float(errors)), rel=1e-4)
    assert loop.validate(loop.network)[0] == pytest.approx(progress.best_loss, rel=1e-6)


@pytest.mark.parametrize(("kind", "sign_symmetric"), [("noise", True), ("skewed", False)])
@pytest.mark.parametrize("repeats", [False, True])
def test_a_network_is_fitted_to_the_innovations_of_a_linear_model(
    kind: str, sign_symmetric: bool, repeats: bool
) -> None:
    """Of one that leaves all, a level of 1 and no reflections: mirrored where it may be."""
    blocks, data = process(kind)
    sizes = FotenPlusSizes(**PLUS, order=1, n_tones=int(repeats))
    tensors = untrained_tensors("foten-plus", sizes, untrained("foten-plus", sizes))
    for name in tensors:
        if name.endswith((".reflections", ".values", "level.out.weight", "level.out.bias", "level.exponents")):
            tensors[name] = 0 * tensors[name]
    phase = np.cumsum(0.1 * np.ones(data.innovation.shape), axis=1) if repeats else None
    model = LinearModel(sizes, tensors, phase)
    of = innovations_of(model, blocks, 20)
    np.testing.assert_allclose(of.innovation[:, 1:], blocks.samples[:, 1:, 0], rtol=1e-6, atol=1e-9)
    logs = model.level.logarithms(blocks.samples[..., 1:].reshape(-1, 2))
    inputs = innovation_inputs(of.innovation.ravel(), of.innovation.ravel(), logs).reshape(*of.innovation.shape, 5)
    np.testing.assert_allclose(of.inputs[:, 1:], inputs[:, 1:])
    assert of.sign_symmetric == (sign_symmetric and not repeats)


def test_only_what_has_no_sign_is_mirrored() -> None:
    """And in mirror images what follows changes its sign with the innovation and x, and nothing else does."""
    blocks, data = process("noise")
    assert process("bursts")[1].sign_symmetric
    assert not process("skewed")[1].sign_symmetric
    (inputs, follows), (plain, same) = (
        Batches(dataclasses.replace(data, sign_symmetric=sign_symmetric), blocks, 20, CONFIG, CPU).draw(
            np.random.default_rng(1)
        )
        for sign_symmetric in (True, False)
    )
    sign = torch.sign(follows / same)
    assert set(sign.mean(dim=1).tolist()) == {-1.0, 1.0}
    for column in range(5):
        expected = plain[..., column] * (sign if column in (0, 2) else 1.0)
        torch.testing.assert_close(inputs[..., column], expected, rtol=0, atol=0)


def test_slow_chunks_are_drawn_more_often() -> None:
    """By 1 / (speed + 25 mm/s): from 20 to 140 mm/s over the training blocks, 3.7 to 1."""
    blocks, data = process("noise")
    where = Chunks(data, blocks.split.train, 20)
    block, sample = where.draw(20_000, np.random.default_rng(0))
    assert sample.shape == (20_000, 20 + CHUNK)
    assert sample.max() < 1000 - 21  # rows of inputs and of what follows each
    first, last = (np.mean(block[:, 0] == number) for number in (0, 15))
    speed = data.speed.mean(axis=1)
    assert first / last == pytest.approx((speed[15] + 25) / (speed[0] + 25), rel=0.1)


def corrected(correlation: float, n: int, seed: int, factor: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Innovations of two blocks of n samples, means that predict that share of their variance times a factor, and gains."""
    rng = np.random.default_rng(seed)
    mean = math.sqrt(correlation) * rng.standard_normal((2, n))
    innovation = mean + math.sqrt(1 - correlation) * rng.standard_normal((2, n))
    return innovation, factor * mean, np.full((2, n), 0.3)


def test_a_mean_that_brings_nothing_is_not_used() -> None:
    """In few of 400 recordings by chance: the interval's 5 %, twice as many with stretches that are few and not normal."""
    rng = np.random.default_rng(7)
    for n_epochs, limit in ((1, 0.1), (12, 0.01)):
        shares = []
        for seed in range(400):
            innovation, _, gain = corrected(0.0, 200, seed)
            shares.append(mean_share(innovation, 0.05 * rng.standard_normal(innovation.shape), gain, 1000.0, n_epochs))
        assert np.mean(np.array(shares) > 0) <= limit
    innovation, mean, gain = corrected(0.2, 4, 0)
    assert mean_share(innovation, mean, gain, 1000.0, 1) == 0  # too little for an interval


def test_a_mean_is_shrunk_by_its_uncertainty() -> None:
    """On short recordings more, and where it is twice as large as it should be by half; where it is right and sure, hardly."""
    long, short = (
        np.mean([mean_share(*corrected(0.05, n, seed), 1000.0, 5) for seed in range(20)]) for n in (40_000, 1000)
    )
    assert 0.85 < long <= 1
    assert 0.1 < short < 0.7
    assert mean_share(*corrected(0.05, 400_000, 0, factor=2.0), 1000.0, 5) == pytest.approx(0.5, abs=0.06)
    assert mean_share(*corrected(0.05, 40_000, 0, factor=-1.0), 1000.0, 5) == 0


def test_a_share_of_a_mean_changes_nothing_else_of_a_mixture() -> None:
    network = untrained("foten-plus", SIZES).double()
    inputs = torch.from_numpy(np.random.default_rng(0).standard_normal((3, 30, 5)))
    with torch.no_grad():
        weight, mean, scale = network(inputs)
        for share in (0.0, 0.35, 1.0):
            of_share = with_mean_share(network, share)(inputs)
            torch.testing.assert_close(of_share[1], share * mean)
            assert torch.equal(of_share[0], weight)
            assert torch.equal(of_share[2], scale)
        assert torch.equal(network(inputs)[1], mean)
    assert mean.abs().max() > 0.01
