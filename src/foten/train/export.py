"""A trained network to a texture file, proved on its golden windows before it is written."""

from __future__ import annotations

import copy
import math
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from foten.architecture import TenArchitecture, sizes
from foten.dsp.noise import Swell, gaussian
from foten.models.foten_plus import FotenPlus
from foten.recording.scaling import Scaling
from foten.render.engine import engine_for
from foten.render.synthesizer import prove
from foten.texture_file import FORMAT_VERSION, Texture, texture_from_bytes

_N_GOLDEN = 32


class TorchPredictor:
    """A network as a predictor in float64: the reference that every engine is held to."""

    def __init__(self, network: nn.Module, window: int) -> None:
        self.window = window
        self._network = copy.deepcopy(network).cpu().double().eval()
        self.excited = isinstance(network, FotenPlus)

    def predict(self, windows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        with torch.no_grad():
            return self._network(torch.from_numpy(np.ascontiguousarray(windows))).numpy()

    def scale(self, windows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return by how much a unit of excitation moves the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        with torch.no_grad():
            heard = self._network.start(torch.from_numpy(np.ascontiguousarray(windows)))
            return self._network.forecast(heard)[1].numpy() * self._swell().factor()

    def _swell(self) -> Swell:
        kept, sd = (float(value) for value in self._network.excitation.swell)
        return Swell(kept, sd, np.zeros(1))

    def _heavy(self, z: float, condition: NDArray[np.float64], scale: float) -> float:
        excitation = self._network.excitation
        with torch.no_grad():
            h = float(excitation.tails(torch.from_numpy(condition[None]))[0])
        limit = min(float(excitation.largest[0]), float(excitation.largest[1]) / scale)
        return max(-limit, min(limit, z * math.exp(0.5 * h * z * z)))

    def closed_loop(
        self,
        start: NDArray[np.float64],
        condition: NDArray[np.float64],
        noise: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Return what follows a window (m, 3) under speed and force (n, 2), with excitation where there is one, shape (n,)."""
        out = np.empty(len(condition))
        window = start[None].astype(np.float64)
        with torch.no_grad():
            heard = self._network.start(torch.from_numpy(window)) if self.excited else None
            before = window[0, -1, 1:]
            swell = self._swell() if self.excited else None
            for n, row in enumerate(condition):
                if heard is None or swell is None:
                    out[n] = self.predict(window)[0]
                    window = np.concatenate([window[:, 1:], [[[out[n], *row]]]], axis=1)
                    continue
                sample, scale = self._network.forecast(heard)
                loud = float(scale[0]) * float(swell.factor()[0])
                sample = sample + loud * self._heavy(noise[n], before, loud)
                swell.push(noise[n : n + 1])
                heard = self._network.push(heard, sample, torch.from_numpy(row[None].astype(np.float64)))
                out[n], before = float(sample[0]), row
        return out


def export(
    network: nn.Module,
    key: str,
    architecture: TenArchitecture,
    scaling: Scaling,
    windows: NDArray[np.float64],
    warm_start: NDArray[np.float64],
    card: dict[str, Any],
) -> Texture:
    """Return a trained network as a texture, its golden windows replayed through the engine that will render it.

    Args:
        network: on any device; not changed.
        key, architecture: which network it is.
        scaling: of the trace.
        windows: scaled windows to take the golden ones from, shape (b, m, 3).
        warm_start: scaled, shape (m, 3).
        card: what the training knows beyond model, sizes and scaling.

    Raises:
        ValueError: the engine does not reproduce the network.
    """
    tensors = {name: tensor.detach().cpu().numpy().copy() for name, tensor in network.state_dict().items()}
    # The reference reads the same rounded tensors that the file holds.
    predictor = TorchPredictor(network, architecture.history)
    picked = windows[np.linspace(0, len(windows) - 1, _N_GOLDEN).astype(int)]
    # Windows at rest and far outside the recording, where a wrong engine shows first.
    golden = np.concatenate([picked, np.zeros_like(picked[:1]), 4 * picked[:1]])
    condition = np.repeat(warm_start[-1:, 1:], 64, axis=0)
    condition[32:] = picked[0, -1, 1:]
    tensors["warm_start"] = warm_start
    tensors["golden.windows"] = golden
    tensors["golden.one_step"] = predictor.predict(golden)
    tensors["golden.condition"] = condition
    tensors["golden.closed_loop"] = predictor.closed_loop(warm_start, condition, gaussian(0, 0, 0, 64))
    if predictor.excited:
        tensors["golden.sigma"] = predictor.scale(golden)
    texture = Texture(
        card={
            "format_version": FORMAT_VERSION,
            "model": key,
            "sizes": sizes(architecture),
            "window": architecture.history,
            "units": {"acceleration": "m/s^2", "speed": "mm/s", "force": "N"},
            "scaling": {"mean": list(scaling.mean), "sd": list(scaling.sd)},
            **card,
        },
        tensors=tensors,
    )
    # Proved as it will be read: through the file's bytes.
    texture = texture_from_bytes(texture.to_bytes())
    prove(texture, engine_for(texture))
    return texture
