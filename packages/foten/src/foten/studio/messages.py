"""Messages of pages to the server: each is checked here once, and refused with a reason.

Text is JSON, an object such as {"do": "volume", "volume_db": -6}; bytes are events of a pen or samples of a sound.
"""

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.untrusted import is_number, parse_json

MAX_BYTES = 4096  # of a message
MAX_EVENTS = 64  # in a message
MAX_EVENTS_PER_S = 2000.0  # twice as many as a pen has
MAX_NAME_LENGTH = 100  # characters of a texture's or an input's
MAX_SOUND_SAMPLE = 16.0  # of full scale: floats go beyond 1


class RefusedError(ValueError):
    """A message that a page may not send; the text says why."""


Allowed = tuple[float, float] | tuple[str, ...] | type[str] | None


@dataclass(frozen=True)
class Protocol:
    """The messages of a kind of page.

    Args:
        kinds: by what a message asks to `do`, the fields that it must have, and those that it may have.
        fields: what a field may be: a number from low to high, one of some texts, any text for `str`, or, for None, a short text
            that can be read. A field that is not named here is checked where it is used.
    """

    kinds: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]]
    fields: Mapping[str, Allowed]


CALIBRATION = ("newtons", "steepness")  # of the pen's pressure, Eq. 12
PLAYING_FIELDS: Mapping[str, tuple[float, float]] = {
    "volume_db": (-60.0, 24.0),
    "newtons": (1e-3, 1e3),
    "steepness": (-50.0, 50.0),
    "rate_hz": (8000.0, 192_000.0),
}
STROKE = Protocol(
    {
        "open": (("texture",), ("sink", "rate_hz", "volume_db", *CALIBRATION)),
        "volume": (("volume_db",), ()),
        "calibrate": (CALIBRATION, ()),
        "actuate": ((), ("resonance_hz", "damping", "gain", "lowest_hz", "limit", "full_scale")),
        "close": ((), ()),
    },
    {
        **PLAYING_FIELDS,
        "texture": str,
        "sink": ("stream", "device"),
        "resonance_hz": (0.0, 1e6),
        "damping": (0.0, 1e6),
        "gain": (-1e6, 1e6),
        "lowest_hz": (0.0, 1e6),
        "limit": (0.0, 1e6),
        "full_scale": (1e-6, 1e6),
    },
)
CAPTURE = Protocol(
    {
        "begin": (("name", "rate_hz"), (*CALIBRATION, "full_scale_m_s2", "input")),
        "train": ((), ()),
        "discard": ((), ()),
    },
    {**PLAYING_FIELDS, "full_scale_m_s2": (1e-3, 1e5), "name": None, "input": None},
)


def parse_message(text: str, protocol: Protocol = STROKE) -> dict[str, Any]:
    """Message in text, checked; RefusedError where it is too long, no JSON object, unknown, or a field is wrong."""
    if len(text) > MAX_BYTES:
        raise RefusedError(f"the message has {len(text)} characters, expected {MAX_BYTES} at most")
    try:
        message = parse_json(text)
    except ValueError:
        raise RefusedError("the message is no JSON") from None
    if not isinstance(message, dict) or not isinstance(message.get("do"), str):
        raise RefusedError("the message is no object with 'do'")
    kind = message["do"]
    if kind not in protocol.kinds:
        raise RefusedError(f"unknown message {kind[:40]!r}, expected one of {', '.join(protocol.kinds)}")
    needed, allowed = protocol.kinds[kind]
    for name in needed:
        if name not in message:
            raise RefusedError(f"{kind}: {name} is missing")
    if unknown := sorted(message.keys() - {"do", *needed, *allowed}):
        raise RefusedError(f"{kind}: unknown field {unknown[0][:40]!r}")
    for name, allowed_values in protocol.fields.items():
        if name in message and (expected := _expectation(name, message[name], allowed_values)):
            raise RefusedError(f"{kind}: {name} is {message[name]!r:.40}, expected {expected}")
    return message


def _expectation(name: str, value: Any, allowed: Allowed) -> str:
    """What a field's value should have been; empty where it is that."""
    if allowed is None:
        readable = isinstance(value, str) and len(value) <= MAX_NAME_LENGTH and value.isprintable()
        return "" if readable and (value or name == "input") else f"up to {MAX_NAME_LENGTH} characters that can be read"
    if not isinstance(allowed, tuple):
        return "" if isinstance(value, str) else "a name"
    if isinstance(allowed[0], str):
        return "" if value in allowed else f"one of {', '.join(map(str, allowed))}"
    low, high = float(allowed[0]), float(allowed[1])
    return "" if is_number(value) and low <= value <= high else f"a number from {low:g} to {high:g}"


def parse_events(data: bytes) -> NDArray[np.float64]:
    """Events of a pen in bytes: x, y [mm], pressure 0 … 1 (0 is lifted), the device's time t [s], shape (n, 4), each four
    little-endian float64; RefusedError unless 1 to `MAX_EVENTS` are there, complete, finite and in range.
    """
    n, remainder = divmod(len(data), 32)
    if remainder or not 1 <= n <= MAX_EVENTS:
        raise RefusedError(f"{len(data)} bytes of events, expected 1 to {MAX_EVENTS} of 32 bytes")
    events = np.frombuffer(data, dtype="<f8").reshape(n, 4)
    if not np.isfinite(events).all() or np.abs(events).max() > 1e9:
        raise RefusedError("an event is not finite, or out of range")
    if (events[:, 2] < 0).any() or (events[:, 2] > 1).any():
        raise RefusedError("a pressure is outside of 0 to 1")
    return events


def parse_capture_bytes(data: bytes) -> tuple[str, NDArray[np.float64]]:
    """Values in the bytes of a capture: `events` behind a letter `e`, shape (n, 4), or `sound` behind an `s`, shape (n,),
    little-endian float32; RefusedError for anything else, and for values that are not finite or out of range.
    """
    kind, payload = data[:1], data[1:]
    if kind == b"e":
        return "events", parse_events(payload)
    if kind != b"s" or not payload or len(payload) % 4:
        raise RefusedError(f"{len(data)} bytes that are neither events nor complete samples of a sound")
    sound = np.frombuffer(payload, dtype="<f4")
    if not np.isfinite(sound).all() or np.abs(sound).max() > MAX_SOUND_SAMPLE:
        raise RefusedError(f"a sample of the sound is not finite, or above {MAX_SOUND_SAMPLE:g} times full scale")
    return "sound", sound.astype(np.float64)


@dataclass
class Allowance:
    """How much a page may still send: so many per second, and a second's worth at once after a pause."""

    per_s: float
    remaining: float = 0.0
    at_s: float = -math.inf

    def take(self, n: float, now_s: float | None = None) -> bool:
        """Whether n more are allowed; they are counted where they are."""
        now_s = time.monotonic() if now_s is None else now_s
        self.remaining = min(self.per_s, self.remaining + (now_s - self.at_s) * self.per_s)
        self.at_s = now_s
        allowed = n <= self.remaining
        self.remaining -= n * allowed
        return allowed
