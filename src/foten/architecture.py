"""The sizes of the networks, free of any framework: training and rendering both read them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class FotenArchitecture:
    """The paper's network, Sec. IV: a temporal and a Fourier branch, fused at the last token.

    Differs from the paper where it is silent: layers normalise before attention (Fig. 3 shows it so); the
    spectral branches are lifted from width 1 to `spectral_width` and projected back, since at the literal width 1 a layer
    normalisation outputs a constant and the branch carries nothing; all m bins are kept and Eq. 9 gives its real part.
    """

    window: int = 20  # m, samples; Sec. VI-b
    d_model: int = 32  # Sec. IV-c
    n_heads: int = 4  # Sec. IV-c
    n_layers: int = 3  # temporal encoder layers; Sec. IV-c
    d_feedforward: int = 128  # Sec. IV-c
    head: tuple[int, int] = (256, 64)  # dense layers before the output; Sec. IV-e
    dropout: float = 0.2  # Sec. IV-e
    spectral_width: int = 32  # 1 is the literal reading, and degenerate
    pre_norm: bool = True  # False normalises after each sub-layer, as [17]
    bin_embedding: bool = False  # a learned vector for each bin; the paper has none (Sec. IV-d)
    phase_input: str = "angle"  # or "cos_sin"

    def __post_init__(self) -> None:
        if self.window < 2:
            raise ValueError(f"window is {self.window} samples, expected 2 or more")
        if self.d_model % self.n_heads or (self.spectral_width > 1 and self.spectral_width % self.n_heads):
            raise ValueError(
                f"widths {self.d_model} and {self.spectral_width} do not divide into {self.n_heads} heads"
            )
        if self.phase_input not in ("angle", "cos_sin"):
            raise ValueError(f"phase_input is {self.phase_input!r}, expected 'angle' or 'cos_sin'")
        if not 0 <= self.dropout < 1:
            raise ValueError(f"dropout is {self.dropout}, expected from 0 to below 1")
        object.__setattr__(self, "head", tuple(self.head))


@dataclass(frozen=True)
class FotenPlusArchitecture(FotenArchitecture):
    """Ours: the same two branches and head, on a linear shortcut, and an excitation whose scale follows the hand.

    The network's output is a bounded correction of the shortcut's prediction.
    """

    dropout: float = 0.0  # the target is mostly noise already
    correction_limit: float = (
        3.0  # in standard deviations of the shortcut's error; |correction| stays below it
    )
    excitation_width: int = 16  # hidden units of log σ(speed, force)


ARCHITECTURES: dict[str, type[FotenArchitecture]] = {
    "foten": FotenArchitecture,
    "foten-plus": FotenPlusArchitecture,
}


def architecture_from(key: str, sizes: Mapping[str, Any]) -> FotenArchitecture:
    """Return the architecture that a card describes.

    Raises:
        ValueError: the model or a size is unknown, or a size is out of range.
    """
    if key not in ARCHITECTURES:
        raise ValueError(f"unknown model {key!r}, expected one of {', '.join(ARCHITECTURES)}")
    try:
        return ARCHITECTURES[key](**sizes)
    except TypeError as error:
        raise ValueError(f"the sizes of {key!r} do not fit: {error}") from error


def sizes(architecture: FotenArchitecture) -> dict[str, Any]:
    """Return the sizes as plain JSON values."""
    fields = asdict(architecture)
    return {**fields, "head": list(fields["head"])}
