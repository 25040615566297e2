"""White noise through a spectrum, which makes samples of a model that predicts spectra alone."""

import numpy as np
import torch
from torch import Tensor, nn

FAINTEST = 1e-4  # of |X|, scaled; below it a logarithm is of the sensor
_LIMIT = 10.0  # of log |X|, scaled: beyond it is no vibration


def log_magnitudes(frames: Tensor) -> Tensor:
    """Log |X| of frames under a Hann window: (..., n) scaled → (..., n // 2 + 1)."""
    window = torch.hann_window(frames.shape[-1], dtype=torch.float64).to(frames)
    return torch.fft.rfft(frames * window).abs().clamp(min=FAINTEST).log()


class NoiseFilter(nn.Module):
    """Symmetric filter of n taps, whose output has given mean log magnitudes under a Hann window.

    The mean log magnitude of Gaussian noise lies γ/2 below the log of its root mean square (γ is Euler's constant), and
    (γ + log 2)/2 in the two real bins. That is added here.
    """

    def __init__(self, n: int) -> None:
        super().__init__()
        bins = np.arange(n // 2 + 1)  # of a frame of n samples
        alone = (bins == 0) | (2 * bins == n)
        turns = np.outer(np.arange(n) - n // 2, bins) / n
        cosines = np.where(alone, 1.0, 2.0) * np.cos(2 * np.pi * turns) / n
        scatter = 0.5 * (np.euler_gamma + np.where(alone, np.log(2.0), 0.0))
        power = float(torch.hann_window(n, dtype=torch.float64).square().sum())
        self.register_buffer("cosines", torch.from_numpy(cosines).float(), persistent=False)
        self.register_buffer("offset", torch.from_numpy(scatter - 0.5 * np.log(power)).float(), persistent=False)

    def forward(self, noise: Tensor, logs: Tensor) -> Tensor:
        """A sample of each frame of noise: (..., n), its log |X| (..., n // 2 + 1) → (...)."""
        magnitudes = torch.exp(logs.clamp(-_LIMIT, _LIMIT) + self.offset.to(logs.dtype))
        return ((noise @ self.cosines.to(noise.dtype)) * magnitudes).sum(-1)
