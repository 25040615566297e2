"""FoTEN and TEN fitted to a recording, as Sec. IV-e or our recipe has it."""

import torch

from foten.models.definitions import model_of
from foten.models.foten.network import Foten
from foten.models.foten.sizes import TransformerSizes
from foten.training.config import WindowConfig
from foten.training.job import Trained, TrainingJob, check_block
from foten.training.loop import Monitor, pick_device
from foten.training.texture_builder import tensors_of
from foten.training.window_fit import Packed, fit_windows, one_step_texture, one_step_windows


def fit(job: TrainingJob, monitor: Monitor) -> Trained:
    """A texture of the paper's network, or of TEN, learned from a recording."""
    assert isinstance(job.sizes, TransformerSizes)
    assert isinstance(job.config, WindowConfig)
    blocks, m = job.blocks(), job.sizes.window
    check_block(blocks, m)
    torch.manual_seed(job.config.seed)
    network = Foten(job.sizes).to(pick_device())
    progress = fit_windows(network, one_step_windows(blocks, m), job.config, monitor)
    packed = Packed(job.sizes, tensors_of(network), model_of)
    return one_step_texture(job, blocks, network, progress, packed, monitor)
