"""What networks are to give, where it is not the next sample of the recording."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from foten.architecture import HapinfArchitecture
from foten.models import build
from foten.models.noise_filter import log_magnitudes
from foten.train.config import TrainConfig
from foten.train.fit import Data, fit, pick_device, predict
from foten.train.prepared import Prepared

_AT_ONCE = 65536  # frames


def taught(data: Data, m: int, config: TrainConfig, on_stage: Callable[[str], None]) -> Data:
    """Return data whose targets in training lie half-way to what a teacher predicts, those of validation as they were.

    The mean of the squared errors against the recording and against the teacher, 0.5 (y − s)² + 0.5 (t − s)², differs from the
    squared error against their mean by what s has no part in.
    """
    on_stage("training the teacher, hapinf")
    teacher = build("hapinf", HapinfArchitecture(window=m, n_start=min(10, m))).to(pick_device())
    if fit(teacher, data, config).interrupted:
        raise KeyboardInterrupt  # of a student that is half taught nothing is kept
    target = data.samples[:, 0].copy()
    target[data.train] = 0.5 * (target[data.train] + predict(teacher, data, data.train))
    return replace(data, target=target)


def spectra(data: Data, prepared: Prepared) -> Data:
    """Return data whose targets are the log magnitudes of frames around every fourth sample or so, (n, m // 2 + 1), float32.

    A window ends before the middle of its frame.
    """
    m, block = data.window, prepared.trace.block
    blocks = torch.from_numpy(prepared.samples[..., 0]).float()
    target = np.zeros((len(data.samples), m // 2 + 1), dtype=np.float32)

    def framed(n: NDArray[np.int64]) -> NDArray[np.int64]:
        within = n % block
        return n[((within - m) % max(1, m // 25) == 0) & (within - m // 2 + m <= block)]

    train, validation = framed(data.train), framed(data.validation)
    for n in (train, validation):
        for i in range(0, len(n), _AT_ONCE):
            some = n[i : i + _AT_ONCE]
            around = torch.from_numpy(some % block - m // 2)[:, None] + torch.arange(m)
            target[some] = log_magnitudes(blocks[torch.from_numpy(some // block)[:, None], around]).numpy()
    return replace(data, train=train, validation=validation, target=target)


def ahead(data: Data, prepared: Prepared, n_ahead: int) -> Data:
    """Return data whose targets are a sample and those after it, (n, n_ahead), of which none is of another block."""
    x, block = data.samples[:, 0], prepared.trace.block
    target = np.lib.stride_tricks.sliding_window_view(np.append(x, np.zeros(n_ahead - 1)), n_ahead)
    whole = [n[n % block + n_ahead <= block] for n in (data.train, data.validation)]
    return replace(data, train=whole[0], validation=whole[1], target=np.ascontiguousarray(target))
