"""A generator of spectra and what judges it [34], made causal so that it renders sample by sample."""

from __future__ import annotations

import math
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import conv1d, leaky_relu
from torch.nn.utils.parametrizations import spectral_norm

from foten.baselines.noise_filter import NoiseFilter
from foten.baselines.sizes import GanSizes

LATENTS = 5  # numbers of noise that a frame is made from


class Gan(nn.Module):
    """Noise, speed and force of 27 frames give the spectrum of the last, and that filters noise.

    Three layers of convolutions over frames, each of three frames. A frame's own chance is what a Hann window and its first two
    cosines and sines hear of its noise, which changes little from one sample to the next.

    Source: a generator of spectrograms for speed and force that a discriminator judges, as Ujitoko & Ban (EuroHaptics 2018);
    the paper names [34] without a list of references, so whose it compared with is not known. Our re-implementation; causal,
    where theirs makes half a second at once, and without a search for phases (`NoiseFilter`).
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
        """Samples as they are rendered, but for a spectrum that stands still for a stride: (b, n, 3) → (b, k · stride).

        The first follows m samples, and the last of n are followed by none.
        """
        logs = self.spectra(windows[:, : windows.shape[1] - self.stride])
        noise = windows[:, 26 * self.stride :, 0].unfold(1, self.frame, 1)[:, : logs.shape[1] * self.stride]
        return self.filter(noise, logs.repeat_interleave(self.stride, dim=1))

    def _frames(self, windows: Tensor) -> Tensor:
        """Noise and condition of every frame: (b, n, 3) → (b, LATENTS + 2, frames)."""
        noise, condition = windows[:, None, :, 0], windows[:, self.frame - 1 :: self.stride, 1:]
        latents = conv1d(noise, self.kernels.to(noise.dtype), stride=self.stride)
        return torch.cat([latents, condition.transpose(1, 2)], dim=1)


class Discriminator(nn.Module):
    """Tells recorded spectrograms from made ones, beside the speed and force of each frame: convolutions in both directions."""

    def __init__(self) -> None:
        super().__init__()
        widths = (3, 16, 32, 64)
        self.layers = nn.ModuleList(spectral_norm(nn.Conv2d(a, b, 4, stride=2, padding=2)) for a, b in pairwise(widths))
        self.out = spectral_norm(nn.Linear(widths[-1], 1))

    def forward(self, spectrogram: Tensor, condition: Tensor) -> Tensor:
        """How recorded it looks, above 0 or below: (b, frames, bins) standardised, (b, frames, 2) scaled → (b,)."""
        condition = condition.transpose(1, 2)[..., None].expand(-1, -1, -1, spectrogram.shape[2])
        features = torch.cat([spectrogram[:, None], condition], dim=1)
        for layer in self.layers:
            features = leaky_relu(layer(features), 0.2)
        return self.out(features.mean(dim=(2, 3)))[:, 0]
