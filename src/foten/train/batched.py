"""Several networks of one architecture fitted as one batched model: few large operations in place of many small ones.

Each sees what `fit` would show it, in the same order and under the same masks, and stops when it would; sums are taken in
another order, so the weights differ by rounding. Worth its while for small batches of many textures (benchmarks/batched.py).
"""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.func import functional_call, grad_and_value, stack_module_state, vmap

from foten.networks.dropout import mask, masks_from, set_dropout
from foten.train.config import TrainConfig
from foten.train.epochs import Progress, goes_on
from foten.train.fit import DeviceWindows, TrainingWindows, epoch_seed, loss_of, mask_seed, masks_of, rate_of, validated
from foten.train.optimiser import Optimiser

BATCHED = ("foten", "ten", "ten-mfcc", "ten-wavelet", "foten-d", "fnn")
"""Models that are faster so; those with recurrent layers would be taken apart again."""


@dataclass
class _Texture:
    """One of the networks, and what it is fitted to."""

    network: nn.Module
    config: TrainConfig
    data: DeviceWindows
    progress: Progress
    error: ValueError | None = None


def fit_batched(
    networks: Sequence[nn.Module], data: Sequence[TrainingWindows], configs: Sequence[TrainConfig]
) -> list[Progress | ValueError]:
    """Train networks in place, each to its best validation loss, as `fit` does; return each log, or why it could not be fitted.

    The networks are of one architecture, windows (b, m, c) → (b,), on one device.

    Raises:
        ValueError: their configurations differ in more than the seed, or have threads, or there are more windows of one.
    """
    config = configs[0]
    alike = {(repr({**vars(one), "seed": 0}), len(of.train)) for one, of in zip(configs, data, strict=True)}
    if len(alike) > 1 or config.threads > 1:
        raise ValueError("networks are fitted as one model by one recipe, one thread and as many windows each")
    textures = [
        _Texture(network, one, DeviceWindows(of, network), Progress())
        for network, of, one in zip(networks, data, configs, strict=True)
    ]
    criterion = loss_of(config)

    def validate(texture: _Texture, epoch: int, train_loss: float, seconds: float) -> None:
        started = time.perf_counter()
        loss, error = validated(texture.network, texture.data, criterion)
        seconds += time.perf_counter() - started
        texture.progress.add(texture.network, epoch, train_loss, loss, error, seconds)
        if (epoch and not math.isfinite(train_loss)) or not texture.progress.best_state:
            texture.error = ValueError("a loss is not finite; is the acceleration full of outliers?")

    for texture in textures:
        set_dropout(texture.network, config.dropout)
        validate(texture, 0, math.nan, 0.0)
    stack = _Stack(textures, config, criterion)
    for epoch in range(1, config.epochs + 1):
        live = [texture.error is None and goes_on(texture.progress, config) for texture in stack.textures]
        if not any(live):
            break
        if not all(live):
            stack.keep(live)
        started = time.perf_counter()
        losses = stack.epoch(epoch)
        each = (time.perf_counter() - started) / len(losses)
        for texture, loss in zip(stack.textures, losses, strict=True):
            validate(texture, epoch, loss, each)
    for texture in textures:
        if texture.error is None:
            texture.network.load_state_dict(texture.progress.best_state)
            texture.network.eval()
    return [texture.error or texture.progress for texture in textures]


