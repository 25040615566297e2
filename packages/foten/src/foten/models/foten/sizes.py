"""FoTEN, the paper's network (Sec. IV), and TEN, the same without its Fourier branch (Table II)."""

from dataclasses import dataclass
from typing import ClassVar

from foten.models.excitation import WithExcitation, linear_shapes, scale_cost
from foten.models.model_sizes import ModelSizes, Shapes, check_count, check_heads, shortened


@dataclass(frozen=True)
class TransformerSizes(ModelSizes):
    """A temporal branch and a head.

    Differs from the paper where it says two things: layers normalise before attention (Sec. IV-c, Fig. 3), unlike those of [17].
    """

    window: int = 25  # m, samples; Table II
    d_model: int = 32  # Sec. IV-c
    n_heads: int = 4  # Sec. IV-c
    n_layers: int = 3  # temporal encoder layers; Sec. IV-c
    d_feedforward: int = 128  # Sec. IV-c
    head: tuple[int, int] = (256, 64)  # dense layers before the output; Sec. IV-e
    pre_norm: bool = True  # False normalises after each sub-layer, as [17]
    n_branches: ClassVar[int] = 1  # each of which gives the head d_model numbers

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.head, list | tuple) or len(self.head) != 2:
            raise ValueError("head is not a pair, expected the widths of two layers, such as [256,64]")
        for width in self.head:
            check_count("head", width, 1)
        check_heads(self.d_model, self.n_heads)
        object.__setattr__(self, "head", tuple(self.head))

    @property
    def n_features(self) -> int:
        """Numbers that the branches give the head."""
        return self.n_branches * self.d_model

    def network_shapes(self) -> Shapes:
        d, (first, second) = self.d_model, self.head
        shapes = linear_shapes("temporal.embedding", d, 1)
        for layer in range(self.n_layers):
            shapes |= encoder_shapes(f"temporal.layers.{layer}", d, self.d_feedforward)
        if self.pre_norm:
            shapes |= {"temporal.norm.weight": (d,), "temporal.norm.bias": (d,)}
        shapes |= linear_shapes("head_1", first, self.n_features + 2)
        return shapes | linear_shapes("head_2", second, first) | linear_shapes("head_3", 1, second)

    def network_cost(self) -> int:
        """Multiply-adds of a step; of the last temporal layer one query counts."""
        m, d, (first, second) = self.window, self.d_model, self.head
        temporal = m * d + encoder_cost(m, 1, d, self.d_feedforward)
        temporal += (self.n_layers - 1) * encoder_cost(m, m, d, self.d_feedforward)
        return temporal + (self.n_features + 2) * first + first * second + second


@dataclass(frozen=True)
class TenSizes(TransformerSizes, WithExcitation):
    """TEN, Table II."""

    def tensor_shapes(self) -> Shapes:
        return self.network_shapes() | WithExcitation.tensor_shapes(self)

    def multiply_adds(self) -> int:
        return self.network_cost() + self.excitation * (scale_cost(self.excitation_width) + 5)


@dataclass(frozen=True)
class SpectralSizes(TransformerSizes):
    """A temporal and a Fourier branch, fused at the last token.

    Differs from the paper: the spectral branches are lifted from width 1 to `spectral_width` and projected back, since at width
    1 a layer normalisation outputs a constant; of Eq. 9 the real part is taken.
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
        """Bins of the spectral branch."""
        return self.window if self.bins == "all" else self.window // 2 + 1

    def network_shapes(self) -> Shapes:
        width, shapes = self.spectral_width, super().network_shapes()
        shapes |= linear_shapes("spectral_embedding", self.d_model, 1)
        for name in ("magnitude", "phase"):
            shapes |= encoder_shapes(f"spectral.{name}_layer", width, self.d_feedforward)
            if width > 1:
                shapes |= linear_shapes(f"spectral.{name}_in", width, 1)
                shapes |= linear_shapes(f"spectral.{name}_out", 1, width)
        return shapes

    def network_cost(self) -> int:
        """Multiply-adds of a step; magnitudes count up to half of the rate, and of Eq. 9 the last sample."""
        m, width, n_magnitudes = self.window, self.spectral_width, self.window // 2 + 1
        spectral = 2 * m * n_magnitudes + 2 * self.n_bins + self.d_model
        for n_tokens in (n_magnitudes, self.n_bins):
            spectral += encoder_cost(n_tokens, n_tokens, width, self.d_feedforward)
            spectral += n_tokens * 2 * width * (width > 1)
        return super().network_cost() + spectral


@dataclass(frozen=True)
class FotenSizes(SpectralSizes, TenSizes):
    """The paper's network, the row "FoTEN" of every table."""


def encoder_shapes(name: str, width: int, d_feedforward: int) -> Shapes:
    shapes = linear_shapes(f"{name}.attention_in", 3 * width, width)
    shapes |= linear_shapes(f"{name}.attention_out", width, width)
    shapes |= linear_shapes(f"{name}.feedforward_in", d_feedforward, width)
    shapes |= linear_shapes(f"{name}.feedforward_out", width, d_feedforward)
    norms = [f"{name}.{norm}.{part}" for norm in ("norm_1", "norm_2") for part in ("weight", "bias")]
    return shapes | {norm: (width,) for norm in norms}


def encoder_cost(n_tokens: int, n_queries: int, width: int, d_feedforward: int) -> int:
    """The multiply-adds of an encoder layer."""
    projected = 2 * n_tokens * width * width + n_queries * width * width
    attended = 2 * n_queries * n_tokens * width + n_queries * width * width
    return projected + attended + 2 * n_queries * width * d_feedforward
