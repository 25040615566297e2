"""The studio's server: what it gives, whom it refuses, and that nobody's page is lost or left behind."""

from __future__ import annotations

import json
import os
import random
import re
import signal
import socket
import ssl
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
from numpy.typing import NDArray
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from foten.families.texture_file import read_texture
from foten.runtime.actuator import ActuatorProfile
from foten.runtime.live import devices
from foten.runtime.live.live import LiveStatistics
from foten.runtime.renderer import EXAMPLE, Renderer
from foten.runtime.stylus import PressureCalibration, Stylus
from foten.studio import players, studio_server, websocket
from foten.studio.access import LOOPBACK, Access, access_to, write_certificate
from foten.studio.live_contact import Contact, limit
from foten.studio.messages import Allowance, RefusedError, parse_events, parse_message
from foten.studio.players import OutputDevice, RoundRobinRenderer
from foten.studio.shelf import Shelf
from foten.studio.studio_server import Studio
from test_live import FakeDaq

LOCAL = Access(LOOPBACK, 8000)
HERE = "http://127.0.0.1:8000"
WS = "ws://127.0.0.1:8000"
KEY = EXAMPLE.name


@pytest.fixture
def studio() -> Studio:
    return Studio(Shelf([EXAMPLE]))


@pytest.fixture
def client(studio: Studio) -> Iterator[TestClient]:
    with TestClient(studio.app(LOCAL), base_url=HERE, headers={"origin": HERE}) as client:
        yield client


@contextmanager
def stroking(studio: Studio) -> Iterator[Any]:
    """Return the socket of a page that strokes."""
    client = TestClient(studio.app(LOCAL), base_url=HERE, headers={"origin": HERE})
    with client, client.websocket_connect(f"{WS}/stroke") as socket:
        yield socket


def event(x: float, t: float, pressure: float = 0.5) -> bytes:
    return np.array([x, 0.0, pressure, t], dtype="<f8").tobytes()


def until(socket: Any, *keys: str) -> dict[str, Any]:
    while True:
        message = socket.receive()
        if message.get("text"):
            document: dict[str, Any] = json.loads(message["text"])
            if document.keys() & set(keys):
                return document


def until_opened(socket: Any) -> dict[str, Any]:
    return until(socket, "opened", "refused")


def test_the_page_and_what_it_needs_are_served(client: TestClient) -> None:
    assert "<title>foten</title>" in client.get("/").text
    for name, kind in {
        "studio.js": "text/javascript",
        "worklet.js": "text/javascript",
        "studio.css": "text/css",
    }.items():
        answer = client.get(f"/{name}")
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith(kind)
    assert client.get("/foten.mjs").headers["content-type"].startswith("text/javascript")
    assert client.get("/foten.wasm").headers["content-type"] == "application/wasm"
    assert client.get("/foten.wasm").content[:4] == b"\0asm"


def test_nothing_of_the_page_comes_from_elsewhere() -> None:
    """It works without a network: no address of another host in any of its files."""
    for name, path in studio_server.page_files().items():
        if path.suffix in (".js", ".mjs", ".html", ".css"):
            text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
            assert not re.search("https?://|[\"'(]//", text), name


def test_the_page_weighs_at_most_500_kb() -> None:
    assert sum(path.stat().st_size for path in studio_server.page_files().values()) <= 500_000


def test_a_texture_is_listed_and_given_as_it_is(client: TestClient) -> None:
    (listed,) = client.get("/textures.json").json()["textures"]
    assert listed == {"file": KEY, "name": "steel-mesh-1", "method": "foten-plus", "picture": None, "relative": False}
    assert client.get(f"/textures/{KEY}").content == EXAMPLE.read_bytes()


def test_a_photograph_beside_a_texture_is_its_picture(tmp_path: Path) -> None:
    (tmp_path / "mesh.foten").write_bytes(EXAMPLE.read_bytes())
    (tmp_path / "mesh.jpg").write_bytes(b"\xff\xd8 picture")
    (tmp_path / "mesh.png").write_bytes(b"what foten render draws")
    with TestClient(Studio(Shelf([tmp_path])).app(LOCAL), base_url=HERE) as client:
        (listed,) = client.get("/textures.json").json()["textures"]
        assert client.get(f"/{listed['picture']}").content == b"\xff\xd8 picture"


