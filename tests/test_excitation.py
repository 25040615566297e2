"""The excitation that training fits: a scale, tails and bounds that are known are recovered; PyTorch's scale beside NumPy's."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from foten.training.scale import Excitation, Scale
from scipy.stats import norm

from conftest import untrained_tensors
from foten.dsp.noise import heavy_tailed
from foten.models.conditions import FADE_SPEED
from foten.models.excitation import HEAVIEST_TAIL
from foten.models.excitation import Excitation as ReferenceExcitation
from foten.models.excitation import Scale as ReferenceScale
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.recording.scaling import Scaling
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.training.blocks import ScaledBlocks
from foten.training.calibration import (
    ClosedLoop,
    FittedExcitation,
    _likelihood_of,
    fit_excitation,
    fit_scale,
    fit_tail,
    gaussianised,
)
from foten.training.config import TrainConfig
from foten.training.texture_builder import tensors_of
from foten.training.window_fit import TrainingWindows
from test_closed_loop_training import loop_of


def windows_under(speed: np.ndarray, force: np.ndarray, scaling: Scaling, n_train: int) -> TrainingWindows:
    """Return windows of one sample under a hand; the first `n_train` are for training."""
    samples = scaling.scale(np.stack([np.zeros(len(speed)), speed, force], axis=1))
    n = np.arange(1, len(speed))
    return TrainingWindows(samples, n[:n_train], n[n_train:], 1)


def conditions(windows: TrainingWindows) -> torch.Tensor:
    """Return the speed and force that go with each residual."""
    return torch.from_numpy(windows.samples[:-1, 1:]).float()


def test_a_power_law_is_recovered() -> None:
    rng = np.random.default_rng(2)
    n = 40_000
    speed, force = rng.uniform(5, 300, n), rng.uniform(0.2, 4, n)
    scaling = Scaling((0.0, speed.mean(), force.mean()), (1.0, speed.std(), force.std()))
    windows = windows_under(speed, force, scaling, n - 5001)
    true = (0.3 * (speed / 100) ** 0.8 * force**0.4)[:-1]
    excitation = Excitation(16)
    nll = fit_scale(excitation, windows, scaling, true * rng.standard_normal(n - 1), seed=0)
    with torch.no_grad():
        sigma = excitation(conditions(windows)).numpy()
    # 40 000 residuals estimate a scale within 1/√(2·40000) = 0.4 %; a flexible σ costs some of it.
    assert np.abs(np.log(sigma / true)).mean() < 0.04
    entropy = float(np.log(true[-5000:]).mean()) + 0.5 * math.log(2 * math.pi * math.e)
    assert nll == pytest.approx(entropy, abs=0.03)  # 5000 validation residuals: 1/√(2·5000) = 0.014


def test_no_shape_is_kept_that_validation_contradicts() -> None:
    """Loud where speed is high in training, and the other way round in validation: one scale for all."""
    rng = np.random.default_rng(5)
    n = 4000
    speed = rng.uniform(50, 150, n)
    scaling = Scaling((0.0, 100.0, 1.0), (1.0, 30.0, 1.0))
    windows = windows_under(speed, np.ones(n), scaling, 1999)
    slope = np.where(np.arange(1, n) < 2000, 1.0, -1.0)
    residual = np.exp(slope * (speed[:-1] - 100) / 50) * rng.standard_normal(n - 1)
    excitation = Excitation(16)
    fit_scale(excitation, windows, scaling, residual, seed=0)
    with torch.no_grad():
        sigma = excitation(conditions(windows))
    assert float(sigma.max() / sigma.min()) == pytest.approx(1.0, abs=1e-5)


def test_tails_that_follow_speed_are_recovered() -> None:
    rng = np.random.default_rng(7)
    n = 60_000
    speed, force = np.exp(rng.uniform(np.log(10), np.log(300), n)), rng.uniform(0.5, 2, n)
    scaling = Scaling((0.0, 100.0, 1.0), (1.0, 60.0, 0.5))
    windows = windows_under(speed, force, scaling, n - 10_001)
    h = np.where(speed < 60, 0.25, 0.1)[:-1]
    residual = 0.7 * heavy_tailed(rng.standard_normal(n - 1), h, np.inf)
    excitation = Excitation(16)
    fit_scale(excitation, windows, scaling, residual, seed=0)
    gained = fit_tail(excitation, windows, residual)
    # What a Gaussian of the right variance loses: integrated for these two tails, 0.15 and 0.03 nat at 35 and 65 %.
    assert gained > 0.03
    with torch.no_grad():
        tails, scale = (part(conditions(windows)).numpy() for part in (excitation.tails, excitation))
    # A quadratic in log speed for a step: it is nearest in the middle of each side.
    slow, fast = (speed[:-1] > 15) & (speed[:-1] < 35), (speed[:-1] > 100) & (speed[:-1] < 250)
    assert tails[slow].mean() == pytest.approx(0.25, abs=0.04)
    assert tails[fast].mean() == pytest.approx(0.10, abs=0.03)
    assert scale[fast].mean() == pytest.approx(0.7, rel=0.1)


def test_gaussian_residuals_get_no_tails() -> None:
    rng = np.random.default_rng(8)
    n = 20_000
    samples = rng.standard_normal((n, 3))
    scaling = Scaling((0.0, 100.0, 1.0), (1.0, 30.0, 0.2))
    residual = rng.standard_normal(n - 1)
    windows = TrainingWindows(samples, np.arange(1, n - 5000), np.arange(n - 5000, n), 1)
    excitation = Excitation(16)
    fit_scale(excitation, windows, scaling, residual, seed=0)
    fit_tail(excitation, windows, residual)
    with torch.no_grad():
        assert float(excitation.tails(conditions(windows)).max()) < 0.02


def test_a_heavy_tailed_number_is_taken_back_to_its_gaussian() -> None:
    z = torch.linspace(-5.6, 5.6, 401, dtype=torch.float64)
    for h in (0.0, 1e-9, 0.05, 0.4):
        u = z * torch.exp(0.5 * h * z**2)
        np.testing.assert_allclose(gaussianised(u, torch.full_like(u, h)), z.abs(), atol=1e-9)
    u = torch.tensor([0.3, 2.0, 40.0], dtype=torch.float64)
    h = torch.full((3,), 0.2, dtype=torch.float64, requires_grad=True)
    (slope,) = torch.autograd.grad(gaussianised(u, h).sum(), h)
    step = (gaussianised(u, h + 1e-6) - gaussianised(u, h - 1e-6)).detach() / 2e-6
    np.testing.assert_allclose(slope, step, rtol=1e-5)


def innovations_of(loop: ClosedLoop, excitation: Excitation, heavy: bool = False) -> tuple[np.ndarray, TrainingWindows]:
    """Return innovations as the excitation makes them, and the windows that they are missed from."""
    rng = np.random.default_rng(4)
    windows = TrainingWindows(loop.blocks.flat, *loop.blocks.targets(loop.history), loop.history)
    both = np.concatenate([windows.train, windows.validation])
    with torch.no_grad():
        sigma = excitation(torch.from_numpy(windows.samples[both - 1, 1:]).float()).double().numpy()
    z = rng.standard_normal(len(both))
    return sigma * (z**3 if heavy else z), windows


def fit(loop: ClosedLoop, innovations: np.ndarray, windows: TrainingWindows) -> FittedExcitation:
    made = fit_excitation(16, innovations, windows, loop, TrainConfig())
    assert made is not None
    return made


def test_the_closed_loop_has_the_last_word_on_the_level() -> None:
    """Innovations half as large as those that the recording was made of: by likelihood alone it would be 6 dB too soft."""
    loop, excitation = loop_of()
    innovations, windows = innovations_of(loop, excitation)
    fitted = fit(loop, 0.5 * innovations, windows)
    assert fitted.level_errors_db[0] == pytest.approx(-6.02, abs=1.0)
    assert abs(fitted.level_errors_db[-1]) < 0.5
    recorded, runs = loop.free_runs(fitted.excitation, loop.blocks.known, 9, 77, 4)
    # Four runs of 16 s, 16 Hz wide: known to 0.15 dB, the recording to 0.3.
    assert 10 * math.log10(np.square(runs).mean() / np.square(recorded).mean()) == pytest.approx(0, abs=0.8)


def test_no_excitation_is_larger_than_what_was_left_to_explain() -> None:
    """In the unit of the excitation and in acceleration, whichever is less; the reference draws none that is."""
    loop, excitation = loop_of()
    innovations, windows = innovations_of(loop, excitation, heavy=True)
    fitted = fit(loop, innovations, windows).excitation
    in_sigma, in_acceleration = fitted.largest.tolist()
    n_train = len(windows.train)
    assert in_acceleration == pytest.approx(np.abs(innovations[:n_train]).max(), rel=1e-6)
    assert 5 < in_sigma < 100
    reference = ReferenceExcitation(tensors_of(fitted, "excitation."))
    condition = np.array([[-1.0, 0.0], [1.0, 0.0]])
    for unit in (0.05, 10.0):
        prediction = reference.added_to(np.zeros(2), np.full(2, unit), condition)
        for z in (5.6, -5.6):
            limit = np.minimum(in_sigma * prediction.scale, in_acceleration)
            shocks = prediction.excited(np.full(2, z))
            assert (np.abs(shocks) <= limit * (1 + 1e-9)).all()
    assert np.abs(shocks) == pytest.approx([in_acceleration] * 2)


def test_the_same_seed_gives_the_same_excitation() -> None:
    loop, excitation = loop_of()
    innovations, windows = innovations_of(loop, excitation, heavy=True)
    states = []
    for k in range(2):
        torch.manual_seed(k)  # whatever was drawn before
        states.append(fit(loop, innovations, windows).excitation.state_dict())
    for name, tensor in states[0].items():
        assert torch.equal(tensor, states[1][name]), name


@pytest.mark.parametrize("allowed", [True, False])
def test_a_spiky_recording_gets_volatility_where_it_may(allowed: bool) -> None:
    """A quarter of each block is eight times louder, whatever the hand does there: a kurtosis of 12 in place of 3."""
    loop, excitation = loop_of()
    innovations, windows = innovations_of(loop, excitation)
    samples = loop.blocks.samples.copy()
    samples[:, -samples.shape[1] // 4 :, 0] *= 8
    spiky = replace(loop, blocks=replace(loop.blocks, samples=samples))
    fitted = fit_excitation(16, innovations, windows, spiky, replace(TrainConfig(), volatility=allowed))
    assert fitted is not None
    assert (float(fitted.excitation.volatility[1]) > 0.3) == allowed


def test_the_likelihood_is_that_of_the_validation_blocks_where_the_hand_moves() -> None:
    """Oracle: SciPy's normal density, of Gaussian innovations with a unit of 0.5 and σ = 2, rest left out."""
    rng = np.random.default_rng(0)
    n, block = 4000, 1000
    speed = np.where(np.arange(n) % 1000 < 600, 50.0, 0.5 * FADE_SPEED)
    trace = Trace(np.zeros(n), speed, np.ones(n), 1000.0, block)
    scaling = Scaling((0.0, 50.0, 1.0), (1.0, 20.0, 0.5))
    samples = scaling.scale(trace.stacked()).reshape(4, block, 3)
    split = Split((0, 1), (2,), (3,), 4, block, "contiguous", 0)
    blocks = ScaledBlocks(trace, split, scaling, samples)
    windows = TrainingWindows(blocks.flat, *blocks.targets(10), 10, None, np.full(n, 0.5))
    excitation = Excitation(2).requires_grad_(False)
    excitation.out.weight.zero_()
    excitation.power_law.weight.zero_()
    excitation.out.bias.fill_(math.log(2))
    innovations = rng.standard_normal(len(windows.train) + len(windows.validation))
    loop = ClosedLoop(blocks, 10, None, None)  # type: ignore[arg-type]
    counted = innovations[len(windows.train) :][speed[windows.validation] >= FADE_SPEED]
    expected = -norm.logpdf(0.5 * counted, scale=0.5 * 2).mean()
    of_innovations = -norm.logpdf(innovations[len(windows.train) :], scale=2.0).mean()
    likelihoods = _likelihood_of(excitation, innovations, windows, loop)
    assert likelihoods == pytest.approx((expected, of_innovations), rel=1e-6)


