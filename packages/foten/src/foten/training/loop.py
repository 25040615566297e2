"""The training loop: optimiser, gradients shared by threads, averaging, best weights, early stop."""

import copy
import math
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from foten.training.checkpoint import Checkpoint, Epoch, Progress
from foten.training.config import GradientConfig, LoopConfig

MOMENTUM = 0.95
BETAS = 0.9, 0.999  # of Adam, as published
MIN_SIDE = 4  # a matrix is wider and taller than that: of what is narrower little is left by orthogonalisation


class Optimiser:
    """Steps of all parameters, at a share of their learning rates.

    Matrices move along the orthogonal factor of their momentum, so that no direction is slow.

    PyTorch's own AdamW loads a compiler when it is made, which takes longer than an epoch.

    Source: Jordan et al., "Muon: an optimizer for hidden layers in neural networks" (2024), the iteration and its coefficients;
    Loshchilov & Hutter, "Decoupled weight decay regularization" (ICLR 2019), AdamW; for the paper's recipe Adam, Sec. IV-e.
    """

    def __init__(
        self, parameters: Mapping[str, nn.Parameter], config: GradientConfig, matrix_learning_rate: float = 0.0
    ) -> None:
        """Matrices are moved as the others where their learning rate is 0."""
        self._config, self._matrix_learning_rate = config, matrix_learning_rate
        self._matrices = {
            name: matrix
            for name, matrix in parameters.items()
            if matrix_learning_rate and matrix.ndim == 2 and min(matrix.shape) > MIN_SIDE
        }
        self._momentum = {name: torch.zeros_like(matrix) for name, matrix in self._matrices.items()}
        self._others = [parameter for name, parameter in parameters.items() if name not in self._matrices]
        sizes = [parameter.numel() for parameter in self._others]
        self._moments, (self._gradient, self._direction) = self._others[0].new_zeros(2, 2, sum(sizes))
        self._gradients, self._directions = (
            [part.view_as(parameter) for part, parameter in zip(flat.split(sizes), self._others, strict=True)]
            for flat in (self._gradient, self._direction)
        )
        self._n_steps = 0

    def step(self, rate: float) -> None:
        """Take a step with the gradients that there are, at a share of the highest learning rates."""
        config = self._config
        self._step_of_others(config.learning_rate * rate)
        directions = []
        for name, matrix in self._matrices.items():
            momentum = self._momentum[name].mul_(MOMENTUM).add_(matrix.grad)
            directions.append(matrix.grad.add(momentum, alpha=MOMENTUM))
        with torch.no_grad():
            for matrix, direction in zip(self._matrices.values(), orthogonalised(directions), strict=True):
                tall = max(1.0, matrix.shape[-2] / matrix.shape[-1]) ** 0.5
                matrix.mul_(1 - config.learning_rate * rate * config.weight_decay)
                matrix.sub_(direction, alpha=self._matrix_learning_rate * rate * tall)

    @torch.no_grad()
    def _step_of_others(self, rate: float) -> None:
        self._n_steps += 1
        torch._foreach_copy_(self._gradients, [parameter.grad for parameter in self._others])
        means, squares = self._moments
        means.lerp_(self._gradient, 1 - BETAS[0])
        squares.lerp_(self._gradient * self._gradient, 1 - BETAS[1])
        first, second = (moment / (1 - beta**self._n_steps) for moment, beta in zip(self._moments, BETAS, strict=True))
        torch.div(first, second.sqrt_().add_(self._config.adam_epsilon), out=self._direction)
        if self._config.weight_decay:
            torch._foreach_mul_(self._others, 1 - rate * self._config.weight_decay)
        torch._foreach_sub_(self._others, self._directions, alpha=rate)

    def state_dict(self) -> dict[str, Any]:
        return {"moments": self._moments, "n_steps": self._n_steps, "momentum": self._momentum}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        self._moments.copy_(state["moments"])
        self._n_steps = state["n_steps"]
        for name, momentum in state["momentum"].items():
            self._momentum[name].copy_(momentum)


