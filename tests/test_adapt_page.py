"""The page that measures a user: tones as they were asked for, pairs that play, answers that are kept."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
from starlette.testclient import TestClient

from foten.editing.describe import describe
from foten.editing.user import UserProfile, read_user
from foten.models.texture_file import read_texture, texture_from_bytes
from foten.runtime.actuator import ActuatorProfile
from foten.runtime.renderer import EXAMPLE
from foten.studio.access import LOOPBACK, Access
from foten.studio.page_files import page_files
from foten.studio.shelf import Shelf
from foten.studio.studio_server import Studio
from foten_study.adapt_server import AdaptServer
from foten_study.adapt_session import Limits, Session

TOWEL = EXAMPLE.parent / "towel.foten"
HERE = "http://127.0.0.1:8000"
SHORT = Limits(detect=(1, 1), compare=(1, 1), match=(2, 2))
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="needs Node")


@pytest.fixture
def server(tmp_path: Path) -> AdaptServer:
    session = Session(UserProfile("Ada"), "towel", limits=SHORT)
    return AdaptServer(session, tmp_path / "ada.json", read_texture(TOWEL))


@pytest.fixture
def client(server: AdaptServer) -> Iterator[TestClient]:
    with TestClient(server.app(Access(LOOPBACK, 8000)), base_url=HERE, headers={"origin": HERE}) as client:
        yield client


def test_all_is_asked_and_each_answer_is_kept(server: AdaptServer, client: TestClient) -> None:
    parts, kept = [], 0
    while (question := client.get("/session").json()["question"]) is not None:
        parts.append(question["part"])
        if question["part"] == "match":
            sides = [client.get(f"/pair/{question['n']}/{which}") for which in (0, 1)]
            assert [side.status_code for side in sides] == [200, 200]
            assert sides[0].content != sides[1].content
            assert "for the user Ada: a filter, not measured; edited: " in texture_from_bytes(sides[0].content).evidence
        else:
            assert sum(tone is not None for tone in question["tones"]) == (1 if question["part"] == "detect" else 2)
        assert client.post("/answer", json={"n": question["n"], "which": 1}).status_code == 200
        kept += 1
        assert len(read_user(server.output).answers) == kept
    assert parts == ["detect"] * 5 + ["compare"] * 4 + ["match"] * 2
    profile = read_user(server.output)
    assert profile.texture == "towel"
    assert len(profile.gain_db) == 5
    levels = [
        describe(texture_from_bytes(client.get(f"/textures/{kind}.foten").content)).level_db
        for kind in ("plain", "adapted")
    ]
    assert levels[1] - levels[0] == pytest.approx(profile.moves[0], abs=0.01)


@pytest.mark.parametrize(
    ("body", "line"),
    [
        (b"{", "Expecting"),
        (b"[]", "the answer is no object"),
        (b'{"n": 0}', "an answer has n and which"),
        (b'{"n": true, "which": 0}', "an answer has n and which"),
        (b'{"n": 7, "which": 0}', "answer to question 7, expected one to 0"),
        (b'{"n": 0, "which": 9}', "choice 9, expected 0 to 2"),
        (b'{"stop": true}', "2 choices are the fewest"),
    ],
)
def test_a_bad_answer_is_refused_and_nothing_kept(
    server: AdaptServer, client: TestClient, body: bytes, line: str
) -> None:
    answer = client.post("/answer", content=body)
    assert answer.status_code == 409
    assert line in answer.text
    assert not server.output.exists()
    assert client.get("/session").json()["question"]["n"] == 0


def test_others_get_nothing(client: TestClient) -> None:
    assert client.post("/answer", json={"n": 0, "which": 0}, headers={"origin": "http://x.test"}).status_code == 403
    for path in ("/pair/0/0", "/pair/99/5", "/pair/-1/0", "/textures/other.foten", "/session.py", "/../session.py"):
        assert client.get(path).status_code == 404
    assert "foten: your hand" in client.get("/").text


def test_no_address_is_a_fault_of_a_server(server: AdaptServer, tmp_path: Path) -> None:
    """Every route of every server, with values in each place of its path and of its query."""
    from test_study_server import server_of, study_file

    asked = set()
    for one in (server, Studio(Shelf([TOWEL])), server_of(study_file(tmp_path))):
        app = one.app(Access(LOOPBACK, 8000))
        with TestClient(app, base_url=HERE, headers={"origin": HERE}) as client:
            for value in ("9" * 5000, "-1", "1e999", "nan", "²", "%00", "%ff", "a" * 5000):
                query = "&".join(f"{of}={value}" for of in ("texture", "level", "at", "exact", "key", "role", "token"))
                for route in app._app.routes:  # type: ignore[attr-defined]
                    path = re.sub(r"\{.*?\}", value, route.path)
                    for method in sorted(getattr(route, "methods", ())):  # a WebSocket has none
                        assert client.request(method, f"{path}?texture={TOWEL.name}&{query}").status_code < 500, path
                        asked.add(route.path)
    assert len(asked) >= 12


def test_a_profile_that_cannot_be_written_is_said(server: AdaptServer, client: TestClient) -> None:
    server.output.mkdir()
    answer = client.post("/answer", json={"n": 0, "which": 0})
    assert answer.status_code == 409
    assert "is a folder" in answer.text


def test_the_page_knows_the_actuator(tmp_path: Path) -> None:
    coil = ActuatorProfile("coil", resonance_hz=80.0, gain=10.0, limit=2.0)
    state = AdaptServer(Session(UserProfile()), tmp_path / "a.json", None, coil).state()
    assert (state["actuator"]["full_scale"], state["actuator"]["knee"]) == (2.0, 0.8)


@needs_node
def test_tones_are_as_loud_and_as_high_as_asked(tmp_path: Path) -> None:
    """The page's own worklet in Node."""
    for name, path in page_files().items():
        shutil.copy(path, tmp_path / name)
    shutil.copy(tmp_path / "worklet.js", tmp_path / "worklet.mjs")
    (tmp_path / "worklet.mjs").write_text((tmp_path / "worklet.mjs").read_text().replace("./stream.js", "./stream.mjs"))
    shutil.copy(tmp_path / "stream.js", tmp_path / "stream.mjs")
    (tmp_path / "tones.mjs").write_text(
        """
import { readFileSync } from "node:fs";
globalThis.sampleRate = 48000;
globalThis.currentFrame = 0;
globalThis.AudioWorkletProcessor = class { constructor() { this.port = { postMessage: () => {} }; } };
let Contact;
globalThis.registerProcessor = (_, made) => (Contact = made);
await import("./worklet.mjs");
const contact = new Contact({ processorOptions: { module: new WebAssembly.Module(readFileSync("foten.wasm")) } });
contact.port.onmessage({ data: { do: "burst", tones: [[0.2, 100, 0.5, 0.4], [0.8, 250, 0.01, 0.4]], seconds: 1.3 } });
const samples = [];
for (let k = 0; k < 600; k++) {
  const out = new Float32Array(128);
  contact.process([], [[out]]);
  samples.push(...out);
}
console.log(JSON.stringify(samples));
"""
    )
    done = subprocess.run(["node", "tones.mjs"], cwd=tmp_path, capture_output=True, text=True, check=True)
    samples = np.array(json.loads(done.stdout))
    t = np.arange(samples.size) / 48000
    for begin, hz, peak in ((0.2, 100.0, 0.5), (0.8, 250.0, 0.01)):
        steady = (t >= begin + 0.06) & (t < begin + 0.34)
        amplitude = 2 * abs(np.mean(samples[steady] * np.exp(-2j * np.pi * hz * t[steady])))
        assert amplitude == pytest.approx(peak, rel=0.01)
        inside = (t >= begin) & (t < begin + 0.4)
        assert np.abs(samples[inside]).max() <= peak * 1.001
        assert np.abs(np.diff(samples[inside][:200])).max() < 0.1 * peak  # it begins softly
    assert not samples[(t < 0.19) | ((t > 0.61) & (t < 0.79)) | (t > 1.21)].any()


