"""The studio's server: what it gives, whom it refuses, and that nobody's page is lost or left behind."""

from __future__ import annotations

import asyncio
import contextlib
import json
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
from contextlib import ExitStack, contextmanager
from http.client import HTTPConnection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import anyio
import numpy as np
import pytest

pytest.importorskip("starlette")
from numpy.typing import NDArray
from starlette.testclient import TestClient
from websockets.sync.client import connect as connect_page
from websockets.typing import Origin

from foten.models.texture_file import read_texture, write_texture
from foten.runtime.actuator import ActuatorProfile
from foten.runtime.live import devices
from foten.runtime.renderer import EXAMPLE
from foten.runtime.stylus import PressureCalibration
from foten.studio import studio_server, web_server
from foten.studio.access import LOOPBACK, Access
from foten.studio.live_contact import Contact
from foten.studio.page_files import page_files
from foten.studio.players import OutputDevice, RoundRobinRenderer
from foten.studio.shelf import Shelf
from foten.studio.studio_server import Studio
from foten.studio.websocket import PageSocket
from test_live import FakeDaq
from test_messages import event

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
    """The socket of a page that strokes."""
    client = TestClient(studio.app(LOCAL), base_url=HERE, headers={"origin": HERE})
    with client, client.websocket_connect(f"{WS}/stroke") as socket:
        yield socket


def until(socket: Any, *keys: str) -> dict[str, Any]:
    while True:
        message = socket.receive()
        assert message["type"] != "websocket.close", message
        if message.get("text"):
            document: dict[str, Any] = json.loads(message["text"])
            if document.keys() & set(keys):
                return document


def open_texture(socket: Any, **options: Any) -> dict[str, Any]:
    socket.send_text(json.dumps({"do": "open", "texture": KEY, **options}))
    return until(socket, "opened", "refused")


def test_the_page_and_what_it_needs_are_served(client: TestClient) -> None:
    assert "<title>foten</title>" in client.get("/").text
    kinds = {"studio.js": "text/javascript", "studio.css": "text/css", "foten.mjs": "text/javascript"}
    for name, kind in {**kinds, "foten.wasm": "application/wasm"}.items():
        answer = client.get(f"/{name}")
        assert answer.status_code == 200
        assert answer.headers["content-type"].startswith(kind)
    (listed,) = client.get("/textures.json").json()["textures"]
    assert listed == {"file": KEY, "name": "steel-mesh-1", "method": "foten-plus", "picture": None, "relative": False}
    assert client.get(f"/textures/{KEY}").content == EXAMPLE.read_bytes()


def test_nothing_of_the_page_comes_from_elsewhere_and_it_is_small() -> None:
    """It works without a network: no address of another host in any of its files, which are at most 500 KB."""
    files = page_files()
    for name, path in files.items():
        if path.suffix in (".js", ".mjs", ".html", ".css"):
            text = path.read_text(encoding="utf-8").replace("http://www.w3.org/2000/svg", "")
            assert not re.search("https?://|[\"'(]//", text), name
    assert sum(path.stat().st_size for path in files.values()) <= 500_000


def test_a_photograph_beside_a_texture_is_its_picture_and_a_name_that_is_taken_gets_a_number(tmp_path: Path) -> None:
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "mesh.foten").write_bytes(EXAMPLE.read_bytes())
    (tmp_path / "b/mesh.jpg").write_bytes(b"\xff\xd8 picture")
    (tmp_path / "b/mesh.png").write_bytes(b"what foten render draws")
    with TestClient(Studio(Shelf([tmp_path / "a", tmp_path / "b"])).app(LOCAL), base_url=HERE) as client:
        listed = client.get("/textures.json").json()["textures"]
        assert [one["file"] for one in listed] == ["mesh.foten", "mesh-2.foten"]
        assert client.get(f"/{listed[1]['picture']}").content == b"\xff\xd8 picture"
        gains = client.get("/gains", params={"texture": [one["file"] for one in listed]}).json()["gains_db"]
        assert gains == [0.0, 0.0]


