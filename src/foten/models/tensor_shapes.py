"""The random part of a family: a scale over speed and force, heavy tails, volatility; or a network of innovations.

Source: `docs/fidelity.md`; the paper has none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from foten.models.model_sizes import Shapes, Sizes

N_INNOVATION_INPUTS = 5  # of a network of innovations: one and its size, the sample, log speed and log force
HEAVIEST_TAIL = 0.25  # of h in z·exp(h z²/2); beyond it there is no fourth moment


@dataclass(frozen=True)
class WithExcitation(Sizes):
    """A one-step model that may have the excitation of foten-plus; none of the sources has one."""

    excitation: bool = False  # whether it has
    excitation_width: int = 16  # hidden units of log σ over speed and force

    @property
    def excited(self) -> bool:
        """Return whether there is an excitation."""
        return self.excitation

    def tensor_shapes(self) -> Shapes:
        """Return those of the excitation, where there is one."""
        return excitation_shapes(self.excitation_width) if self.excitation else {}

    def to_card(self) -> dict[str, Any]:
        """Return the sizes as plain JSON values; nothing of an excitation where there is none."""
        kept = super().to_card().items()
        return {name: size for name, size in kept if self.excitation or not name.startswith("excitation")}


def innovation_shapes(name: str, inputs: int, n_hidden: int, head_width: int, n_components: int) -> Shapes:
    """Return the tensors of a network of innovations."""
    h, width = n_hidden, head_width
    recurrent = {"weight_ih": (3 * h, inputs), "weight_hh": (3 * h, h), "bias_ih": (3 * h,), "bias_hh": (3 * h,)}
    shapes: Shapes = {f"{name}.recurrent.{part}_l0": shape for part, shape in recurrent.items()}
    return (
        shapes
        | linear_shapes(f"{name}.head", width, h + inputs)
        | linear_shapes(f"{name}.out", 3 * n_components, width)
    )


def innovation_cost(inputs: int, n_hidden: int, head_width: int, n_components: int) -> int:
    """Return the multiply-adds of a step of a network of innovations."""
    return 3 * n_hidden * (inputs + n_hidden) + head_width * (n_hidden + inputs) + 3 * n_components * head_width


def excitation_shapes(width: int) -> Shapes:
    """Return the tensors of an excitation."""
    shapes = scale_shapes("excitation", width) | linear_shapes("excitation.tail", 1, 5)
    return shapes | {"excitation.largest": (2,), "excitation.volatility": (2,)}


def scale_shapes(name: str, width: int) -> Shapes:
    """Return the tensors of a standard deviation over speed and force."""
    shapes = linear_shapes(f"{name}.hidden", width, 4) | linear_shapes(f"{name}.out", 1, width)
    shapes |= {f"{name}.power_law.weight": (1, 5), f"{name}.highest": (1,)}
    return shapes | {f"{name}.{part}": (2,) for part in ("mean", "sd", "floor")}


def scale_cost(width: int) -> int:
    """Return the multiply-adds of one scale at one speed and force."""
    return 6 * width + 5


def linear_shapes(name: str, outputs: int, inputs: int) -> Shapes:
    """Return the tensors of a linear map."""
    return {f"{name}.weight": (outputs, inputs), f"{name}.bias": (outputs,)}
