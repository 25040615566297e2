"""The server's side of a capture: what it takes and keeps; a subprocess, `foten.cli.train_capture`, learns of it."""

from __future__ import annotations

import dataclasses
import json
import re
import sys
import time
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("starlette")
import scipy.io.wavfile
from starlette.testclient import TestClient

from conftest import exported
from foten.cli import train_capture
from foten.datasets.hdf5 import load_recording
from foten.dsp import Array
from foten.models.foten_plus.config import WITHHELD
from foten.models.texture_file import read_texture
from foten.recording.capture_folder import About
from foten.recording.recording import RELATIVE
from foten.runtime.renderer import EXAMPLE
from foten.simulation.simulate import simulate
from foten.simulation.simulated_capture import SOUND_HZ, SimulatedCapture, simulate_capture
from foten.studio import capture_server, studio_server
from foten.studio.capture_server import CaptureSession, in_order
from foten.studio.messages import MAX_BYTES, RefusedError
from foten.studio.shelf import Shelf
from foten.studio.studio_server import Studio
from test_messages import BEGIN
from test_studio_server import HERE, LOCAL, until

WS = "ws://127.0.0.1:8000/capture"
PIECE = 896  # samples


@pytest.fixture
def studio(tmp_path: Path) -> Studio:
    return Studio(Shelf([EXAMPLE]), tmp_path / "captures")


@pytest.fixture
def client(studio: Studio) -> Iterator[TestClient]:
    with TestClient(studio.app(LOCAL), base_url=HERE, headers={"origin": HERE}) as client:
        yield client


def sound(samples: Array) -> bytes:
    return b"s" + samples.astype("<f4").tobytes()


def events(*rows: tuple[float, float, float, float]) -> bytes:
    return b"e" + np.array(rows, dtype="<f8").tobytes()


def answered(socket: Any, kind: str) -> dict[str, Any]:
    """The first answer of a kind, or the one that nothing follows: without an end, a missing answer is waited for in vain."""
    return until(socket, kind, "refused", "done")


