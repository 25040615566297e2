"""The excitation of foten-plus: σ(speed, force) by maximum likelihood, its level settled in the closed loop."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.signal import fftconvolve, lfilter

from foten.architecture import HEAVIEST_TAIL
from foten.dsp.distance import log_spectral_distance, scored_bins, segment_length, welch
from foten.dsp.lattice import polynomial
from foten.dsp.level import frame_levels, frame_means
from foten.dsp.noise import gaussian
from foten.models.excited import Excited
from foten.models.foten_plus import Excitation, FotenPlus, Scale
from foten.recording.scaling import Scaling
from foten.render.closed_loop import ClosedLoop
from foten.render.engine import NumpyFotenPlus
from foten.render.excitation import Excitation as NumpyExcitation
from foten.render.forecast import State
from foten.render.synthesizer import FADE_FORCE, FADE_SPEED
from foten.render.window_state import begun
from foten.train.card import saturation_of
from foten.train.config import TrainConfig
from foten.train.fit import Data
from foten.train.prepared import Prepared

Array = NDArray[np.float64]

N_SETTLING = 3
SWELLS_S = (0.005, 0.01, 0.02, 0.05, 0.1, 0.2)  # that a swell may last
SWOLLEN_MS = (2.0, 5.0, 10.0, 20.0, 40.0)  # frames that tell how long it does
MOST_SWELL = 0.6  # standard deviation of the log of loudness
STRAYING_MS = 10.0  # frames whose levels tell whether there is a swell
LEVEL_STRAYS = 0.01  # variance of the log of loudness that is left to errors of the level: 0.9 dB
N_HEARD = 5  # free runs of a block that a distance is the mean of
KEPT = (0.0, 0.25, 0.5, 0.75, 1.0)  # of the fitted shape of log σ


def fit_scale(scale: Scale, data: Data, scaling: Scaling, residual: NDArray[np.float64], seed: int) -> float:
    """Fit the scale over speed and force of a vibration or of residuals, by Gaussian maximum likelihood.

    The shape of log σ over speed and force is fitted on the training blocks, and how much of it is kept, from none to all, is
    chosen by the likelihood of the validation blocks: in a recording of two seconds the differences between blocks are
    mostly chance. It did not cure the level errors of the real wood (−4.4 dB on one split before and after).

    Args:
        scale: fitted in place.
        data: the speed and force that go with each residual are those of the last sample of its window.
        scaling: of speed and force.
        residual: what it is the scale of, at the training, then the validation indices, in the unit that the scale is to have,
            shape (len(data.train) + len(data.validation),).
        seed: of the initial weights.

    Returns:
        The mean negative log-likelihood of the validation blocks [nat].
    """
    device = scale.out.weight.device
    n = np.concatenate([data.train, data.validation])
    condition = torch.from_numpy(data.samples[n - 1, 1:3]).to(device, torch.float64)
    squared = torch.from_numpy(residual**2).to(device, torch.float64) + 1e-12
    train, validation = slice(0, len(data.train)), slice(len(data.train), None)
    torch.manual_seed(seed)
    scale.hidden.reset_parameters()
    with torch.no_grad():
        scale.mean.copy_(torch.tensor(scaling.mean[1:]))
        scale.sd.copy_(torch.tensor(scaling.sd[1:]))
        scale.out.weight.zero_()
        scale.power_law.weight.zero_()
        scale.highest.fill_(1e6)
        scale.out.bias.copy_(0.5 * torch.log(squared[train].mean(dim=0, keepdim=True)))
    scale.double().requires_grad_(True)
    optimiser = torch.optim.LBFGS(
        scale.parameters(),
        max_iter=60,
        history_size=20,
        line_search_fn="strong_wolfe",
        tolerance_change=1e-7,
    )

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        loss = _likelihood(scale(condition[train]), squared[train])
        # Keeps σ smooth where the plane was hardly visited.
        loss = loss + 1e-4 * (scale.hidden.weight.square().sum() + scale.out.weight.square().sum())
        loss.backward()
        return loss

    optimiser.step(closure)
    scale.requires_grad_(False)
    shape = torch.log(scale(condition)) - scale.out.bias
    found = []
    for kept in KEPT:
        # The factor that maximises the likelihood of a given shape, in closed form.
        factor = torch.sqrt((squared[train] * torch.exp(-2 * kept * shape[train])).mean())
        nll = _likelihood(factor * torch.exp(kept * shape[validation]), squared[validation])
        found.append((float(nll), kept, math.log(float(factor))))
    nll, kept, log_factor = min(found)
    scale.out.weight.mul_(kept)
    scale.power_law.weight.mul_(kept)
    scale.out.bias.fill_(log_factor)
    scale.float()
    scale.bound(condition[train].float())
    return nll


def _likelihood(sigma: torch.Tensor, squared: torch.Tensor) -> torch.Tensor:
    """Return the mean Gaussian negative log-likelihood [nat] of squared residuals."""
    return (torch.log(sigma) + squared / (2 * sigma**2)).mean() + 0.5 * math.log(2 * math.pi)


def _louder(rendered: Array, recorded: Array) -> tuple[float, float]:
    """Return by how much rendered blocks are louder than recorded ones [dB], and its standard error over blocks."""
    ours, theirs = np.square(rendered).mean(axis=1), np.square(recorded).mean(axis=1)
    louder = 10 * math.log10(ours.sum() / theirs.sum())
    if len(ours) < 2:
        return louder, math.inf
    return louder, _jackknifed(10 * np.log10((ours.sum() - ours) / (theirs.sum() - theirs)))


def _jackknifed(without: Array) -> float:
    """Return the standard error of a figure over n blocks, given what it is without each block in turn, (n,)."""
    n = len(without)
    return float(np.sqrt((n - 1) / n * np.square(without - without.mean()).sum()))


def fit_tail(
    excitation: Excitation, data: Data, residual: NDArray[np.float64], sigma: NDArray[np.float64]
) -> float:
    """Give a fitted excitation the tails that its residuals have, where validation agrees.

    h(speed, force) and a factor on σ, a power law too, are fitted on the training blocks by the likelihood of z·exp(h z²/2),
    and kept if the validation blocks are more likely with them. A Student t and two Gaussians are about as likely
    (`benchmarks/innovations.py`); this one is a smooth function of one Gaussian number, which a stream of noise is made of.

    Args:
        excitation: changed in place.
        data: the conditions that go with each residual.
        residual: at the training, then the validation indices.
        sigma: of the excitation there.

    Returns:
        What the tails gain in the mean negative log-likelihood of the validation blocks [nat]; 0 where they are not kept.
    """
    n = np.concatenate([data.train, data.validation])
    condition = torch.from_numpy(data.samples[n - 1, 1:3]).double()
    u = torch.from_numpy(residual / sigma).double()
    train, validation = slice(0, len(data.train)), slice(len(data.train), None)
    with torch.no_grad():
        powers = excitation.double().logarithms(condition)
    excitation.float()
    tail, factor = (torch.zeros(6, dtype=torch.float64, requires_grad=True) for _ in range(2))
    with torch.no_grad():
        tail[5] = -2.0
    powers = torch.cat([powers, torch.ones_like(powers[:, :1])], dim=1)
    optimiser = torch.optim.LBFGS(
        [tail, factor], max_iter=80, line_search_fn="strong_wolfe", tolerance_change=1e-7
    )

    def nll(part: slice) -> torch.Tensor:
        h = HEAVIEST_TAIL * torch.sigmoid(powers[part] @ tail)
        log_factor = powers[part] @ factor
        z2 = gaussianised(u[part] * torch.exp(-log_factor), h).square()
        return (0.5 * (1 + h) * z2 + torch.log1p(h * z2) + log_factor).mean()

    def closure() -> torch.Tensor:
        optimiser.zero_grad()
        loss = nll(train) + 1e-3 * (tail[:5].square().sum() + factor[:5].square().sum())
        loss.backward()
        return loss

    optimiser.step(closure)
    with torch.no_grad():
        gained = float(0.5 * u[validation].square().mean() - nll(validation))
        if gained > 0:
            excitation.tail.weight.copy_(tail[None, :5])
            excitation.tail.bias.copy_(tail[5:])
            excitation.power_law.weight += factor[None, :5].float()
            excitation.out.bias += factor[5:].float()
            excitation.bound(condition[train].float())
    return max(0.0, gained)


def gaussianised(u: torch.Tensor, h: torch.Tensor) -> torch.Tensor:
    """Return |z| with z·exp(h z²/2) = u, any equal shapes, differentiable: Newton's method on log |z|."""
    log_u = torch.log(u.abs() + 1e-12)
    with torch.no_grad():
        # From above the root of a convex function every step stays above, and falls by a half until it is near.
        q = log_u
        for _ in range(20):
            z2 = torch.exp(2 * q)
            q = q - (q + 0.5 * h * z2 - log_u) / (1 + h * z2)
    z2 = torch.exp(2 * q)
    # One step more, for its derivative.
    return torch.exp(q - (q + 0.5 * h * z2 - log_u) / (1 + h * z2))