def excitation() -> Excitation:
    """Return one of 100 mm/s and 1 N on the mean, whose network is silent."""
    sigma = Excitation(4).requires_grad_(False)
    sigma.mean.copy_(torch.tensor([100.0, 1.0]))
    sigma.sd.copy_(torch.tensor([60.0, 0.5]))
    sigma.out.weight.zero_()
    sigma.out.bias.zero_()
    sigma.power_law.weight.zero_()
    return sigma


def both(sigma: Excitation, condition: np.ndarray) -> list[np.ndarray]:
    """Return what PyTorch and NumPy make of it, in float64."""
    tensors = tensors_of(sigma)
    return [sigma.double()(torch.from_numpy(condition)).numpy(), ReferenceScale(tensors, "")(condition)]


def test_it_is_a_power_law_where_its_network_is_silent() -> None:
    speed, force = np.array([0.0, 10.0, 100.0, 300.0]), np.array([0.0, 0.1, 1.0, 4.0])
    sigma = excitation()
    sigma.power_law.weight.copy_(torch.tensor([[0.7, 0.4, 0.0, 0.0, 0.0]]))
    scaled = np.stack([(speed - 100) / 60, (force - 1) / 0.5], axis=1)
    expected = ((speed + 2) / 102) ** 0.7 * ((force + 0.05) / 1.05) ** 0.4
    for values in both(sigma, scaled):
        np.testing.assert_allclose(values, expected, rtol=1e-6)  # exponents and floors come from float32


