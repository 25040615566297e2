"""Recording to texture: prepare(job) → fit → finish, the whole left side of the flow."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from foten.models.foten.fit import prepare_end_to_end
from foten.models.foten_plus.fit import prepare_foten_plus
from foten.models.piecewise_ar.fit import prepare_piecewise_ar
from foten.models.texture_file import Texture
from foten.training.job import Stage, Task, Trained, TrainingJob
from foten.training.loop import Epoch, Progress
from foten.training.networks import NETWORKS
from foten.training.window_fit import reproducible

PREPARE: Mapping[str, Callable[[TrainingJob, Stage], Task]] = {
    **dict.fromkeys(NETWORKS, prepare_end_to_end),
    "foten-plus": prepare_foten_plus,
    "ar": prepare_piecewise_ar,
}


def prepare(job: TrainingJob, on_stage: Stage = lambda stage: None) -> Task:
    """Return a job's network, what it is to be fitted to, and what is playable without it."""
    if job.sizes.in_graph:  # what is missing is said before training, not after
        import onnx  # noqa: F401
        import onnxruntime  # noqa: F401
    return PREPARE[job.model](job, on_stage)


def train(
    job: TrainingJob,
    on_epoch: Callable[[Epoch], None] = lambda epoch: None,
    checkpoint: Path | None = None,
    resume: bool = False,
    on_stage: Stage = lambda stage: None,
    on_playable: Callable[[Texture], None] = lambda texture: None,
) -> Trained:
    """Return a texture learned from a recording.

    Args:
        on_epoch: called with the log's line after each epoch.
        checkpoint: where the state is kept after each epoch; None for nowhere.
        resume: go on from the checkpoint.
        on_playable: called with a valid texture as soon as there is one, long before the network is fitted.

    Raises:
        ValueError: the recording does not fit the configuration; the message names the option.
    """
    with reproducible():
        task = prepare(job, on_stage)
        if task.playable is not None:
            on_playable(task.playable)
        return _trained(task, task.fit(on_epoch, checkpoint, resume), on_stage)


def _trained(task: Task, progress: Progress, on_stage: Stage = lambda stage: None) -> Trained:
    texture = task.finish(progress, on_stage)
    return Trained(texture, task.blocks.trace, task.blocks.split, progress, task.linear_mae)
