"""Sliders on the page: the server gives what `foten edit` would, and going over to it during a stroke does not click."""

import shutil
import subprocess
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.testclient import TestClient

from foten.editing.describe import describe
from foten.editing.edit import Edit, edited
from foten.models.texture_file import read_texture, texture_from_bytes, write_texture
from foten.runtime.renderer import EXAMPLE
from foten.studio import studio_server, tuning
from foten.studio.page_files import page_files
from foten.studio.shelf import Shelf
from foten.studio.studio_server import Studio
from foten.studio.tuning import moves_of, tuned
from test_studio_server import HERE, LOCAL

FOLDER = EXAMPLE.parent
TOWEL, JEANS = FOLDER / "towel.foten", FOLDER / "jeans.foten"
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="needs Node")


@pytest.mark.slow
def test_exact_sliders_give_what_the_command_gives() -> None:
    moves = {"level": 3.0, "brighter": 0.5}
    expected = edited(read_texture(TOWEL), Edit(level_db=3.0, brighter=0.5)).texture
    assert tuned(TOWEL, None, moves, exact=True) == expected.to_bytes()


def test_a_slider_that_moves_is_nearly_there() -> None:
    before = describe(read_texture(TOWEL))
    after = describe(texture_from_bytes(tuned(TOWEL, None, {"level": 3.0, "brighter": 0.5}, exact=False)))
    assert after.level_db - before.level_db == pytest.approx(3.0, abs=0.01)
    assert np.log2(after.centroid_hz / before.centroid_hz) == pytest.approx(0.5, abs=0.15)


