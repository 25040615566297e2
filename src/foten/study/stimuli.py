"""Texture files of a study and their gains, and whether they are those of its beginning."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from foten.models.texture_file import Texture, read_texture
from foten.runtime.renderer import Renderer
from foten.studio.levels import gains_db
from foten.study.design import Design
from foten.study.schema import Stimulus

DOUBTFUL_GAIN_DB = 10.0


@dataclass(frozen=True)
class Stimuli:
    """What is compared, and what a person should know before the first participant."""

    listed: list[Stimulus]
    bytes_of: Mapping[tuple[int, int], bytes]  # by texture and method
    doubts: list[str]


def load_stimuli(design: Design, calibrated: bool) -> Stimuli:
    """Texture files of a study, and the gains that make the methods of a texture equally loud.

    Equally loud is equal power over nine conditions (`gains_db`). Without matching, methods keep their recorded levels.

    Args:
        calibrated: the output takes m/s², and not shares of each file's own standard deviation.

    Raises:
        FileNotFoundError: a file is missing.
        ValueError: a file is no texture file, is damaged, or does not pass its proof here.
    """
    listed: list[Stimulus] = []
    bytes_of: dict[tuple[int, int], bytes] = {}
    doubts: list[str] = []
    for t, texture in enumerate(design.textures):
        units = {_checked(path).unit for path in texture.files.values()}
        if len(units) > 1:
            raise ValueError(f"methods of {texture.key} are in different units: {', '.join(sorted(units))}")
        data = [path.read_bytes() for path in texture.files.values()]
        renderers = [_renderer(file, path) for file, path in zip(data, texture.files.values(), strict=True)]
        scales = [1.0 if calibrated else 1 / r.native_texture.info.acceleration_sd for r in renderers]
        gains = [20 * math.log10(scales[0] / scale) for scale in scales]
        if design.match_levels:
            gains = gains_db(renderers, scales)
            for method, gain in zip(texture.files, gains, strict=True):
                if abs(gain) > DOUBTFUL_GAIN_DB:
                    doubts.append(
                        f"{method} of {texture.key} is {-gain:+.0f} dB beside the other methods: does it fall silent?"
                    )
        digests = [hashlib.sha256(file).hexdigest() for file in data]
        if len(set(digests)) < len(digests):
            raise ValueError(f"two methods of {texture.key} are the same file")
        for m, (method, digest, gain) in enumerate(zip(texture.files, digests, gains, strict=True)):
            listed.append(Stimulus(t, m, texture.key, method, digest, gain))
            bytes_of[t, m] = data[m]
    return Stimuli(listed, bytes_of, doubts)


def changed(now: Sequence[Stimulus], then: Mapping[tuple[int, int], Stimulus]) -> list[str]:
    """Texture files that are others than when a study began."""
    return [
        f"{s.method_key} of {s.texture_key}"
        for s in now
        if (s.texture, s.method) not in then or then[s.texture, s.method].sha256 != s.sha256
    ]


def _checked(path: Path) -> Texture:
    if not path.exists():
        raise FileNotFoundError(f"no such file: {path}")
    return read_texture(path)


def _renderer(data: bytes, path: Path) -> Renderer:
    try:
        return Renderer(data)
    except ValueError as error:
        raise ValueError(f"{path.name}: {error}") from error
