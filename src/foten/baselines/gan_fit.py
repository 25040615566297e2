"""Training of a generator against a discriminator: rendered spectrograms beside recorded ones under the same speed and force."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.optim import Adam

from foten.baselines.gan import Discriminator, Gan
from foten.baselines.noise_filter import log_magnitudes
from foten.training.blocks import ScaledBlocks
from foten.training.config import TrainConfig
from foten.training.loop import Loop, Monitor, Progress, Stateful, epoch_seed, run_loop

FRAMES = 56  # of a spectrogram; Table III
STEPS = 50  # in an epoch
MEAN_WEIGHT = 10.0  # of how far mean spectra are apart, beside what the discriminator says
_MIN_FRAMES = 8
_N_DRAWS = 4  # draws of noise for each validation spectrogram


class _Crops:
    """Recorded spectrograms of some blocks, and the speed and force that the same length of noise goes with."""

    def __init__(self, network: Gan, m: int, of: ScaledBlocks, blocks: tuple[int, ...]) -> None:
        frame, stride, block = network.frame, network.stride, of.trace.block
        self.m, self.stride = m, stride
        self.n_frames = min(FRAMES, (block - m - frame) // stride + 1)
        if self.n_frames < _MIN_FRAMES:
            shortest = m + frame + (_MIN_FRAMES - 1) * stride
            raise ValueError(
                f"a block of {block} samples is too short for spectrograms of {_MIN_FRAMES} frames after {m} samples, expected "
                f"{shortest} or more: use a longer --block"
            )
        self.length = frame + (self.n_frames - 1) * stride  # samples of a spectrogram
        samples = torch.from_numpy(of.samples[list(blocks)]).float()
        # Frames end where the first of their strides begins, as what is rendered does.
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


def fit_adversarial(network: Gan, m: int, blocks: ScaledBlocks, config: TrainConfig, monitor: Monitor) -> Progress:
    """Train a generator in place, on the CPU, and leave it where mean spectra of the validation blocks are nearest.

    The discriminator is given spectrograms of what is rendered, and the speed and force of their frames (hinge loss); the
    generator is given besides how far the mean over the frames is from that of the recorded spectrogram under the same hand.
    An epoch is `STEPS` steps; its losses are means of absolute differences of mean log magnitudes [nat], as `validation_mae`
    is.
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
        distance = (fake.mean(1) - real.mean(1)).abs().mean()
        adam.zero_grad()
        (MEAN_WEIGHT * distance - score(fake, conditions).mean()).backward(inputs=generating)
        adam.step()
        return distance.detach()

    def validate(gan: nn.Module) -> tuple[float, float]:
        block, begin = (index.repeat(_N_DRAWS) for index in validation.tiles())
        noise = torch.Generator().manual_seed(config.seed)
        with torch.no_grad():
            fake = rendered_spectra(gan, validation.windows(block, begin, noise), validation.n_frames)
            real = validation.spectrograms(block, begin)
            # Over the draws of noise, whose scatter is none of the generator's.
            means = [s.mean(1).reshape(_N_DRAWS, -1, s.shape[2]).mean(0) for s in (fake, real)]
            distance = float((means[0] - means[1]).abs().mean())
        return distance, distance

    parts: dict[str, Stateful] = {"discriminator": discriminator, "adam": adam}
    return run_loop(Loop("generator", network, STEPS, step, validate, parts), config, monitor)
