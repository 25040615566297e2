"""Recording to texture, for every model."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib import import_module

import torch

from foten.baselines.sizes import BASELINES
from foten.training.job import Trained, TrainingJob
from foten.training.loop import Monitor

FITS: Mapping[str, str] = {
    "foten-plus": "foten.models.foten_plus.fit",
    "foten": "foten.models.foten.fit",
    "ten": "foten.models.foten.fit",
    "ar": "foten.models.piecewise_ar.fit",
    **dict.fromkeys(BASELINES, "foten.baselines.fit"),
}
"""Module of each model's `fit(job, monitor) -> Trained`, imported on demand: a result depends on its own model alone."""


def train(job: TrainingJob, monitor: Monitor | None = None) -> Trained:
    """A texture learned from a recording.

    Raises:
        ValueError: the recording does not fit the configuration; the message names the option.
    """
    with reproducible():
        return import_module(FITS[job.model]).fit(job, monitor or Monitor())


@contextmanager
def reproducible() -> Iterator[None]:
    """Deterministic algorithms, and one thread for PyTorch's own operations; `shared_gradients` shares out the batch."""
    os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")  # a fixed order of sums on a GPU
    n_threads, deterministic = torch.get_num_threads(), torch.are_deterministic_algorithms_enabled()
    torch.set_num_threads(1)
    # On the CPU one thread adds up in one order anyway, and the call takes a second, for it loads a compiler.
    on_gpu = torch.cuda.is_available()
    if on_gpu:
        torch.use_deterministic_algorithms(True, warn_only=True)
    try:
        yield
    finally:
        torch.set_num_threads(n_threads)
        if on_gpu:
            torch.use_deterministic_algorithms(deterministic)