@pytest.mark.parametrize(
    "path",
    [
        "/textures/../server.py",
        "/textures/..%2f..%2f..%2fpyproject.toml",
        "/textures/%2fetc%2fpasswd",
        f"/textures/{KEY}%00.png",
        f"/textures/..\\{KEY}",
        "/%2e%2e%2fserver.py",
        "/access.py",
        "/pictures/..%2f..%2fpyproject.toml",
    ],
)
def test_a_name_is_looked_up_and_is_no_path(client: TestClient, path: str) -> None:
    answer = client.get(path)
    assert answer.status_code == 404
    assert "there is no" in answer.text
    assert answer.text.count("\n") == 1


def test_a_stroke_is_rendered_and_sent_back(client: TestClient, studio: Studio) -> None:
    with client.websocket_connect(f"{WS}/stroke") as socket:
        assert open_texture(socket, rate_hz=8000) == {"opened": KEY, "sink": "stream", "rate_hz": 8000.0}
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
        assert open_texture(socket, sink="device", rate_hz=8000)["sink"] == "device"
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
        assert "opened" in open_texture(socket)
        socket.send_bytes(event(0.0, 0.0))
        assert "state" in until(socket, "state", "refused")


def test_a_device_that_goes_is_said_and_the_page_may_open_again(daq: FakeDaq) -> None:
    studio = Studio(Shelf([EXAMPLE]), output_device=OutputDevice("daq:Dev1/ao0", gain=0.5))
    with stroking(studio) as socket:
        assert "opened" in open_texture(socket, sink="device", rate_hz=8000)
        daq.fails = "samples"
        assert "plays no more: the NI-DAQ takes no samples" in until(socket, "refused")["refused"]
        daq.fails = ""
        assert "opened" in open_texture(socket, sink="device", rate_hz=8000)


def test_pages_have_states_of_their_own(client: TestClient, studio: Studio) -> None:
    with client.websocket_connect(f"{WS}/stroke") as one, client.websocket_connect(f"{WS}/stroke") as other:
        open_texture(one)
        other.send_bytes(event(0, 0))
        assert "before a texture was opened" in json.loads(other.receive()["text"])["refused"]
        state = client.get("/state").json()
        assert sorted(page["texture"] for page in state["pages"]) == ["", KEY]
        assert state["n_refused"] == 1


def test_a_hostile_texture_is_refused(tmp_path: Path) -> None:
    texture, path = read_texture(EXAMPLE), tmp_path / "hostile.foten"
    false = {**texture.tensors, "golden.one_step": texture.tensors["golden.one_step"] + 1.0}
    write_texture(type(texture)(texture.card, false), path)
    contact = Contact(RoundRobinRenderer().player(48_000.0), lambda *_: None)
    for data in (EXAMPLE.read_bytes()[:5000], b"PK\3\4" + bytes(1000), path.read_bytes()):
        with pytest.raises(ValueError, match=r"texture file|truncated|proof"):
            contact.open(data, PressureCalibration())
    contact.close()


def test_a_shelf_says_what_is_missing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"no such file: .*nothing\.foten"):
        Shelf([tmp_path / "nothing.foten"])
    with pytest.raises(ValueError, match=r"holds no texture file \(\.foten\)"):
        Shelf([tmp_path])
    assert len(Shelf()) >= 1


@contextmanager
def serving(
    *arguments: str, command: str = "serve", after: str = "pass"
) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """A server, begun after a statement, until it has ended cleanly, and the link that it printed."""
    code = f"{after}; from foten.cli import main; main()"
    begin = [sys.executable, "-c", code, command, "--no-open", "--port", "0"]
    process = subprocess.Popen([*begin, *arguments], stderr=subprocess.PIPE, text=True, start_new_session=True)
    assert process.stderr is not None
    try:
        yield process, process.stderr.readline().rsplit(" ", 1)[-1].strip()
    finally:
        if process.poll() is None:
            process.terminate()
            assert "Traceback" not in process.communicate(timeout=30)[1]


