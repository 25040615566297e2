"""What a page may say to the server, and no more: each message is checked here once, and refused with a reason.

Text is JSON, one object with `do`. A page that strokes says:

    {"do": "open", "texture": KEY, "sink": "stream" | "device", "rate_hz": 48000, "volume_db": 0,
     "newtons": 0.13, "steepness": 3.32}
    {"do": "volume", "volume_db": -6}
    {"do": "calibrate", "newtons": 0.13, "steepness": 3.32}
    {"do": "actuate", "resonance_hz": 80, "damping": 0.3, "gain": 40, "lowest_hz": 20, "limit": 2, "full_scale": 2}
    {"do": "actuate"}                               without an actuator
    {"do": "close"}

Bytes are events of a pen, 1 to `MOST_EVENTS` at once, each four little-endian float64: x and y [mm], pressure 0 … 1 (0 is
lifted), the device's time [s].

A page that captures says:

    {"do": "begin", "name": "denim", "rate_hz": 48000, "newtons": 0.13, "steepness": 3.32, "full_scale_m_s2": 50, "input": "…"}
    {"do": "train"}
    {"do": "discard"}

The bytes of a capture begin with a letter: `e` and events as above, or `s` and samples of the sound in their order,
little-endian float32.

A participant's page in a study says, and strokes in bytes as above:

    {"do": "join", "code": "KXWQA", "role": "all" | "stroke" | "answer", "rate_hz": 48000, "volume_db": 0, "newtons": 0.13,
     "steepness": 3.32}
    {"do": "join", "fresh": "KXWQA", …}             as a new participant, under a code that the page drew; not with an operator
    {"do": "done", "step": "trial:5", "rating": 63, "seconds": 12.5, "underruns": 0}
    {"do": "done", "step": "questions:end", "answers": {"remarks": "…"}}
    {"do": "side", "side": "real" | "virtual"}

The operator's page says:

    {"do": "begin"}
    {"do": "hold" | "go", "number": 3}
    {"do": "side", "number": 3, "side": "real" | "virtual"}
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.untrusted import parse_json

MOST_BYTES = 4096  # of a message
MOST_EVENTS = 64  # in a message
MOST_REFUSED = 1000  # messages of a page, after which it is sent away
EVENTS_A_SECOND, MESSAGES_A_SECOND = 2000.0, 1200.0  # a pen has at most a thousand events
CAPTURED_A_SECOND = 12_000.0  # messages, after a pause of a page that goes on recording
BURST_S = 1.0  # of either, that may come at once after a pause


class RefusedError(ValueError):
    """A message that is not one of those above; the text says why."""


LONGEST_NAME = 100  # characters of a texture's or an input's
LOUDEST = 16.0  # of full scale, that a sample of a sound may be: floats go beyond 1
_NUMBERS: Mapping[str, tuple[float, float]] = {
    "volume_db": (-60.0, 24.0),
    "newtons": (1e-3, 1e3),
    "steepness": (-50.0, 50.0),
    "rate_hz": (8000.0, 192_000.0),
    "full_scale_m_s2": (1e-3, 1e5),
    "resonance_hz": (0.0, 1e6),
    "damping": (0.0, 1e6),
    "gain": (-1e6, 1e6),
    "lowest_hz": (0.0, 1e6),
    "limit": (0.0, 1e6),
    "full_scale": (1e-6, 1e6),
    "rating": (0.0, 100.0),
    "seconds": (0.0, 1e6),
    "underruns": (0, 1e6),
    "number": (1, 1e6),
}
_CHOICES: Mapping[str, tuple[str, ...]] = {
    "sink": ("stream", "device"),
    "role": ("all", "stroke", "answer"),
    "side": ("virtual", "real"),
}
Kinds = Mapping[str, tuple[frozenset[str], frozenset[str]]]
STROKE: Kinds = {
    "open": (frozenset({"texture"}), frozenset({"sink", "rate_hz", "volume_db", "newtons", "steepness"})),
    "volume": (frozenset({"volume_db"}), frozenset()),
    "calibrate": (frozenset({"newtons", "steepness"}), frozenset()),
    "actuate": (frozenset(), frozenset({"resonance_hz", "damping", "gain", "lowest_hz", "limit", "full_scale"})),
    "close": (frozenset(), frozenset()),
}
CAPTURE: Kinds = {
    "begin": (frozenset({"name", "rate_hz"}), frozenset({"newtons", "steepness", "full_scale_m_s2", "input"})),
    "train": (frozenset(), frozenset()),
    "discard": (frozenset(), frozenset()),
}
SESSION: Kinds = {
    "join": (frozenset(), frozenset({"code", "fresh", "role", "rate_hz", "volume_db", "newtons", "steepness"})),
    "done": (frozenset({"step"}), frozenset({"rating", "seconds", "underruns", "answers"})),
    "side": (frozenset({"side"}), frozenset()),
}
OPERATOR: Kinds = {
    "begin": (frozenset(), frozenset()),
    "hold": (frozenset({"number"}), frozenset()),
    "go": (frozenset({"number"}), frozenset()),
    "side": (frozenset({"number", "side"}), frozenset()),
}
"""What each kind of message must have, and what it may have."""


def parse_message(text: str, kinds: Kinds = STROKE) -> dict[str, Any]:
    """Return a message in text, one of some kinds.

    Raises:
        RefusedError: it is too long, no JSON object, of an unknown kind, or a field is missing, unknown or out of range.
    """
    if len(text) > MOST_BYTES:
        raise RefusedError(f"the message has {len(text)} characters, expected {MOST_BYTES} at most")
    try:
        message = parse_json(text)
    except ValueError:
        raise RefusedError("the message is no JSON") from None
    if not isinstance(message, dict) or not isinstance(message.get("do"), str):
        raise RefusedError("the message is no object with 'do'")
    kind = message["do"]
    if kind not in kinds:
        raise RefusedError(f"unknown message {kind[:40]!r}, expected one of {', '.join(kinds)}")
    needed, allowed = kinds[kind]
    given = message.keys() - {"do"}
    if missing := sorted(needed - given):
        raise RefusedError(f"{kind}: {missing[0]} is missing")
    if unknown := sorted(given - needed - allowed):
        raise RefusedError(f"{kind}: unknown field {unknown[0][:40]!r}")
    for name, (low, high) in _NUMBERS.items():
        value = message.get(name, low)
        if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
            raise RefusedError(f"{kind}: {name} is {value!r:.40}, expected a number from {low:g} to {high:g}")
    if not isinstance(message.get("texture", ""), str):
        raise RefusedError(f"{kind}: texture is a name")
    for name, choices in _CHOICES.items():
        if message.get(name, choices[0]) not in choices:
            raise RefusedError(f"{kind}: {name} is {message[name]!r:.40}, expected one of {', '.join(choices)}")
    for name in ("name", "input", "code", "fresh", "step"):
        said = message.get(name, "-")
        if (
            not isinstance(said, str)
            or len(said) > LONGEST_NAME
            or not (said or name == "input")
            or not said.isprintable()
        ):
            raise RefusedError(
                f"{kind}: {name} is {said!r:.40}, expected up to {LONGEST_NAME} characters that can be read"
            )
    return message


def parse_events(data: bytes) -> NDArray[np.float64]:
    """Return the events in a message of bytes: x, y [mm], pressure, t [s], shape (n, 4).

    Raises:
        RefusedError: it does not hold 1 to `MOST_EVENTS` whole events, or one is not finite or out of range.
    """
    n, remainder = divmod(len(data), 32)
    if remainder or not 1 <= n <= MOST_EVENTS:
        raise RefusedError(f"{len(data)} bytes of events, expected 1 to {MOST_EVENTS} of 32 bytes")
    events = np.frombuffer(data, dtype="<f8").reshape(n, 4)
    if not np.isfinite(events).all() or np.abs(events).max() > 1e9:
        raise RefusedError("an event is not finite, or out of range")
    if (events[:, 2] < 0).any() or (events[:, 2] > 1).any():
        raise RefusedError("a pressure is outside of 0 to 1")
    return events


def parse_captured(data: bytes) -> tuple[str, NDArray[np.float64]]:
    """Return what a message of bytes of a capture holds: `events`, shape (n, 4), or `sound`, shape (n,).

    Raises:
        RefusedError: it is too long, neither of the two, or a value is not finite or out of range.
    """
    if len(data) > MOST_BYTES:
        raise RefusedError(f"the message has {len(data)} bytes, expected {MOST_BYTES} at most")
    kind, payload = data[:1], data[1:]
    if kind == b"e":
        return "events", parse_events(payload)
    if kind != b"s" or not payload or len(payload) % 4:
        raise RefusedError(f"{len(data)} bytes that are neither events nor whole samples of a sound")
    sound = np.frombuffer(payload, dtype="<f4")
    if not np.isfinite(sound).all() or np.abs(sound).max() > LOUDEST:
        raise RefusedError(f"a sample of the sound is not finite, or above {LOUDEST:g} times full scale")
    return "sound", sound.astype(np.float64)


@dataclass
class Allowance:
    """How much a page may still send: so many a second, and `BURST_S` of them at once."""

    a_second: float
    left: float = math.inf
    at: float = 0.0

    def take(self, n: float, now: float | None = None) -> bool:
        """Return whether n more are allowed, and count them where they are."""
        now = time.monotonic() if now is None else now
        most = self.a_second * BURST_S
        self.left = min(most, self.left + (now - self.at) * self.a_second) if math.isfinite(self.left) else most
        self.at = now
        if n > self.left:
            return False
        self.left -= n
        return True
