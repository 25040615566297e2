"""FoTEN, the paper's network (Sec. IV): TEN with a Fourier branch."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from foten.models.foten.ten_sizes import TenSizes, TransformerSizes, encoder_cost, encoder_shapes
from foten.models.model_sizes import Shapes, check_heads, shortened
from foten.models.tensor_shapes import linear_shapes


@dataclass(frozen=True)
class SpectralSizes(TransformerSizes):
    """A temporal and a Fourier branch, fused at the last token.

    Differs from the paper where it is silent: the spectral branches are lifted from width 1 to `spectral_width` and projected
    back, since at the literal width 1 a layer normalisation outputs a constant and the branch carries nothing; all m bins are
    kept and Eq. 9 gives its real part.
    """

    window: int = 20  # m, samples; Sec. VI-b
    spectral_width: int = 32  # 1 is the literal reading, and degenerate
    bins: str = "all"  # or "half": 0 … m/2 with a Hermitian inverse, so that a_spec is real by itself
    n_branches: ClassVar[int] = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.spectral_width > 1:
            check_heads(self.spectral_width, self.n_heads)
        if self.bins not in ("all", "half"):
            raise ValueError(f"bins is {shortened(self.bins)}, expected 'all' or 'half'")

    @property
    def n_bins(self) -> int:
        """Return how many bins the spectral branch is given."""
        return self.window if self.bins == "all" else self.window // 2 + 1

    def network_shapes(self) -> Shapes:
        """Return the tensors of both branches and the head."""
        width, shapes = self.spectral_width, super().network_shapes()
        shapes |= linear_shapes("spectral_embedding", self.d_model, 1)
        for name in ("magnitude", "phase"):
            shapes |= encoder_shapes(f"spectral.{name}_layer", width, self.d_feedforward)
            if width > 1:
                shapes |= linear_shapes(f"spectral.{name}_in", width, 1)
                shapes |= linear_shapes(f"spectral.{name}_out", 1, width)
        return shapes

    def network_cost(self) -> int:
        """Return the multiply-adds of a step of the network.

        Of the magnitudes those up to half of the rate count, whose mirror images are equal, and of Eq. 9 the last sample.
        """
        m, width, n_magnitudes = self.window, self.spectral_width, self.window // 2 + 1
        spectral = 2 * m * n_magnitudes + 2 * self.n_bins + self.d_model
        for n_tokens in (n_magnitudes, self.n_bins):
            spectral += encoder_cost(n_tokens, n_tokens, width, self.d_feedforward)
            spectral += n_tokens * 2 * width * (width > 1)
        return super().network_cost() + spectral


@dataclass(frozen=True)
class FotenSizes(SpectralSizes, TenSizes):
    """The paper's network, the row "FoTEN" of every table."""