def test_textures_of_one_name_have_keys_of_their_own(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mesh.foten").write_bytes(EXAMPLE.read_bytes())
    shelf = Shelf([tmp_path / "a", tmp_path / "b"])
    assert [one["file"] for one in shelf.listed()["textures"]] == ["mesh.foten", "mesh-2.foten"]


@pytest.mark.parametrize(
    "path",
    [
        "/textures/../server.py",
        "/textures/..%2f..%2f..%2fpyproject.toml",
        "/textures/%2e%2e/%2e%2e/pyproject.toml",
        "/textures/%2fetc%2fpasswd",
        f"/textures/{KEY}%00.png",
        f"/textures/..\\{KEY}",
        "/..%2fserver.py",
        "/%2e%2e%2fserver.py",
        "/page/index.html",
        "/access.py",
        "/textures/nothing.foten",
        f"/pictures/{KEY}.png",
        "/pictures/..%2f..%2fpyproject.toml",
    ],
)
def test_a_name_is_looked_up_and_is_no_path(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 404
    assert "there is no" in answer.text
    assert answer.text.count("\n") == 1


def test_a_page_that_another_name_leads_to_is_refused(studio: Studio) -> None:
    """A name of someone else's that resolves to this machine would let their page read ours."""
    for host in ("evil.example:8000", "127.0.0.1:8001", "127.0.0.1", "[::1", ""):
        with TestClient(studio.app(LOCAL), base_url=HERE) as client:
            answer = client.get("/textures.json", headers={"host": host})
            assert answer.status_code == 403
            assert "does not answer to" in answer.text
    with TestClient(studio.app(LOCAL), base_url=HERE) as client:
        for host in ("localhost:8000", "[::1]:8000"):
            assert client.get("/textures.json", headers={"host": host}).status_code == 200


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", "https://127.0.0.1:8000", "http://127.0.0.1:8001", None]
)
def test_a_socket_from_another_page_is_refused(studio: Studio, origin: str | None) -> None:
    headers = {} if origin is None else {"origin": origin}
    with TestClient(studio.app(LOCAL), base_url=HERE) as client:
        connection = client.websocket_connect(f"{WS}/stroke", headers=headers)
        with pytest.raises(WebSocketDisconnect) as refused, connection:
            pass
    assert refused.value.code == 1008
    assert "origin" in refused.value.reason


def test_on_a_network_the_token_is_asked_for_and_becomes_a_cookie(studio: Studio) -> None:
    access = access_to("192.0.2.7", 8443)
    assert access.token is not None
    there = "https://192.0.2.7:8443"
    assert access.link("192.0.2.7") == f"{there}/?token={access.token}"
    with TestClient(studio.app(access), base_url=there, headers={"origin": there}) as client:
        assert client.get("/").status_code == 403
        assert client.get("/", params={"token": access.token[:-1] + "~"}).status_code == 403
        assert client.get("/", headers={"cookie": b"foten=\xe9\xff"}).status_code == 403
        with pytest.raises(WebSocketDisconnect), client.websocket_connect("wss://192.0.2.7:8443/stroke"):
            pass
        moved = client.get("/", params={"token": access.token}, follow_redirects=False)
        assert (moved.status_code, moved.headers["location"]) == (303, "/")
        cookie = moved.headers["set-cookie"].lower()
        assert all(word in cookie for word in ("httponly", "secure", "samesite=lax"))
        assert access.token.lower() not in cookie
        assert client.get("/textures.json").status_code == 200
    assert access.token not in repr(access)
    assert access_to("192.0.2.7", 8443).token != access.token


def test_this_machine_alone_needs_no_token() -> None:
    assert access_to("127.0.0.1", 8000) == LOCAL
    assert LOCAL.link("127.0.0.1") == "http://127.0.0.1:8000/"


def test_a_certificate_is_for_the_hosts_and_its_key_is_for_the_owner_alone(tmp_path: Path) -> None:
    certificate, key = write_certificate(tmp_path, ["192.0.2.7", "localhost"])
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    names = ssl._ssl._test_decode_cert(str(certificate))["subjectAltName"]  # type: ignore[attr-defined]
    assert names == (("IP Address", "192.0.2.7"), ("DNS", "localhost"))
    if os.name == "posix":
        assert key.stat().st_mode & 0o077 == 0


def test_a_stroke_is_rendered_and_sent_back(client: TestClient, studio: Studio) -> None:
    with client.websocket_connect(f"{WS}/stroke") as socket:
        socket.send_text(json.dumps({"do": "open", "texture": KEY, "rate_hz": 8000}))
        assert until_opened(socket) == {"opened": KEY, "sink": "stream", "rate_hz": 8000.0}
        loudest = fastest = firmest = 0.0
        begin = time.monotonic()
        n = 0
        while time.monotonic() - begin < 10 and not (loudest > 0.5 and fastest > 60):
            socket.send_bytes(event(80 * 0.005 * n, 0.005 * n))  # by the pen's clock, however busy this machine is
            n += 1
            data = socket.receive().get("bytes")
            if data:
                speed, force, *samples = np.frombuffer(data, dtype="<f4")
                loudest, fastest = max(loudest, float(np.abs(samples).max())), max(fastest, float(speed))
                firmest = max(firmest, float(force))
        assert loudest > 0.5  # m/s²
        assert 60 < fastest < 90  # of 80 mm/s, and 4 % that the low-pass overshoots
        assert 0.5 < firmest < 0.9  # Eq. 12 at a pressure of 0.5: 0.68 N
        (page,) = studio.pages
        assert page.state()["n_events"] == n
    deadline = time.monotonic() + 10
    while studio.pages and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not studio.pages
    assert not [thread for thread in threading.enumerate() if thread.name in ("foten-render", "foten-sink")]


COIL = ActuatorProfile(name="coil", resonance_hz=80.0, damping=0.3, gain=40.0, unit="V", limit=5.0)


@pytest.fixture
def daq(monkeypatch: pytest.MonkeyPatch) -> FakeDaq:
    fake = FakeDaq(every_s=0.01)  # half of its buffer, in real time
    monkeypatch.setattr(devices, "_nidaqmx", lambda: fake)
    return fake


def test_a_page_is_played_through_a_daq(daq: FakeDaq) -> None:
    """Its volts are what is rendered, which the page is sent to draw."""
    studio = Studio(Shelf([EXAMPLE]), output_device=OutputDevice("daq:Dev1/ao0", COIL))
    drawn: list[NDArray[np.float32]] = []
    with stroking(studio) as socket:
        socket.send_text(json.dumps({"do": "open", "texture": KEY, "sink": "device", "rate_hz": 8000}))
        assert until(socket, "opened")["sink"] == "device"
        begin = time.monotonic()
        while time.monotonic() - begin < 10 and sum(np.abs(one).max() > 1e-3 for one in drawn) < 20:
            socket.send_bytes(event(0.4 * len(drawn), 0.005 * len(drawn)))
            data = None
            while data is None:
                data = socket.receive().get("bytes")
            drawn.append(np.frombuffer(data, dtype="<f4")[2:])
    assert ("Dev1/ao0", {"min_val": -10.0, "max_val": 10.0}) in daq.log
    assert daq.log[-2] == ("volts", 0.0)
    # But silence where this machine was too busy, and what fades as it stops.
    seen, volts = (every[every != 0.0] for every in (np.concatenate(drawn), np.concatenate(daq.written)))
    n = min(seen.size, volts.size - 2 * daq.n)
    assert np.abs(volts[:n]).max() > 1e-3
    np.testing.assert_allclose(volts[:n], seen[:n], rtol=1e-6)


class Held:
    """A player that renders when a test says so."""

    def __init__(self, calibrated: bool, actuator: ActuatorProfile | None) -> None:
        self.rate_hz, self.running = 8000.0, True
        self.calibrated, self.actuator, self.statistics = calibrated, actuator, LiveStatistics()

    def start(self, render: Any) -> None:
        self.render = render

    def stop(self) -> None:
        pass


@pytest.mark.parametrize("there", [True, False])
def test_an_actuator_is_driven_as_it_needs(there: bool) -> None:
    """One that is wired to this machine, at 0 dB as it was recorded, and not the page's; else the page's."""
    events = [(0.4 * k, 0.0, 0.5, 0.005 * k) for k in range(20)]
    renderer = Renderer(EXAMPLE, rate=8000.0, actuator=COIL)
    stylus = Stylus(renderer)
    player = Held(there, COIL if there else None)
    contact = Contact(player, lambda *_: None)
    contact.open(EXAMPLE.read_bytes(), PressureCalibration())
    contact.actuate(ActuatorProfile(resonance_hz=200.0, damping=0.1, gain=3.0) if there else COIL, full_scale=5.0)
    contact.set_volume(-6.0)
    contact.push(np.array(events))
    for one in events:
        stylus.push(*one)
    out, expected = np.zeros(800, dtype=np.float32), stylus.render(800)
    player.render(out)
    scale = 1.0 if there else 1 / 5.0
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(out, expected * scale * 10 ** (-6 / 20), rtol=1e-5)


def stroked(contact: Contact, player: Held, n: int, seconds: float) -> NDArray[np.float32]:
    """Return what a player is given for n events of a steady stroke at 80 mm/s and what follows, in blocks of 8 ms."""
    blocks = []
    for k in range(round(seconds / 0.008)):
        contact.push(np.array([[80 * t, 0.0, 0.5, t] for t in (0.008 * k, 0.008 * k + 0.004) if k < n]).reshape(-1, 4))
        block = np.zeros(64, dtype=np.float32)
        player.render(block)
        blocks.append(block)
    return np.concatenate(blocks)


def test_a_texture_that_takes_over_in_a_stroke_makes_no_gap_and_no_click() -> None:
    player = Held(False, None)
    contact = Contact(player, lambda *_: None)
    contact.open(EXAMPLE.read_bytes(), PressureCalibration())
    before = stroked(contact, player, 100, 0.4)[-1600:]
    contact.open(EXAMPLE.read_bytes(), PressureCalibration(), seed=7)
    after = np.zeros(640, dtype=np.float32)
    player.render(after)  # without another event: the last ones are known to the new one
    usual = np.abs(np.diff(before)).max()
    assert np.abs(np.diff(np.concatenate([before[-1:], after]))).max() < 1.5 * usual
    # Behind the fade, 85 samples, the new one sounds alone: the pen was moving when it came.
    assert np.sqrt(np.mean(after[90:200] ** 2)) > 0.05 * np.sqrt(np.mean(before**2))


def test_the_volume_moves_without_a_step_and_what_is_too_loud_is_bent() -> None:
    player = Held(False, None)
    contact = Contact(player, lambda *_: None)
    contact.open(EXAMPLE.read_bytes(), PressureCalibration())
    contact.set_volume(-20.0)
    soft = stroked(contact, player, 100, 0.4)[-800:]
    contact.set_volume(24.0)
    loud = np.zeros(64, dtype=np.float32)
    player.render(loud)
    assert abs(loud[0]) < 10 * np.abs(soft).max()
    for _ in range(20):
        player.render(loud)
        assert np.abs(loud).max() < 1.0
    samples = np.array([-3.0, -0.8, 0.0, 0.5, 0.9, 3.0], dtype=np.float32)
    limit(samples)
    np.testing.assert_allclose(samples[1:4], [-0.8, 0.0, 0.5])
    assert 0.8 < samples[4] < 0.9
    assert -1.0 <= samples[0] < -0.99


def test_a_contact_that_is_closed_while_it_opens_does_not_play() -> None:
    player = Held(False, None)
    contact = Contact(player, lambda *_: None)
    contact.close()
    with pytest.raises(OSError, match="the page has left"):
        contact.open(EXAMPLE.read_bytes(), PressureCalibration())
    assert not hasattr(player, "render")


def test_a_page_that_opens_slowly_is_not_taken_for_one_that_died(
    studio: Studio, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reports of how rendering keeps up come in between."""
    opens = Contact.open

    def slowly(*arguments: Any, **options: Any) -> None:
        time.sleep(0.3)
        opens(*arguments, **options)

    monkeypatch.setattr(Contact, "open", slowly)
    monkeypatch.setattr(studio_server, "STATE_S", 0.05)
    with stroking(studio) as socket:
        socket.send_text(json.dumps({"do": "open", "texture": KEY}))
        assert "opened" in until_opened(socket)
        socket.send_bytes(event(0.0, 0.0))
        assert "state" in until(socket, "state", "refused")


def test_without_an_actuator_a_daq_is_told_its_volts() -> None:
    with pytest.raises(ValueError, match="say with --gain how many volts 1 m/s² is"):
        OutputDevice("daq:Dev1/ao0")
    with pytest.raises(ValueError, match="a page plays in real time"):
        OutputDevice("stroke.wav")
    with pytest.raises(ValueError, match="--device and --channel are a sound card's"):
        OutputDevice("null", device="3").check()
    assert OutputDevice("daq:Dev1/ao0", gain=0.5).calibrated
    assert not OutputDevice().calibrated


def test_a_device_that_goes_is_said_and_the_page_may_open_again(daq: FakeDaq) -> None:
    studio = Studio(Shelf([EXAMPLE]), output_device=OutputDevice("daq:Dev1/ao0", gain=0.5))
    opening = json.dumps({"do": "open", "texture": KEY, "sink": "device", "rate_hz": 8000})
    with stroking(studio) as socket:
        socket.send_text(opening)
        assert "opened" in until_opened(socket)
        daq.fails = "samples"
        assert "plays no more: the NI-DAQ takes no samples" in until(socket, "refused")["refused"]
        daq.fails = ""
        socket.send_text(opening)
        assert "opened" in until_opened(socket)


def test_pages_have_states_of_their_own(client: TestClient, studio: Studio) -> None:
    with client.websocket_connect(f"{WS}/stroke") as one, client.websocket_connect(f"{WS}/stroke") as other:
        one.send_text(json.dumps({"do": "open", "texture": KEY}))
        until_opened(one)
        other.send_bytes(event(0, 0))
        assert "before a texture was opened" in json.loads(other.receive()["text"])["refused"]
        state = client.get("/state").json()
        assert sorted(page["texture"] for page in state["pages"]) == ["", KEY]
        assert state["n_refused"] == 1


BAD = [
    ("", "no JSON"),
    ("[1]", "no object with 'do'"),
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
    ('{"do": "volume", "volume_db": 1e999}', "volume_db is inf"),
    ('{"do": "calibrate", "newtons": 0.1}', "steepness is missing"),
    ('{"do": "close", "x": 1}', "unknown field"),
    ("x" * 5000, "5000 characters"),
    ("[" * 3000 + "]" * 3000, "characters"),
]


@pytest.mark.parametrize(("text", "why"), BAD)
def test_a_message_of_another_kind_is_refused_with_a_reason(text: str, why: str) -> None:
    with pytest.raises(RefusedError, match=why.replace("(", r"\(")):
        parse_message(text)


@pytest.mark.parametrize(
    ("data", "why"),
    [
        (b"", "0 bytes"),
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


def hostile(rng: random.Random) -> dict[str, Any]:
    """Return a message that is malformed, oversized or out of order."""
    kind = rng.randrange(5)
    if kind == 0:
        return {"type": "websocket.receive", "bytes": rng.randbytes(rng.choice([0, 1, 31, 32, 33, 64, 2048, 5000]))}
    if kind == 1:
        return {"type": "websocket.receive", "text": rng.choice(BAD)[0]}
    if kind == 2:
        text = json.dumps({"do": "open", "texture": KEY, "volume_db": -6, "newtons": 0.13, "steepness": 3.32})
        at = rng.randrange(len(text))
        return {"type": "websocket.receive", "text": text[:at] + chr(rng.randrange(1, 0x2FFF)) + text[at + 1 :]}
    if kind == 3:
        return {"type": "websocket.receive", "bytes": event(rng.gauss(0, 1e3), rng.gauss(0, 10), rng.uniform(-1, 2))}
    words: list[Any] = ["open", "close", "volume", "texture", KEY, "../x", None, 1e308, -1, [], {}, True, "do", "sink"]
    return {
        "type": "websocket.receive",
        "text": json.dumps({str(rng.choice(words)): rng.choice(words) for _ in range(4)}),
    }


@pytest.mark.parametrize("n", [2000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_no_message_brings_it_down(monkeypatch: pytest.MonkeyPatch, n: int) -> None:
    """Each is taken or refused with a reason; afterwards a page strokes as before."""
    monkeypatch.setattr(websocket, "MAX_REFUSED", 10 * n)
    monkeypatch.setattr(studio_server, "MAX_MESSAGES_PER_S", 1e9)
    studio, rng = Studio(Shelf([EXAMPLE])), random.Random(0)
    with TestClient(studio.app(LOCAL), base_url=HERE, headers={"origin": HERE}) as client:
        with client.websocket_connect(f"{WS}/stroke") as socket:
            for _ in range(n):
                message = hostile(rng)
                data, text = message.get("bytes"), message.get("text")
                socket.send_bytes(data) if data is not None else socket.send_text(text)
            socket.send_text(json.dumps({"do": "open", "texture": KEY}))
            while "opened" not in until_opened(socket):
                pass
        assert studio.n_refused > 0.8 * n
        with client.websocket_connect(f"{WS}/stroke") as socket:
            socket.send_text(json.dumps({"do": "open", "texture": KEY}))
            assert until_opened(socket)["opened"] == KEY


def test_a_flood_is_refused_and_then_sent_away(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(websocket, "MAX_REFUSED", 50)
    with TestClient(Studio(Shelf([EXAMPLE])).app(LOCAL), base_url=HERE, headers={"origin": HERE}) as client:
        with client.websocket_connect(f"{WS}/stroke") as socket:
            for _ in range(100):
                socket.send_text("{}")
            with pytest.raises(WebSocketDisconnect) as gone:
                list(iter(socket.receive_text, None))
        assert gone.value.code == 1008


def test_an_allowance_fills_again() -> None:
    allowance = Allowance(100.0)
    assert allowance.take(100, now_s=10.0)
    assert not allowance.take(1, now_s=10.0)
    assert allowance.take(50, now_s=10.5)
    assert not allowance.take(1, now_s=10.5)
    assert allowance.take(100, now_s=99.0)
    assert not allowance.take(1, now_s=99.0)


@pytest.mark.parametrize("damage", ["truncated", "another", "proof"])
def test_a_hostile_texture_is_refused(tmp_path: Path, damage: str) -> None:
    data = bytearray(EXAMPLE.read_bytes())
    if damage == "truncated":
        data = data[: len(data) // 2]
    elif damage == "another":
        data = bytearray(b"PK\3\4" + bytes(1000))
    else:
        tensors = {name: tensor.copy() for name, tensor in read_texture(EXAMPLE).tensors.items()}
        tensors["golden.one_step"] += 1.0
        from safetensors.numpy import save

        data = bytearray(save(tensors, metadata={"foten": json.dumps(dict(read_texture(EXAMPLE).card))}))
    path = tmp_path / "hostile.foten"
    path.write_bytes(data)
    contact = Contact(RoundRobinRenderer().player(48_000.0), lambda *_: None)
    with pytest.raises(ValueError, match=r"texture file|truncated|proof"):
        contact.open(bytes(data), PressureCalibration())
    contact.close()
    if damage != "proof":  # which only rendering finds
        with pytest.raises(ValueError, match=r"hostile\.foten"):
            Shelf([path])


def test_what_rendering_dies_of_is_raised_by_stop_and_ends_no_other_page() -> None:
    turns, rendered = RoundRobinRenderer(), threading.Event()

    def fails(_out: Any) -> None:
        raise ValueError("no more")

    broken, sound = turns.player(48_000.0), turns.player(48_000.0)
    broken.start(fails)
    sound.start(lambda _out: rendered.set())
    assert rendered.wait(5.0)
    rendered.clear()
    assert rendered.wait(5.0)
    sound.stop()
    with pytest.raises(ValueError, match="no more"):
        broken.stop()


def test_turns_that_were_left_out_are_missed() -> None:
    turns, after = RoundRobinRenderer(), threading.Event()
    player, n = turns.player(48_000.0), iter(range(10**6))

    def stands_still(_out: Any) -> None:
        k = next(n)
        if k == 1:
            time.sleep(0.5)
        if k == 4:
            after.set()

    player.start(stands_still)
    assert after.wait(5.0)
    player.stop()
    assert player.statistics.n_missed >= 0.9 * 0.5 / turns.block_s


def test_a_shelf_says_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no such file: .*nothing\.foten"):
        Shelf([tmp_path / "nothing.foten"])
    with pytest.raises(ValueError, match=r"holds no texture file \(\.foten\)"):
        Shelf([tmp_path])
    assert len(Shelf()) >= 1


def started(*arguments: str) -> tuple[subprocess.Popen[str], str]:
    """Return a server and the link that it printed."""
    command = [
        sys.executable,
        "-c",
        "from foten.cli import main; main()",
        "serve",
        "--no-open",
        "--port",
        "0",
        *arguments,
    ]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stderr is not None
    line = process.stderr.readline()
    return process, line.rsplit(" ", 1)[-1].strip()


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_it_starts_says_where_and_ends_cleanly(number: int, status: int) -> None:
    process, link = started(str(EXAMPLE))
    try:
        with urllib.request.urlopen(link, timeout=20) as answer:
            assert b"<title>foten</title>" in answer.read()
    finally:
        process.send_signal(number)
        _, rest = process.communicate(timeout=30)
    assert process.returncode in (status, -number)
    assert "Traceback" not in rest


def on_the_network(studio: Studio) -> tuple[Access, list[Access], Any]:
    """Return the access to a server on a network, those that it was renewed to, and how to come there with a new device."""
    renewed: list[Access] = []
    access = access_to("192.0.2.7", 8443, on_joined=renewed.append)
    app, there = studio.app(access), "https://192.0.2.7:8443"
    return access, renewed, lambda: TestClient(app, base_url=there, headers={"origin": there}, follow_redirects=False)


def test_a_link_lets_one_device_in_and_the_next_one_has_another(studio: Studio) -> None:
    access, renewed, device = on_the_network(studio)
    first, second, third = device(), device(), device()
    assert first.get("/", params={"token": access.token}).status_code == 303
    (newest,) = renewed
    assert newest.token not in (None, access.token)
    assert (newest.hosts, newest.port) == (access.hosts, access.port)
    refused = second.get("/", params={"token": access.token})
    assert refused.status_code == 403
    assert "open the newest link" in refused.text
    assert second.get("/").status_code == 403
    assert second.get("/", params={"token": newest.token}).status_code == 303
    assert first.get("/").status_code == second.get("/").status_code == 200
    assert first.cookies["foten"] != second.cookies["foten"]
    # The link of the second one is used up too, and a device's secret is no token.
    for token in (newest.token, first.cookies["foten"]):
        assert third.get("/", params={"token": token}).status_code == 403
    assert len(renewed) == 2
    # A device whose cookies are gone comes in by the newest link, like any other.
    first.cookies.clear()
    assert first.get("/").status_code == 403
    assert first.get("/", params={"token": renewed[-1].token}).status_code == 303
    assert first.get("/").status_code == 200


def test_a_device_that_is_in_opens_an_old_link_and_uses_up_no_new_one(studio: Studio) -> None:
    access, renewed, device = on_the_network(studio)
    client = device()
    client.get("/", params={"token": access.token})
    cookie = client.cookies["foten"]
    for token in (access.token, renewed[0].token, "of another start"):
        moved = client.get("/", params={"token": token})
        assert (moved.status_code, moved.headers["location"]) == (303, "/")
        assert "set-cookie" not in moved.headers
    assert client.cookies["foten"] == cookie
    assert len(renewed) == 1
    assert client.get("https://192.0.2.7:8443//evil.example/x?token=x").headers["location"] == "/evil.example/x"


@pytest.mark.parametrize(
    "headers",
    [{"sec-purpose": "prefetch;prerender"}, {"purpose": "prefetch"}, {"x-purpose": "preview"}, {"x-moz": "prefetch"}],
)
def test_who_looks_ahead_does_not_use_up_the_link(studio: Studio, headers: dict[str, str]) -> None:
    access, renewed, device = on_the_network(studio)
    client = device()
    assert client.head("/", params={"token": access.token}).status_code == 200
    assert client.get("/", params={"token": access.token}, headers=headers).status_code == 503
    assert client.post("/", params={"token": access.token}).status_code == 403
    with pytest.raises(WebSocketDisconnect):
        client.websocket_connect(f"wss://192.0.2.7:8443/stroke?token={access.token}").__enter__()
    assert not renewed
    assert not client.cookies
    assert client.get("/", params={"token": access.token}).status_code == 303
    with client.websocket_connect("wss://192.0.2.7:8443/stroke"):
        pass


def test_a_host_is_known_in_whatever_case_it_is_written(studio: Studio) -> None:
    """A browser asks for `mybox.local` where the link says `MyBox.local`."""
    access = access_to("MyBox.local", 8443)
    with TestClient(studio.app(access), base_url="https://mybox.local:8443") as client:
        for host in ("mybox.local:8443", "MyBox.local:8443"):
            headers = {"host": host, "origin": "https://mybox.local:8443"}
            assert client.get("/", params={"token": access.token}, headers=headers).status_code == 200
            with client.websocket_connect("wss://mybox.local:8443/stroke", headers=headers):
                pass
        assert client.get("/", headers={"host": "other.local:8443"}).status_code == 403
    assert access_to("LocalHost", 8000) == LOCAL


def ended(process: subprocess.Popen[str]) -> str:
    """End a server, and return what else it said."""
    process.terminate()
    return process.communicate(timeout=30)[1]


def test_on_a_network_the_next_link_is_printed_once_one_is_used() -> None:
    process, link = started(str(EXAMPLE), "--host", "0.0.0.0")
    try:
        own = ssl.create_default_context()
        own.check_hostname, own.verify_mode = False, ssl.CERT_NONE  # as a tablet does that was told to
        for _ in range(2):
            opener = urllib.request.build_opener(
                urllib.request.HTTPSHandler(context=own),
                urllib.request.HTTPCookieProcessor(),
                urllib.request.ProxyHandler({}),
            )
            for _ in range(2):  # a reload of the same link
                with opener.open(link, timeout=20) as answer:
                    assert b"<title>foten</title>" in answer.read()
            assert process.stderr is not None
            line = next(line for line in process.stderr if "for the next one: " in line)
            before, link = link, line.rsplit(" ", 1)[-1].strip()
            assert link.partition("?")[0] == before.partition("?")[0]
            assert link != before
            assert "▀" in "".join(process.stderr.readline() for _ in range(5))  # and its code
    finally:
        rest = ended(process)
    assert "Traceback" not in rest


@pytest.mark.skipif(not socket.has_ipv6, reason="needs IPv6")
def test_the_address_that_is_printed_is_the_one_it_listens_at() -> None:
    with socket.socket(socket.AF_INET6) as probe:
        try:
            probe.bind(("::1", 0))
        except OSError:
            pytest.skip("this machine has no ::1")
    for host, shown in (("::1", "http://[::1]:"), ("localhost", "http://127.0.0.1:")):
        process, link = started(str(EXAMPLE), "--host", host)
        try:
            assert link.startswith(shown)
            with urllib.request.build_opener(urllib.request.ProxyHandler({})).open(link, timeout=20) as answer:
                assert b"<title>foten</title>" in answer.read()
        finally:
            ended(process)


def test_a_damaged_capture_is_left_out_and_said(tmp_path: Path) -> None:
    for name, data in {"cork": EXAMPLE.read_bytes(), "cloth": EXAMPLE.read_bytes()[:5000], "oak": b""}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}.foten").write_bytes(data)
    process, _ = started(str(EXAMPLE), "--captures", str(tmp_path))
    rest = ""
    try:
        assert process.stderr is not None
        while " at http://" not in rest:
            line = process.stderr.readline()
            assert line, rest
            rest += line
        with urllib.request.urlopen(rest.rsplit(" ", 1)[-1].strip() + "textures.json", timeout=20) as answer:
            listed = [one["file"] for one in json.load(answer)["textures"]]
    finally:
        ended(process)
    assert listed == [KEY, "cork.foten"]
    assert rest.count("\n") == 2  # the first line was read by `started`
    assert f"left out {tmp_path / 'oak' / 'oak.foten'}: the file has 0 bytes" in rest


def test_white_noise_has_its_level_and_is_white(monkeypatch: pytest.MonkeyPatch) -> None:
    taken: list[NDArray[np.float32]] = []

    class Sink:
        rate_hz, n_at_once, patient, failed = 48_000.0, 480, False, None

        def start(self, read: Any) -> None:
            for _ in range(20):
                block = np.zeros(480, dtype=np.float32)
                time.sleep(0.005)
                read(block)
                taken.append(block)

        def stop(self) -> None:
            pass

    asked: list[Any] = []
    monkeypatch.setattr(players, "sink_of", lambda *options: asked.append(options) or Sink())
    with players.white_noise(-30.0, "3"):
        pass
    assert asked[0][0] == "sound"
    assert asked[0][4] == "3"
    noise = np.concatenate([block for block in taken if block.any()]).astype(float)
    assert noise.size > 5000
    assert 20 * np.log10(noise.std()) == pytest.approx(-30.0, abs=0.5)
    assert abs(np.corrcoef(noise[:-1], noise[1:])[0, 1]) < 0.05
