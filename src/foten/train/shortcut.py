"""The linear shortcut of foten-plus: AR(m) by least squares on the training blocks."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from foten.dsp.ar import MAX_POLE, least_squares, stabilised
from foten.models.foten_plus import FotenPlus
from foten.recording.windows import window_indices
from foten.train.fit import Data


def fit_shortcut(network: FotenPlus, data: Data) -> NDArray[np.float64]:
    """Set the shortcut to the least-squares linear prediction from the acceleration window, made stable.

    Returns:
        Its error at the training, then the validation indices, scaled.
    """
    windows = data.samples[window_indices(data.train, data.window), 0]
    design = np.concatenate([windows, np.ones((len(windows), 1))], axis=1)
    coefficients = least_squares(design, data.samples[data.train, 0])
    taps = stabilised(coefficients[:-1], MAX_POLE)
    device = network.shortcut.device
    network.shortcut.copy_(torch.from_numpy(taps).to(device))
    network.shortcut_bias.copy_(torch.from_numpy(coefficients[-1:]).to(device))
    n = np.concatenate([data.train, data.validation])
    return data.samples[n, 0] - data.samples[window_indices(n, data.window), 0] @ taps - coefficients[-1]
