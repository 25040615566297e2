"""A generator of spectra and its discriminator [34], causal so that it renders sample by sample."""

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import conv1d, leaky_relu
from torch.nn.utils.parametrizations import spectral_norm
from torch.optim import Adam

from foten.training.checkpoint import Progress
from foten.training.config import LoopConfig
from foten.training.job import ScaledBlocks
from foten.training.loop import Loop, Monitor, epoch_seed, run_loop
from foten_lab.baselines.noise_filter import NoiseFilter, log_magnitudes
from foten_lab.baselines.sizes import GanSizes

LATENTS = 5  # numbers of noise that a frame is made from
FRAMES = 56  # of a spectrogram; Table III
STEPS = 50  # in an epoch
MEAN_WEIGHT = 10.0  # of how far mean spectra are apart, beside what the discriminator says
_MIN_FRAMES = 8
_N_DRAWS = 4  # draws of noise for each validation spectrogram


class Gan(nn.Module):
    """Noise filtered by the spectrum that three convolutions make of the noise, speed and force of 27 frames.

    Latents of a frame are its noise under a Hann window and its first two cosines and sines.

    Source: Ujitoko & Ban (EuroHaptics 2018), our re-implementation; we lack the list of references that names [34]. Differs
    from it: causal, where theirs makes half a second at once, and without a search for phases (`NoiseFilter`).
    """

    def __init__(self, sizes: GanSizes) -> None:
        super().__init__()
        self.frame, self.stride = sizes.frame, sizes.stride
        n, c = sizes.frame, sizes.channels
        self.layers = nn.ModuleList(nn.Conv1d(inputs, c, 3) for inputs in (LATENTS + 2, c, c))
        self.out = nn.Conv1d(c, n // 2 + 1, 1)
        self.filter = NoiseFilter(n)
        turns = 2 * math.pi * torch.arange(n, dtype=torch.float64) / n
        waves = [wave(k * turns) for k in (1, 2) for wave in (torch.cos, torch.sin)]
        kernels = torch.stack([torch.ones_like(turns), *waves]) * torch.hann_window(n, dtype=torch.float64)
        kernels = kernels / kernels.square().sum(1, keepdim=True).sqrt()
        self.register_buffer("kernels", kernels[:, None].float(), persistent=False)

    def forward(self, windows: Tensor) -> Tensor:
        """The next samples: windows (b, m, 3) of noise, speed and force, scaled → (b,) scaled."""
        features = self._frames(windows)
        for layer in self.layers:
            # The last frame alone, which each layer needs every third of what is before it for.
            features = torch.relu(conv1d(features, layer.weight, layer.bias, stride=3))
        return self.filter(windows[:, -self.frame :, 0], self.out(features)[:, :, 0])

    def spectra(self, windows: Tensor) -> Tensor:
        """Log |X| for every stride of longer windows (b, n, 3): (b, frames − 26, bins), the first as `forward`'s of m."""
        features = self._frames(windows)
        for layer, spread in zip(self.layers, (1, 3, 9), strict=True):  # frames between what a layer looks at
            features = torch.relu(conv1d(features, layer.weight, layer.bias, dilation=spread))
        return self.out(features).transpose(1, 2)

    def played(self, windows: Tensor) -> Tensor:
        """Samples after the first m, with one spectrum for each stride: (b, n, 3) → (b, k · stride)."""
        logs = self.spectra(windows[:, : windows.shape[1] - self.stride])
        noise = windows[:, 26 * self.stride :, 0].unfold(1, self.frame, 1)[:, : logs.shape[1] * self.stride]
        return self.filter(noise, logs.repeat_interleave(self.stride, dim=1))

    def _frames(self, windows: Tensor) -> Tensor:
        """Noise and condition of every frame: (b, n, 3) → (b, LATENTS + 2, frames)."""
        noise, condition = windows[:, None, :, 0], windows[:, self.frame - 1 :: self.stride, 1:]
        latents = conv1d(noise, self.kernels.to(noise.dtype), stride=self.stride)
        return torch.cat([latents, condition.transpose(1, 2)], dim=1)


class Discriminator(nn.Module):
    """Convolutions over frames and bins that tell recorded spectrograms from generated ones, given speed and force."""

    def __init__(self) -> None:
        super().__init__()
        widths = (3, 16, 32, 64)
        self.layers = nn.ModuleList(spectral_norm(nn.Conv2d(a, b, 4, stride=2, padding=2)) for a, b in pairwise(widths))
        self.out = spectral_norm(nn.Linear(widths[-1], 1))

    def forward(self, spectrogram: Tensor, condition: Tensor) -> Tensor:
        """Score, positive for recorded: (b, frames, bins) standardised, (b, frames, 2) scaled → (b,)."""
        condition = condition.transpose(1, 2)[..., None].expand(-1, -1, -1, spectrogram.shape[2])
        features = torch.cat([spectrogram[:, None], condition], dim=1)
        for layer in self.layers:
            features = leaky_relu(layer(features), 0.2)
        return self.out(features.mean(dim=(2, 3)))[:, 0]


class _Crops:
    """Recorded spectrograms of some blocks, and noise with their speed and force."""

    def __init__(self, network: Gan, m: int, of: ScaledBlocks, blocks: tuple[int, ...]) -> None:
        frame, stride, block = network.frame, network.stride, of.trace.block
        self.m, self.stride = m, stride
        self.n_frames = min(FRAMES, (block - m - frame) // stride + 1)
        if self.n_frames < _MIN_FRAMES:
            expected = f"expected {m + frame + (_MIN_FRAMES - 1) * stride} or more: use a longer --block"
            what = f"spectrograms of {_MIN_FRAMES} frames after {m} samples"
            raise ValueError(f"a block of {block} samples is too short for {what}, {expected}")
        self.length = frame + (self.n_frames - 1) * stride  # samples of a spectrogram
        samples = torch.from_numpy(of.samples[list(blocks)]).float()
        self._logs = log_magnitudes(samples[:, m:, 0].unfold(1, frame, 1))
        self._speed_force = samples[:, :, 1:]
        self.n_blocks, self.last = len(blocks), block - m - self.length  # where a crop may begin, after m

    def spectrograms(self, block: Tensor, begin: Tensor) -> Tensor:
        """Log |X| of crops, (b, frames, bins)."""
        return self._logs[block[:, None], begin[:, None] + self.stride * torch.arange(self.n_frames)]

    def windows(self, block: Tensor, begin: Tensor, generator: torch.Generator) -> Tensor:
        """Noise with the speed and force of crops, (b, m + length, 3)."""
        samples = begin[:, None] + torch.arange(self.m + self.length)
        noise = torch.randn(samples.shape, generator=generator)
        return torch.cat([noise[:, :, None], self._speed_force[block[:, None], samples]], dim=2)

    def conditions(self, block: Tensor, begin: Tensor) -> Tensor:
        """Speed and force at the end of each frame, (b, frames, 2)."""
        frames = begin[:, None] + self.m + self.length - 1 - self.stride * torch.arange(self.n_frames).flip(0)
        return self._speed_force[block[:, None], frames]

    def tiles(self) -> tuple[Tensor, Tensor]:
        """The block and the beginning of crops that cover all blocks without overlap."""
        begins = torch.arange(0, self.last + 1, self.length)
        return torch.arange(self.n_blocks).repeat_interleave(len(begins)), begins.repeat(self.n_blocks)


def rendered_spectra(network: nn.Module, windows: Tensor, n_frames: int) -> Tensor:
    """Log |X| of what a generator plays, (b, frames, bins), under windows (b, m + length, 3)."""
    return log_magnitudes(network.played(windows).unfold(1, network.frame, network.stride)[:, :n_frames])


def fit_adversarial(network: Gan, m: int, blocks: ScaledBlocks, config: LoopConfig, monitor: Monitor) -> Progress:
    """Train a generator in place, on the CPU; see `run_loop`.

    The loss of the discriminator is the hinge loss. That of the generator adds the difference of mean log magnitudes from the
    recorded spectrogram under the same speed and force [nat], which is also the loss and `validation_mae` of the log.
    """
    train, validation = (_Crops(network, m, blocks, some) for some in (blocks.split.train, blocks.split.validation))
    discriminator = Discriminator()
    recorded = train.spectrograms(*train.tiles()).flatten(0, 1)
    middle, spread = recorded.mean(0), recorded.std(0).clamp(min=1e-3)
    with torch.no_grad():
        network.out.weight *= 0.1
        network.out.bias.copy_(middle)
    generating = list(network.parameters())
    adam = Adam([*generating, *discriminator.parameters()], lr=config.learning_rate, betas=(0.5, 0.9))
    generator = torch.Generator()

    def score(spectrograms: Tensor, conditions: Tensor) -> Tensor:
        return discriminator((spectrograms - middle) / spread, conditions)

    def step(epoch: int, number: int) -> Tensor:
        if number == 0:  # seeded by the epoch, so that a resumed run sees the same crops and noise
            generator.manual_seed(epoch_seed(config.seed, epoch))
        block = torch.randint(train.n_blocks, (config.batch,), generator=generator)
        begin = torch.randint(train.last + 1, (config.batch,), generator=generator)
        real, conditions = train.spectrograms(block, begin), train.conditions(block, begin)
        fake = rendered_spectra(network, train.windows(block, begin, generator), train.n_frames)
        loss = torch.relu(1 - score(real, conditions)).mean() + torch.relu(1 + score(fake.detach(), conditions)).mean()
        adam.zero_grad()
        loss.backward()
        adam.step()  # of what has gradients, which here the discriminator alone has, and then the generator alone
        spectrum_error = (fake.mean(1) - real.mean(1)).abs().mean()
        adam.zero_grad()
        (MEAN_WEIGHT * spectrum_error - score(fake, conditions).mean()).backward(inputs=generating)
        adam.step()
        return spectrum_error.detach()

    def validate(gan: nn.Module) -> tuple[float, float]:
        block, begin = (index.repeat(_N_DRAWS) for index in validation.tiles())
        noise = torch.Generator().manual_seed(config.seed)
        with torch.no_grad():
            fake = rendered_spectra(gan, validation.windows(block, begin, noise), validation.n_frames)
            real = validation.spectrograms(block, begin)
            # Over the draws of noise, whose scatter is none of the generator's.
            means = [s.mean(1).reshape(_N_DRAWS, -1, s.shape[2]).mean(0) for s in (fake, real)]
            spectrum_error = float((means[0] - means[1]).abs().mean())
        return spectrum_error, spectrum_error

    parts = {"discriminator": discriminator, "adam": adam}
    return run_loop(Loop("generator", network, STEPS, step, validate, parts), config, monitor)