def fit_excitation(
    network: FotenPlus | Excited, residual: Array, random: Data, prepared: Prepared, config: TrainConfig
) -> tuple[list[float], float]:
    """Give a network its excitation: scale, tails, and level in the closed loop; nothing is left of one that it had.

    Args:
        network: its excitation is fitted in place.
        residual: what is left to chance at the training, then the validation indices, in innovations.
        random: whose residuals they are.
        prepared, config: of the training.

    Returns:
        What `settle_level` and `fit_tail` return.
    """
    network.excitation.forget()
    fit_scale(network.excitation, random, prepared.scaling, residual, config.seed)
    gained = 0.0
    if config.tails:
        gained = fit_tail(network.excitation, random, residual, _sigma(network.excitation, random))
    _bound(network.excitation, random, residual[: len(random.train)])
    network.cpu()  # the closed loop is rendered by the engine, which knows no GPU
    errors = settle_level(network, prepared, random.train, config.seed)
    if config.swell:
        fit_swell(network, prepared, config.seed)
    return errors, gained


def _sigma(excitation: Excitation, random: Data) -> Array:
    """Return σ at the training, then the validation indices."""
    n = np.concatenate([random.train, random.validation])
    with torch.no_grad():
        condition = torch.from_numpy(random.samples[n - 1, 1:3]).to(excitation.out.weight)
        return excitation(condition).cpu().double().numpy()


