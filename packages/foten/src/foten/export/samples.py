"""A clip as samples: WAV for a sound card, CSV and NPZ for programs."""

import json
from pathlib import Path

import numpy as np

from foten.atomic_write import atomic_write
from foten.dsp.resample import interpolate, rate_ratio
from foten.export.clip import Clip
from foten.runtime.live.sinks import AUDIBLE_HZ, pcm_wav

KEEPS = "the samples are kept as they are"
KEEPS_WAV = "the samples are kept to 16 bits, at 48 kHz"


def write_wav(clip: Clip, path: Path) -> None:
    """Write a clip at 48 kHz and 16 bits, full scale for 1. The comment holds `unit`, `full_scale` and `about`."""
    sound = interpolate(clip.drive, rate_ratio(AUDIBLE_HZ, clip.rate_hz))
    metadata = {**clip.about, "full_scale": clip.full_scale}
    with atomic_write(path) as part:
        part.write_bytes(pcm_wav(np.clip(sound, -1.0, 1.0), AUDIBLE_HZ, metadata))


def write_csv(clip: Clip, path: Path) -> None:
    """Write time [s] and drive within ±1."""
    rows = np.stack([np.arange(clip.drive.size) / clip.rate_hz, clip.drive], axis=1)
    with atomic_write(path) as part:
        np.savetxt(part, rows, "%.9g", ",", header="t [s],drive", comments="")


def write_npz(clip: Clip, path: Path) -> None:
    """Write `drive`, `rate_hz`, `full_scale` and, as JSON, `about`."""
    about = np.array(json.dumps(dict(clip.about), sort_keys=True))
    rate_hz, full_scale = np.array(clip.rate_hz), np.array(clip.full_scale)
    with atomic_write(path) as part, part.open("wb") as file:
        np.savez_compressed(file, drive=clip.drive, rate_hz=rate_hz, full_scale=full_scale, about=about)
