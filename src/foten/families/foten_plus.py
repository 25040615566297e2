"""foten-plus, ours: a lattice over speed and force, tones, an excitation, and the paper's network as a bounded correction.

With ℓ(v, f) the level of the vibration, x = a/ℓ is of about unit size at every speed and force. A lattice whose reflection
coefficients follow v and f (`dsp.lattice`) predicts x and leaves the innovation e, of unit variance; a unit of it is worth
Π cᵢ in x. The network is given x, e, v and f at each sample of its window and predicts the next innovation in part:

    â[n] = ℓ · ( lattice(x[n−1], x[n−2], …) + Π cᵢ · L · tanh(FoTEN(x, e, v, f) / L) )

This is the gain after the filter. With the gain before the filter the lattice predicts a itself and ℓ e enters it:
â[n] = lattice(a[n−1], …) + ℓ · Π cᵢ · L · tanh(…), so that what rang before rings on as loud as it was. Training chooses.

In the closed loop ℓ · Π cᵢ · σ(v, f) times heavy-tailed noise of a volatility is added. What enters the lattice is at most
E = L + σ · (largest volatility) · (largest shock), times the largest ℓ where the gain comes before the filter, whatever the
network says; the lattice's energy stays below E²/(1 − leak²), however speed and force move (`dsp.lattice`).

A surface that repeats is rendered otherwise: tones of the path (`dsp.tones`), plus a lattice of its own for the residual,
excited by noise alone. Its next sample is still predicted as above.

The network is given e because what a tool does after an impact depends on the impact, which is one large innovation that the
acceleration hides under ringing (on simulated styrofoam, over the best AR's error: 0.96 without it, 0.94 with it).

Source: ours; the network is Sec. IV.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from foten.families.excitation import excitation_shapes, scale_cost, scale_shapes
from foten.families.foten import SpectralSizes
from foten.families.sizes import Shapes, shortened


@dataclass(frozen=True)
class FotenPlusSizes(SpectralSizes):
    """The sizes of foten-plus; those of lattices and tones are chosen in training."""

    excitation_width: int = 16  # hidden units of log σ over speed and force, and of log levels
    correction_limit: float = 3.0  # L, in standard deviations of the lattice's innovation
    # Whether the tokens hold speed and force, as well as the head (the paper's). One-step validation error re the head alone:
    # 0.960 on a simulated mesh, 1.001 on a towel, on grass and on wood.
    condition_in_tokens: bool = True
    network_in_loop: bool = True  # whether a rendering uses the network; one with tones never does
    order: int = 20  # p of the lattice, samples
    n_speed: int = 1  # its vertices over speed
    n_force: int = 1  # and over force
    gain_before_filter: bool = False  # where the level enters the lattice
    n_tones: int = 0  # multiples of the path's frequency; none for a surface that does not repeat, nor what follows
    n_tone_speed: int = 1  # vertices of their amplitudes over speed
    n_tone_force: int = 1  # and over force
    residual_order: int = 1  # of the lattice of what tones leave
    n_residual_speed: int = 1  # its vertices over speed
    n_residual_force: int = 1  # and over force
    residual_gain_before_filter: bool = False
    excited: ClassVar[bool] = True

    def __post_init__(self) -> None:
        super().__post_init__()
        limit = self.correction_limit
        if type(limit) not in (int, float) or not 0 < limit < 1e6:
            raise ValueError(f"correction_limit is {shortened(limit)}, expected a positive number")

    @property
    def history(self) -> int:
        """Return how many samples a prediction is given: a window of innovations, the lattice's order before it, and one."""
        return self.window + max(self.order, self.residual_order) + 1

    @property
    def n_inputs(self) -> int:
        """Return how many numbers of each sample the tokens hold: acceleration and innovation, speed and force."""
        return 4 if self.condition_in_tokens else 2

    @property
    def renders_with_network(self) -> bool:
        """Return whether a rendered sample takes a step of the network."""
        return self.network_in_loop and not self.n_tones

    def tensor_shapes(self) -> Shapes:
        """Return the tensors of network, lattices, tones and excitation."""
        width = self.excitation_width
        shapes = {f"network.{name}": shape for name, shape in self.network_shapes().items()}
        shapes |= excitation_shapes(width)
        shapes |= lattice_shapes("lattice", self.n_speed, self.n_force, self.order, width)
        if self.n_tones:
            shapes |= table_shapes("tones", self.n_tone_speed, self.n_tone_force, "values", 2 * self.n_tones)
            shapes["tones.motion"] = (3,)
            n_speed, n_force = self.n_residual_speed, self.n_residual_force
            shapes |= lattice_shapes("residual", n_speed, n_force, self.residual_order, width)
        return shapes

    def multiply_adds(self) -> int:
        """Return what a rendered sample costs: predicted and taken in, four vertices mixed for each coefficient."""
        order = self.residual_order if self.n_tones else self.order
        linear = 10 * order + 12 * self.n_tones + (2 + (self.n_tones > 0)) * scale_cost(self.excitation_width)
        return linear + (self.network_cost() if self.renders_with_network else 0)


def lattice_shapes(name: str, n_speed: int, n_force: int, order: int, width: int) -> Shapes:
    """Return the tensors of a lattice and its level."""
    return table_shapes(name, n_speed, n_force, "reflections", order) | scale_shapes(f"{name}.level", width)


def table_shapes(name: str, n_speed: int, n_force: int, values: str, k: int) -> Shapes:
    """Return the tensors of a table of k numbers over speed and force."""
    knots: Shapes = {f"{name}.speed_knots": (n_speed,), f"{name}.force_knots": (n_force,)}
    return knots | {f"{name}.{values}": (n_speed * n_force, k)}