def say(socket: Any, performance: SimulatedCapture, hz: float = 200.0) -> None:
    """Send a whole performance: its sound in pieces, its events in between, one of them a millisecond late."""
    plan = performance.plan[:: round(1000 / hz)]
    down = plan[:, 3] > 0
    samples_in = down | np.append(False, down[:-1])  # what touches, and the lift after it
    rows = plan[samples_in][:, [1, 2, 3, 0]]
    middle = int(np.flatnonzero((rows[1:-1, 2] > 0) & (rows[:-2, 2] > 0))[len(rows) // 3]) + 1  # amid a stroke
    rows[middle, 3] = rows[middle - 1, 3] - 0.001
    piece_s, sent = PIECE / SOUND_HZ, 0
    for k in range(performance.sound.size // PIECE):
        come = int(np.searchsorted(np.maximum.accumulate(rows[:, 3]), (k + 1) * piece_s))
        if come > sent:
            socket.send_bytes(events(*map(tuple, rows[sent:come].tolist())))
            sent = come
        socket.send_bytes(sound(performance.sound[k * PIECE : (k + 1) * PIECE]))


def test_a_capture_is_kept_in_files_that_import_reads(client: TestClient, studio: Studio, monkeypatch: Any) -> None:
    monkeypatch.setattr(studio.trainings, "start", lambda folder, say: None)
    rng = np.random.default_rng(0)
    samples_in = rng.uniform(-1, 1, 3 * PIECE).astype(np.float32)
    with client.websocket_connect(WS) as socket:
        socket.send_text(json.dumps({**BEGIN, "full_scale_m_s2": 50, "input": "Built-in"}))
        assert answered(socket, "ready") == {"ready": True}
        socket.send_bytes(sound(samples_in[:PIECE]))
        socket.send_bytes(events((1, 2, 0.5, 0.01), (1.5, 2, 0.6, 0.015)))
        socket.send_bytes(sound(samples_in[PIECE : 2 * PIECE]))
        socket.send_bytes(sound(samples_in[2 * PIECE :]))
        socket.send_bytes(events((1.5, 2, 0.0, 0.02)))
        socket.send_text('{"do": "train"}')
        kept = answered(socket, "saved")
    assert "saved" in kept, kept
    folder = studio.trainings.captures / kept["saved"]
    assert (folder.name, kept["seconds"]) == ("old-denim-washed", samples_in.size / 48000)
    rate, samples = scipy.io.wavfile.read(folder / "sound.wav")
    assert rate == 48000
    np.testing.assert_array_equal(samples, samples_in)
    rows = np.loadtxt(folder / "pen.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(rows, [[0.01, 1, 2, 0.5], [0.015, 1.5, 2, 0.6], [0.02, 1.5, 2, 0.0]])
    about = json.loads((folder / "capture.json").read_text())
    assert about["full_scale_m_s2"] == 50
    assert about["input"] == "Built-in"


def test_a_folder_is_named_after_its_surface_and_a_second_one_has_a_number(tmp_path: Path) -> None:
    names = {"../../etc/pass": "etc-pass", "…": "surface", "Wool 2": "wool-2", "a" * 90: "a" * 60, "wool/2": "wool-2-2"}
    for name, expected in names.items():
        capture = CaptureSession(About(name, 48000))
        capture.add_sound(np.zeros(100, dtype=np.float32))
        capture.add_events(np.array([[0, 0, 0.5, 1.0]]))
        assert capture.write(tmp_path).name == expected


def test_a_sound_in_messages_of_one_sample_takes_no_more_memory(tmp_path: Path) -> None:
    """An array for each took 155 bytes a sample."""
    capture, n = CaptureSession(About("Wool", 48000)), 20_000
    tracemalloc.start()
    for _ in range(n):
        capture.add_sound(np.ones(1))
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert held < 10 * n
    capture.add_events(np.array([[0, 0, 0.5, 1.0]]))
    _, sound = scipy.io.wavfile.read(capture.write(tmp_path) / "sound.wav")
    assert sound.tolist() == [1.0] * n


def test_what_is_out_of_order_is_refused_and_ends_the_capture(client: TestClient) -> None:
    begin, train = json.dumps(BEGIN), '{"do": "train"}'
    with client.websocket_connect(WS) as socket:

        def refused(message: str | bytes) -> str:
            socket.send_bytes(message) if isinstance(message, bytes) else socket.send_text(message)
            return str(answered(socket, "ready").get("refused", "ready"))

        assert f"expected {MAX_BYTES} at most" in refused(b"s" + bytes(MAX_BYTES))
        assert "before a capture was begun" in refused(sound(np.zeros(4)))
        assert refused(begin) == "ready"
        socket.send_bytes(events((0, 0, 0.5, 2.0)))
        assert "not in the order" in refused(events((0, 0, 0.5, 1.0)))
        assert "train before a capture was begun" in refused(train)
        assert refused(begin) == "ready"
        assert "the pen has not touched yet" in refused(train)


def test_events_that_come_late_are_left_out_and_counted() -> None:
    taken = [
        [0, 0, 0.5, 1.000],
        [1, 0, 0.5, 1.005],
        [2, 0, 0.5, 1.004],  # late
        [3, 0, 0.5, 1.010],
        [4, 0, 0.0, 1.009],  # late, and lifts: the touch ended, whatever the clock says
        [5, 0, 0.6, 1.020],
        [6, 0, 0.0, 1.030],
        [7, 0, 0.7, 1.030],  # touches at the time of the lift
        [8, 0, 0.7, 1.030_000_4],  # one time, as the file has it
    ]
    kept, n_late = in_order(np.array(taken, dtype=float))
    np.testing.assert_array_equal(kept[:, 0], [0, 1, 4, 5, 8])
    np.testing.assert_allclose(kept[:, 3], [1.0, 1.005, 1.010, 1.020, 1.030])
    assert n_late == 2


def with_late_events(n: int, n_late: int) -> CaptureSession:
    rows = np.column_stack([np.arange(n), np.zeros(n), np.full(n, 0.5), 0.005 * np.arange(n)])
    rows[10 : 10 + 3 * n_late : 3, 3] -= 0.006
    capture = CaptureSession(About("Denim", 48000))
    capture.add_sound(np.zeros(100, dtype=np.float32))
    for row in rows:
        capture.add_events(row[None])
    return capture


def test_a_capture_says_how_many_events_came_late_and_is_refused_where_these_are_many(tmp_path: Path) -> None:
    folder = with_late_events(1000, 10).write(tmp_path)
    assert json.loads((folder / "capture.json").read_text())["n_late_events"] == 10
    times = np.loadtxt(folder / "pen.csv", delimiter=",", skiprows=1)[:, 0]
    assert times.size == 990
    assert (np.diff(times) > 0).all()
    with pytest.raises(RefusedError, match="11 of 1000 came late, expected 1 % at most"):
        with_late_events(1000, 11).write(tmp_path)
    capture = with_late_events(100, 0)
    with pytest.raises(RefusedError, match="longer than 300 s"):
        capture.add_sound(np.zeros(300 * 48000, dtype=np.float32))
    capture.add_events(np.array([[0, 0, 0.5, 0.4]]))
    with pytest.raises(RefusedError, match="one is 105 ms back, expected 100 at most"):
        capture.add_events(np.array([[0, 0, 0.5, 0.39]]))


@pytest.mark.parametrize(
    ("bound", "value", "why"),
    [
        ("MAX_CAPTURE_BYTES", 13 * PIECE, "it may have 0.0116 MB, and those of all pages 400 MB"),
        ("MAX_ALL_CAPTURES_BYTES", 17 * PIECE, "it may have 100 MB, and those of all pages 0.0152 MB"),
    ],
)
def test_a_capture_that_is_full_says_so_once_and_loses_nothing(
    client: TestClient, studio: Studio, monkeypatch: Any, bound: str, value: int, why: str
) -> None:
    """Without a bound of their bytes eight pages held 1.9 GB, at 192 kHz."""
    monkeypatch.setattr(studio.trainings, "start", lambda folder, say: None)
    monkeypatch.setattr(capture_server, bound, value)
    with client.websocket_connect(WS) as other, client.websocket_connect(WS) as socket:
        for page, n_pieces in ((other, 1), (socket, 10)):
            page.send_text(json.dumps(BEGIN))
            assert answered(page, "ready") == {"ready": True}
            page.send_bytes(events((1, 2, 0.5, 0.01)))
            for k in range(n_pieces):
                page.send_bytes(sound(np.full(PIECE, 0.1 * k)))
            while page is other and sum(one.n_bytes for one in studio.capture_pages) < 32 + 4 * PIECE:
                time.sleep(0.01)
        socket.send_text('{"do": "train"}')
        refused = answered(socket, "saved")["refused"]
        assert refused == f"the capture is full, as {why}: train from what came before, or save it"
        folder = studio.trainings.captures / answered(socket, "saved")["saved"]
        samples = scipy.io.wavfile.read(folder / "sound.wav")[1]
        np.testing.assert_allclose(samples, np.repeat([0.0, 0.1, 0.2], PIECE), atol=1e-7)
        other.send_text('{"do": "train"}')
        assert answered(other, "saved")["seconds"] == PIECE / 48000


def test_only_so_many_pages_capture_at_once_and_one_that_left_makes_room(
    client: TestClient, studio: Studio, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(studio_server, "MAX_CAPTURING", 1)
    with client.websocket_connect(WS) as socket:
        socket.send_text(json.dumps(BEGIN))
        answered(socket, "ready")
        with client.websocket_connect(WS) as one_more:
            message = one_more.receive()
            assert (message["type"], message["code"]) == ("websocket.close", 1013)
    end = time.monotonic() + 5
    while studio.capture_pages and time.monotonic() < end:
        time.sleep(0.01)
    with client.websocket_connect(WS) as socket:
        socket.send_text(json.dumps(BEGIN))
        assert answered(socket, "ready") == {"ready": True}


def test_without_what_trains_a_capture_says_so_before_it_begins(client: TestClient, monkeypatch: Any) -> None:
    monkeypatch.setattr(capture_server, "why_not", lambda: "pip install './packages/foten[train]'")
    with client.websocket_connect(WS) as socket:
        socket.send_text(json.dumps(BEGIN))
        assert "pip install './packages/foten[train]'" in answered(socket, "ready")["refused"]


def test_noise_without_taps_is_refused_in_words_and_kept(client: TestClient, studio: Studio) -> None:
    rng = np.random.default_rng(0)
    with client.websocket_connect(WS) as socket:
        socket.send_text(json.dumps(BEGIN))
        for k in range(20):
            socket.send_bytes(sound(0.01 * rng.standard_normal(PIECE)))
            socket.send_bytes(events((k, 0, 0.5, 0.02 * k)))
        socket.send_text('{"do": "train"}')
        kept = answered(socket, "saved")
        assert "tap three times before the strokes" in answered(socket, "done")["refused"]
    assert (studio.trainings.captures / kept["saved"] / "sound.wav").is_file()
    assert len(studio.shelf) == 1


def python(code: str) -> tuple[str, ...]:
    return sys.executable, "-c", code


@pytest.mark.parametrize(
    ("command", "why"),
    [
        (python("print('Downloading a network')"), "the training failed: "),
        (python("""print('{"joined": {"delay_ms": NaN}}')"""), "a number that is not finite"),
        (python("""print('{"done": "missing.foten"}')"""), r"missing\.foten"),
        (("/nowhere/python",), "/nowhere/python: no such file"),
        (python("raise SystemExit('out of memory')"), "the training died: out of memory"),
    ],
)
def test_a_training_that_fails_says_so_to_the_page_and_lets_the_next_one_run(
    client: TestClient, monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...], why: str
) -> None:
    monkeypatch.setattr(capture_server, "COMMAND", command)
    with client.websocket_connect(WS) as socket:
        for _ in range(2):
            socket.send_text(json.dumps(BEGIN))
            socket.send_bytes(sound(np.zeros(PIECE)))
            socket.send_bytes(events((0, 0, 0.5, 0.01)))
            socket.send_text('{"do": "train"}')
            assert "saved" in answered(socket, "saved")
            refused = answered(socket, "done")["refused"]
            assert re.search(why, refused), refused
            assert "\n" not in refused


def test_a_texture_is_there_before_its_training_ends_and_the_servers_end_ends_that(tmp_path: Path) -> None:
    studio = Studio(Shelf([EXAMPLE]), tmp_path / "captures")
    with TestClient(studio.app(LOCAL), base_url=HERE, headers={"origin": HERE}) as client:
        with client.websocket_connect(WS) as socket:
            socket.send_text(json.dumps(BEGIN))
            say(socket, simulate_capture("steel-mesh-1", 14.0))
            socket.send_text('{"do": "train"}')
            folder = studio.trainings.captures / answered(socket, "saved")["saved"]
            assert abs(answered(socket, "joined")["joined"]["delay_ms"]) < 3  # one clock gave both here
            assert "1 event of the pen came late" in answered(socket, "notes")["notes"][0]
            playable = answered(socket, "playable")["playable"]
        assert (playable["name"], playable["file"]) == ("Old denim, washed", "old-denim-washed.foten")
        assert playable["relative"]
        assert client.get("/textures.json").json()["textures"][1] == playable
    card = read_texture(folder / "old-denim-washed.foten").card
    assert card["units"]["acceleration"] == RELATIVE
    assert any("came late" in sentence for sentence in load_recording(folder / "old-denim-washed.h5").history)
    assert not studio.trainings._running


def test_the_texture_is_playable_early_and_the_last_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    early, last = (exported("foten-plus", texture=name) for name in ("early", "last"))
    monkeypatch.setattr(
        train_capture, "train", lambda _, of: [of.on_playable(early) for _ in "12"] and SimpleNamespace(texture=last)
    )
    train_capture.train_recording(simulate("linear-hum", 8), {}, tmp_path / "a.foten")
    assert read_texture(tmp_path / "a.foten").card["texture"] == "last"
    said = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert [one.get("playable") or one.get("done") for one in said] == ["a.foten", "a.foten"]


@pytest.mark.parametrize(
    ("microphone", "rate_hz", "told"), [(True, 2500.0, True), (True, 1000.0, False), (False, 2500.0, False)]
)
def test_the_page_is_told_where_nothing_heard_is_stored(
    microphone: bool,
    rate_hz: float,
    told: bool,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(train_capture, "train", lambda *_: SimpleNamespace(texture=exported("foten-plus")))
    heard = dataclasses.replace(simulate("towel", 8), microphone=microphone)
    train_capture.train_recording(heard, {rate_hz: 1.0}, tmp_path / "a.foten")
    said = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert said == [{"notes": [WITHHELD]}] * told + [{"done": "a.foten"}]