def fit_swell(network: FotenPlus | Excited, prepared: Prepared, seed: int) -> None:
    """Let the loudness swell by itself where the recording is spikier than the free run, as far as that is beyond chance.

    exp(4s²) is the ratio of their kurtoses over all training and validation blocks, its logarithm shrunk by how little it is
    known: with all of it, a cardboard whose ratio was hardly more than its standard error had 1.39 of the ceiling's level
    error, and 1.12 with no swell. A kurtosis is made by a few large samples, so s² is at most twice what the levels of frames
    stray by (`_strays`), less what errors of the level may explain: without that, nine of 36 simulated recordings had a swell by
    chance, and up to 1.7 of the ceiling's level error.

    How long a swell lasts, of `SWELLS_S`, is what describes best how much more uneven the powers of frames of 2 to 40 ms are
    than those of the free run: short swells average out in long frames. Real wood was 1.6 times as uneven at all lengths, copper
    1.4 times in 2 ms and 1.1 in 40 ms. The autocovariance of the innovations' log power, which it was read from before,
    hardly shows a swell of what lies far below the highest frequencies, and gave any of the lengths.

    Args:
        network: its excitation is changed in place.
        prepared, seed: as `fit_excitation` has them.
    """
    rate = prepared.trace.rate_hz
    recorded, runs = _free_runs(network, prepared, prepared.known, seed, 2**34)
    rendered = np.concatenate(runs, axis=1)  # every run of a block beside it
    spikier = _beyond_chance(*_spikier(recorded, rendered))
    strays = _beyond_chance(*_strays(recorded, runs, _moving(prepared, recorded.shape[1]), rate))
    sd = min(MOST_SWELL, math.sqrt(min(spikier / 4, 2 * max(0.0, strays - LEVEL_STRAYS))))
    lasts = _lasts_s(recorded, rendered, rate)
    network.excitation.swell.copy_(torch.tensor([math.exp(-1 / (lasts * rate)), sd]))


def _beyond_chance(value: float, doubt: float) -> float:
    """Return a positive value less the share of it that chance explains, 0 where that is all."""
    return value * max(0.0, 1 - (doubt / value) ** 2) if value > 0 else 0.0


def _moving(prepared: Prepared, n: int) -> NDArray[np.bool_]:
    """Return where the hand moves and presses enough to be heard, in the last n samples of each known block."""
    trace, known = prepared.trace, list(prepared.known)
    speed, force = (trace.blocks(channel)[known, -n:] for channel in (trace.speed, trace.force))
    return np.asarray((speed >= FADE_SPEED) & (force >= FADE_FORCE))