def check_page(link: str, *handlers: Any) -> None:
    with urllib.request.build_opener(urllib.request.ProxyHandler({}), *handlers).open(link, timeout=20) as answer:
        assert b"<title>foten</title>" in answer.read()


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_it_starts_says_where_and_ends_cleanly(number: int, status: int) -> None:
    with serving(str(EXAMPLE), "--host", "localhost") as (process, link):
        assert link.startswith("http://127.0.0.1:")  # the address that it listens at
        check_page(link)
        process.send_signal(number)
        assert "Traceback" not in process.communicate(timeout=30)[1]
    assert process.returncode in (status, -number)


def test_on_a_network_the_next_link_is_printed_once_one_is_used() -> None:
    own = ssl.create_default_context()
    own.check_hostname, own.verify_mode = False, ssl.CERT_NONE  # as a tablet does that was told to
    with serving(str(EXAMPLE), "--host", "0.0.0.0") as (process, link):
        assert process.stderr is not None
        for _ in range(2):
            device = urllib.request.HTTPSHandler(context=own), urllib.request.HTTPCookieProcessor()
            for _ in range(2):  # a reload of the same link
                check_page(link, *device)
            line = next(line for line in process.stderr if "for the next one: " in line)
            before, link = link, line.rsplit(" ", 1)[-1].strip()
            assert link.partition("?")[0] == before.partition("?")[0]
            assert link != before
            assert "▀" in "".join(process.stderr.readline() for _ in range(5))  # and its code


def closed_after(connections: list[socket.socket], patience_s: float) -> float:
    """Seconds until the server has closed all of some connections."""
    begin = time.monotonic()
    for connection in connections:
        connection.settimeout(max(0.01, begin + patience_s - time.monotonic()))
        try:
            while connection.recv(1000):
                pass
        except ConnectionError:
            pass
    return time.monotonic() - begin


@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of open files")
@pytest.mark.parametrize(
    ("allowed", "limit", "n"), [(1024, -1, 4096), (-1, -1, 4096), (1024, 2048, 2048), (5000, -1, 5000)]
)
def test_files_are_allowed_up_to_the_limit(monkeypatch: pytest.MonkeyPatch, allowed: int, limit: int, n: int) -> None:
    monkeypatch.setattr("resource.getrlimit", lambda _: (allowed, limit))  # -1: without end
    monkeypatch.setattr("resource.setrlimit", lambda *_: None)
    assert web_server._allowed_files() == n


def test_a_connection_that_gives_room_waits_no_more() -> None:
    async def waiting() -> dict[Any, None]:
        connections, sockets = web_server.Connections(lambda *_: None, 2), socket.socketpair()
        for number, one in enumerate(sockets):
            connections._wait(web_server._Connection(one, ("a", number)), 60.0)
            one.close()
        connections._drop_oldest()
        return connections._waiting

    assert [connection.peer for connection in asyncio.run(waiting())] == [("a", 1)]