PROGRAM = """
from pathlib import Path
from foten.editing.user import UserProfile
from foten.models.texture_file import read_texture
from foten_study.adapt_server import AdaptServer
from foten_study.adapt_session import Limits, Session
from foten.studio.web_server import serve
session = Session(UserProfile("Ada"), "towel", limits=Limits(detect=(1, 1), compare=(1, 1), match=(2, 3)))
server = AdaptServer(session, Path({output!r}), read_texture(Path({texture!r})))
serve(server.app, "127.0.0.1", 0, lambda access, shown, joined: print(access.link(shown), flush=True))
"""


@pytest.mark.browser
@pytest.mark.slow
def test_a_user_is_measured_in_a_browser(tmp_path: Path) -> None:
    """Tones light up and are answered by clicks and by keys, two pairs are stroked, and the end shows what the file holds."""
    pytest.importorskip("playwright.sync_api", reason="needs Playwright: pip install '.[browser]'")
    from test_studio_page import chromium, look, until

    output = tmp_path / "ada.json"
    program = PROGRAM.format(output=str(output), texture=str(TOWEL))
    process = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    link = process.stdout.readline().strip()
    complaints: list[Any] = []
    try:
        with chromium() as browser:
            page = browser.new_page()
            page.on("pageerror", lambda error: complaints.append(str(error)))
            page.on("console", lambda message: message.type == "error" and complaints.append(message.text))
            page.goto(link)
            page.wait_for_selector("html[data-ready]")
            complaints += look(page, "adapt-start", ("tablet",))
            page.click("#go")
            for n in range(9):
                until(
                    page,
                    "!document.querySelector('#lights button:disabled') && !document.querySelector('#tones').hidden",
                )
                if n == 3:
                    complaints += look(page, "adapt-tones", ("phone",))
                if n % 2:
                    page.keyboard.press("2")
                else:
                    page.click("#lights button:first-child")
                deadline = time.monotonic() + 10
                while not output.exists() or len(read_user(output).answers) <= n:
                    assert time.monotonic() < deadline
                    page.wait_for_timeout(20)
            for n in range(2):
                if not n:
                    until(page, "document.querySelector('#choose').textContent === 'Yes'", 30)
                    page.fill("#choice input", "-12")
                    complaints += look(page, "adapt-volume", ("tablet",))
                    page.click("#choose")
                until(page, "document.querySelector('#choose').textContent === 'Try B too'", 30)
                assert page.locator("#choose").is_disabled()
                page.mouse.move(300, 300)
                page.mouse.down()
                page.mouse.move(500, 320, steps=20)
                page.mouse.up()
                page.click("#choice [role=radio]:nth-child(2)")
                if not n:
                    complaints += look(page, "adapt-match", ("phone", "desktop"))
                page.click("#choose")
            until(page, "!document.querySelector('#stop').hidden", 30)
            page.click("#stop")
            until(page, "!document.querySelector('#end').hidden")
            until(page, "document.querySelector('#choice [aria-checked=true]')?.textContent === 'yours'", 30)
            complaints += look(page, "adapt-end", ("phone", "desktop"))
            assert page.locator("#done").inner_text() == "Kept in ada.json"
            assert page.locator("#curve circle").count() == 5
    finally:
        process.terminate()
        process.communicate(timeout=20)
    assert not complaints
    profile = read_user(output)
    assert [part for part, *_ in profile.answers] == ["detect"] * 5 + ["compare"] * 4 + ["match:towel"] * 2
    assert profile.answers[-1][2] == 1  # B
    assert profile.volume_db == -12