def _strays(recorded: Array, runs: Array, moving: NDArray[np.bool_], rate_hz: float) -> tuple[float, float]:
    """Return by how much more recorded levels stray from free runs' mean than free runs do, and its jackknifed standard error.

    The variance of the log of loudness in frames of 10 ms, under the same hand: what is loud under a fast hand, or spiky within
    a frame, is so in both and does not count, as it does in a kurtosis. Linear processes, which have no swell, came to
    0.00 ± 0.01; simulated cardboard and smooth rubber, whose levels are not quite right, to 0.01; the real copper, leather,
    wood and fabric to 0.03, 0.04, 0.16 and 0.45.

    Args:
        recorded: shape (n_blocks, n).
        runs: shape (n_runs, n_blocks, n).
        moving: where frames count, shape (n_blocks, n).
    """
    frame = max(1, round(STRAYING_MS * rate_hz / 1000))
    n = recorded.shape[1] // frame
    least = 1e-8 * float(np.square(recorded).mean())

    def framed(signal: NDArray[Any]) -> NDArray[Any]:
        return signal[..., : n * frame].reshape(*signal.shape[:-1], n, frame)

    levels, ours = (
        0.5 * np.log(np.square(framed(signal)).mean(axis=-1) + least) for signal in (recorded, runs)
    )
    beyond = np.square(levels - ours.mean(axis=0)) - ours.var(axis=0, ddof=1) * (1 + 1 / len(ours))
    counts = framed(moving).all(axis=-1)
    total, number = np.where(counts, beyond, 0.0).sum(axis=1), counts.sum(axis=1)
    others = number.sum() - number
    if len(recorded) < 3 or not (others > 0).all():
        return 0.0, math.inf
    return float(total.sum() / number.sum()), _jackknifed((total.sum() - total) / others)


def _spikier(recorded: Array, rendered: Array) -> tuple[float, float]:
    """Return the log of the ratio of kurtoses over all blocks, (n_blocks, any) each, and its jackknifed standard error."""

    def log_kurtosis(blocks: Array) -> Array:
        """Return log kurtosis of all, then without each block in turn."""
        second, fourth = (np.power(blocks, k).mean(axis=1) for k in (2, 4))
        n = len(blocks)
        sums = [
            np.concatenate([[part.sum() / n], (part.sum() - part) / max(1, n - 1)])
            for part in (second, fourth)
        ]
        return np.log(sums[1] / np.square(sums[0]))

    ratio = log_kurtosis(recorded) - log_kurtosis(rendered)
    if len(recorded) < 3:
        return 0.0, math.inf
    return float(ratio[0]), _jackknifed(ratio[1:])


def _lasts_s(recorded: Array, rendered: Array, rate_hz: float) -> float:
    """Return how long the loudness stays up that recorded blocks have beyond rendered ones, (n_blocks, any) each [s]."""
    more = np.array(
        [_unevenness(recorded, ms, rate_hz) / _unevenness(rendered, ms, rate_hz) - 1 for ms in SWOLLEN_MS]
    )

    def missed(lasts_s: float) -> float:
        # What is left of the variance of an exponentially correlated loudness in the mean of a frame.
        frames = np.array(SWOLLEN_MS) / 1000 / lasts_s
        left = 2 * (frames - 1 + np.exp(-frames)) / frames**2
        size = max(0.0, float(left @ more) / float(left @ left))
        return float(np.square(more - size * left).sum())

    return min(SWELLS_S, key=missed)


def _unevenness(blocks: Array, frame_ms: float, rate_hz: float) -> float:
    """Return the mean square of the powers of frames over the square of their mean: (n_blocks, n)."""
    frame = max(1, round(frame_ms * rate_hz / 1000))
    n = blocks.shape[1] // frame
    powers = np.square(blocks[:, : n * frame].reshape(len(blocks), n, frame)).mean(axis=2)
    return float(np.square(powers).mean() / powers.mean() ** 2)


def _bound(excitation: Excitation, random: Data, residual: Array) -> None:
    """Let no excitation be larger than what was left to explain at the training indices, (n,), in σ and in acceleration."""
    scale = _sigma(excitation, random)[: len(residual)]
    unit = 1.0 if random.unit is None else random.unit[random.train]
    largest = [float(np.abs(values).max()) for values in (residual / scale, residual * unit)]
    excitation.largest.copy_(torch.tensor(largest))


