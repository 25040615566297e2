"""Messages of pages: which are refused, and with which reason."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
from foten.studio.messages import (
    CAPTURE,
    MAX_NAME_LENGTH,
    Allowance,
    Protocol,
    RefusedError,
    parse_capture_bytes,
    parse_events,
    parse_message,
)
from foten_study.participants import OPERATOR
from foten_study.protocol import PARTICIPANT


def event(x: float, t: float, pressure: float = 0.5) -> bytes:
    return np.array([x, 0.0, pressure, t], dtype="<f8").tobytes()


STROKE_TEXTS = [
    ("", "no JSON"),
    ('{"do": 5}', "no object with 'do'"),
    ('{"do": "dance"}', "unknown message 'dance', expected one of open"),
    ('{"do": "open"}', "texture is missing"),
    ('{"do": "open", "texture": 5}', "texture is 5, expected a name"),
    ('{"do": "open", "texture": "a", "sink": "daq"}', "sink is 'daq', expected one of stream, device"),
    ('{"do": "actuate", "full_scale": 0}', "full_scale is 0, expected a number from 1e-06"),
    ('{"do": "open", "texture": "a", "colour": 1}', "unknown field 'colour'"),
    ('{"do": "open", "texture": "a", "rate_hz": 1}', "rate_hz is 1, expected a number from 8000"),
    ('{"do": "volume", "volume_db": NaN}', "volume_db is nan"),
    ('{"do": "volume", "volume_db": true}', "volume_db is True"),
    ("x" * 5000, "5000 characters"),
    ("[" * 3000 + "]" * 3000, "characters"),
]


@pytest.mark.parametrize(("text", "why"), STROKE_TEXTS)
def test_a_text_that_is_no_message_is_refused_with_a_reason(text: str, why: str) -> None:
    with pytest.raises(RefusedError, match=why):
        parse_message(text)


BEGIN = {"do": "begin", "name": "Old denim, washed", "rate_hz": 48000}
DONE = {"do": "done", "step": "trial:1"}


@pytest.mark.parametrize(
    ("protocol", "message", "why"),
    [
        (CAPTURE, {"do": "open", "texture": "x"}, "unknown message 'open', expected one of begin, train, discard"),
        (CAPTURE, {**BEGIN, "name": ""}, "name is ''"),
        (CAPTURE, {**BEGIN, "name": "a\nb"}, "name is"),
        (CAPTURE, {**BEGIN, "name": "a" * (MAX_NAME_LENGTH + 1)}, "expected up to 100 characters"),
        (CAPTURE, {**BEGIN, "full_scale_m_s2": 0}, "full_scale_m_s2 is 0"),
        (CAPTURE, {**BEGIN, "sink": "device"}, "unknown field 'sink'"),
        (PARTICIPANT, {**DONE, "seconds": "50"}, "seconds is '50'"),
        (PARTICIPANT, {"do": "open", "texture": "x"}, "unknown message 'open', expected one of join"),
        (PARTICIPANT, {"do": "join", "role": "operator"}, "role is 'operator'"),
        (OPERATOR, {"do": "side", "number": 1, "side": []}, r"side is \[\], expected one of virtual, real"),
        (OPERATOR, {"do": "go", "number": 0}, "number is 0, expected a number from 1"),
    ],
)
def test_a_page_sends_what_its_kind_may(protocol: Protocol, message: dict[str, Any], why: str) -> None:
    with pytest.raises(RefusedError, match=why):
        parse_message(json.dumps(message), protocol)
    assert parse_message(json.dumps({**BEGIN, "input": ""}), CAPTURE)["input"] == ""  # may be empty


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "0 bytes of events, expected 1 to 64 of 32 bytes"),
        (b"x" * 31, "31 bytes"),
        (event(0, 0) * 65, "2080 bytes"),
        (event(float("nan"), 0), "not finite"),
        (event(1e12, 0), "out of range"),
        (event(0, 0, 1.5), "pressure"),
        (event(0, 0, -0.1), "pressure"),
    ],
)
def test_events_that_cannot_be_are_refused(data: bytes, why: str) -> None:
    with pytest.raises(RefusedError, match=why):
        parse_events(data)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"s", "neither events nor complete samples"),
        (b"s123", "neither events nor complete samples"),
        (b"x1234", "neither events nor complete samples"),
        (b"e" + bytes(31), "expected 1 to 64 of 32 bytes"),
        (b"s" + np.array([np.nan], dtype="<f4").tobytes(), "not finite"),
        (b"s" + np.array([17.0], dtype="<f4").tobytes(), "above 16 times full scale"),
    ],
)
def test_bytes_that_are_no_capture_are_refused(data: bytes, why: str) -> None:
    with pytest.raises(RefusedError, match=why):
        parse_capture_bytes(data)


def test_an_allowance_fills_again() -> None:
    allowance = Allowance(100.0)
    assert allowance.take(100, now_s=10.0)
    assert not allowance.take(1, now_s=10.0)
    assert allowance.take(50, now_s=10.5)
    assert not allowance.take(1, now_s=10.5)
    assert not allowance.take(101, now_s=99.0)
