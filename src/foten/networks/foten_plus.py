"""The network of foten-plus: the paper's, its answer bounded. Lattice, tones and excitation are not trained by gradient."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from foten.families.foten_plus import FotenPlusSizes
from foten.networks.foten import Foten


class Corrector(Foten):
    """What of the next innovation can be predicted, L · tanh(FoTEN / L): windows (b, m, 4) of x, speed, force, e → (b,).

    The head's last layer starts at zero, so training starts at the lattice's error.
    """

    def __init__(self, sizes: FotenPlusSizes) -> None:
        super().__init__(sizes)
        self.limit = sizes.correction_limit
        nn.init.zeros_(self.head_3.weight)
        nn.init.zeros_(self.head_3.bias)

    def forward(self, windows: Tensor) -> Tensor:
        """Return the correction, within ±`correction_limit`, in units of the innovation."""
        return self.limit * torch.tanh(super().forward(windows) / self.limit)
