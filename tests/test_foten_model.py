import math

import numpy as np
import pytest
import torch
from foten.architecture import FotenArchitecture, FotenPlusArchitecture
from torch import Tensor
from torch.nn.functional import layer_norm, linear

from conftest import SMALL, reflections_of, untrained
from foten.dsp.lattice import LEAK
from foten.networks import build
from foten.networks.foten_plus import Excitation

ARCHITECTURES = {
    "paper": FotenArchitecture(),
    "post-norm": FotenArchitecture(**SMALL, pre_norm=False),
    "cos-sin": FotenArchitecture(**SMALL, phase_input="cos_sin"),
    "bin-embedding": FotenArchitecture(**SMALL, bin_embedding=True),
    "literal-width": FotenArchitecture(**{**SMALL, "spectral_width": 1}),
    "literal-width-post-norm": FotenArchitecture(**{**SMALL, "spectral_width": 1}, pre_norm=False),
    "window-5": FotenArchitecture(**SMALL, window=5),
    "window-30": FotenArchitecture(**SMALL, window=30),
    "one-layer": FotenArchitecture(**{**SMALL, "n_layers": 1}),
}


class Reference:
    """Eq. 2 to 11 as they are written: all m queries of every layer, the whole complex inverse transform, all tokens.

    It shares nothing with the network but the names of its parameters.
    """

    def __init__(self, network: torch.nn.Module, architecture: FotenArchitecture) -> None:
        self.w = network.state_dict()
        self.architecture = architecture

    def affine(self, name: str, x: Tensor) -> Tensor:
        return linear(x, self.w[f"{name}.weight"], self.w[f"{name}.bias"])

    def norm(self, name: str, x: Tensor) -> Tensor:
        weight = self.w[f"{name}.weight"]
        return layer_norm(x, weight.shape, weight, self.w[f"{name}.bias"], 1e-5)

    def attention(self, name: str, x: Tensor) -> Tensor:
        """Eq. 3 to 5, one head after the other."""
        width = x.shape[-1]
        n_heads = self.architecture.n_heads if width % self.architecture.n_heads == 0 else 1
        query, key, value = self.affine(f"{name}.attention_in", x).split(width, dim=-1)
        heads = []
        for head in range(n_heads):
            part = slice(head * width // n_heads, (head + 1) * width // n_heads)
            scores = query[..., part] @ key[..., part].transpose(1, 2) / math.sqrt(width // n_heads)
            heads.append(torch.softmax(scores, dim=-1) @ value[..., part])
        return self.affine(f"{name}.attention_out", torch.cat(heads, dim=-1))

    def layer(self, name: str, x: Tensor) -> Tensor:
        def feedforward(x: Tensor) -> Tensor:
            return self.affine(
                f"{name}.feedforward_out", torch.relu(self.affine(f"{name}.feedforward_in", x))
            )

        if self.architecture.pre_norm:
            x = x + self.attention(name, self.norm(f"{name}.norm_1", x))
            return x + feedforward(self.norm(f"{name}.norm_2", x))
        x = self.norm(f"{name}.norm_1", x + self.attention(name, x))
        return self.norm(f"{name}.norm_2", x + feedforward(x))

    def temporal(self, a: Tensor) -> Tensor:
        m, d = a.shape[1], self.architecture.d_model
        positions = torch.zeros(m, d, dtype=torch.float64)
        for pos in range(m):
            for i in range(d // 2):
                positions[pos, 2 * i] = math.sin(pos * 10000 ** (-2 * i / d))
                positions[pos, 2 * i + 1] = math.cos(pos * 10000 ** (-2 * i / d))
        x = self.affine("temporal.embedding", a[..., None]) + positions
        for i in range(self.architecture.n_layers):
            x = self.layer(f"temporal.layers.{i}", x)
        return self.norm("temporal.norm", x) if self.architecture.pre_norm else x

    def encode(self, name: str, tokens: Tensor) -> Tensor:
        if self.architecture.spectral_width > 1:
            tokens = self.affine(f"spectral.{name}_in", tokens)
        if self.architecture.bin_embedding:
            tokens = tokens + self.w["spectral.bins"]
        tokens = self.layer(f"spectral.{name}_layer", tokens)
        if self.architecture.spectral_width > 1:
            tokens = self.affine(f"spectral.{name}_out", tokens)
        return tokens[..., 0]

    def spectral(self, a: Tensor) -> Tensor:
        z = torch.fft.fft(a)  # Eq. 6
        magnitude, phase = (
            z.abs(),
            torch.atan2(z.imag + 0.0, z.real),
        )  # Eq. 7; a real bin's angle is 0 or π, not −π
        if self.architecture.phase_input == "cos_sin":
            turned = torch.stack([torch.cos(phase), torch.sin(phase)], dim=-1)
        else:
            turned = phase[..., None]
        encoded = torch.polar(torch.ones_like(phase), self.encode("phase", turned))
        encoded = self.encode("magnitude", magnitude[..., None]) * encoded  # Eq. 8
        return torch.fft.ifft(encoded).real  # Eq. 9

    def __call__(self, windows: Tensor) -> Tensor:
        a = windows[..., 0]
        e_s = self.affine("spectral_embedding", self.spectral(a)[..., None])  # Eq. 10
        fused = torch.cat([self.temporal(a), e_s, windows[..., 1:]], dim=-1)  # Eq. 11
        x = fused[:, -1]
        for name in ("head_1", "head_2"):
            x = torch.relu(self.affine(name, x))
        return self.affine("head_3", x)[:, 0]


def windows(architecture: FotenArchitecture, n: int = 40, seed: int = 0) -> Tensor:
    rng = np.random.default_rng(seed)
    return torch.from_numpy(rng.standard_normal((n, architecture.history, 3)))


@pytest.mark.parametrize("name", ARCHITECTURES)
def test_the_pruned_network_is_the_papers(name: str) -> None:
    """Oracle: an unpruned network of the paper's equations, in float64."""
    architecture = ARCHITECTURES[name]
    network = untrained("foten", architecture).double()
    given = windows(architecture)
    with torch.no_grad():
        found = network(given)
    expected = Reference(network, architecture)(given)
    assert expected.std() > 1e-3  # or there would be nothing to compare
    # Rounding through six layers, and √(|Z|² + 1e-16), which is 5e-17/|Z| off.
    np.testing.assert_allclose(found, expected, atol=1e-10)


def n_parameters(network: torch.nn.Module) -> int:
    return sum(parameter.numel() for parameter in network.parameters())


def test_it_has_the_papers_sizes() -> None:
    def dense(inputs: int, outputs: int) -> int:
        return inputs * outputs + outputs

    layer = (
        4 * dense(32, 32) + dense(32, 128) + dense(128, 32) + 2 * 64
    )  # Eq. 3 to 5, feed-forward, two norms
    temporal = dense(1, 32) + 3 * layer + 64  # embedding, three layers, the last norm
    spectral = 2 * (dense(1, 32) + layer + dense(32, 1)) + dense(1, 32)
    head = dense(2 * 32 + 2, 256) + dense(256, 64) + dense(64, 1)
    found = n_parameters(build("foten", FotenArchitecture()))
    assert found == temporal + spectral + head
    assert found == pytest.approx(97_500, rel=0.005)


def test_positions_and_matrices_are_not_parameters() -> None:
    kept = set(build("foten", FotenArchitecture()).state_dict())
    assert not {name for name in kept if "positions" in name or name.endswith(("real", "imaginary", "sine"))}


@pytest.mark.parametrize("pre_norm", [True, False])
def test_the_literal_width_of_one_is_degenerate(pre_norm: bool) -> None:
    """A layer normalisation over one feature gives its bias, so the encoders add a constant, or are one."""
    architecture = FotenArchitecture(**{**SMALL, "spectral_width": 1}, pre_norm=pre_norm)
    branch = untrained("foten", architecture).double().spectral
    given = torch.from_numpy(np.random.default_rng(0).uniform(0, 9, (30, architecture.window, 1)))
    for name in ("magnitude", "phase"):
        with torch.no_grad():
            left = branch._encode(name, given) - given[..., 0] * pre_norm
        assert left.std() < 1e-12  # rounding
    wide = untrained("foten", FotenArchitecture(**SMALL, pre_norm=pre_norm)).double().spectral
    with torch.no_grad():
        assert (wide._encode("magnitude", given) - given[..., 0] * pre_norm).std() > 1e-3


@pytest.mark.parametrize("name", ["magnitude", "phase"])
def test_the_spectral_encoders_do_not_know_which_bin_is_which(name: str) -> None:
    """Sec. IV-d leaves positions out; a learned vector for each bin brings them back."""
    order = torch.randperm(20, generator=torch.Generator().manual_seed(0))
    tokens = windows(FotenArchitecture())[..., :1]
    for embedded in (False, True):
        architecture = FotenArchitecture(**SMALL, bin_embedding=embedded)
        branch = untrained("foten", architecture).double().spectral
        with torch.no_grad():
            difference = branch._encode(name, tokens[:, order]) - branch._encode(name, tokens)[:, order]
        assert (difference.abs().max() > 1e-3) == embedded
        if not embedded:
            assert difference.abs().max() < 1e-13  # sums in another order: rounding


def test_the_temporal_branch_knows_the_order() -> None:
    branch = untrained("foten").double().temporal
    a = windows(FotenArchitecture())[..., :1]
    swapped = a[:, [1, 0, *range(2, 20)]]
    with torch.no_grad():
        assert (branch(a) - branch(swapped)).abs().max() > 1e-3


def test_only_the_last_speed_and_force_are_heard() -> None:
    network = untrained("foten").double()
    given = windows(FotenArchitecture())
    before, last = given.clone(), given.clone()
    before[:, :-1, 1:] += 5.0
    last[:, -1, 1:] += 5.0
    with torch.no_grad():
        torch.testing.assert_close(network(before), network(given), rtol=0, atol=0)
        assert (network(last) - network(given)).abs().min() > 0


def test_a_prediction_of_foten_plus_takes_no_more_than_its_history() -> None:
    """Innovations that the network sees need the lattice's order before them, and a level the sample before that."""
    network = untrained("foten-plus", FotenPlusArchitecture(**SMALL, window=5, order=4)).double()
    m = network.architecture.history
    longer = torch.from_numpy(np.random.default_rng(0).standard_normal((30, m + 3, 3)))
    changed = longer.clone()
    changed[:, :3] += 1.0
    first = longer.clone()
    first[:, 3, 1:] += 1.0
    with torch.no_grad():
        torch.testing.assert_close(network(changed), network(longer), rtol=1e-9, atol=1e-9)
        torch.testing.assert_close(network(longer[:, 3:]), network(longer), rtol=1e-9, atol=1e-9)
        assert (network(first) - network(longer)).abs().max() > 1e-8  # rounding is 1e-14 of 30


@pytest.mark.parametrize("key", ["foten", "foten-plus"])
@pytest.mark.parametrize(
    "fields", [{}, {"phase_input": "cos_sin"}, {"pre_norm": False}, {"spectral_width": 1}]
)
def test_silence_has_finite_gradients(key: str, fields: dict[str, object]) -> None:
    """|Z| = 0 is where √ has no derivative and the angle none either."""
    kind = FotenArchitecture if key == "foten" else FotenPlusArchitecture
    network = untrained(key, kind(**fields)).train()
    network(torch.zeros(4, network.architecture.history, 3)).sum().backward()
    gradients = [p.grad for p in network.parameters() if p.requires_grad]
    assert all(gradient is not None and torch.isfinite(gradient).all() for gradient in gradients)
    assert any(gradient.abs().max() > 0 for gradient in gradients if gradient is not None)


def test_foten_plus_starts_as_its_lattice() -> None:
    """Oracle: the direct form of an AR(2)."""
    torch.manual_seed(0)
    network = build("foten-plus", FotenPlusArchitecture(order=2)).double().eval()
    network.lattice.reflections[:, :2] = reflections_of(np.array([-0.9, 1.6]))
    with torch.no_grad():
        network.lattice.level.out.weight.zero_()
        network.lattice.level.out.bias.zero_()
        network.lattice.level.power_law.weight.zero_()
    given = windows(network.architecture)
    with torch.no_grad():
        found = network(given).numpy()
    expected = given[:, -2:, 0].numpy() @ (np.array([-0.9, 1.6]) * LEAK ** np.array([2, 1]))
    np.testing.assert_allclose(found, expected, atol=1e-6)  # reflections from float32 numbers


def test_the_correction_is_bounded_in_innovations() -> None:
    network = untrained("foten-plus").double()
    given = windows(network.architecture, 200)
    with torch.no_grad():
        before = network.network.head_3.weight.clone()
        network.network.head_3.weight.zero_()
        network.network.head_3.bias.zero_()
        linear, _ = network.forecast(network.start(given))
        network.network.head_3.weight.copy_(1e3 * before)
        sample, scale = network.forecast(network.start(given))
        share = (sample - linear) * network.excitation(given[:, -1, 1:]) / scale
    limit = FotenPlusArchitecture().correction_limit
    assert share.abs().max() <= limit * (1 + 1e-9)  # tanh; rounding of the difference
    assert share.abs().max() > 0.99 * limit


def test_the_network_sees_a_vibration_of_unit_size_whatever_the_level() -> None:
    """Twice the level and twice the vibration: twice the prediction."""
    network = untrained("foten-plus").double()
    given = windows(network.architecture)
    doubled = given.clone()
    doubled[..., 0] *= 2
    with torch.no_grad():
        expected = 2 * network(given)
        network.lattice.level.out.bias += math.log(2)
        np.testing.assert_allclose(network(doubled), expected, rtol=1e-9)  # rounding


def test_the_excitation_is_a_power_law_where_its_network_is_silent() -> None:
    sigma = Excitation(4).double()
    speed, force = np.array([0.0, 10.0, 100.0, 300.0]), np.array([0.0, 0.1, 1.0, 4.0])
    with torch.no_grad():
        sigma.mean.copy_(torch.tensor([100.0, 1.0]))
        sigma.sd.copy_(torch.tensor([60.0, 0.5]))
        sigma.out.weight.zero_()
        sigma.out.bias.zero_()
        sigma.power_law.weight.copy_(torch.tensor([[0.7, 0.4, 0.0, 0.0, 0.0]]))
        scaled = torch.from_numpy(np.stack([(speed - 100) / 60, (force - 1) / 0.5], axis=1))
        expected = ((speed + 2) / 102) ** 0.7 * ((force + 0.05) / 1.05) ** 0.4
        # Exponents and floors come from float32.
        np.testing.assert_allclose(sigma(scaled), expected, rtol=1e-6)


def test_speed_and_force_below_zero_count_as_rest() -> None:
    sigma = Excitation(4).double()
    with torch.no_grad():
        sigma.mean.copy_(torch.tensor([100.0, 1.0]))
        sigma.sd.copy_(torch.tensor([60.0, 0.5]))
        assert torch.isfinite(sigma(torch.full((3, 2), -50.0, dtype=torch.float64))).all()
