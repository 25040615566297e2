"""Sizes of models, whichever framework trains them and whichever engine runs them."""

from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar

MAX_WINDOW = 512  # samples that the kernel's networks are given
MAX_COUNT = 65536  # bounds what a damaged file can make a program allocate
MIN_COUNTS = {"window": 2, "ma": 0, "n_tones": 0, "n_bands": 2, "n_models": 3}
"""Of those that may be 0, or not 1."""

Shapes = dict[str, tuple[int | None, ...]]
"""Of tensors by name; None for any length."""


@dataclass(frozen=True)
class ModelSizes:
    """The sizes of one model, as its texture file has them; each is of its default's type."""

    window: int = 20  # m, samples that its network or filter is given
    max_window: ClassVar[int] = MAX_WINDOW
    predicts_samples: ClassVar[bool] = True  # False where a network filters noise
    bounded: ClassVar[bool] = False  # whether its closed loop is bounded without a saturator
    editable: ClassVar[bool] = False  # whether its level, spectrum and tones can be changed (`foten.editing`)
    has_linear_part: ClassVar[bool] = False  # whether a prediction without its network can be asked for
    learns_growth: ClassVar[bool] = False  # whether its fit learns how the level grows beyond the trained range

    def __post_init__(self) -> None:
        for field in fields(self):
            name, size = field.name, getattr(self, field.name)
            if type(field.default) is int:
                check_count(name, size, MIN_COUNTS.get(name, 1), self.max_window if name == "window" else MAX_COUNT)
            elif type(field.default) is bool and not isinstance(size, bool):
                raise ValueError(f"{name} is {shortened(size)}, expected true or false")

    @property
    def history(self) -> int:
        """Samples that a prediction is given."""
        return self.window

    @property
    def excited(self) -> bool:
        """Whether there is an excitation of its own."""
        return False

    def tensor_shapes(self) -> Shapes:
        """Name and shape of every tensor in a texture file; linear maps are (outputs, inputs)."""
        return {}

    def multiply_adds(self) -> int | None:
        """Multiplications and additions in pairs that a rendered sample costs; None where the card alone knows."""
        return None

    def to_card(self) -> dict[str, Any]:
        """The sizes as plain JSON values."""
        return {name: list(size) if isinstance(size, tuple) else size for name, size in asdict(self).items()}


def check_count(name: str, value: object, minimum: int, maximum: int = MAX_COUNT) -> None:
    """Refuse all but whole numbers from `minimum` to `maximum`, by default the largest of any model."""
    if type(value) is not int or value < minimum:
        raise ValueError(f"{name} is {shortened(value)}, expected a whole number, {minimum} or more")
    if value > maximum:
        raise ValueError(f"{name} is {shortened(value)}, expected {maximum} at most")


def check_heads(width: int, n_heads: int) -> None:
    """Refuse a width that heads cannot share."""
    if width % n_heads:
        raise ValueError(f"width {width} does not divide into {n_heads} heads")


def shortened(value: object) -> str:
    """A value for an error message, at most 40 characters of it."""
    try:
        text = repr(value)
    except ValueError:  # an integer of more digits than Python writes
        return "a number of thousands of digits"
    return text if len(text) <= 40 else text[:37] + "..."
