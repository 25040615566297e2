"""FNN [13]: the vibration in four bands, a small network for each."""

import numpy as np
import torch
from torch import Tensor, nn

from foten.dsp import Array
from foten.dsp.filters import Biquads, butterworth
from foten.training.dropout import Dropout
from foten_lab.baselines.sizes import FnnSizes

EDGES = (0.06, 0.125, 0.25)  # between the bands, of the rate: 60, 125 and 250 Hz at 1 kHz
SPACING = (8, 4, 2, 1)  # samples between the lags of each band, lowest first


class Fnn(nn.Module):
    """The sum of four bands' next samples, each from lags of its band, speed and force.

    Causal low-passes and their residuals split the vibration into bands that add up to it, without delay.

    Source: Shin, Osgouei, Kim and Choi, World Haptics 2015, of which only the abstract was available: our re-implementation. All
    bands are trained at once on the error of their sum.
    """

    def __init__(self, sizes: FnnSizes) -> None:
        super().__init__()
        n, first, second = sizes.n_lags + 2, sizes.first, sizes.second
        layers = [
            (nn.Linear(n, first), nn.Tanh(), Dropout(), nn.Linear(first, second), nn.Tanh(), nn.Linear(second, 1))
            for _ in SPACING
        ]
        self.bands = nn.ModuleList(nn.Sequential(*of_band) for of_band in layers)
        self.register_buffer("lags", torch.from_numpy(lagged_bands(sizes.window, sizes.n_lags)), persistent=False)

    def forward(self, windows: Tensor) -> Tensor:
        """The next samples: windows (b, m, 3) scaled → (b,) scaled."""
        lagged = torch.einsum("bm,klm->kbl", windows[:, :, 0], self.lags.to(windows.dtype))
        pieces = [band(torch.cat([lagged[k], windows[:, -1, 1:]], dim=1))[:, 0] for k, band in enumerate(self.bands)]
        return torch.stack(pieces).sum(dim=0)


def lagged_bands(m: int, n_lags: int) -> Array:
    """Matrices from a window of m samples to the bands at their lags, shape (4, n_lags, m); lag 1 is the last sample."""
    impulse = np.eye(1, m)[0]
    low = [Biquads(butterworth("lowpass", edge, 1.0)).process(impulse) for edge in EDGES]
    responses = np.diff([np.zeros(m), *low, impulse], axis=0)
    rows = np.zeros((len(SPACING), n_lags, m))
    for k, (response, spacing) in enumerate(zip(responses, SPACING, strict=True)):
        for i in range(n_lags):
            last = m - 1 - i * spacing
            rows[k, i, : last + 1] = response[: last + 1][::-1]
    return rows
