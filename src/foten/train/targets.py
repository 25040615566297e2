"""What networks are to give, where it is not the next sample of the recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from foten.families.graphs import HapinfSizes
from foten.networks import build
from foten.networks.noise_filter import log_magnitudes
from foten.train.blocks import ScaledBlocks
from foten.train.config import TrainConfig
from foten.train.fit import TrainingWindows, fit, pick_device, predict

_AT_ONCE = 65536  # frames


def distilled(
    windows: TrainingWindows, m: int, config: TrainConfig, on_stage: Callable[[str], None]
) -> TrainingWindows:
    """Return windows whose targets in training lie half-way to what a teacher predicts, those of validation as they were.

    The mean of the squared errors against the recording and against the teacher, 0.5 (y − s)² + 0.5 (t − s)², differs from the
    squared error against their mean by what s has no part in.
    """
    on_stage("training the teacher, hapinf")
    teacher = build("hapinf", HapinfSizes(window=m, n_start=min(10, m))).to(pick_device())
    if fit(teacher, windows, config).interrupted:
        raise KeyboardInterrupt  # of a half-distilled student nothing is kept
    target = windows.samples[:, 0].copy()
    target[windows.train] = 0.5 * (target[windows.train] + predict(teacher, windows, windows.train))
    return replace(windows, target=target)


def log_spectra(windows: TrainingWindows, blocks: ScaledBlocks) -> TrainingWindows:
    """Return windows whose targets are the log magnitudes of frames around every fourth sample or so, (n, m // 2 + 1), float32.

    A window ends before the middle of its frame.
    """
    m, block = windows.window, blocks.trace.block
    acceleration = torch.from_numpy(blocks.samples[..., 0]).float()
    target = np.zeros((len(windows.samples), m // 2 + 1), dtype=np.float32)
    framed = []
    for n in (windows.train, windows.validation):
        within = n % block
        framed.append(n[((within - m) % max(1, m // 25) == 0) & (within - m // 2 + m <= block)])
        for some in np.split(framed[-1], range(_AT_ONCE, len(framed[-1]), _AT_ONCE)):
            around = torch.from_numpy(some % block - m // 2)[:, None] + torch.arange(m)
            target[some] = log_magnitudes(acceleration[torch.from_numpy(some // block)[:, None], around]).numpy()
    return replace(windows, train=framed[0], validation=framed[1], target=target)


def multi_step(windows: TrainingWindows, blocks: ScaledBlocks, n_ahead: int) -> TrainingWindows:
    """Return windows whose targets are a sample and those after it, (n, n_ahead), of which none is of another block."""
    x, block = windows.samples[:, 0], blocks.trace.block
    target = np.lib.stride_tricks.sliding_window_view(np.append(x, np.zeros(n_ahead - 1)), n_ahead)
    train, validation = (n[n % block + n_ahead <= block] for n in (windows.train, windows.validation))
    return replace(windows, train=train, validation=validation, target=np.ascontiguousarray(target))