@pytest.mark.parametrize("exact", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_towards_another_texture_lies_between(exact: bool) -> None:
    ends = [describe(read_texture(path)) for path in (TOWEL, JEANS)]
    between = describe(texture_from_bytes(tuned(TOWEL, JEANS, {"at": 0.5}, exact)))
    levels = sorted(one.level_db for one in ends)
    assert levels[0] - 0.1 < between.level_db < levels[1] + 0.1
    assert min(one.centroid_hz for one in ends) < between.centroid_hz < max(one.centroid_hz for one in ends)


def test_a_period_moves_by_octaves() -> None:
    one = texture_from_bytes(tuned(JEANS, None, {"period": 0.5}, exact=False))
    assert describe(one).period_mm == pytest.approx(0.9 * 2**0.5, rel=0.01)
    assert tuned(TOWEL, None, {"period": 0.5}, exact=False) == read_texture(TOWEL).to_bytes()  # which has none


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ({"level": "99"}, "level is 99, expected -12 to 12"),
        ({"brighter": "x"}, "brighter is no number"),
        ({"wider": "nan"}, "wider is nan"),
        ({"at": "-0.1"}, "at is -0.1, expected 0 to 1"),
    ],
)
def test_sliders_beyond_their_range_are_refused(query: dict[str, str], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        moves_of(query)


def test_the_server_moves_its_textures_alone(tmp_path: Path) -> None:
    for path in (TOWEL, JEANS):
        shutil.copy(path, tmp_path / path.name)
    shutil.copy(FOLDER / "steel-mesh-1_ar.foten", tmp_path / "ar.foten")
    app = Studio(Shelf([tmp_path]), tmp_path / "captures").app(LOCAL)
    with TestClient(app, base_url=HERE, headers={"origin": HERE}) as client:
        answer = client.post(
            "/tuned", params={"texture": "towel.foten", "level": "3", "other": "jeans.foten", "at": "0.3"}
        )
        assert answer.status_code == 200
        assert "blended: 0.7 towel, 0.3 jeans" in texture_from_bytes(answer.content).evidence
        for query, line in (
            ({"texture": "../towel.foten"}, "there is no such texture here"),
            ({"texture": "towel.foten", "other": "none"}, "there is no such texture here"),
            ({"texture": "towel.foten", "level": "x"}, "cannot be moved so: level is no number"),
            ({"texture": "ar.foten", "brighter": "1"}, "only the level of ar can be edited"),
        ):
            answer = client.post("/tuned", params=query)
            assert answer.status_code == 404
            assert line in answer.text


def test_the_work_of_sliders_is_done_for_this_servers_page_alone_and_one_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """An exact search takes ten seconds, which a tag on a page of someone else's must not begin."""
    work, done = threading.Event(), threading.Event()
    monkeypatch.setattr(studio_server, "MAX_TUNING_WAIT_S", 0.05)
    monkeypatch.setattr(tuning, "tuned", lambda *arguments: (work.set(), done.wait(10), b"moved")[-1])
    here = {"origin": HERE}
    with TestClient(Studio(Shelf([TOWEL])).app(LOCAL), base_url=HERE) as client:

        def ask(method: str = "POST", **headers: str) -> Any:
            return client.request(method, "/tuned?texture=towel.foten&level=1&exact=1", headers=headers)

        assert ask("GET").status_code == 404
        assert [ask(**headers).status_code for headers in ({}, {"origin": "http://evil.example"})] == [403, 403]
        assert not work.is_set()
        with ThreadPoolExecutor(1) as executor:
            first = executor.submit(ask, **here)
            assert work.wait(10)
            busy = ask(**here)
            done.set()
            assert (busy.status_code, busy.text.count("\n")) == (503, 1)
            assert "another texture is being moved" in busy.text
            assert first.result().content == ask(**here).content == b"moved"


@needs_node
def test_going_over_to_a_moved_texture_does_not_click(tmp_path: Path) -> None:
    """The page's own worklet in Node: no step of the output is larger than those of the two textures by themselves."""
    for name, path in page_files().items():
        shutil.copy(path, tmp_path / name)
    shutil.copy(tmp_path / "worklet.js", tmp_path / "worklet.mjs")
    for name in ("worklet.mjs", "stream.js"):
        (tmp_path / name).write_text((tmp_path / name).read_text().replace("./stream.js", "./stream.mjs"))
    shutil.copy(tmp_path / "stream.js", tmp_path / "stream.mjs")
    moved = [
        tuned(JEANS, None, {"level": 4.0, "brighter": 0.5}, exact=False),
        tuned(JEANS, TOWEL, {"at": 0.4}, exact=False),
        tuned(JEANS, None, {"wider": 0.3, "period": -0.4}, exact=False),
    ]
    (tmp_path / "0.foten").write_bytes(JEANS.read_bytes())
    for i, data in enumerate(moved, 1):
        (tmp_path / f"{i}.foten").write_bytes(data)
    program = tmp_path / "clicks.mjs"
    program.write_text(
        """
import { readFileSync } from "node:fs";
const said = [];
globalThis.sampleRate = 48000;
globalThis.currentFrame = 0;
globalThis.AudioWorkletProcessor = class { constructor() { this.port = { postMessage: (m) => said.push(m) }; } };
let Contact;
globalThis.registerProcessor = (_, made) => (Contact = made);
await import("./worklet.mjs");
const module = new WebAssembly.Module(readFileSync("foten.wasm"));
const run = (plan, n = 1500) => {
  const contact = new Contact({ processorOptions: { module } }), tell = (data) => contact.port.onmessage({ data });
  for (const id of [0, 1, 2, 3]) tell({ do: "load", id, bytes: readFileSync(`${id}.foten`) });
  tell({ do: "use", id: plan(0), scale: 0.03 });
  let last = 0, steepest = 0, loudest = 0;
  for (let k = 0; k < n; k++) {
    const t = (k * 128) / 48000;
    tell({ do: "event", event: [30 + 25 * Math.sin(3 * t), 40 + 10 * Math.sin(4.1 * t), 0.5, t] });
    const id = plan(k);
    if (k && id !== plan(k - 1)) tell({ do: "use", id, scale: 0.03 });
    const out = new Float32Array(128);
    contact.process([], [[out]]);
    for (const x of out) {
      if (k > 200) steepest = Math.max(steepest, Math.abs(x - last));
      loudest = Math.max(loudest, Math.abs(x));
      last = x;
    }
  }
  if (said.some((m) => m.failed)) throw new Error(said.find((m) => m.failed).failed);
  return [steepest, loudest];
};
const alone = [0, 1, 2, 3].map((id) => run(() => id));
console.log(Math.max(...alone.map(([s]) => s)), run((k) => Math.floor(k / 37) % 4)[0], Math.min(...alone.map(([, l]) => l)));
"""
    )
    done = subprocess.run(["node", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    alone, going_over, quietest = map(float, done.stdout.split())
    assert quietest > 0.02  # they sound
    assert going_over <= 1.05 * alone
    assert going_over > 0.3 * alone


@needs_node
def test_the_path_that_was_chosen_last_is_the_one_that_renders(tmp_path: Path) -> None:
    """Where another is chosen before the server has answered, its connection is closed, and nothing is taken from it."""
    for name, path in page_files().items():
        shutil.copy(path, tmp_path / name)
    (tmp_path / "package.json").write_text('{"type": "module"}')
    program = tmp_path / "paths.js"
    program.write_text(
        """
globalThis.location = { href: "http://localhost/" };
globalThis.fetch = async () => ({ arrayBuffer: async () => new Uint8Array([0, 97, 115, 109, 1, 0, 0, 0]).buffer });
const sockets = [];
globalThis.WebSocket = class {
  static OPEN = 1;
  constructor() { Object.assign(this, { readyState: 0, isClosed: false }); sockets.push(this); }
  send() {}
  close() { this.isClosed = true; }
  up() { this.readyState = 1; this.onopen(); }
};
const { PageSound } = await import("./sound.js");
const made = () => {
  const sound = new PageSound();
  sound.context = { sampleRate: 48000, state: "running", currentTime: 0 };
  sound.node = { port: { postMessage() {} } };
  sockets.length = 0;
  return sound;
};
let sound = made();
const first = sound.from("stream");
await sound.from("");
sockets[0].up();
await first;
console.log(sound.server, sockets[0].isClosed);
sound = made();
const both = [sound.from("stream"), sound.from("device")];
for (const socket of sockets) socket.up();
await Promise.all(both);
console.log(sound.server.sink, sockets.map((socket) => socket.isClosed).join(" "));
"""
    )
    done = subprocess.run(["node", program], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["null true", "device true false"]


def test_a_description_is_made_anew_once_the_file_changes(tmp_path: Path) -> None:
    path = tmp_path / "t.foten"
    shutil.copy(TOWEL, path)
    first = tuned(path, None, {"level": 1.0}, exact=False)
    write_texture(read_texture(JEANS), path)
    assert tuned(path, None, {"level": 1.0}, exact=False) != first