@torch.no_grad()
def orthogonalised(matrices: Sequence[Tensor]) -> list[Tensor]:
    """Approximate orthogonal factors of matrices: (…, a, b) each → singular values of 0.7 to 1.2.

    Five steps of Newton and Schulz's iteration in its quintic form; matrices of one shape are batched.
    """
    a, b, c = 3.4445, -4.7750, 2.0315  # pushes singular values towards 1
    wide = [x.mT if x.shape[-2] > x.shape[-1] else x for x in matrices]
    out = [torch.empty(0)] * len(wide)
    for shape in {x.shape[-2:] for x in wide}:
        alike = [i for i, x in enumerate(wide) if x.shape[-2:] == shape]
        x = torch.cat([wide[i].reshape(-1, *shape) for i in alike])
        x = x / (x.norm(dim=(-2, -1), keepdim=True) + 1e-7)
        for _ in range(5):
            gram = x @ x.mT
            x = torch.baddbmm(x, torch.baddbmm(gram, gram, gram, beta=b, alpha=c), x, beta=a)
        for i, product in zip(alike, x.split([wide[i].numel() // shape.numel() for i in alike]), strict=True):
            factor = product.reshape(wide[i].shape)
            out[i] = factor.mT if wide[i].shape != matrices[i].shape else factor
    return out


@dataclass(frozen=True)
class Loop:
    """Network of a loop, and its steps."""

    name: str  # in a checkpoint
    network: nn.Module  # trained in place, left at its lowest validation loss
    n_steps: int  # of an epoch
    step: Callable[[int, int], Tensor]  # moves the weights at epoch 1, 2, … and step 0, 1, …, and gives the loss
    # Validation loss, and the error of the log (`Epoch.validation_mae`).
    validate: Callable[[nn.Module], tuple[float, float]]
    parts: Mapping[str, Any]  # of a checkpoint, beside the network: what has a `state_dict`
    # Decay of the exponential moving average of the weights, which is what is validated and kept; 0 for none.
    averaging: float = 0.0
    trial: tuple[int, float] | None = None  # epochs in which the error has to fall by at least this share


@dataclass(frozen=True)
class Monitor:
    """Callbacks of a training while it runs, and its checkpoint."""

    on_stage: Callable[[str], None] = lambda stage: None
    on_epoch: Callable[[Epoch], None] = lambda epoch: None
    on_playable: Callable[[Any], None] = lambda texture: None  # a valid texture, long before its network is fitted
    checkpoint: Checkpoint | None = None  # to go on from, and written after each epoch


def run_loop(loop: Loop, config: LoopConfig, monitor: Monitor) -> Progress:
    """Epochs until there are enough, none gains, or Ctrl-C; the network is left at its best, epoch 0 included.

    Raises:
        ValueError: a loss is not finite, or the checkpoint is another run's.
        KeyboardInterrupt: before anything was validated.
    """
    network, on_epoch = loop.network, monitor.on_epoch
    averaged = copy.deepcopy(network) if loop.averaging else network
    parts = {"network": network, **({"averaged": averaged} if loop.averaging else {}), **loop.parts}
    progress = Progress() if monitor.checkpoint is None else monitor.checkpoint.load(loop.name, parts)
    for line in progress.epochs:
        on_epoch(line)

    def train(epoch: int) -> float:
        network.train()
        total: Tensor | float = 0.0
        for number in range(loop.n_steps):
            total = total + loop.step(epoch, number)
            if loop.averaging:
                n = loop.n_steps * (epoch - 1) + number + 1
                _average(averaged, network, min(loop.averaging, n / (n + 9)))
        return float(total) / loop.n_steps

    def finish(epoch: int, train_loss: float, started: float) -> None:
        averaged.eval()
        loss, error = loop.validate(averaged)
        progress.add(averaged, epoch, train_loss, loss, error, time.perf_counter() - started)
        on_epoch(progress.epochs[-1])

    try:
        if not progress.epochs:
            finish(0, math.nan, time.perf_counter())
        for epoch in range(len(progress.epochs), config.epochs + 1):
            if not progress.best_state or not should_continue(progress, config.patience, loop.trial):
                break
            started = time.perf_counter()
            finish(epoch, train(epoch), started)
            if not math.isfinite(progress.epochs[-1].train_loss):
                raise ValueError("the training loss is not finite; is the acceleration full of outliers?")
            if monitor.checkpoint is not None:
                monitor.checkpoint.save(loop.name, parts, progress)
    except KeyboardInterrupt:
        if not progress.best_state:
            raise
        progress.interrupted = True
    if not progress.best_state:
        raise ValueError("the validation loss is not finite; is the acceleration full of outliers?")
    network.load_state_dict(progress.best_state)
    network.eval()
    return progress


def should_continue(progress: Progress, patience: int, trial: tuple[int, float] | None = None) -> bool:
    """False after `patience` epochs without a better loss, or, with a note, after a trial that failed (`Loop.trial`)."""
    epoch, first = progress.epochs[-1].epoch, progress.epochs[0].validation_mae
    if epoch - progress.best.epoch >= patience:
        return False
    gain = 1 - min(line.validation_mae for line in progress.epochs) / first if first > 0 else 0.0
    if trial is None or epoch != trial[0] or gain >= trial[1]:
        return True
    progress.notes.append(
        f"the network gains {100 * gain:.2f} % on the validation blocks in {epoch} epochs, less than "
        f"{100 * trial[1]:g} %: its training stops there"
    )
    return False


@torch.no_grad()
def _average(averaged: nn.Module, network: nn.Module, share: float) -> None:
    for mean, weight in zip(averaged.parameters(), network.parameters(), strict=True):
        mean.lerp_(weight, 1 - share)


def gradient_step(
    network: nn.Module,
    optimiser: Optimiser,
    gradients: Callable[[int, int], tuple[Tensor, Sequence[Tensor]]],
    clip_norm: float,
    rate: Callable[[int, int], float],
) -> Callable[[int, int], Tensor]:
    """A step down a loss: its gradients, clipped, taken by the optimiser at the schedule's rate.

    Args:
        gradients: loss and its gradients by parameter at an epoch's step.
        rate: share of the highest learning rate at an epoch's step.
    """
    parameters = list(network.parameters())

    def step(epoch: int, number: int) -> Tensor:
        loss, values = gradients(epoch, number)
        for parameter, gradient in zip(parameters, values, strict=True):
            parameter.grad = gradient
        if clip_norm > 0:
            nn.utils.clip_grad_norm_(parameters, clip_norm)
        optimiser.step(rate(epoch, number))
        return loss

    return step


def shared_gradients(
    parameters: Sequence[nn.Parameter], pool: ThreadPoolExecutor, loss_of_share: Callable[[int], Tensor], n_shares: int
) -> tuple[Tensor, list[Tensor]]:
    """Loss and gradients, of the losses of share 0 … n_shares − 1, whose sum is the batch's, added in that order."""

    def gradients(share: int) -> tuple[Tensor, tuple[Tensor, ...]]:
        loss = loss_of_share(share)
        return loss.detach(), torch.autograd.grad(loss, parameters)

    if n_shares == 1:  # a change of threads takes as long as an operation
        loss, (*values,) = gradients(0)
        return loss, values
    losses, pieces = zip(*pool.map(gradients, range(n_shares)), strict=True)
    return torch.stack(losses).sum(), [sum(others, start=first) for first, *others in zip(*pieces, strict=True)]


def schedule(config: GradientConfig, n_steps: int) -> Callable[[int, int], float]:
    """Learning rate over its highest at an epoch's step: a linear rise over the first tenth of all steps, then half a cosine."""
    n_all = n_steps * config.epochs
    rise = max(1, n_all // 10)

    def rate(epoch: int, number: int) -> float:
        step = n_steps * (epoch - 1) + number
        if config.schedule == "constant":
            return 1.0
        return (step + 1) / rise if step < rise else 0.5 * (1 + math.cos(math.pi * ((step - rise) / (n_all - rise))))

    return rate


def epoch_seed(seed: int, epoch: int) -> int:
    """Seed of what an epoch draws, so that a resumed run draws the same."""
    return seed * 100_003 + epoch


def pick_device() -> torch.device:
    """The GPU where there is one, else the CPU."""
    return torch.device("cuda" if torch.cuda.is_available() else "cpu")


def device_name() -> str:
    """Name of the device that networks train on."""
    return torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu"