class _Stack:
    """The weights of several networks in one tensor a parameter, of which each network's own are views, and their optimiser."""

    def __init__(
        self, textures: list[_Texture], config: TrainConfig, criterion: Callable[[Tensor, Tensor], Tensor]
    ) -> None:
        self.textures, self._config, self._device = textures, config, textures[0].data.device
        self._shapes: dict[int, list[torch.Size]] = {}
        self._share()
        self._optimiser = Optimiser(self._weights, config, stacked=True)

        def loss(
            weights: dict[str, Tensor], fixed: dict[str, Tensor], windows: Tensor, target: Tensor, masks: list[Tensor]
        ) -> Tensor:
            in_turn = iter(masks)
            with masks_from(lambda *_: next(in_turn)):
                return criterion(functional_call(self.textures[0].network, (weights, fixed), (windows,)), target)

        self._gradients = vmap(grad_and_value(loss))

    def _share(self) -> None:
        weights, self._fixed = stack_module_state([texture.network for texture in self.textures])
        self._weights = {name: nn.Parameter(weight.detach()) for name, weight in weights.items()}
        for k, texture in enumerate(self.textures):
            for name, parameter in texture.network.named_parameters():
                parameter.data = self._weights[name].data[k]

    def keep(self, kept: Sequence[bool]) -> None:
        """Go on with some of the networks alone; the others have what weights they have."""
        self.textures = list(itertools.compress(self.textures, kept))
        self._share()
        self._optimiser = self._optimiser.keep(self._weights, torch.tensor(kept, device=self._device))

    def epoch(self, epoch: int) -> list[float]:
        """Train all for an epoch, and return the mean loss of each."""
        seeds = [texture.config.seed for texture in self.textures]
        for texture in self.textures:
            texture.network.train()
        orders = torch.stack([one.data.shuffled(seed, epoch) for one, seed in zip(self.textures, seeds, strict=True)])
        # Of masks on a GPU, where one generator draws a whole epoch's, as `fit` has it there.
        of_epoch = [torch.Generator(self._device).manual_seed(epoch_seed(seed, epoch)) for seed in seeds]
        total = torch.zeros(len(seeds), device=self._device)
        for number, batch in enumerate(orders.split(self._config.batch, dim=1)):
            of_step = [masks_of(mask_seed(seed, epoch, number), self._device) for seed in seeds]
            generators = [one or common for one, common in zip(of_step, of_epoch, strict=True)]
            rate = rate_of(self._config, orders.shape[1], epoch, number)
            total += self._step(batch, generators, rate) * batch.shape[1]
        return [float(one) / orders.shape[1] for one in total]

    def _step(self, batch: Tensor, generators: list[torch.Generator], rate: float) -> Tensor:
        """Take a step of all networks on a batch of each, (n, b) sample numbers, and return their losses."""
        samples = [(texture.data, n) for texture, n in zip(self.textures, batch, strict=True)]
        windows = torch.stack([data.windows(n) for data, n in samples])
        targets = torch.stack([data.target[n] for data, n in samples])
        weights = {name: weight.detach() for name, weight in self._weights.items()}
        gradients, losses = self._gradients(weights, self._fixed, windows, targets, self._masks(windows, generators))
        limit = self._config.clip_norm
        if limit > 0:  # each network's own, as `torch.nn.utils.clip_grad_norm_`
            squares = torch.stack([one.flatten(1).square().sum(1) for one in gradients.values()])
            scale = (limit / (squares.sum(0).sqrt() + 1e-6)).clamp(max=1.0)
            gradients = {name: one * scale.view(-1, *[1] * (one.ndim - 1)) for name, one in gradients.items()}
        for name, weight in self._weights.items():
            weight.grad = gradients[name]
        self._optimiser.step(rate)
        return losses.detach()

    def _masks(self, windows: Tensor, generators: list[torch.Generator]) -> list[Tensor]:
        """Return the masks of dropout, (n, …) each, drawn for each network as if it were alone."""
        p, b = self._config.dropout, windows.shape[1]
        if p == 0:
            return []
        if b not in self._shapes:
            shapes = self._shapes[b] = []

            def noted(shape: torch.Size, device: torch.device, p: float) -> Tensor:
                shapes.append(shape)
                return mask(shape, device, p)

            with masks_from(noted), torch.no_grad():
                self.textures[0].network(windows[0])
        drawn = [[mask(shape, self._device, p, one) for shape in self._shapes[b]] for one in generators]
        return [torch.stack(masks) for masks in zip(*drawn, strict=True)]