def engine_of(network: FotenPlus) -> NumpyFotenPlus:
    """Return what renders a network that is not in a file yet."""
    return NumpyFotenPlus(
        network.architecture, {name: t.cpu().numpy() for name, t in network.state_dict().items()}
    )


class TorchEngine:
    """A one-step network with an excitation that is not in a file yet, in float32."""

    def __init__(self, network: Excited) -> None:
        self.window = network.architecture.history
        self.excitation = NumpyExcitation(
            {f"excitation.{name}": t.cpu().numpy() for name, t in network.excitation.state_dict().items()}
        )
        self._network = network.network

    def predict(self, windows: Array) -> Array:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        return self.ahead(windows)[:, 0]

    def ahead(self, windows: Array) -> Array:
        """Return what the network says of the samples to come: windows (b, m, 3) scaled → (b, n_ahead) scaled."""
        with torch.no_grad():
            found = self._network(torch.from_numpy(windows).float())
        return found.double().reshape(len(windows), -1).numpy()

    def start(self, windows: Array) -> State:
        """Return the state of streams that have heard the given scaled windows, shape (s, m, 3)."""
        return begun(self, windows)


def _loop(network: FotenPlus | Excited, prepared: Prepared, start: Array) -> ClosedLoop:
    """Return streams that go on from scaled windows (s, m, 3); what nothing bounds, the saturator does."""
    if isinstance(network, FotenPlus):
        return ClosedLoop(engine_of(network).start(start))
    return ClosedLoop(TorchEngine(network).start(start), saturation_of(prepared))


def _free_runs(
    network: FotenPlus | Excited, prepared: Prepared, blocks: tuple[int, ...], seed: int, first_stream: int
) -> tuple[Array, Array]:
    """Return recorded blocks and free runs under their speed and force, scaled: (n_blocks, n), (N_HEARD, n_blocks, n).

    The first fifth of each block is left out, or all of the history that the run began from where that is longer.

    Args:
        first_stream: of the noise; the judge's begin at 0, and each that listens has its own.
    """
    m, block = network.architecture.history, prepared.trace.block
    by_block = prepared.samples[list(blocks)]
    settled = max(m, round(0.2 * block))
    start, condition = (np.tile(part, (N_HEARD, 1, 1)) for part in (by_block[:, :m], by_block[:, m:, 1:]))
    noise = np.stack([gaussian(seed, first_stream + k, 0, block - m) for k in range(len(start))])
    rendered = _loop(network, prepared, start).run(condition, noise)[:, settled - m :]
    return by_block[:, settled:, 0], rendered.reshape(N_HEARD, len(blocks), -1)


def free_run_distance(
    network: FotenPlus | Excited, prepared: Prepared, blocks: tuple[int, ...], seed: int
) -> tuple[float, float]:
    """Return how far the free run is from recorded blocks, on noise of its own: log-spectral distance and level error [dB]."""
    trace = prepared.trace
    recorded, played = _free_runs(network, prepared, blocks, seed, 2**33)
    n_segment = segment_length(trace.block)
    frequencies, p = welch(recorded, trace.rate_hz, n_segment)
    _, q = welch(played, trace.rate_hz, n_segment)
    bins = scored_bins(frequencies, trace.rate_hz)
    reference = float(np.sqrt(np.square(recorded).mean()))
    levels = [frame_levels(signal, trace.rate_hz, reference) for signal in (recorded, played)]
    return float(log_spectral_distance(p[None, :, bins], q[..., bins]).mean()), float(
        np.abs(levels[1] - levels[0]).mean()
    )


def _rung(network: FotenPlus | Excited, power: Array) -> Array:
    """Return the power that leaves the excited lattice, for that which drives it at each sample, (n_blocks, n, any).

    Where the level scales what leaves the lattice, what rang before is levelled with the sample that it rings into, and nothing
    carries over. Where it drives it, power rings on as the square of the impulse response does, that of the mean reflections.
    """
    if isinstance(network, Excited) or not network.excited.level_drives:
        return power
    lattice = network.excited
    k = lattice.reflections.mean(dim=0).numpy()
    n = power.shape[1]
    answer = np.square(lfilter([1.0], polynomial(k), np.eye(1, n)[0]))
    # Before the first sample as at the first.
    held = np.pad(power, ((0, 0), (n, 0), (0, 0)), mode="edge")
    return fftconvolve(held, answer[None, :, None] / answer.sum(), axes=1)[:, n : 2 * n]


