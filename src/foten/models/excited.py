"""Any one-step network with the excitation of foten-plus, so that free runs are compared fairly."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foten.architecture import PredictorArchitecture, TenArchitecture
from foten.models.foten_plus import Excitation


class Excited(nn.Module):
    """A network's prediction, to which a rendering adds noise: σ(v, f) times what is heavy-tailed and swells, scaled.

    A network that was trained one step ahead foretells the mean, and on its own output falls silent; what it cannot foretell is
    given back as chance.
    """

    def __init__(self, network: nn.Module, architecture: TenArchitecture | PredictorArchitecture) -> None:
        super().__init__()
        self.architecture = architecture
        self.network = network
        self.excitation = Excitation(architecture.excitation_width).requires_grad_(False)

    def forward(self, windows: Tensor) -> Tensor:
        """Return the next samples without excitation: windows (b, m, 3) scaled → (b,) or (b, n_ahead) scaled."""
        return self.network(windows)

    def rendered_power(self, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Return the mean square of the excitation under a steady hand (b, 2) scaled, and zeros: (b,), (b,), float64.

        What the network makes of it is not known; where it is a filter, it is as loud in the same measure.
        """
        chance = self.excitation(condition).double().square()
        return chance, torch.zeros_like(chance)
