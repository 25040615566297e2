"""The excitation's part of a family: a scale over speed and force, heavy tails, volatility.

Source: `docs/fidelity.md`; the paper has none.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from foten.families.sizes import Shapes, Sizes

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