def settle_level(
    network: FotenPlus | Excited, prepared: Prepared, trained: NDArray[np.int64], seed: int
) -> list[float]:
    """Adjust σ until the closed loop is as loud as the recording, at every speed and force.

    A likelihood measures the error of one step. In the closed loop the lattice filters the excitation, and small errors
    of its resonances, or a correction that feeds on itself, change the level by a dB. What the levels of frames miss is taken
    off the terms of log σ in log speed and log force, by a ridge regression on how each frame answers to each term; what the
    power of all misses, as far as that is beyond chance, off its constant; three times over.

    Args:
        network: its excitation is adjusted in place.
        prepared: the loop runs under the speed and force of its training and validation blocks, the first fifth not counted.
        trained: indices of the trained samples, within whose range σ stays.
        seed: of the excitation.

    Returns:
        By how much the closed loop is louder than the recording before each adjustment [dB].
    """
    trace, m = prepared.trace, network.architecture.history
    rate, by_block = trace.rate_hz, prepared.samples[list(prepared.known)]
    settled = max(m, round(0.2 * trace.block))
    recorded = by_block[:, settled:, 0]
    reference = float(np.sqrt(np.square(recorded).mean()))
    level = frame_levels(recorded, rate, reference)
    # Streams of their own: the judge, who counts from 0, must not hear the noise that the level was settled on.
    noise = np.stack([gaussian(seed, 2**32 + k, 0, trace.block - m) for k in range(len(by_block))])
    condition = torch.from_numpy(by_block[:, m - 1 : -1, 1:].reshape(-1, 2)).float()
    within = torch.from_numpy(prepared.samples.reshape(-1, 3)[trained - 1, 1:]).float()
    errors = []
    for _ in range(N_SETTLING):
        loop = _loop(network, prepared, by_block[:, :m])
        rendered = loop.run(by_block[:, m:, 1:], noise)[:, settled - m :]
        error = (frame_levels(rendered, rate, reference) - level).ravel()
        louder, doubt = _louder(rendered, recorded)
        errors.append(louder)
        # A frame's power is the mean of ℓ²σ² and the tones': it answers to a term of log σ by that term's mean under ℓ²σ².
        with torch.no_grad():
            chance, of_tones = network.rendered_power(condition)
            terms = network.excitation.logarithms(condition).double()
        weighed = (chance[:, None] * torch.cat([torch.ones_like(chance)[:, None], terms], dim=1)).numpy()
        weighed = _rung(network, weighed.reshape(len(by_block), -1, weighed.shape[1]))[:, settled - m :]
        tones = of_tones.numpy().reshape(len(by_block), -1)[:, settled - m :]
        total = frame_means(weighed[..., 0] + tones, rate).reshape(-1, 1)
        by_term = [frame_means(part, rate).ravel() for part in np.moveaxis(weighed, -1, 0)]
        answers = np.stack(by_term, axis=1) / total
        # Ridge: a recording at one condition has no slopes to adjust, one that varies (log-variance 0.5 and more) has.
        ridge = 0.05 * len(error) * np.diag([0.0, 1.0, 1.0, 1.0, 1.0, 1.0])
        step = -np.linalg.solve(answers.T @ answers + ridge, answers.T @ error)
        # What all frames have in common follows the power of all, and only as far as it is beyond chance: of two seconds
        # it is known to a dB, and settled on that the real copper's free run was 2 to 9 % further from the recording.
        loud = 10 ** (level.ravel() / 10)
        answer = (loud[:, None] * answers).sum(axis=0) / loud.sum()
        beyond_chance = max(0.0, 1 - (doubt / louder) ** 2) if louder else 0.0
        step[0] = -(louder * beyond_chance + float(answer[1:] @ step[1:])) / answer[0]
        step = np.clip(step * math.log(10) / 20, -1.0, 1.0)
        with torch.no_grad():
            network.excitation.out.bias += float(step[0])
            network.excitation.power_law.weight += torch.from_numpy(step[None, 1:]).float()
        network.excitation.bound(within)
    return errors
