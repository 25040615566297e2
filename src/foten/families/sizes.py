"""What every family of models says of itself, whichever framework trains it and whichever engine runs it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar

LONGEST_WINDOW = 512  # samples that the kernel's networks are given
LONGEST_GRAPH_WINDOW = 4096  # and a graph
LARGEST_COUNT = 65536  # bounds what a damaged file can make a program allocate

Shapes = dict[str, tuple[int, ...]]


@dataclass(frozen=True)
class Sizes:
    """The sizes of one model, as its texture file has them.

    Attributes:
        window: m, samples that its network or filter is given.
    """

    window: int = 20
    in_graph: ClassVar[bool] = False  # whether a file holds it as a graph for ONNX Runtime
    from_noise: ClassVar[bool] = False  # whether it makes samples from noise, and predicts none

    def __post_init__(self) -> None:
        check_count("window", self.window, 2, LONGEST_GRAPH_WINDOW if self.in_graph else LONGEST_WINDOW)

    @property
    def history(self) -> int:
        """Return how many samples a prediction is given."""
        return self.window

    @property
    def n_ahead(self) -> int:
        """Return how many samples a window gives."""
        return 1

    @property
    def excited(self) -> bool:
        """Return whether there is an excitation of its own."""
        return False

    def tensor_shapes(self) -> Shapes:
        """Return the name and shape of every tensor in a texture file; linear maps are (outputs, inputs)."""
        return {}

    def multiply_adds(self) -> int:
        """Return the multiplications and additions in pairs that a rendered sample costs.

        Raises:
            ValueError: it is run as a graph, whose card has them.
        """
        raise ValueError("what a graph costs is in its card, under metrics")

    def to_card(self) -> dict[str, Any]:
        """Return the sizes as plain JSON values."""
        return {name: list(size) if isinstance(size, tuple) else size for name, size in asdict(self).items()}


def sizes_from_card(kind: type[Sizes], model: str, card: Mapping[str, Any]) -> Sizes:
    """Return a family's sizes from a card.

    Raises:
        ValueError: a size is unknown or out of range.
    """
    known = [field.name for field in fields(kind)]
    unknown = sorted(set(card) - set(known))
    if unknown:
        raise ValueError(f"{model} has no size {unknown[0]!r}, expected one of {', '.join(known)}")
    return kind(**card)


def check_count(name: str, value: object, minimum: int, maximum: int = LARGEST_COUNT) -> None:
    """Refuse what is no whole number from `minimum` to `maximum`, by default the largest of any model."""
    if type(value) is not int or value < minimum:
        raise ValueError(f"{name} is {shortened(value)}, expected a whole number, {minimum} or more")
    if value > maximum:
        raise ValueError(f"{name} is {shortened(value)}, expected {maximum} at most")


def check_counts(sizes: Sizes, minimum: int = 1) -> None:
    """Refuse sizes of which one is no whole number from `minimum` on."""
    for field in fields(sizes):
        if field.type == "int" and field.name != "window":
            check_count(field.name, getattr(sizes, field.name), minimum)


def check_flag(name: str, value: object) -> None:
    """Refuse what is neither true nor false."""
    if not isinstance(value, bool):
        raise ValueError(f"{name} is {shortened(value)}, expected true or false")


def check_heads(width: int, n_heads: int) -> None:
    """Refuse a width that heads cannot share."""
    if width % n_heads:
        raise ValueError(f"width {width} does not divide into {n_heads} heads")


def shortened(value: object) -> str:
    """Return a value for an error message, at most 40 characters of it."""
    try:
        text = repr(value)
    except ValueError:  # an integer of more digits than Python writes
        return "a number of thousands of digits"
    return text if len(text) <= 40 else text[:37] + "..."
