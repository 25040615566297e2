"""Recording to texture, whatever the model: the whole left side of the flow."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module

from foten.baselines.sizes import BASELINES
from foten.training.job import Trained, TrainingJob
from foten.training.loop import Monitor, reproducible

FITS: Mapping[str, str] = {
    "foten-plus": "foten.models.foten_plus.fit",
    "foten": "foten.models.foten.fit",
    "ten": "foten.models.foten.fit",
    "ar": "foten.models.piecewise_ar.fit",
    **dict.fromkeys(BASELINES, "foten.baselines.fit"),
}
"""Module of each model's `fit(job, monitor) -> Trained`; imported when asked, so that a result depends on its own model alone."""


def train(job: TrainingJob, monitor: Monitor | None = None) -> Trained:
    """A texture learned from a recording.

    Raises:
        ValueError: the recording does not fit the configuration; the message names the option.
    """
    with reproducible():
        trained: Trained = import_module(FITS[job.model]).fit(job, monitor or Monitor())
        return trained
