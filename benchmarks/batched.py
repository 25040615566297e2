"""Several textures trained as one batched model, beside one after another: time of a step for each texture.

    python benchmarks/batched.py [--model foten] [--textures 1,2,4,8] [--steps 10]

One model holds the weights of all textures, stacked (`torch.func`), and a step takes a batch of windows of each: few large
operations in place of many small ones. Both ways take the same gradients, which is checked first, and one optimiser step; one
thread. Where a GPU is there, it is measured too. Prints ratios of the same run.
"""

from __future__ import annotations

import argparse
import os
import statistics
import time
from collections.abc import Callable, Sequence

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import torch
from torch import Tensor, nn
from torch.func import functional_call, grad, stack_module_state, vmap

from foten.architecture import ARCHITECTURES
from foten.models import build
from foten.train.fit import reproducible

WARM, TURNS = 3, 4  # steps that are not counted, and rounds in which both ways are measured


def both_ways(key: str, n: int, batch: int, device: str) -> tuple[Callable[[], None], Callable[[], None]]:
    """Return a step of one of n networks alone, and of all as one, from the same weights on the same windows."""
    torch.manual_seed(0)
    m = ARCHITECTURES[key]().window
    networks = [build(key, ARCHITECTURES[key]()).to(device).train() for _ in range(n)]
    windows, targets = torch.randn(n, batch, m, 3, device=device), torch.randn(n, batch, device=device)
    stacked, buffers = stack_module_state(networks)
    weights = {name: tensor.detach() for name, tensor in stacked.items()}
    criterion = nn.HuberLoss(delta=1.6)

    def loss_of(one: dict[str, Tensor], fixed: dict[str, Tensor], given: Tensor, target: Tensor) -> Tensor:
        return criterion(functional_call(networks[0], (one, fixed), (given,)), target)

    gradients = vmap(grad(loss_of))

    def loss(k: int) -> Tensor:
        return criterion(networks[k](windows[k]), targets[k])

    at_once = gradients(weights, buffers, windows, targets)
    for k, network in enumerate(networks):
        alone = torch.autograd.grad(loss(k), list(network.parameters()))
        for (name, _), found in zip(network.named_parameters(), alone, strict=True):
            torch.testing.assert_close(at_once[name][k], found, rtol=1e-3, atol=1e-5)

    own = torch.optim.AdamW(networks[0].parameters(), fused=True)
    trained = {name: nn.Parameter(tensor.clone()) for name, tensor in weights.items()}
    together = torch.optim.AdamW(trained.values(), fused=True)

    def alone_step() -> None:
        parameters = list(networks[0].parameters())
        for parameter, found in zip(parameters, torch.autograd.grad(loss(0), parameters), strict=True):
            parameter.grad = found
        own.step()

    def batched() -> None:
        found = gradients(
            {name: parameter.detach() for name, parameter in trained.items()}, buffers, windows, targets
        )
        for name, parameter in trained.items():
            parameter.grad = found[name]
        together.step()

    return alone_step, batched


def seconds(ways: Sequence[Callable[[], None]], n: int, device: str) -> list[float]:
    """Return the median time of a step of each way, which take turns of n steps, as a sweep takes one texture for long."""
    times: list[list[float]] = [[] for _ in ways]
    for _ in range(TURNS):
        for step, found in zip(ways, times, strict=True):
            for i in range(WARM + n):
                started = time.perf_counter()
                step()
                if device == "cuda":
                    torch.cuda.synchronize()
                if i >= WARM:
                    found.append(time.perf_counter() - started)
    return [statistics.median(found) for found in times]


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--model", default="foten", choices=[key for key in ARCHITECTURES if key != "ar"])
    parser.add_argument(
        "--textures", type=lambda text: [int(n) for n in text.split(",")], default=[1, 2, 4, 8]
    )
    parser.add_argument("--steps", type=int, default=10)
    arguments = parser.parse_args()
    print("| device | batch | textures | one after another [ms a texture] | as one [ms a texture] | ratio |")
    print("|---|---|---|---|---|---|")
    with reproducible():
        for device in ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]:
            for batch in (16, 128):
                for n in arguments.textures:
                    a, together = seconds(
                        both_ways(arguments.model, n, batch, device), arguments.steps, device
                    )
                    b = together / n
                    print(
                        f"| {device} | {batch} | {n} | {1000 * a:.2f} | {1000 * b:.2f} | {b / a:.2f} |",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
