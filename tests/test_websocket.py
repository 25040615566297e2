"""Pages at a WebSocket: no message brings the server down, and a page that floods it is sent away."""

from __future__ import annotations

import json
import random
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from foten.runtime.renderer import EXAMPLE
from foten.studio import capture_server, studio_server, websocket
from foten.studio.messages import MAX_BYTES
from foten.studio.shelf import Shelf
from foten.studio.studio_server import Studio
from test_messages import BEGIN, STROKE_TEXTS, event
from test_studio_server import HERE, KEY, LOCAL, WS, until

OPEN = {"do": "open", "texture": KEY, "volume_db": -6, "newtons": 0.13, "steepness": 3.32}
# Of each page: a good message, another, texts that are sent as they are, letters before bytes, the good message's answer.
PAGES: dict[str, tuple[Any, Any, list[str], list[bytes], str]] = {
    "stroke": (OPEN, OPEN, [text for text, _ in STROKE_TEXTS], [b""], "opened"),
    "capture": (
        BEGIN,
        {**BEGIN, "newtons": 0.2, "full_scale_m_s2": 3.0},
        [json.dumps(BEGIN), '{"do": "train"}', '{"do": "discard"}'],
        [b"", b"e", b"s", b"x"],
        "ready",
    ),
}


def hostile(rng: random.Random, page: str) -> bytes | str:
    """A message that is malformed, oversized, out of order, or none of these."""
    good, full, texts, letters, _ = PAGES[page]
    kind = rng.randrange(5)
    if kind == 0:
        return rng.choice(letters) + rng.randbytes(rng.choice([0, 1, 3, 4, 31, 32, 33, 64, 2048, 5000]))
    if kind == 1:
        prefix = b"e" if page == "capture" else b""
        return prefix + event(rng.gauss(0, 1e3), rng.gauss(0, 10), rng.uniform(-1, 2))
    if kind == 2:
        text = json.dumps(rng.choice([good, full]))
        at = rng.randrange(len(text))
        return text[:at] + chr(rng.randrange(1, 0x2FFF)) + text[at + 1 :]
    if kind == 3:
        return rng.choice(texts)
    words: list[Any] = [*good, *good.values(), "close", "train", "volume", "../x", None, 1e308, -1, [], {}, True]
    return json.dumps({str(rng.choice(words)): rng.choice(words) for _ in range(4)})


@pytest.mark.parametrize("n", [2000, pytest.param(100_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("page", PAGES)
def test_no_message_brings_it_down(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, page: str, n: int) -> None:
    """Each is taken or refused with a reason; afterwards a page strokes or captures as before."""
    monkeypatch.setattr(websocket, "MAX_REFUSED", 10 * n)
    monkeypatch.setattr(studio_server, "MAX_MESSAGES_PER_S", 1e9)
    monkeypatch.setattr(capture_server, "MAX_CAPTURE_MESSAGES_PER_S", 1e9)
    studio, rng = Studio(Shelf([EXAMPLE]), tmp_path / "captures"), random.Random(0)
    monkeypatch.setattr(studio.trainings, "start", lambda folder, say: None)
    good, *_, answer = PAGES[page]
    with TestClient(studio.app(LOCAL), base_url=HERE, headers={"origin": HERE}) as client:
        with client.websocket_connect(f"{WS}/{page}") as socket:
            for _ in range(n):
                message = hostile(rng, page)
                socket.send_bytes(message) if isinstance(message, bytes) else socket.send_text(message)
            socket.send_text('{"do": "end of the fuzz"}')
            n_refused = 0
            while "end of the fuzz" not in (why := until(socket, "refused")["refused"]):
                n_refused += bool(why)
        assert n_refused > 0.5 * n
        with client.websocket_connect(f"{WS}/{page}") as socket:
            socket.send_text(json.dumps(good))
            document = until(socket, answer, "refused")
            assert answer in document or "captures are kept already" in document["refused"]


@pytest.mark.parametrize("page", PAGES)
def test_what_is_too_long_or_too_much_is_refused(page: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(studio_server, "MAX_MESSAGES_PER_S", 3.0)
    monkeypatch.setattr(capture_server, "MAX_CAPTURE_MESSAGES_PER_S", 3.0)
    monkeypatch.setattr(websocket, "MAX_REFUSED", 50)
    client = TestClient(Studio(Shelf([EXAMPLE])).app(LOCAL), base_url=HERE, headers={"origin": HERE})
    with client, client.websocket_connect(f"{WS}/{page}") as socket:
        socket.send_bytes(bytes(MAX_BYTES + 1))
        assert f"has {MAX_BYTES + 1} bytes, expected {MAX_BYTES} at most" in until(socket, "refused")["refused"]
        for _ in range(100):
            socket.send_text("{}")
        texts: list[str] = []
        with pytest.raises(WebSocketDisconnect) as gone:
            texts.extend(socket.receive_text() for _ in range(100))
    assert gone.value.code == 1008
    assert "more than 3 messages a second" in texts[-1]