@pytest.mark.skipif(sys.platform == "win32", reason="has no limit of open files")
@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0"])
def test_connections_that_ask_nothing_shut_nobody_out(host: str) -> None:
    """Three times as many as the server may have files; one that speaks slowly is closed, an open WebSocket goes on."""
    own = ssl.create_default_context()
    own.check_hostname, own.verify_mode = False, ssl.CERT_NONE
    limit = "import resource; resource.setrlimit(resource.RLIMIT_NOFILE, (128, 128))"
    deadline = "import foten.studio.web_server as server; server.REQUEST_S = 1.0"
    with serving(str(EXAMPLE), "--host", host, after=f"{limit}; {deadline}") as (process, link), ExitStack() as stack:
        assert process.stderr is not None
        cookies = urllib.request.HTTPCookieProcessor()
        check_page(link, urllib.request.HTTPSHandler(context=own), cookies)
        address = urlsplit(link)
        encrypted = own if address.scheme == "https" else None
        if encrypted is not None:
            link = next(line for line in process.stderr if "for the next one: " in line).rsplit(" ", 1)[-1].strip()
        there = (address.hostname or "", address.port or 0)

        def connect() -> socket.socket:
            return stack.enter_context(socket.create_connection(there, timeout=5))

        def part_of_a_head() -> socket.socket:
            connection = connect()
            if encrypted is not None:
                connection = stack.enter_context(encrypted.wrap_socket(connection))
            connection.sendall(b"GET / HTTP/1.1\r\nHost: ")
            return connection

        page = stack.enter_context(
            connect_page(
                f"{address.scheme.replace('http', 'ws')}://{address.netloc}/stroke",
                ssl=encrypted,
                proxy=None,
                origin=Origin(f"{address.scheme}://{address.netloc}"),
                additional_headers={"Cookie": "; ".join(f"{one.name}={one.value}" for one in cookies.cookiejar)},
            )
        )
        idle = [connect() for _ in range(400)]
        begin = time.monotonic()
        check_page(link, urllib.request.HTTPSHandler(context=own), urllib.request.HTTPCookieProcessor())
        page_s = time.monotonic() - begin
        closed_s = closed_after([*idle, *[part_of_a_head() for _ in range(10)]], 5.0)
        print(f"a new device has the page after {page_s:.2f} s, all others are closed after {closed_s:.2f} s")
        assert page_s < 2.0
        page.send(json.dumps({"do": "open", "texture": KEY, "rate_hz": 8000}))
        while isinstance(said := page.recv(timeout=5), bytes):
            pass  # of sound
        assert "opened" in json.loads(said)


def test_the_next_request_of_a_connection_has_a_deadline_too() -> None:
    deadline = "import foten.studio.web_server as server; server.NEXT_REQUEST_S = 0.5"
    with serving(str(EXAMPLE), after=deadline) as (_, link):
        connection = HTTPConnection(urlsplit(link).netloc, timeout=5)
        connection.connect()
        used = connection.sock
        for _ in range(3):
            connection.request("GET", "/state")
            assert connection.getresponse().read()
            time.sleep(0.3)
            assert connection.sock is used
        used.sendall(b"GET /state HTTP/1.1\r\n")
        assert closed_after([used], 5.0) < 2.0
        connection.close()


def test_a_body_has_the_deadline_of_its_head(tmp_path: Path) -> None:
    """One at ten bytes a second is closed, and waits meanwhile as an idle connection does; one in pieces is taken."""
    deadline = "import foten.studio.web_server as server; server.REQUEST_S = 1.0; server.MAX_WAITING = 4; server.SHUTDOWN_S = 0.5"
    with ExitStack() as stack, serving("-o", str(tmp_path / "a.json"), command="adapt", after=deadline) as (_, link):
        there, port = urlsplit(link).netloc, urlsplit(link).port or 0
        head = f"POST /answer HTTP/1.1\r\nHost: {there}\r\nOrigin: http://{there}\r\nContent-Length: 900\r\n\r\n"
        slow = [stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=5)) for _ in range(5)]
        for connection in slow:
            connection.sendall(head.encode())
        assert closed_after(slow[:1], 5.0) < 0.9  # there is no room for it
        begin = time.monotonic()
        with contextlib.suppress(ConnectionError):
            while time.monotonic() < begin + 5:
                slow[-1].sendall(b" ")
                time.sleep(0.1)
        assert time.monotonic() - begin < 3
        page = HTTPConnection(there, timeout=5)
        for body, status in (([b'{"n": 0,', b' "which": 0}'], 200), ([b" " * 500] * 8, 409), ([b" " * 500] * 9, 413)):
            page.request("POST", "/answer", iter(body), {"Origin": f"http://{there}"}, encode_chunked=True)
            answer = page.getresponse()
            assert (answer.status, bool(answer.read())) == (status, True)
        page.close()
        stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=5)).sendall(head.encode())
        time.sleep(0.3)  # one that is there as the server ends leaves no traceback


