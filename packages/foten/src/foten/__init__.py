"""Haptic textures, learned from a recording and given back under a hand.

The flow, each arrow one function from one frozen value to the next::

    recording ─ preprocess ─ trace ─ split ─ windows ─ model ─ train ─▶ texture file ─▶ render
                                                                                     └▶ evaluate

Left of the texture file is PyTorch (extra ``train``); right of it NumPy alone is enough.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from foten.models.texture_file import Texture as Texture
    from foten.models.texture_file import read_texture as read_texture
    from foten.recording.recording import Channel as Channel
    from foten.recording.recording import Recording as Recording
    from foten.recording.trace import Trace as Trace
    from foten.runtime.actuator import ActuatorProfile as ActuatorProfile
    from foten.runtime.live.live import Live as Live
    from foten.runtime.renderer import EXAMPLE as EXAMPLE
    from foten.runtime.renderer import Renderer as Renderer
    from foten.runtime.stylus import PressureCalibration as PressureCalibration
    from foten.runtime.stylus import Stylus as Stylus
    from foten.runtime.stylus import fit_pressure as fit_pressure

__version__ = "0.1.0"

# Looked up on first use, so that a program that only renders loads only what renders.
_PUBLIC = {
    "Channel": "foten.recording.recording",
    "Recording": "foten.recording.recording",
    "Trace": "foten.recording.trace",
    "ActuatorProfile": "foten.runtime.actuator",
    "Live": "foten.runtime.live.live",
    "PressureCalibration": "foten.runtime.stylus",
    "EXAMPLE": "foten.runtime.renderer",
    "Renderer": "foten.runtime.renderer",
    "Stylus": "foten.runtime.stylus",
    "fit_pressure": "foten.runtime.stylus",
    "Texture": "foten.models.texture_file",
    "read_texture": "foten.models.texture_file",
}

__all__ = [*_PUBLIC, "__version__"]


def __getattr__(name: str) -> Any:
    if name not in _PUBLIC:
        raise AttributeError(f"module 'foten' has no attribute {name!r}")
    return getattr(import_module(_PUBLIC[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