def test_speed_and_force_below_zero_count_as_zero() -> None:
    sigma = excitation()
    sigma.power_law.weight.copy_(torch.tensor([[0.7, 0.4, 0.1, 0.1, 0.1]]))
    below, zero = np.full((3, 2), -50.0), np.tile([[-100 / 60, -2.0]], (3, 1))
    for one, other in zip(both(sigma, below), both(sigma, zero), strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_allclose(one, other, rtol=1e-6)


def test_it_nowhere_exceeds_the_97th_percentile_of_where_it_was_trained() -> None:
    sigma = excitation()
    sigma.power_law.weight.copy_(torch.tensor([[1.0, 0.0, 0.0, 0.0, 0.0]]))
    within = torch.linspace(-1.5, 2.0, 1001)[:, None].repeat(1, 2)
    expected = float(torch.quantile(sigma(within), 0.97))
    sigma.highest.fill_(1e-3)  # of an earlier fit
    sigma.bound(within)
    assert float(sigma.highest) == pytest.approx(expected, rel=1e-6)
    for values in both(sigma, np.array([[3.0, 0.0], [50.0, 0.0]])):
        np.testing.assert_allclose(values, expected, rtol=1e-6)


def test_scales_and_tails_in_numpy_are_those_that_were_fitted() -> None:
    sizes = FotenPlusSizes(excitation_width=7)
    tensors = untrained_tensors("foten-plus", sizes, torch.nn.Module())
    condition = np.random.default_rng(0).standard_normal((200, 2)) * [2.0, 2.0]
    for prefix, kind in (("excitation.", Excitation), ("lattice.level.", Scale)):
        module = kind(7)
        module.load_state_dict({n: torch.from_numpy(tensors[prefix + n]) for n in module.state_dict()})
        with torch.no_grad():
            expected = module.double()(torch.from_numpy(condition)).numpy()
        np.testing.assert_allclose(ReferenceScale(tensors, prefix)(condition), expected, rtol=1e-12)
    sigma = Excitation(7)
    sigma.load_state_dict({n: torch.from_numpy(tensors[f"excitation.{n}"]) for n in sigma.state_dict()})
    sigma.tail.bias.data.fill_(0.3)
    tensors["excitation.tail.bias"] = np.array([0.3], dtype=np.float32)
    with torch.no_grad():
        tails = sigma.double().tails(torch.from_numpy(condition)).numpy()
    np.testing.assert_allclose(ReferenceExcitation(tensors).tail(condition), tails, rtol=1e-12)
    assert 0 <= tails.min() < tails.max() <= HEAVIEST_TAIL