def test_a_socket_that_floods_what_no_page_counts_is_cut() -> None:
    """The rest of what it sent is not read, which took seconds of everybody's time."""
    empty = b"\x80\0\0\0\0"  # and masked, after the byte of a ping, a pong, or a piece of a text that was begun
    with serving(str(EXAMPLE)) as (_, link):
        here = link.rstrip("/")
        for before, kind in ((b"", b"\x89"), (b"", b"\x8a"), (b"\1" + empty, b"\0")):
            with connect_page(f"{here.replace('http', 'ws')}/stroke", proxy=None, origin=Origin(here)) as page:
                page.socket.sendall(100 * (b"\x89" + empty))  # a client may ping
                page.send("{}")
                assert "no object with 'do'" in str(page.recv(timeout=5))
                with pytest.raises(OSError, match=r"^\[Errno "):
                    page.socket.sendall(before + 2_000_000 * (kind + empty))


def test_malformed_requests_do_not_scroll_the_links_away() -> None:
    with serving(str(EXAMPLE)) as (process, link):
        for _ in range(150):
            with socket.create_connection(("127.0.0.1", urlsplit(link).port or 0), timeout=5) as connection:
                connection.sendall(b"\0\r\n\r\n")
                assert connection.recv(1000).startswith(b"HTTP/1.1 400 ")
        process.terminate()
        lines = process.communicate(timeout=30)[1].splitlines()
    assert [line.partition("received")[2] for line in lines if "Invalid HTTP" in line] == [
        ".",
        ". (10 times)",
        ". (100 times)",
    ]


def test_an_address_of_ipv6_is_in_brackets() -> None:
    try:
        with socket.socket(socket.AF_INET6) as probe:
            probe.bind(("::1", 0))
    except OSError:
        pytest.skip("this machine has no ::1")
    with serving(str(EXAMPLE), "--host", "::1") as (_, link):
        assert link.startswith("http://[::1]:")
        check_page(link)


def test_a_page_that_ends_as_it_is_cancelled_is_cancelled_by_its_scope() -> None:
    """What cancels is told by its message, which the end of a sender must not take the place of."""

    async def run() -> bool:
        class Going:
            async def receive(self) -> dict[str, str]:
                await asyncio.sleep(0)  # the sender has begun
                asyncio.get_running_loop().call_soon(scope.cancel)
                return {"type": "websocket.disconnect"}

        with anyio.CancelScope() as scope:
            await PageSocket(Going(), {}, lambda: asyncio.sleep(10)).run()  # type: ignore[arg-type]
        return scope.cancelled_caught

    assert asyncio.run(run())


def test_a_damaged_capture_is_left_out_and_said(tmp_path: Path) -> None:
    for name, data in {"cork": EXAMPLE.read_bytes(), "cloth": EXAMPLE.read_bytes()[:5000], "oak": b""}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}.foten").write_bytes(data)
    with serving(str(EXAMPLE), "--captures", str(tmp_path)) as (process, _):
        assert process.stderr is not None
        lines = [process.stderr.readline() for _ in range(2)]  # the first was read by `serving`
        link = lines[1].rsplit(" ", 1)[-1].strip()
        with urllib.request.urlopen(link + "textures.json", timeout=20) as answer:
            listed = [entry["file"] for entry in json.load(answer)["textures"]]
    assert listed == [KEY, "cork.foten"]
    assert lines[0].startswith(f"left out {tmp_path / 'oak' / 'oak.foten'}: the file has 0 bytes")
