"""WAV files as columns, for an accelerometer that was recorded through a sound card."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from foten.datasets.columns import Column
from foten.datasets.units import FULL_SCALE
from foten.untrusted import brief, check_regular


def read_wav(path: Path) -> list[Column]:
    """Return the tracks of a WAV file, named by number, with its rate.

    Integer samples become fractions of full scale; float samples stay as they are.

    Raises:
        ValueError: empty, truncated, foreign.
    """
    check_regular(path)
    if path.stat().st_size == 0:
        raise ValueError(f"{path.name} is empty")
    from scipy.io import wavfile

    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Chunk .*not understood", category=wavfile.WavFileWarning)
            warnings.filterwarnings("error", message=".*EOF", category=wavfile.WavFileWarning)
            rate, samples = wavfile.read(path)
    except Exception as error:  # a damaged file raises a dozen kinds, struct.error and ZeroDivisionError among them
        raise ValueError(f"{path.name} is truncated or is no WAV file ({brief(error)})") from None
    unit = ""
    if samples.dtype.kind == "u":
        samples, unit = (samples.astype(np.float64) - 128) / 128, FULL_SCALE
    elif samples.dtype.kind == "i":
        # 24-bit files come left-justified in 32 bits, so the type alone gives full scale.
        samples, unit = samples / -float(np.iinfo(samples.dtype).min), FULL_SCALE
    tracks = samples.reshape(samples.shape[0], -1)
    if not tracks.size:
        raise ValueError(f"{path.name} has no samples")
    return [Column(str(k), tracks[:, k].astype(np.float64), float(rate), unit) for k in range(tracks.shape[1])]
