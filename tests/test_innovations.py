"""The innovation network: mixtures by their definition, the unit as PyTorch's, and what training makes of known processes."""

from __future__ import annotations

import ctypes
import dataclasses
import math
import re
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.integrate import quad
from scipy.special import log_ndtr, ndtri_exp
from scipy.stats import norm

from conftest import PLUS, exported, untrained
from foten.models.excitation import Scale
from foten.models.foten_plus.innovation_network import InnovationNetwork as Reference
from foten.models.foten_plus.innovation_network import Mixture, innovation_inputs
from foten.models.foten_plus.likelihood import (
    CHUNK,
    Innovations,
    _chunks,
    asymmetry,
    fit_innovations,
    innovations_of,
    validated,
)
from foten.models.foten_plus.network import InnovationNetwork, NextInnovation, negative_log_likelihood
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.training import training_kernel as kernel
from foten.training.blocks import ScaledBlocks, scaled_blocks
from foten.training.config import OWN_RECIPES, TrainConfig
from foten.training.loop import Epoch
from foten.training.texture_builder import tensors_of

SIZES = FotenPlusSizes(**PLUS)
C_SOURCE = Path(__file__).parents[1] / "native/training/training_kernel.c"
CONFIG = TrainConfig(**{**OWN_RECIPES["foten-plus"], "epochs": 2, "threads": 1, "batch": 32})


def mixtures(n: int, k: int = 4, seed: int = 0) -> Mixture:
    """Return n mixtures: near, far, sharp and wide components."""
    rng = np.random.default_rng(seed)
    weight = rng.dirichlet(np.full(k, 0.5), n) + 1e-9
    scale = np.exp(rng.uniform(-5, 2, (n, k)))
    return Mixture(weight / weight.sum(axis=1, keepdims=True), 3 * rng.standard_normal((n, k)), scale)


def standardised(mixture: Mixture, values: np.ndarray) -> np.ndarray:
    """Return the z of which values are the quantiles at Φ(z), by SciPy."""
    logs = np.log(mixture.weight)
    below, above = (
        np.logaddexp.reduce(logs + log_ndtr(sign * (values[:, None] - mixture.mean) / mixture.scale), axis=1)
        for sign in (1, -1)
    )
    return np.where(below < above, 1, -1) * ndtri_exp(np.minimum(below, above))


