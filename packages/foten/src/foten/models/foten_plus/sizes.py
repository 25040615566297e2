"""foten-plus, ours: a lattice over speed and force, tones, and a network that predicts the next innovation.

    a[n] = ℓ · ( lattice(x[n−1], x[n−2], …) + Π cᵢ · e[n] )        x = a / ℓ(v, f),  e[n] ~ Σ w_k N(μ_k, s_k)
    w, μ, s = network(e, x, v, f)

The lattice (`dsp.lattice`) leaves uncorrelated innovations e of unit variance; the network says how they are distributed. The
mean of its mixture is predicted, as far as validation bears it out. A rendering uses no network: its e is Gaussian noise or
recorded innovations, times σ(v, f). With the gain before the filter the lattice predicts a and ℓ e enters it. What enters is at
most E = σ · (largest innovation), there times the largest ℓ: the lattice's energy stays below E²/(1 − leak²).

Source: ours (docs/model.md). Differs from the paper: its network (Sec. IV) is `foten`.
"""

from dataclasses import dataclass
from typing import ClassVar

from foten.dsp.equaliser import N_LOWPASSES, N_TERMS
from foten.dsp.level import N_BANDS
from foten.models.excitation import excitation_shapes, linear_shapes, scale_cost, scale_shapes
from foten.models.model_sizes import ModelSizes, Shapes

N_INPUTS = 5  # of the innovation network: the innovation and its size, the sample, log speed and log force


@dataclass(frozen=True)
class FotenPlusSizes(ModelSizes):
    """Sizes of foten-plus; those of lattices and tones are chosen in training."""

    window: int = 40  # samples that the network takes in before it predicts
    n_hidden: int = 48  # of its recurrent layer
    head_width: int = 48  # of the layer that makes a distribution of it
    n_components: int = 4  # of that distribution
    excitation_width: int = 16  # hidden units of log σ over speed and force, and of log levels
    order: int = 20  # p of the lattice, samples
    n_speed: int = 1  # its knots over speed
    n_force: int = 1  # and over force
    gain_before_filter: bool = False  # where the level enters the lattice
    n_tones: int = 0  # multiples of the path's frequency; none for a surface that does not repeat, nor what follows
    n_tone_speed: int = 1  # knots of their amplitudes over speed
    n_tone_force: int = 1  # and over force
    residual_order: int = 1  # of the lattice of what tones leave
    n_residual_speed: int = 1  # its knots over speed
    n_residual_force: int = 1  # and over force
    residual_gain_before_filter: bool = False
    equalised: bool = False  # whether an equaliser is behind all of it
    recorded: bool = False  # whether a rendering plays recorded innovations
    along_path: bool = False  # and reads them at the pace of the hand
    excited: ClassVar[bool] = True
    bounded: ClassVar[bool] = True
    editable: ClassVar[bool] = True
    has_linear_part: ClassVar[bool] = True
    learns_growth: ClassVar[bool] = True

    @property
    def history(self) -> int:
        """Samples before a prediction: the network's window, the lattice's order before it, and one."""
        return self.window + max(self.order, self.residual_order) + 1

    def tensor_shapes(self) -> Shapes:
        width = self.excitation_width
        shapes = self.network_shapes() | excitation_shapes(width)
        if self.equalised:
            shapes |= {
                "equaliser.weights": (N_BANDS, N_TERMS),
                "equaliser.filters": (N_BANDS, 3),
                "equaliser.smoothing": (N_LOWPASSES,),
            }
        if self.recorded:
            shapes |= {"recorded.values": (256,), "recorded.innovations": (None, None), "recorded.moments": (None, 5)}
        shapes |= lattice_shapes("lattice", self.n_speed, self.n_force, self.order, width)
        if self.n_tones:
            shapes |= table_shapes("tones", self.n_tone_speed, self.n_tone_force, "values", 2 * self.n_tones)
            shapes["tones.phase_params"] = (3,)
            n_speed, n_force = self.n_residual_speed, self.n_residual_force
            shapes |= lattice_shapes("residual", n_speed, n_force, self.residual_order, width)
        return shapes

    def network_shapes(self) -> Shapes:
        h, width = self.n_hidden, self.head_width
        recurrent = {"weight_ih": (3 * h, N_INPUTS), "weight_hh": (3 * h, h), "bias_ih": (3 * h,), "bias_hh": (3 * h,)}
        shapes: Shapes = {f"network.recurrent.{part}_l0": shape for part, shape in recurrent.items()}
        shapes |= linear_shapes("network.head", width, h + N_INPUTS)
        return shapes | linear_shapes("network.out", 3 * self.n_components, width)

    def multiply_adds(self) -> int:
        """Cost of rendering a sample; four knots are mixed for each coefficient."""
        order = self.residual_order if self.n_tones else self.order
        linear = 10 * order + 12 * self.n_tones + (2 + (self.n_tones > 0)) * scale_cost(self.excitation_width)
        return linear + self.equalised * N_BANDS * (N_TERMS + 6)


def lattice_shapes(name: str, n_speed: int, n_force: int, order: int, width: int) -> Shapes:
    return table_shapes(name, n_speed, n_force, "reflections", order) | scale_shapes(f"{name}.level", width)


def table_shapes(name: str, n_speed: int, n_force: int, values: str, k: int) -> Shapes:
    knots: Shapes = {f"{name}.speed_knots": (n_speed,), f"{name}.force_knots": (n_force,)}
    return knots | {f"{name}.{values}": (n_speed * n_force, k)}
