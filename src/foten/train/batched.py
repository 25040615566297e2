"""Several networks of one architecture fitted as one batched model: few large operations in place of many small ones.

Each sees what `fit` would show it, in the same order and under the same masks, and stops when it would; sums are taken in
another order, so the weights differ by rounding. Worth its while for small batches of many textures (benchmarks/batched.py).
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn
from torch.func import functional_call, grad_and_value, stack_module_state, vmap

from foten.networks.dropout import mask, masks_from, set_dropout
from foten.recording.windows import window_indices
from foten.train.config import TrainConfig
from foten.train.epochs import Epoch, Progress, goes_on
from foten.train.fit import TrainingWindows, epoch_seed, loss_of, mask_seed, masks_of, order_of, schedule_of, validated
from foten.train.optimiser import Optimiser

BATCHED = ("foten", "foten-plus", "ten", "ten-mfcc", "ten-wavelet", "foten-d", "fnn")
"""Models that are faster so; those with recurrent layers would be taken apart again."""


@dataclass
class _Texture:
    """One of the networks, and what it is fitted to, on its device."""

    network: nn.Module
    config: TrainConfig
    samples: Tensor
    goal: Tensor
    unit: Tensor
    train: Tensor
    validation: Tensor
    progress: Progress
    error: ValueError | None = None


def fit_batched(
    networks: Sequence[nn.Module], data: Sequence[TrainingWindows], configs: Sequence[TrainConfig]
) -> list[Progress | ValueError]:
    """Train networks in place and leave each at its best validation loss, as `fit` does one by one.

    Args:
        networks: of one architecture, windows (b, m, c) → (b,), on one device.
        data: what each is fitted to, with as many training windows as the others.
        configs: alike but for their seeds; of one thread.

    Returns:
        The log of each, or why it could not be fitted.

    Raises:
        ValueError: they do not fit together.
    """
    config, n_train = configs[0], len(data[0].train)
    alike = {(repr({**vars(one), "seed": 0}), len(of.train)) for one, of in zip(configs, data, strict=True)}
    if len(alike) > 1 or config.threads > 1:
        raise ValueError("networks are fitted as one model by one recipe, one thread and as many windows each")
    device, m = next(networks[0].parameters()).device, data[0].window
    offsets = torch.from_numpy(window_indices(np.zeros(1, dtype=np.int64), m)).to(device)
    textures = [_of_device(network, of, one, device) for network, of, one in zip(networks, data, configs, strict=True)]
    criterion = loss_of(config)
    steps = max(1, math.ceil(n_train / config.batch))
    rate = schedule_of(config, steps * max(1, config.epochs))

    def validate(texture: _Texture, epoch: int, train_loss: float, seconds: float) -> None:
        def windows(n: Tensor) -> Tensor:
            return texture.samples[n[:, None] + offsets]

        started = time.perf_counter()
        loss, error = validated(texture.network, windows, texture.goal, texture.unit, texture.validation, criterion)
        progress = texture.progress
        best = loss < progress.best_loss
        if best:
            progress.best_loss = loss
            state = texture.network.state_dict().items()
            progress.best_state = {name: tensor.detach().clone() for name, tensor in state}
        seconds += time.perf_counter() - started
        progress.epochs.append(Epoch(epoch, train_loss, loss, error, seconds, best))
        if (epoch and not math.isfinite(train_loss)) or not progress.best_state:
            texture.error = ValueError("a loss is not finite; is the acceleration full of outliers?")

    for texture in textures:
        set_dropout(texture.network, config.dropout)
        validate(texture, 0, math.nan, 0.0)
    live = [texture for texture in textures if texture.error is None]
    stack = _Stack(live, config, rate, criterion, offsets) if live else None
    for epoch in range(1, config.epochs + 1):
        going = [k for k, texture in enumerate(live) if texture.error is None and goes_on(texture.progress, config)]
        if not going or stack is None:
            break
        if len(going) < len(live):
            live = [live[k] for k in going]
            stack.leave(going, live)
        started = time.perf_counter()
        losses = stack.epoch(epoch)
        each = (time.perf_counter() - started) / len(live)
        for texture, loss in zip(live, losses, strict=True):
            validate(texture, epoch, loss, each)
    for texture in textures:
        if texture.error is None:
            texture.network.load_state_dict(texture.progress.best_state)
            texture.network.eval()
    return [texture.error or texture.progress for texture in textures]


def _of_device(network: nn.Module, data: TrainingWindows, config: TrainConfig, device: torch.device) -> _Texture:
    samples = torch.from_numpy(data.samples).to(device, torch.float32)
    goal = samples[:, 0] if data.target is None else torch.from_numpy(data.target).to(device, torch.float32)
    unit = torch.ones(len(samples)) if data.unit is None else torch.from_numpy(data.unit)
    train, validation = (torch.from_numpy(n).to(device) for n in (data.train, data.validation))
    unit = unit.to(device, torch.float32)
    return _Texture(network, config, samples, goal, unit, train, validation, Progress())


class _Stack:
    """The weights of several networks in one tensor a parameter, of which each network's own are views, and their optimiser."""

    def __init__(
        self,
        textures: Sequence[_Texture],
        config: TrainConfig,
        rate: Callable[[int], float],
        criterion: Callable[[Tensor, Tensor], Tensor],
        offsets: Tensor,
    ) -> None:
        self._textures, self._config, self._rate, self._offsets = textures, config, rate, offsets
        self._device = offsets.device
        self._n_steps = 0
        self._shapes: dict[int, list[torch.Size]] = {}
        self._generators: list[torch.Generator] = []
        weights, self._fixed = stack_module_state([texture.network for texture in textures])
        self._weights = {name: nn.Parameter(weight.detach()) for name, weight in weights.items()}
        self._share()
        self._optimiser = Optimiser(self._weights, config, stacked=True)

        def loss(
            weights: dict[str, Tensor], fixed: dict[str, Tensor], windows: Tensor, goal: Tensor, masks: list[Tensor]
        ) -> Tensor:
            in_turn = iter(masks)
            with masks_from(lambda *_: next(in_turn)):
                return criterion(functional_call(self._textures[0].network, (weights, fixed), (windows,)), goal)

        self._gradients = vmap(grad_and_value(loss))

    def _share(self) -> None:
        for k, texture in enumerate(self._textures):
            for name, parameter in texture.network.named_parameters():
                parameter.data = self._weights[name].data[k]

    def leave(self, kept: Sequence[int], textures: Sequence[_Texture]) -> None:
        """Go on with those networks alone; the others have what weights they have."""
        remaining = torch.tensor(kept, device=self._device)
        self._textures = textures
        self._fixed = {name: fixed[remaining] for name, fixed in self._fixed.items()}
        self._weights = {name: nn.Parameter(weight.data[remaining]) for name, weight in self._weights.items()}
        self._share()
        self._optimiser = self._optimiser.keep(self._weights, remaining)

    def epoch(self, epoch: int) -> list[float]:
        """Train all for an epoch, and return the mean loss of each."""
        for texture in self._textures:
            texture.network.train()
        orders = torch.stack(
            [one.train[order_of(len(one.train), one.config.seed, epoch).to(self._device)] for one in self._textures]
        )
        # Of masks on a GPU, where one generator draws a whole epoch's, as `fit` has it there.
        self._generators = [
            torch.Generator(self._device).manual_seed(epoch_seed(one.config.seed, epoch)) for one in self._textures
        ]
        total = torch.zeros(len(self._textures), device=self._device)
        for number, batch in enumerate(orders.split(self._config.batch, dim=1)):
            total += self._step(batch, epoch, number) * batch.shape[1]
        return [float(one) / orders.shape[1] for one in total]

    def _step(self, batch: Tensor, epoch: int, number: int) -> Tensor:
        """Take a step of all networks on a batch of each, (n, b) sample numbers, and return their losses."""
        of = list(zip(self._textures, batch, strict=True))
        windows = torch.stack([one.samples[n[:, None] + self._offsets] for one, n in of])
        goals = torch.stack([one.goal[n] for one, n in of])
        seeds = [mask_seed(one.config.seed, epoch, number) for one in self._textures]
        weights = {name: weight.detach() for name, weight in self._weights.items()}
        gradients, losses = self._gradients(weights, self._fixed, windows, goals, self._masks(windows, seeds))
        limit = self._config.clip_norm
        if limit > 0:  # each network's own, as `torch.nn.utils.clip_grad_norm_`
            squares = torch.stack([one.flatten(1).square().sum(1) for one in gradients.values()])
            scale = (limit / (squares.sum(0).sqrt() + 1e-6)).clamp(max=1.0)
            gradients = {name: one * scale.view(-1, *[1] * (one.ndim - 1)) for name, one in gradients.items()}
        for name, weight in self._weights.items():
            weight.grad = gradients[name]
        self._optimiser.step(self._rate(self._n_steps))
        self._n_steps += 1
        return losses.detach()

    def _masks(self, windows: Tensor, seeds: Sequence[int]) -> list[Tensor]:
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
                self._textures[0].network(windows[0])
        drawn = []
        for seed, of_epoch in zip(seeds, self._generators, strict=True):
            generator = masks_of(seed, self._device) or of_epoch
            drawn.append([mask(shape, self._device, p, generator) for shape in self._shapes[b]])
        return [torch.stack(masks) for masks in zip(*drawn, strict=True)]