@pytest.mark.parametrize("of", ["portable", kernel.isa()])
@pytest.mark.parametrize(("n_inputs", "n_hidden", "s"), [(5, 48, 7), (9, 6, 1), (5, 17, 64)])
def test_hidden_states_and_gradients_are_pytorch_s(
    n_inputs: int, n_hidden: int, s: int, of: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of its own unit, in every instruction set, whatever rows are padded to: to what float32 leaves of 40 samples."""
    monkeypatch.setattr(kernel, "_function", lambda name: getattr(kernel.training_library(), f"{name}_{of}"))
    torch.manual_seed(3)
    unit = torch.nn.GRU(n_inputs, n_hidden, batch_first=True)
    inputs, weight = 2 * torch.randn(s, 40, n_inputs), torch.randn(s, 40, n_hidden)
    (theirs, _), ours = unit(inputs), kernel.hidden_states(unit, inputs)
    torch.testing.assert_close(ours, theirs, atol=1e-5, rtol=0)
    expected, gradients = (torch.autograd.grad((one * weight).sum(), list(unit.parameters())) for one in (theirs, ours))
    for one, other in zip(gradients, expected, strict=True):
        torch.testing.assert_close(one, other, atol=1e-4 * float(other.abs().max()), rtol=0)


def test_hidden_states_in_double_are_pytorch_s_own() -> None:
    unit = torch.nn.GRU(5, 6, batch_first=True).double()
    inputs = torch.randn(2, 9, 5, dtype=torch.float64)
    assert torch.equal(kernel.hidden_states(unit, inputs), unit(inputs)[0])


@pytest.mark.parametrize(
    ("name", "structure"),
    [
        ("recurrent_unit", kernel.RecurrentUnit),
        ("roll_out", kernel.RolloutBatch),
        ("roll_out_gradients", kernel.RolloutGradients),
    ],
)
def test_structures_are_laid_out_as_in_c(name: str, structure: type[ctypes.Structure]) -> None:
    """By their source: each member by name, in its place, as number or as array."""
    source = re.sub(r"/\*.*?\*/", "", C_SOURCE.read_text(encoding="utf-8"), flags=re.S)
    (body,) = re.findall(r"typedef struct \{([^}]*)\} " + name + ";", source)
    kinds = {"int": ctypes.c_int, "float": ctypes.c_float, "double": ctypes.c_double}
    members, doubles = [], []
    for declared in filter(None, (line.strip() for line in body.split(";"))):
        kind, names = re.fullmatch(r"(?:const )?(int|float|double) (.*)", declared, re.S).groups()  # type: ignore[union-attr]
        for member in (one.strip() for one in names.split(",")):
            members.append((member.lstrip("*"), ctypes.c_void_p if member[0] == "*" else kinds[kind]))
            doubles += [member[1:]] if kind == "double" and member[0] == "*" else []
    assert structure._fields_ == members
    assert set(doubles) <= set(kernel._DOUBLES)
    assert not {array for array, of in members if of is ctypes.c_void_p and array not in doubles} & set(kernel._DOUBLES)
    assert f"GATES = {kernel.GATES} " in source


def test_a_quantile_has_as_much_below_it_as_a_normal_number() -> None:
    """By the definition of each: Σ w Φ((x − μ)/s) = Φ(z), and far in the upper tail by what is above."""
    z = np.array([-5.6, -3.0, -1.0, 0.0, 0.3, 2.0, 5.6])
    for row in range(40):
        one = Mixture(*(np.repeat(part[row : row + 1], len(z), axis=0) for part in dataclasses.astuple(mixtures(40))))
        x = one.quantile(z)
        below, above = (
            (one.weight * norm.cdf(sign * (x[:, None] - one.mean) / one.scale)).sum(axis=1) for sign in (1, -1)
        )
        np.testing.assert_allclose(np.where(z < 0, below, above), norm.cdf(-np.abs(z)), rtol=1e-9)
        assert (np.diff(x) > 0).all()
        np.testing.assert_allclose(standardised(one, x), z, atol=1e-7)


def test_one_component_is_a_normal_distribution() -> None:
    one = Mixture(np.ones((3, 1)), np.array([[0.0], [2.0], [-1.0]]), np.array([[1.0], [0.1], [30.0]]))
    z = np.array([1.3, -2.0, 5.0])
    np.testing.assert_allclose(one.quantile(z), one.mean[:, 0] + one.scale[:, 0] * z, rtol=1e-12)
    np.testing.assert_allclose(one.log_density(one.quantile(z)), norm.logpdf(z) - np.log(one.scale[:, 0]))


def test_mean_and_spread_are_those_of_the_density() -> None:
    """Oracle: quadrature of exp(log_density)."""
    one = Mixture(np.array([[0.7, 0.3]]), np.array([[-0.5, 2.0]]), np.array([[0.4, 1.5]]))

    def moment(power: int, about: float = 0.0) -> float:
        return quad(lambda x: (x - about) ** power * math.exp(one.log_density(np.array([x]))[0]), -20, 20, limit=400)[0]

    assert moment(0) == pytest.approx(1.0)
    assert one.expected()[0] == pytest.approx(moment(1))
    assert one.sd()[0] == pytest.approx(math.sqrt(moment(2, moment(1))))


def test_the_unit_and_its_head_are_pytorchs() -> None:
    """Seam: PyTorch in float64 on the same tensors, sample by sample, and as a graph would be asked."""
    network = untrained("foten-plus", SIZES).double()
    rng = np.random.default_rng(0)
    inputs = 2 * rng.standard_normal((3, 30, 5))
    reference, hidden = Reference(tensors_of(network), ""), np.zeros((3, SIZES.n_hidden))
    with torch.no_grad():
        expected = [part.numpy() for part in network(torch.from_numpy(inputs))]
        last = NextInnovation(network)(torch.from_numpy(inputs)).numpy()
    innovation = rng.standard_normal((3, 30))
    nll = negative_log_likelihood([torch.from_numpy(one) for one in expected], torch.from_numpy(innovation)).numpy()  # type: ignore[arg-type]
    for i in range(30):
        hidden = reference.push(hidden, inputs[:, i])
        mixture = reference.mixture(hidden, inputs[:, i])
        for ours, theirs in zip((np.log(mixture.weight), mixture.mean, np.log(mixture.scale)), expected, strict=True):
            np.testing.assert_allclose(ours, theirs[:, i], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(-mixture.log_density(innovation[:, i]), nll[:, i], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(last, np.concatenate([part[:, -1] for part in expected], axis=1), atol=1e-12)


def test_untrained_it_expects_nothing() -> None:
    torch.manual_seed(0)
    network = InnovationNetwork(SIZES)
    assert not network.expected(torch.randn(4, 20, 5)).any()


def process(kind: str, n_blocks: int = 24, block: int = 1000) -> tuple[ScaledBlocks, Innovations]:
    """Return unit innovations of a known kind as what a network is fitted to, under a steady hand."""
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
    mirrored = asymmetry(z[:16]) < 4.0
    return blocks, Innovations(inputs, z, np.ones_like(z), speed.reshape(z.shape), 20, mirrored)


def fitted(kind: str) -> tuple[float, InnovationNetwork]:
    """Return the validation likelihood [nat] of a network that was fitted to such innovations, and the network."""
    blocks, data = process(kind)
    torch.manual_seed(0)
    network = InnovationNetwork(FotenPlusSizes(n_hidden=16, head_width=16, window=20))
    progress = fit_innovations([network], [data], blocks, 20, CONFIG)
    return progress.best_loss, network


def test_of_noise_nothing_is_learned_and_of_bursts_when_they_are() -> None:
    """Gaussian noise has ½ log 2πe; bursts that are known have their own share of it, and 20 samples hide little."""
    gaussian = 0.5 * math.log(2 * math.pi * math.e)
    assert fitted("noise")[0] == pytest.approx(gaussian, abs=0.03)
    known = gaussian + 0.8 * math.log(0.1) - 0.5 * math.log(0.2 + 0.8 * 0.01)
    likelihood = fitted("bursts")[0]
    assert known - 0.02 < likelihood < known + 0.25  # the first samples of each burst come unannounced
    # Independent draws of the right kurtosis, all that an excitation without memory can be.
    mixed = Mixture(np.array([[0.2, 0.8]]), np.zeros((1, 2)), np.array([[1.0, 0.1]]) / math.sqrt(0.208))
    x = process("bursts")[1].innovation[16:20].ravel()
    unaware = -float(Mixture(*(np.repeat(p, x.size, axis=0) for p in dataclasses.astuple(mixed))).log_density(x).mean())
    assert likelihood < unaware - 0.15


def test_each_of_two_networks_is_kept_at_its_own_best() -> None:
    """Of noise, every step of which is one away from it, and of bursts, which take all of them."""
    blocks, noise = process("noise")
    _, bursts = process("bursts")
    torch.manual_seed(0)
    networks = [InnovationNetwork(FotenPlusSizes(n_hidden=16, head_width=16, window=20)) for _ in range(2)]
    config = dataclasses.replace(CONFIG, epochs=3)
    lines: list[Epoch] = []
    progress = fit_innovations(networks, [noise, bursts], blocks, 20, config, lines.append)
    scores = [
        validated(network, of, of.tensors(torch.device("cpu")), blocks.split.validation, 20)
        for network, of in zip(networks, (noise, bursts), strict=True)
    ]
    assert sum(loss for loss, _ in scores) == pytest.approx(progress.best_loss)
    assert scores[0][1] == pytest.approx(progress.best.validation_mae)
    losses = [line.validation_loss for line in lines]
    assert losses == sorted(losses, reverse=True)


def test_more_threads_than_a_batch_has_shares_for_learn_the_same() -> None:
    """Ten chunks for eight threads are five shares of two; sums of other shares differ by rounding, which 100 steps amplify."""
    blocks, data = process("bursts")
    losses = []
    for n_threads in (1, 8):
        torch.manual_seed(0)
        network = InnovationNetwork(FotenPlusSizes(n_hidden=16, head_width=16, window=20))
        config = dataclasses.replace(CONFIG, epochs=1, batch=10, threads=n_threads)
        losses.append(fit_innovations([network], [data], blocks, 20, config).epochs[1].train_loss)
    assert losses[1] == pytest.approx(losses[0], rel=1e-3)


def test_only_the_training_blocks_are_learned_from() -> None:
    """Those of validation are ten times as large here: whoever learned from them would have a loss of 3.7 nat."""
    blocks, data = process("bursts")
    louder = data.innovation.copy()
    louder[16:20] *= 10
    lines: list[Epoch] = []
    torch.manual_seed(0)
    network = InnovationNetwork(FotenPlusSizes(n_hidden=16, head_width=16, window=20))
    fit_innovations([network], [dataclasses.replace(data, innovation=louder)], blocks, 20, CONFIG, lines.append)
    assert lines[-1].train_loss < 1.5


@pytest.mark.parametrize(("kind", "mirrored"), [("noise", True), ("skewed", False)])
def test_what_a_network_is_fitted_to_is_mirrored_where_it_may_be(kind: str, mirrored: bool) -> None:
    blocks, data = process(kind)
    level = Scale(exported("foten-plus", SIZES).tensors, "lattice.level.")
    given = blocks, level, data.innovation, data.innovation, data.unit, 20
    assert innovations_of(*given, True).mirrored == mirrored
    assert not innovations_of(*given, False).mirrored
    made = innovations_of(*given, True)
    np.testing.assert_allclose(made.inputs[..., :3], data.inputs[..., :3])
    logs = level.logarithms(blocks.samples[..., 1:].reshape(-1, 2)).reshape(made.inputs[..., 3:].shape)
    np.testing.assert_allclose(made.inputs[..., 3:], logs)


def test_only_what_has_no_sign_is_mirrored() -> None:
    assert process("noise")[1].mirrored
    assert process("bursts")[1].mirrored
    assert not process("skewed")[1].mirrored


def test_slow_chunks_are_drawn_more_often() -> None:
    """By 1 / (speed + 25 mm/s): from 20 to 140 mm/s over the training blocks, 3.7 to 1."""
    blocks, data = process("noise")
    where = _chunks(data, blocks.split.train, 20)
    block, sample = where.draw(20_000, np.random.default_rng(0))
    assert sample.shape == (20_000, 20 + CHUNK)
    assert sample.max() < 1000 - 21  # rows of inputs and of what follows each
    first, last = (np.mean(block[:, 0] == number) for number in (0, 15))
    speed = data.speed.mean(axis=1)
    assert first / last == pytest.approx((speed[15] + 25) / (speed[0] + 25), rel=0.1)


def test_a_resumed_training_is_the_uninterrupted_one(tmp_path: object) -> None:
    blocks, data = process("bursts")
    runs = []
    for stop in (False, True):
        torch.manual_seed(0)
        network = InnovationNetwork(SIZES)
        checkpoint = tmp_path / f"{stop}.pt"  # type: ignore[operator]

        def interrupt(line: object, stop: bool = stop) -> None:
            if stop and line.epoch == 2:  # type: ignore[attr-defined]
                raise KeyboardInterrupt

        fit_innovations([network], [data], blocks, 20, CONFIG, interrupt, checkpoint)
        if stop:
            torch.manual_seed(1)
            network = InnovationNetwork(SIZES)
            fit_innovations([network], [data], blocks, 20, CONFIG, checkpoint=checkpoint, resume=True)
        runs.append(network.state_dict())
    for name, tensor in runs[0].items():
        assert torch.equal(tensor, runs[1][name]), name
