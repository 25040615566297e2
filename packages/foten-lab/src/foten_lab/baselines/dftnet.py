"""The action-conditional model of spectra [14], without its images."""

from itertools import pairwise

import torch
from torch import Tensor, nn

from foten.training.dropout import Dropout
from foten_lab.baselines.noise_filter import NoiseFilter
from foten_lab.baselines.sizes import DftnetSizes


class Spectrum(nn.Module):
    """Perceptron of three hidden layers from past speeds and forces to the log magnitudes of a frame around now."""

    def __init__(self, sizes: DftnetSizes) -> None:
        super().__init__()
        m, n = sizes.window, sizes.n_conditions
        self.samples = [m - 1 - k * (m // n) for k in range(n)]  # samples of the window
        widths = (2 * n, sizes.first, sizes.second, sizes.third)
        self.hidden = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(widths))
        self.out = nn.Linear(sizes.third, m // 2 + 1)
        self.dropout = Dropout()

    def forward(self, windows: Tensor) -> Tensor:
        """Log |X| of frames under a Hann window: windows (b, m, 3) scaled → (b, m // 2 + 1)."""
        hidden = windows[:, self.samples, 1:].flatten(1)
        for layer in self.hidden:
            hidden = self.dropout(torch.relu(layer(hidden)))
        return self.out(hidden)


class Dftnet(nn.Module):
    """Noise filtered by the spectrum that the speeds and forces of the last frame give.

    Source: the abstract of [14], our re-implementation. Differs from it: no image of the surface, since a texture is one surface;
    sizes and the logarithm are our choice; and `NoiseFilter` in place of a retrieval of phases, which waits for later frames.
    """

    def __init__(self, sizes: DftnetSizes) -> None:
        super().__init__()
        self.spectrum = Spectrum(sizes)
        self.filter = NoiseFilter(sizes.window)

    def forward(self, windows: Tensor) -> Tensor:
        """The next samples: windows (b, m, 3) of noise, speed and force, scaled → (b,) scaled."""
        return self.filter(windows[:, :, 0], self.spectrum(windows))
