"""What is recorded of a trial beside its rating: time in contact, speeds and forces, and how rendering kept up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from foten.runtime.live.live import LiveStatistics, Timing

MIN_CONTACT_N = 0.01  # of force, below which the pen does not count as in contact


@dataclass
class TrialLog:
    """A trial through all its contacts: a lost connection or a hold begins another contact."""

    conditions: list[tuple[float, float]] = field(default_factory=list)  # speed [mm/s], force [N] at each block's end
    ended: list[LiveStatistics] = field(default_factory=list)  # of contacts before the present one
    block_s: float = 0.0
    resumed: bool = False  # the server was started again within the trial: only the strokes tell of what was before

    def summary(self, live: Sequence[LiveStatistics]) -> dict[str, Any]:
        """Seconds in contact; of them the 10th, 50th and 90th percentile of speed [mm/s] and force [N]; p99 of a block's
        rendering [ms], blocks that came late, and under-runs.

        Args:
            live: statistics of the contacts that have not ended.
        """
        in_contact = np.array([c for c in list(self.conditions) if c[1] > MIN_CONTACT_N]).reshape(-1, 2)
        result: dict[str, Any] = {"contact_s": round(self.block_s * len(in_contact), 3)}
        for name, column in (("speed_mm_s", 0), ("force_n", 1)):
            for percent in (10, 50, 90):
                value = float(np.percentile(in_contact[:, column], percent)) if len(in_contact) else None
                result[f"{name}_p{percent}"] = None if value is None else round(value, 4)
        block, contacts = Timing(), [*self.ended, *live]
        for contact in contacts:
            block.counts += contact.block.counts
            block.largest_s = max(block.largest_s, contact.block.largest_s)
        p99_ms = 1000 * block.percentile_s(99.0)
        return {
            **result,
            "block_p99_ms": round(p99_ms, 4) if math.isfinite(p99_ms) else None,
            "n_missed": sum(contact.n_missed for contact in contacts),
            "n_underruns": sum(contact.n_underruns for contact in contacts),
            "n_contacts": len(contacts),
            "resumed": self.resumed,
        }
