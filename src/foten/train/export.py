"""A trained network to a texture file, proved on its golden windows before it is written."""

from __future__ import annotations

import copy
import io
import math
import warnings
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from foten.architecture import GraphArchitecture, TenArchitecture, sizes
from foten.dsp.noise import Swell, gaussian
from foten.models.excited import Excited
from foten.models.foten_plus import FotenPlus
from foten.recording.scaling import Scaling
from foten.render.engine import engine_for
from foten.render.graph import GRAPH, INPUT, OUTPUT
from foten.render.synthesizer import prove
from foten.texture_file import FORMAT_VERSION, Texture, texture_from_bytes

_N_GOLDEN = 32


class TorchPredictor:
    """A network as a predictor in float64: the reference that every engine is held to."""

    def __init__(self, network: nn.Module, window: int, of_noise: bool = False) -> None:
        self.window, self._of_noise = window, of_noise
        self._network = copy.deepcopy(network).cpu().double().eval()
        self.excited = isinstance(network, FotenPlus | Excited)

    def predict(self, windows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        return self.ahead(windows)[:, 0]

    def ahead(self, windows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what the network says of the samples to come: windows (b, m, 3) scaled → (b, n_ahead) scaled."""
        with torch.no_grad():
            found = self._network(torch.from_numpy(np.ascontiguousarray(windows)))
        return found.reshape(len(windows), -1).numpy()

    def scale(self, windows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return by how much a unit of excitation moves the next samples: windows (b, m, 3) scaled → (b,) scaled."""
        with torch.no_grad():
            given = torch.from_numpy(np.ascontiguousarray(windows))
            if isinstance(self._network, Excited):
                unit = self._network.excitation(given[:, -1, 1:])
            else:
                unit = self._network.forecast(self._network.start(given))[1]
            return unit.numpy() * self._swell().factor()

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
            by_window = not isinstance(self._network, FotenPlus)
            heard = None if by_window else self._network.start(torch.from_numpy(window))
            before = window[0, -1, 1:]
            swell = self._swell() if self.excited else None
            coming: list[float] = []
            for n, row in enumerate(condition):
                if heard is None or swell is None:
                    coming = coming or self.ahead(window)[0].tolist()
                    out[n] = coming.pop(0)
                    if swell is not None:
                        loud = float(self._network.excitation(torch.from_numpy(window[:, -1, 1:]))[0])
                        loud *= float(swell.factor()[0])
                        out[n] += loud * self._heavy(noise[n], window[0, -1, 1:], loud)
                        swell.push(noise[n : n + 1])
                    seen = noise[n] if self._of_noise else out[n]
                    window = np.concatenate([window[:, 1:], [[[seen, *row]]]], axis=1)
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
    architecture: TenArchitecture | GraphArchitecture,
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
    alone = network.network if isinstance(network, Excited) else network
    tensors: dict[str, NDArray[Any]] = {}
    if architecture.in_graph:
        tensors[GRAPH] = graph_of(alone, architecture.history)
        cost = _multiply_adds(alone, architecture.history) // architecture.n_ahead
        card = {**card, "metrics": {**card["metrics"], "multiply_adds": cost}}
    else:
        tensors = _tensors_of(alone)
    if isinstance(network, Excited):
        tensors |= {f"excitation.{name}": t for name, t in _tensors_of(network.excitation).items()}
    # The reference reads the same rounded tensors that the file holds.
    predictor = TorchPredictor(network, architecture.history, architecture.of_noise)
    picked = windows[np.linspace(0, len(windows) - 1, _N_GOLDEN).astype(int)]
    # Windows at rest and far outside the recording, where a wrong engine shows first.
    golden = np.concatenate([picked, np.zeros_like(picked[:1]), 4 * picked[:1]])
    condition = np.repeat(warm_start[-1:, 1:], 64, axis=0)
    condition[32:] = picked[0, -1, 1:]
    if architecture.of_noise:  # without chance it is silent from the first sample on
        warm_start = warm_start * [0.0, 1.0, 1.0]
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


def _tensors_of(module: nn.Module) -> dict[str, NDArray[Any]]:
    return {name: tensor.detach().cpu().numpy().copy() for name, tensor in module.state_dict().items()}


def graph_of(network: nn.Module, m: int) -> NDArray[np.uint8]:
    """Return a network as the bytes of an ONNX graph, windows (b, m, 3) → (b,) or (b, n_ahead), float32."""
    file = io.BytesIO()
    network = copy.deepcopy(network).cpu().float().eval()
    with warnings.catch_warnings():
        # The exporter by tracing: the other takes fifteen seconds for what this does in half a one, and needs two packages more.
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            (torch.zeros(2, m, 3),),
            file,
            dynamo=False,
            opset_version=17,
            input_names=[INPUT],
            output_names=[OUTPUT],
            dynamic_axes={INPUT: {0: "b"}, OUTPUT: {0: "b"}},
        )
    return np.frombuffer(file.getvalue(), dtype=np.uint8)


def _multiply_adds(network: nn.Module, m: int) -> int:
    """Return what a sample costs in multiplications and additions in pairs."""
    # Without oneDNN, whose recurrent layers are one operation that nobody counts; and without what it says of other processors.
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with (
            torch.no_grad(),
            torch.backends.mkldnn.flags(enabled=False),
            FlopCounterMode(display=False) as counter,
        ):
            copy.deepcopy(network).cpu().float().eval().requires_grad_(False)(torch.zeros(1, m, 3))
    return int(counter.get_total_flops()) // 2
