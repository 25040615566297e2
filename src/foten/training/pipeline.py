"""Recording to texture, whatever the model: the whole left side of the flow."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from foten.baselines import fit as baseline
from foten.baselines.sizes import BASELINES
from foten.models.foten import fit as foten
from foten.models.foten_plus import fit as foten_plus
from foten.models.piecewise_ar import fit as piecewise_ar
from foten.training.job import Trained, TrainingJob
from foten.training.loop import Monitor, reproducible

FITS: Mapping[str, Callable[[TrainingJob, Monitor], Trained]] = {
    "foten-plus": foten_plus.fit,
    "foten": foten.fit,
    "ten": foten.fit,
    "ar": piecewise_ar.fit,
    **dict.fromkeys(BASELINES, baseline.fit),
}


def train(job: TrainingJob, monitor: Monitor | None = None) -> Trained:
    """A texture learned from a recording.

    Raises:
        ValueError: the recording does not fit the configuration; the message names the option.
    """
    with reproducible():
        return FITS[job.model](job, monitor or Monitor())
