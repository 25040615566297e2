"""What a study plays: texture files as they were when it began, made equally loud."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from foten.families.texture_file import Texture, read_texture
from foten.runtime.live.live import LiveStatistics, Timing
from foten.runtime.renderer import Renderer
from foten.studio.levels import gains_db
from foten.study.design import Design
from foten.study.store import Stimulus

DOUBTFUL_DB = 10.0  # that a method is made louder or quieter


@dataclass(frozen=True)
class Stimuli:
    """What is compared, and what a person should know of it before the first participant."""

    listed: list[Stimulus]
    bytes_of: Mapping[tuple[int, int], bytes]
    doubts: list[str]


def load_stimuli(design: Design, calibrated: bool) -> Stimuli:
    """Return the texture files of a study, and the gains that make the methods of a texture equally loud.

    Equally loud is equal power over nine conditions of the range that all its methods were trained in. Without matching, methods
    keep their levels to each other, as they were recorded.

    Args:
        calibrated: whether the output takes what is rendered as it is, and not in full scale of each file's recording.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: one is no texture file, is damaged, or does not pass its own proof here.
    """
    listed: list[Stimulus] = []
    bytes_of: dict[tuple[int, int], bytes] = {}
    doubts: list[str] = []
    for t, texture in enumerate(design.textures):
        units = {_checked(path).unit for path in texture.files.values()}
        if len(units) > 1:
            raise ValueError(f"methods of {texture.key} are in different units: {', '.join(sorted(units))}")
        data = [path.read_bytes() for path in texture.files.values()]
        renderers = [_renderer(one, path) for one, path in zip(data, texture.files.values(), strict=True)]
        scales = [1.0 if calibrated else 1 / r.native_texture.info.acceleration_sd for r in renderers]
        gains = [20 * math.log10(scales[0] / scale) for scale in scales]
        if design.match_levels:
            gains = gains_db(renderers, scales)
            for method, gain in zip(texture.files, gains, strict=True):
                if abs(gain) > DOUBTFUL_DB:
                    doubts.append(
                        f"{method} of {texture.key} is {-gain:+.0f} dB beside the other methods: does it fall silent?"
                    )
        digests = [hashlib.sha256(one).hexdigest() for one in data]
        if len(set(digests)) < len(digests):
            raise ValueError(f"two methods of {texture.key} are the same file")
        for m, (method, digest, gain) in enumerate(zip(texture.files, digests, gains, strict=True)):
            listed.append(Stimulus(t, m, texture.key, method, digest, gain))
            bytes_of[t, m] = data[m]
    return Stimuli(listed, bytes_of, doubts)


def changed(now: Sequence[Stimulus], then: Mapping[tuple[int, int], Stimulus]) -> list[str]:
    """Return which texture files are others than when a study began."""
    return [
        f"{one.method_key} of {one.texture_key}"
        for one in now
        if (one.texture, one.method) not in then or then[one.texture, one.method].sha256 != one.sha256
    ]


@dataclass
class Measured:
    """What a trial's record says of its strokes and of rendering, through all contacts of the trial: a lost connection or a hold
    begins another.
    """

    conditions: list[tuple[float, float]] = field(
        default_factory=list
    )  # speed [mm/s] and force [N] at each block's end
    parts: list[LiveStatistics] = field(default_factory=list)  # of contacts that have ended
    block_s: float = 0.0
    resumed: bool = False  # the server was started again within the trial: what was before is in the strokes alone

    def about(self, live: Sequence[LiveStatistics]) -> dict[str, Any]:
        """Return seconds in contact, and of them the 10th, 50th and 90th percentile of speed [mm/s] and force [N]; the blocks'
        p99 [ms], how many came late, and under-runs; `live` are the contacts that have not ended.
        """
        touching = np.array([one for one in list(self.conditions) if one[1] > 0.01]).reshape(-1, 2)
        result: dict[str, Any] = {"contact_s": round(self.block_s * len(touching), 3)}
        for name, column in (("speed_mm_s", 0), ("force_n", 1)):
            for percent in (10, 50, 90):
                value = float(np.percentile(touching[:, column], percent)) if len(touching) else None
                result[f"{name}_p{percent}"] = None if value is None else round(value, 4)
        block = Timing()
        every = [*self.parts, *live]
        for one in every:
            block.counts += one.block.counts
            block.largest_s = max(block.largest_s, one.block.largest_s)
        p99 = 1000 * block.percentile_s(99.0)
        result["block_p99_ms"] = round(p99, 4) if math.isfinite(p99) else None
        result |= {"n_missed": sum(one.n_missed for one in every), "n_underruns": sum(one.n_underruns for one in every)}
        return result | {"n_contacts": len(every), "resumed": self.resumed}


def _checked(path: Path) -> Texture:
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    return read_texture(path)


def _renderer(data: bytes, path: Path) -> Renderer:
    try:
        return Renderer(data)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error
