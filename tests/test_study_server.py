"""A study's server: the steps of a participant, what pages get, what is refused; a study's file with what it names."""

from __future__ import annotations

import contextlib
import json
import math
import os
import re
import socket
import sqlite3
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("starlette")
pytest.importorskip("statsmodels")
import uvicorn
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect
from websockets.sync.client import ClientConnection as Connection
from websockets.sync.client import connect as connect_page
from websockets.typing import Origin

from foten.models.texture_file import read_texture, write_texture
from foten.runtime.renderer import EXAMPLE, Renderer
from foten.runtime.stylus import PressureCalibration
from foten.studio import live_contact, websocket
from foten.studio.access import LOOPBACK, Access, Admitted, access_to
from foten.studio.levels import gains_db
from foten.studio.messages import MAX_EVENTS, RefusedError
from foten.studio.websocket import MAX_WAITING_BLOCKS, MAX_WAITING_TEXTS
from foten_study import participant_store, study_server
from foten_study import session as session_module
from foten_study import study_file as file_module
from foten_study.analysis import read_ratings
from foten_study.design import titled
from foten_study.languages import read_language
from foten_study.loading import load_study
from foten_study.participants import JOIN_AGAIN, NOT_ALLOWED, RETURNED
from foten_study.planning import study_text
from foten_study.results import of_trials
from foten_study.session import BEFORE_MISSED, ELSEWHERE, MISSED, Session
from foten_study.store import Store
from foten_study.strokes import conditions_of
from foten_study.study_file import FullError
from foten_study.study_server import OPERATOR, OPERATOR_COOKIE, StudyServer, study_files
from test_studio_server import HERE, LOCAL, WS

SESSION = f"{WS}/session"
NAMES = ("artificial-grass", "steel-mesh-1", *(f"surface-{i}" for i in range(3, 13)))
METHODS = ("ar", "dstn", "ldhtd", "foten")


def study_file(
    folder: Path, n_textures: int = 2, n_methods: int = 2, participants: int = 3, language: str = "en", **changes: str
) -> Path:
    """A study of textures that come along, under other names, and lines of its file replaced by others."""
    sources = [read_texture(path) for path in sorted(EXAMPLE.parent.glob("*.foten"))]
    files: dict[str, dict[str, str]] = {}
    for t, name in enumerate(NAMES[:n_textures]):
        for m, method in enumerate(METHODS[:n_methods]):
            source = sources[(t + m) % len(sources)]
            path = folder / f"{name}-{method}.foten"
            write_texture(type(source)({**source.card, "texture": name, "licence": method}, source.tensors), path)
            files.setdefault(name, {})[method] = path.name
    text = study_text("Surfaces", files, participants, 1, language).replace("min_seconds = 3 ", "min_seconds = 0")
    for given, instead in changes.items():
        line = re.search(rf"^{given} = .*$", text, re.M)
        assert line is not None, given
        text = text.replace(line[0], f"{given} = {instead}")
    path = folder / "study.toml"
    path.write_text(text, encoding="utf-8")
    return path


def server_of(path: Path, admitted: Admitted | None = None) -> StudyServer:
    study = load_study(path)
    return StudyServer(study.open_store(path.with_suffix(".db")), study, admitted)


@contextlib.contextmanager
def served(server: StudyServer) -> Iterator[TestClient]:
    with TestClient(server.app(LOCAL), base_url=HERE, headers={"origin": HERE}) as client:
        yield client


@contextlib.contextmanager
def joined(server: StudyServer, **joining: Any) -> Iterator[Page]:
    with served(server) as client, client.websocket_connect(SESSION) as socket:
        yield Page(socket, **joining)


class Page:
    """A participant's page, as the server sees it."""

    def __init__(self, socket: Any, **joining: Any) -> None:
        self.socket, self.bytes, self.texts = socket, 0, []
        self.say(do="join", **joining)
        self.code = self.until("joined")["joined"]
        self.step = self.until("step")["step"]

    def say(self, **message: Any) -> None:
        self.socket.send_text(json.dumps(message))

    def until(self, *keys: str) -> dict[str, Any]:
        while True:
            message = self.socket.receive()
            if message["type"] == "websocket.close":
                raise WebSocketDisconnect(message["code"], message.get("reason"))
            if message.get("bytes"):
                self.bytes += len(message["bytes"])
            if message.get("text"):
                self.texts.append(message["text"])
                document: dict[str, Any] = json.loads(message["text"])
                if document.keys() & set(keys):
                    return document

    def done(self, **answer: Any) -> dict[str, Any]:
        self.say(do="done", step=self.step["id"], **answer)
        document = self.until("step", "refused")
        if "refused" not in document:
            self.step = document["step"]
        return document

    def answer(self, rating: float = 50.0) -> dict[str, Any]:
        """Do what the step asks for."""
        kind = self.step["kind"]
        if kind == "trial":
            return self.done(values={"similarity": rating}, seconds=2.5, underruns=0)
        if kind == "questions":
            given = {
                q["key"]: {"number": "30", "choice": (q["options"] or [""])[0]}.get(q["kind"], "fine")
                for q in self.step["questions"]
            }
            return self.done(answers=given)
        return self.done()

    def to_trial(self) -> None:
        while self.step["kind"] != "trial":
            self.answer()

    def stroke(self, n: int = 10) -> None:
        for k in range(n):
            self.socket.send_bytes(np.array([0.8 * k, 0.0, 0.5, 0.01 * k], dtype="<f8").tobytes())

    def stroke_until_it_sounds(self) -> None:
        self.stroke()
        while self.bytes == 0:
            self.bytes += len(self.socket.receive().get("bytes") or b"")


def test_a_participant_goes_through_all_steps_and_each_is_in_the_database(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path, break_every="2"))
    with joined(server) as page:
        seen = []
        while page.step["kind"] != "end":
            seen.append(page.step["id"])
            page.answer(10.0 * len(seen))
            assert seen[-1] in server.store.done(1)  # before the page moves on
        trials = "trial:-1 trial:0 trial:1 trial:2 break:2 trial:3 trial:4"
        assert " ".join(seen) == f"consent questions:start instructions {trials} questions:end"
    with Store(tmp_path / "study.db") as store:
        rows = store.ratings()
        assert [row["trial"] for row in rows] == [1, 2, 3, 4]
        assert [row["response_s"] for row in rows] == [2.5] * 4
        designed = [(trial.texture, trial.method) for trial in store.trials(1) if not trial.practice]
        assert [(row["texture"], row["method"]) for row in rows] == designed
        assert (len(store.abouts()), len(store.answers())) == (4, 1)  # those that are private, and the others
        assert store.counts()[1]["ended"] == 1


def test_a_trial_is_stroked_switched_and_measured(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path, practice="0"))
    with joined(server, rate_hz=8000, volume_db=-3.0, newtons=0.15, steepness=3.0) as page:
        page.to_trial()
        begin = time.monotonic()
        for k in range(100):
            page.socket.send_bytes(np.array([0.4 * k, 0.0, 0.5, 0.005 * k], dtype="<f8").tobytes())
            time.sleep(max(0.0, begin + 0.005 * k - time.monotonic()))
        page.say(do="side", side="real")
        assert page.until("step")["step"]["side"] == "real"
        page.say(do="side", side="virtual")
        assert page.until("step")["step"]["side"] == "virtual"
        page.answer(71.0)
        assert page.bytes > 8000  # of samples
    with Store(tmp_path / "study.db") as store:
        (row,) = store.ratings()
        assert row["switches"] == 2
        about = row["measured"]
        assert about["contact_s"] > 0.2
        assert 60 < about["speed_mm_s_p50"] < 100
        assert 0.5 < about["force_n_p50"] < 0.9
        assert about["block_p99_ms"] > 0
        assert (about["n_underruns"], about["volume_db"], about["rate_hz"]) == (0, -3.0, 8000.0)
        assert (about["newtons"], about["steepness"]) == (0.15, 3.0)  # without them no force follows from the events
        events = store.strokes(1, 1)
        assert events.shape == (100, 4)
        np.testing.assert_allclose(events[:, 0], 0.4 * np.arange(100))


def test_no_byte_that_a_participant_is_sent_names_or_orders_methods(tmp_path: Path) -> None:
    """All text of two participants whose methods differ in every trial is the same; nothing names a method or a file."""
    server = server_of(study_file(tmp_path, 1, 4, participants=4, order='"random"'))
    said: list[list[str]] = []
    with served(server) as client:
        for _ in range(3):
            with client.websocket_connect(SESSION) as socket:
                page = Page(socket, rate_hz=8000)
                while page.step["kind"] != "end":
                    if page.step["kind"] == "trial":
                        page.stroke()
                    page.answer()
                # When a stroke was stored is a matter of time.
                texts = [text for text in page.texts if not text.startswith('{"stored"')]
                said.append([text.replace(page.code, "CODE") for text in texts])
        for name in ("", *study_files()):
            answer = client.get(f"/{name}")
            said.append([answer.text, str(answer.headers)])
        others = ("operator", "operate", "textures.json", "state", "gains", "pictures/0")
        for path in (f"textures/{EXAMPLE.name}", *others):
            assert client.get(f"/{path}").status_code in (403, 404)
    stored = [[trial.method for trial in server.store.trials(n)] for n in (1, 2, 3)]
    assert len({tuple(one) for one in stored}) == 3  # they were given different orders
    assert said[0] == said[1] == said[2]
    everything = "\n".join(text for texts in said for text in texts).lower()
    for word in ("dstn", "ldhtd", ".foten", '"method', *(one.sha256 for one in server.store.stimuli().values())):
        assert word not in everything
    assert not re.search(r"[\"' -]ar[\"' ,.]", "\n".join(text for texts in said[:3] for text in texts).lower())


def test_an_answer_that_is_said_again_counts_once(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path, practice="0"))
    with joined(server) as page:
        page.to_trial()
        page.done(values={"similarity": 40.0})
        page.say(do="done", step="trial:1", values={"similarity": 90.0})  # the page did not learn that it was taken
        assert page.until("step", "refused")["step"]["id"] == "trial:2"
        page.say(do="done", step="trial:4", values={"similarity": 90.0})
        assert "it is the turn of trial:2" in page.until("step", "refused")["refused"]
        page.say(do="done", step="trial:2")
        assert "values are None, expected similarity" in page.until("step", "refused")["refused"]
    assert [row["rating"] for row in server.store.ratings()] == [40.0]


def test_two_screens_are_joined_by_a_code_and_the_operator_lets_trials_begin(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path, screens="2", operator="true", practice="0"))
    with contextlib.ExitStack() as stack:
        client = stack.enter_context(served(server))
        cookie = {"cookie": f"{OPERATOR_COOKIE}={server.admitted.add(OPERATOR)}"}
        operator = stack.enter_context(client.websocket_connect(f"{WS}/operate", headers=cookie))
        a, b, c = (stack.enter_context(client.websocket_connect(SESSION)) for _ in range(3))

        def operate(**message: Any) -> None:
            operator.send_text(json.dumps(message))

        def until(kind: str) -> Any:
            while kind not in (document := json.loads(operator.receive_text())):
                pass
            return document

        operate(do="begin")
        code = until("started")["code"]
        tablet, screen = Page(a, code=code, role="stroke", rate_hz=8000), Page(b, code=code, role="answer")
        while screen.step["kind"] != "trial":
            screen.answer()
            tablet.step = tablet.until("step")["step"]
        assert screen.step["held"]
        assert tablet.step["id"] == screen.step["id"] == "trial:1"
        while (one := until("sessions")["sessions"][0])["kind"] != "trial":
            pass
        assert (one["held"], one["pages"]) == (True, ["answer", "stroke"])
        assert one["texture"] in map(titled, NAMES)
        assert "method" not in one
        assert "The operator holds this trial" in screen.done(values={"similarity": 5.0})["refused"]
        operate(do="go", number=1)
        assert not tablet.until("step")["step"]["held"]
        assert not screen.until("step")["step"]["held"]
        tablet.stroke()
        operate(do="side", number=1, side="real")
        assert tablet.until("step")["step"]["side"] == "real"
        screen.until("step")
        b.send_bytes(bytes(32))
        assert "events of a page that does not stroke" in screen.until("refused")["refused"]
        screen.answer(61.0)
        assert screen.step["id"] == "trial:2"
        assert tablet.until("step")["step"]["id"] == "trial:2"
        assert server.store.ratings()[0]["switches"] == 1
        operate(do="go", number=9)
        assert "there is no participant 9" in until("refused")["refused"]
        for joining, why in (({}, "ask the operator for a code"), ({"code": "AAAAA"}, "There is no such code")):
            c.send_text(json.dumps({"do": "join", **joining}))
            assert why in json.loads(c.receive_text())["refused"]


def test_a_trial_lasts_as_long_as_the_study_asks_and_goes_on_after_a_restart_with_what_was_counted(
    tmp_path: Path,
) -> None:
    """By the server's own clock, whatever the page says, from when the trial was shown first."""
    path = study_file(tmp_path, practice="0", min_seconds="3")
    server = server_of(path)
    with joined(server, rate_hz=8000) as page:
        page.to_trial()
        begin = time.monotonic()
        page.stroke_until_it_sounds()
        for side in ("real", "virtual"):
            page.say(do="side", side=side)
            while page.until("step")["step"]["side"] != side:  # a stroke is answered by a step too
                pass
        while len(server.store.switches(1, 1)) < 2:  # stored after the page is told, which may leave before
            time.sleep(0.01)
        code, step_id = page.code, page.step["id"]
    with joined(server_of(path), code=code.lower()) as page:
        assert page.step["id"] == step_id
        refused = page.done(values={"similarity": 5.0}, seconds=99.0)
        assert "Explore both surfaces for 3\u00a0s first" in refused["refused"]
        assert (refused["step"], refused["again"]) == ("trial:1", False)
        time.sleep(max(0.0, begin + 2.9 - time.monotonic()))
        page.done(values={"similarity": 44.0}, seconds=0.1)
        assert page.step["id"] == "trial:2"
    with Store(tmp_path / "study.db") as store:
        (row,) = store.ratings()
        assert row["switches"] == 2


def test_a_trial_that_was_not_stroked_is_not_rated(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path, practice="0", min_seconds="0.3"))
    with joined(server, rate_hz=8000) as page:
        page.to_trial()
        time.sleep(0.3)
        assert page.done(values={"similarity": 5.0}, seconds=99.0)["refused"] == "Stroke the virtual surface first"
        page.stroke_until_it_sounds()
        page.done(values={"similarity": 5.0})
        assert page.step["id"] == "trial:2"


def test_another_program_that_holds_the_file_costs_no_answer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor a page that strokes its connection: it is answered before it could seem lost."""
    assert file_module.BUSY_S <= 3.0
    monkeypatch.setattr(file_module, "BUSY_S", 0.4)
    server = server_of(study_file(tmp_path, practice="0"))
    with joined(server, rate_hz=8000) as page:
        page.to_trial()
        other = sqlite3.connect(tmp_path / "study.db", isolation_level=None)
        other.execute("BEGIN EXCLUSIVE")
        refused = page.answer(33.0)
        assert "Your answer is kept here and sent again" in refused["refused"]
        assert refused["again"]
        assert "another program holds the file" in server.sessions[1].for_operator()["trouble"]
        page.stroke_until_it_sounds()  # and what is tried again waits no second time, however many pages there are
        begin = time.monotonic()
        assert page.answer(33.0)["again"]
        assert time.monotonic() - begin < 0.3
        other.execute("ROLLBACK")
        other.close()
        page.answer(33.0)
        assert page.step["id"] == "trial:2"
        assert server.store._execute("PRAGMA busy_timeout").fetchone()[0] == 400
        assert "trouble" not in server.sessions[1].for_operator()
    assert [row["rating"] for row in server.store.ratings()] == [33.0]
    assert server.store.strokes(1, 1).shape == (10, 4)


def test_what_no_page_sends_is_refused_in_a_line(tmp_path: Path) -> None:
    """Half of a surrogate pair in an answer, a picture of five thousand digits, one fresh code of two pages at once."""
    server = server_of(study_file(tmp_path))
    with served(server) as client:
        assert client.get(f"/pictures/{'9' * 5000}").status_code == 404
        with client.websocket_connect(SESSION) as one, client.websocket_connect(SESSION) as other:
            for socket in (one, other):
                socket.send_text(json.dumps({"do": "join", "fresh": "ABCDE"}))
            codes = [json.loads(socket.receive_text()).get("joined") for socket in (one, other)]
            assert codes == ["ABCDE", "ABCDE"]
        assert len(server.sessions) == 1
        with client.websocket_connect(SESSION) as socket:
            page = Page(socket, code="ABCDE")
            while page.step["kind"] != "questions":
                page.answer()
            answers = {q["key"]: "\udc80" for q in page.step["questions"]}
            assert "characters of text" in page.done(answers=answers)["refused"]
            for age in ("-5", "121", "1e999", "nan"):
                refused = page.done(answers={"age": age})["refused"]
                assert refused.startswith("Please enter a number: How old are you?")
                assert refused.endswith("(0–120)") == (age in ("-5", "121"))
            assert "refused" not in page.done(answers={"age": "0"})
        with client.websocket_connect(SESSION) as socket:
            for _ in range(21):
                socket.send_text('{"do": "join", "code": "ZZZZZ"}')
            assert [socket.receive().get("reason") for _ in range(22)][-1] == "20 messages were refused"


@pytest.mark.parametrize(
    ("begins", "kind"),
    [
        (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "png"),
        (b"\xff\xd8\xff\xe0", "jpeg"),
        (b"RIFF\x04\0\0\0WEBPVP8 ", "webp"),
        (b"GIF89a", "gif"),
    ],
)
def test_a_picture_is_served_as_it_was_when_the_study_was_loaded(tmp_path: Path, begins: bytes, kind: str) -> None:
    """By its content's type, whatever its name says, and whatever its place leads to by then."""
    picture, data = tmp_path / "photo.html", begins + b"<script>alert(1)</script>"
    picture.write_bytes(data)
    (tmp_path / "link").symlink_to(picture)
    server = server_of(study_file(tmp_path, name='"Grass"\npicture = "link"'))
    for path in (picture, tmp_path / "link"):
        path.unlink()
        path.symlink_to("/etc/passwd")
    with served(server) as client:
        answer = client.get("/pictures/0")
        assert (answer.content, answer.headers["content-type"]) == (data, f"image/{kind}")
        assert answer.headers["x-content-type-options"] == "nosniff"
        assert client.get("/pictures/1").status_code == 404


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("/etc/passwd", "/etc/passwd lies outside of the study file's folder, expected a picture inside"),
        ("../photo.png", r"/photo.png lies outside of"),
        ("link", "/photo.png lies outside of"),
        ("folder/x", "no such file: .*/study/folder/x"),
        ("loop", "loop"),
        ("pipe", "pipe is a pipe or a device, expected a file"),
        ("/dev/zero", "/dev/zero is a pipe or a device"),
        (".", "is a folder, expected a file"),
        ("page.svg", "page.svg: expected a picture, PNG, JPEG, WebP or GIF, of at most 134217 kB"),
        ("study.toml", "study.toml: expected a picture"),
        ("large.png", "large.png: expected a picture"),
        ("x" * 5000, "too long"),
    ],
)
def test_what_is_no_picture_of_the_studys_folder_is_refused(tmp_path: Path, name: str, why: str) -> None:
    folder = tmp_path / "study"
    folder.mkdir()
    png = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"
    (tmp_path / "photo.png").write_bytes(png)
    (folder / "link").symlink_to(tmp_path / "photo.png")
    (folder / "loop").symlink_to("loop")
    os.mkfifo(folder / "pipe")
    (folder / "page.svg").write_text("<svg xmlns='http://www.w3.org/2000/svg'><script/></svg>")
    with (folder / "large.png").open("wb") as large:
        large.write(png)
        large.truncate(2**27 + 1)
    path = study_file(folder, name=f'"Grass"\npicture = "{name}"')
    with pytest.raises(ValueError, match=why) as refused:
        load_study(path)
    assert str(refused.value).startswith("study.toml: ")
    assert "\n" not in str(refused.value)


def test_every_file_of_a_study_that_is_not_what_it_should_be_is_named(tmp_path: Path) -> None:
    coil = '"sound"\nactuator = "coil.json"'
    path = study_file(tmp_path, name='"Grass"\npicture = "/etc/passwd"', to=coil)
    (tmp_path / "coil.json").write_text("{}")
    (tmp_path / "artificial-grass-ar.foten").unlink()
    (tmp_path / "steel-mesh-1-ar.foten").write_bytes(b"no texture at all")
    with pytest.raises(ValueError, match="no such file") as refused:
        load_study(path)
    for name in ("coil.json is not", "artificial-grass-ar.foten", "steel-mesh-1-ar.foten: ", "/etc/passwd lies"):
        assert name in str(refused.value)


def test_places_of_those_who_answer_nothing_are_returned_with_their_orders(tmp_path: Path) -> None:
    """One page begins one participant; ten minutes after its last message its place, and its order, are another's."""
    path = study_file(tmp_path, participants=1)  # and two for those who leave
    server = server_of(path)

    def asked(client: TestClient, fresh: str) -> dict[str, Any]:
        with client.websocket_connect(SESSION) as socket:
            socket.send_text(json.dumps({"do": "join", "fresh": fresh}))
            said: dict[str, Any] = json.loads(socket.receive_text())
            return said

    all_begun = {"refused": read_language("en").words["all_begun"]}
    with served(server) as client, contextlib.ExitStack() as stack:
        a, b, c = (stack.enter_context(client.websocket_connect(SESSION)) for _ in range(3))
        page = Page(a, fresh="AAAAA")
        for joining in ({"fresh": "BBBBB"}, {}):
            page.say(do="join", **joining)
            assert "a new participant has begun on this connection" in page.until("joined", "refused")["refused"]
        for joining in ({"fresh": "AAAAA"}, {"code": "AAAAA"}):
            page.say(do="join", **joining)
            assert page.until("joined")["joined"] == "AAAAA"
        Page(b, fresh="BBBBB").answer()
        Page(c, fresh="CCCCC")
        assert asked(client, "DDDDD") == all_begun
        for session in server.sessions.values():
            session.last_message_at -= 601
        page.say(do="done", step="trial:1")  # a message, though nothing comes of it
        assert "it is the turn of consent" in page.until("refused")["refused"]
        assert asked(client, "DDDDD")["joined"] == "DDDDD"
        assert closed_by(c) == RETURNED
        assert server.store.codes() == {"AAAAA": 1, "BBBBB": 2, "DDDDD": 3}
        steps = server.sessions[3].state.steps
        assert [step["trial"] for step in steps if step["kind"] == "trial"] == server.store.trials(3)
        assert asked(client, "CCCCC") == all_begun
    server.store.close()
    server = server_of(path)
    with served(server) as client:
        assert asked(client, "EEEEE") == all_begun  # when the last message came is not known
        server.sessions[1].last_message_at -= 601
        assert asked(client, "EEEEE")["joined"] == "EEEEE"
    assert server.store.codes() == {"EEEEE": 1, "BBBBB": 2, "DDDDD": 3}


def test_the_operator_returns_a_place_without_an_answer(tmp_path: Path) -> None:
    """And by the code: its number may be another one's by then, who gets nothing of what was on its way."""
    server = server_of(study_file(tmp_path, operator="true"))
    with on_the_network(server) as devices, devices.operator() as operate:
        operate(lambda said: "started" in said, do="begin")
        old = server.sessions[1]
        assert old.last_message_at == math.inf  # codes that were given out wait
        with devices.page(devices.new(), code=old.code) as page:
            operate(lambda said: True, do="return", code=old.code)
            assert closed_by(page.socket) == RETURNED
        assert (server.store.codes(), server.admitted.has(f"{old.code} answer")) == ({}, False)
        operate(lambda said: said.get("started") == 1, do="begin")
        with pytest.raises(RefusedError, match="There is no such code"):
            devices.client.portal.call(old.finish, "consent", {})
        assert server.store.done(1) == set()
        operate(lambda said: "There is no such code" in said.get("refused", ""), do="return", code=old.code)
        code = server.sessions[1].code
        with devices.page(devices.new(), code=code) as page:
            page.answer()
        operate(lambda said: "participant 1 has answered" in said.get("refused", ""), do="return", code=code)
    assert server.store.codes() == {code: 1}


def test_pages_that_do_not_join_keep_nobody_out(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """They go after a deadline, and before it where another page needs the room: before those that ask, and those that joined."""
    monkeypatch.setattr(websocket, "GOODBYE_S", 0.1)
    monkeypatch.setattr(study_server, "MAX_PAGES", 3)
    monkeypatch.setattr(study_server, "MAX_OPERATOR_PAGES", 1)
    server = server_of(study_file(tmp_path))
    with on_the_network(server) as devices, contextlib.ExitStack() as stack:

        def idle() -> Any:
            return stack.enter_context(devices.connect("session", foten=devices.new()))

        def page(**joining: Any) -> Page:
            return stack.enter_context(devices.page(devices.new(), **joining))

        first = page(fresh="AAAAA")
        asking, _ = stack.enter_context(devices.asking(devices.new(), code="AAAAA"))
        idle_ones = [idle(), idle()]
        assert closed_by(idle_ones[0]) == 1013
        second = page(fresh="BBBBB")
        assert closed_by(idle_ones[1]) == 1013
        third = page(fresh="CCCCC")
        assert closed_by(asking) == 1013
        assert closed_by(idle()) == 1013
        with devices.operator():
            with pytest.raises(WebSocketDisconnect), devices.operator() as operate:
                operate(lambda said: True)
            third.answer()
        monkeypatch.setattr(session_module, "JOIN_S", 0.1)
        monkeypatch.setattr(study_server, "MAX_PAGES", 5)
        asking, _ = stack.enter_context(devices.asking(devices.new(), code="AAAAA"))
        assert closed_by(idle()) == 1008
        for one in (first, second):
            one.answer()
        deadline = time.monotonic() + 10
        while len(server.pages) > 4:  # whether it takes that it is sent away or not
            assert time.monotonic() < deadline
            time.sleep(0.01)


def test_contact_before_a_restart_counts_too(tmp_path: Path) -> None:
    """What was stroked before the server was killed is in the rating's contact time, and its stroke is stored."""
    path = study_file(tmp_path, practice="0")
    first = server_of(path)
    with joined(first, rate_hz=8000) as page:
        page.to_trial()
        page.stroke(40)
        page.stroke_until_it_sounds()
        code = page.code
        log = first.sessions[1].strokes.log
        deadline = time.monotonic() + 10
        while len(log.conditions) < 20:
            page.bytes += len(page.socket.receive().get("bytes") or b"")
            assert time.monotonic() < deadline
    before = log.summary()["contact_s"]
    assert before > 0
    with joined(server_of(path), code=code, rate_hz=8000) as page:
        page.answer(44.0)
    with Store(tmp_path / "study.db") as store:
        (row,) = store.ratings()
        assert row["measured"]["contact_s"] == pytest.approx(before, abs=0.02)  # a block or two are in the air
        assert row["measured"]["n_contacts"] == 1
        assert store.strokes(1, 1).shape == (50, 4)


def test_events_that_are_sent_again_have_the_speed_and_force_of_a_stroke_and_no_end_of_time() -> None:
    """100 mm/s at the paper's force of a pressure of 0.5; a day between two events is no stroke of a day."""
    t = np.arange(64) / 120
    events = np.stack([100 * t, 0 * t, 0.5 + 0 * t, 7.0 + t], axis=1)
    conditions = np.array(conditions_of(events, EXAMPLE.read_bytes(), PressureCalibration()))
    assert len(conditions) == pytest.approx(1000 * t[-1] / 8, abs=2)
    speed, force = conditions[len(conditions) // 2 :].mean(axis=0)
    assert speed == pytest.approx(100, rel=0.05)
    assert force == pytest.approx(0.13 * np.exp(3.32 * 0.5), rel=0.05)
    events[32:, 3] += 86_400.0
    assert len(conditions_of(events, EXAMPLE.read_bytes(), PressureCalibration())) < 120
    assert len(conditions_of(events[::-1], EXAMPLE.read_bytes(), PressureCalibration())) == 1


def send_again(page: Page, events: NDArray[np.float64], first: int = 0, trial: int = 1) -> None:
    """Send events (n, 4) as a page does that comes back."""
    for i in range(0, len(events), MAX_EVENTS):
        before = BEFORE_MISSED.pack(MISSED, 0, trial, first + i)
        page.socket.send_bytes(before + events[i : i + MAX_EVENTS].tobytes())


def outage(n: int) -> NDArray[np.float64]:
    """Events of a pen at 240 a second and 24 mm/s."""
    t = np.arange(n) / 240
    return np.stack([24 * t, 0 * t, 0.5 + 0 * t, t], axis=1)


def test_strokes_of_a_long_outage_are_all_stored_in_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More than a page may send in a second otherwise, as events and as messages; not more than a trial can have."""
    server = server_of(study_file(tmp_path, practice="0"))
    events = outage(6000)
    with joined(server) as page:
        page.to_trial()
        for k in range(1300):  # as of a pen that moves from surface to surface
            send_again(page, events[k : k + 1], k)
        send_again(page, events[1300:], 1300)
        page.answer(33.0)
        assert not any("refused" in text for text in page.texts)
        monkeypatch.setattr(participant_store, "MAX_MISSED", 100)
        send_again(page, outage(128), trial=2)
        assert page.until("refused")["refused"] == "more than 100 events of trial 2 that are sent again"
    np.testing.assert_array_equal(server.store.strokes(1, 1), events)
    (row,) = server.store.ratings()
    assert row["measured"]["contact_s"] == pytest.approx(25.0, abs=0.01)


def abx_file(folder: Path, **changes: str) -> Path:
    path = study_file(folder, practice="0", **changes)
    text = re.sub("^(question|lowest|highest) = .*\n", "", path.read_text(encoding="utf-8"), flags=re.M)
    path.write_text(re.sub('^kind = "rating".*', 'kind = "abx"\nrepeats = 4', text, flags=re.M), encoding="utf-8")
    return path


def slow_to_open(session: Session) -> None:
    """Let the contact of a session take half a second to go over to another surface."""
    assert session.strokes.sound.contact is not None
    open_at_once = session.strokes.sound.contact.open

    def open_later(*about: Any) -> None:
        time.sleep(0.5)
        open_at_once(*about)

    session.strokes.sound.contact.open = open_later  # type: ignore[method-assign]


def test_a_page_learns_of_a_switch_at_once_and_nothing_is_loaded_for_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """How long a surface takes to load, or to be put under the pen, tells nothing of its method."""
    server = server_of(abx_file(tmp_path))
    with joined(server, rate_hz=8000) as page:
        page.to_trial()
        page.stroke_until_it_sounds()
        session = server.sessions[1]
        monkeypatch.setattr(live_contact, "Renderer", None)
        for interval in (1, 2, 0):
            page.say(do="side", side="virtual", interval=interval)
            assert page.until("step", "refused")["step"]["interval"] == interval
        slow_to_open(session)
        begin = time.monotonic()
        page.say(do="side", side="virtual", interval=1)
        page.until("step")
        assert time.monotonic() - begin < 0.3


@pytest.mark.parametrize("what", ["answer", "hold"])
def test_an_answer_or_a_hold_during_a_switch_is_no_failure_to_play(tmp_path: Path, what: str) -> None:
    server = server_of(abx_file(tmp_path, screens="2"))
    with served(server) as client, client.websocket_connect(SESSION) as a, client.websocket_connect(SESSION) as b:
        tablet = Page(a, role="stroke", rate_hz=8000)
        screen = Page(b, code=tablet.code, role="answer")
        screen.to_trial()
        while tablet.step != screen.step:
            tablet.step = tablet.until("step")["step"]
        tablet.stroke_until_it_sounds()
        session = server.sessions[1]
        slow_to_open(session)
        tablet.say(do="side", side="virtual", interval=1)
        tablet.until("step")
        if what == "answer":
            screen.done(values={"choice": 1})
        else:
            client.portal.call(session.hold, True)
        shown = tablet.until("step", "refused")["step"]
        assert (shown["id"], shown["held"]) == (("trial:2", False) if what == "answer" else ("trial:1", True))
        tablet.say(do="side", side="virtual", interval=2)
        if what == "answer":
            assert tablet.until("step", "refused")["step"]["interval"] == 2
        assert "trouble" not in session.for_operator()


def test_who_downloads_the_data_keeps_nobody_waiting(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """And gets what there was when it began."""
    server = server_of(study_file(tmp_path, practice="0"))
    begins, goes_on, counts = threading.Event(), threading.Event(), []

    def zipped(store: Store) -> bytes:
        begins.set()
        goes_on.wait(10)
        counts.append(len(store.ratings()))
        return b"all"

    monkeypatch.setattr("foten_study.record.zipped", zipped)
    with served(server) as client, client.websocket_connect(SESSION) as socket:
        page = Page(socket)
        page.to_trial()
        page.answer()
        client.get("/operator", params={"key": server.operator_key})
        downloaded = list[bytes]()
        download = threading.Thread(target=lambda: downloaded.append(client.get("/data.zip").content))
        download.start()
        assert begins.wait(10)
        begin = time.monotonic()
        page.answer()
        assert time.monotonic() - begin < 5
        goes_on.set()
        download.join(20)
    assert (downloaded, counts) == ([b"all"], [1])
    assert len(server.store.ratings()) == 2


@pytest.mark.parametrize("compared", [False, True])
def test_markers_come_in_pairs_wherever_the_hand_goes(tmp_path: Path, compared: bool) -> None:
    """To the real surface, from which it comes back; to another one in a stroke; while the trial is held; to the answer."""
    server = server_of(abx_file(tmp_path) if compared else study_file(tmp_path, practice="0"))
    sent: list[tuple[str, int, int | None]] = []

    class Recorder:
        def send(self, event: str, trial: int, surface: int | None = None, **about: Any) -> None:
            sent.append((event, trial, surface))

    server.study.markers = Recorder()  # type: ignore[assignment]
    sides = [("virtual", 1), ("virtual", 0)] if compared else [("real", 0), ("virtual", 0)]
    with served(server) as client, client.websocket_connect(SESSION) as socket:
        page = Page(socket, rate_hz=8000)
        page.to_trial()
        for side, interval in sides:
            page.stroke()  # without an end, as where the other surface is tapped with the pen down
            page.say(do="side", side=side, interval=interval)
            page.until("step")
        page.stroke()
        page.done()  # is refused, and all before was taken in
        for held in (True, False):
            client.portal.call(server.sessions[1].hold, held)
            page.step = page.until("step")["step"]
        page.stroke()
        page.done(values={"choice": 1} if compared else {"similarity": 40.0})
    surfaces = [1, 2, 1, 1] if compared else [1, 1, 1]
    strokes = [(event, 1, surface) for surface in surfaces for event in ("contact", "lift")]
    assert sent[: len(strokes) + 2] == [("trial", 1, None), *strokes, ("answer", 1, None)]


def test_under_runs_are_those_of_the_page_that_plays(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path, screens="2", practice="0"))
    with served(server) as client, client.websocket_connect(SESSION) as a, client.websocket_connect(SESSION) as b:
        tablet = Page(a, role="stroke")
        screen = Page(b, code=tablet.code, role="answer")
        screen.to_trial()
        for step, n in (("trial:1", 3), ("trial:2", 9)):  # and one that comes for another trial
            tablet.say(do="count", step=step, underruns=n)
        tablet.say(do="side", side="real")
        screen.step = screen.until("step")["step"]
        for _ in range(2):
            screen.done(values={"similarity": 40.0})
    assert [row["measured"]["n_underruns"] for row in server.store.ratings()] == [3, None]


def test_strokes_on_a_tablet_are_waited_for_where_the_answer_comes_back_first(tmp_path: Path) -> None:
    """Those that come later still are stored with their trial, and count for no other one; none is stored twice."""
    path = study_file(tmp_path, screens="2", practice="0")
    with joined(server_of(path), role="answer") as screen:
        screen.to_trial()
        code, answer = screen.code, {"values": {"similarity": 61.0}}
    server, events = server_of(path), outage(100)
    with contextlib.ExitStack() as stack:
        client = stack.enter_context(served(server))
        a, b = (stack.enter_context(client.websocket_connect(SESSION)) for _ in range(2))
        screen = Page(b, code=code, role="answer")
        refused = screen.done(**answer)
        assert (refused["refused"], refused["again"]) == ("One moment, please", True)
        tablet = Page(a, code=code, role="stroke", again=80)
        assert screen.done(**answer)["again"]
        send_again(tablet, events[:80])
        send_again(tablet, events[70:75], 70)
        deadline = time.monotonic() + 10
        while "refused" in screen.done(**answer):
            assert time.monotonic() < deadline
        assert tablet.until("step")["step"]["id"] == screen.step["id"] == "trial:2"
        send_again(tablet, events[60:], 60)
        send_again(tablet, events, trial=3)
        assert tablet.until("refused")["refused"] == "events of trial 3, which was not shown"
        screen.done(**answer)
    np.testing.assert_array_equal(server.store.strokes(1, 1), events)
    assert len(server.store.strokes(1, 2)) == 0
    assert [row["measured"]["contact_s"] for row in server.store.ratings()] == [pytest.approx(79 / 240, abs=1e-3), 0]


def test_an_answer_is_taken_without_a_tablet_that_does_not_come_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(session_module, "COME_BACK_S", 0.5)
    server = server_of(study_file(tmp_path, screens="2", practice="0"))
    with joined(server, role="answer") as screen:
        screen.to_trial()
        time.sleep(0.5)
        assert screen.answer()["step"]["id"] == "trial:2"


def test_strokes_that_the_disk_has_no_room_for_are_not_stored_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the page comes back meanwhile, and sends again what it knows of none to be stored."""
    server, events = server_of(study_file(tmp_path, practice="0")), outage(50)

    def full(*_: Any) -> None:
        raise FullError("study.db: the disk is full")

    with served(server) as client:
        with monkeypatch.context() as patch:
            patch.setattr(server.store, "add_strokes", full)
            with client.websocket_connect(SESSION) as socket:
                page = Page(socket, rate_hz=8000)
                page.to_trial()
                for event in events:
                    socket.send_bytes(event.tobytes())
                assert "values are None" in page.done()["refused"]  # and all before was taken in
            with client.websocket_connect(SESSION) as socket:
                page = Page(socket, code=page.code, again=50)
                assert page.step["stored"] == 50
                send_again(page, events)
        with client.websocket_connect(SESSION) as socket:
            Page(socket, code=page.code).answer()
    np.testing.assert_array_equal(server.store.strokes(1, 1), events)
    (row,) = server.store.ratings()
    assert row["measured"]["contact_s"] == pytest.approx(49 / 240, abs=1e-3)


def test_strokes_wait_for_room_on_the_disk_and_the_operator_sees_it(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path, practice="0"))
    add = server.store.add_strokes

    def full(*_: Any) -> None:
        raise FullError("study.db: the disk is full")

    with joined(server, rate_hz=8000) as page:
        page.to_trial()
        server.store.add_strokes = full  # type: ignore[method-assign]
        page.stroke(30)
        page.stroke_until_it_sounds()
        page.answer(33.0)
        assert page.step["id"] == "trial:2"
        assert server.sessions[1].for_operator()["n_unsaved"] == 40
        server.store.add_strokes = add  # type: ignore[method-assign]
        page.stroke(5)  # of the next trial
        page.answer(34.0)
        assert "n_unsaved" not in server.sessions[1].for_operator()
    assert server.store.strokes(1, 1).shape == (40, 4)
    assert server.store.strokes(1, 2).shape == (5, 4)


def test_the_page_that_strokes_is_the_one_that_sounds(tmp_path: Path) -> None:
    """After a lost network the old connection may be there still; both count for the trial."""
    server = server_of(study_file(tmp_path, practice="0"))
    with served(server) as client, client.websocket_connect(SESSION) as old:
        first = Page(old, rate_hz=8000)
        first.to_trial()
        first.stroke_until_it_sounds()
        with client.websocket_connect(SESSION) as new:
            second = Page(new, code=first.code, rate_hz=8000)
            assert len(server.sessions[1].pages) == 1
            with pytest.raises(WebSocketDisconnect) as gone:
                first.until("never")
            assert gone.value.code == ELSEWHERE
            second.stroke_until_it_sounds()
            second.answer()
    (row,) = server.store.ratings()
    assert row["measured"]["n_contacts"] >= 2
    assert len(server.store.strokes(1, 1)) > 10  # of both; what the old one still had on its way is not taken any more


def test_an_output_that_ends_by_itself_is_said_counted_and_begun_again(tmp_path: Path) -> None:
    """An unplugged sound card: the participant rated a dead surface, and nobody was told."""
    server = server_of(study_file(tmp_path, practice="0"))
    with joined(server, rate_hz=8000) as page:
        page.to_trial()
        page.stroke_until_it_sounds()
        session = server.sessions[1]
        assert session.strokes.sound.contact is not None

        def unplugged(out: np.ndarray) -> None:
            raise OSError("the device was unplugged")

        player = session.strokes.sound.contact.player
        player._render = unplugged  # type: ignore[attr-defined]
        while player.running:
            time.sleep(0.01)
        page.stroke(1)
        assert page.until("refused")["refused"] == read_language("en").words["cannot_play"]
        assert session.for_operator()["trouble"] == "nothing can be played: the device was unplugged"
        page.bytes = 0
        page.stroke_until_it_sounds()
        assert "trouble" not in session.for_operator()
        page.answer()
    (row,) = server.store.ratings()
    assert row["measured"]["n_stopped"] == 1
    with Store(server.store.path, read_only=True) as store:
        assert "trials in which the output ended by itself: 1" in of_trials(read_ratings(store)[0])


def test_a_device_that_refuses_to_begin_is_given_back(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each event of the pen opened it once more."""
    server, stopped = server_of(study_file(tmp_path, practice="0")), list[bool]()
    make = server.study.player

    def player(rate_hz: float) -> Any:
        made = make(rate_hz)
        monkeypatch.setattr(made, "start", lambda render: (_ for _ in ()).throw(OSError("it is in use")))
        monkeypatch.setattr(made, "stop", lambda: stopped.append(True))
        return made

    monkeypatch.setattr(server.study, "player", player)
    with joined(server, rate_hz=8000) as page:
        page.to_trial()
        page.stroke(1)
        assert page.until("refused")["refused"] == read_language("en").words["cannot_play"]
        assert stopped == [True]


def test_data_of_a_study_with_any_name_is_downloaded(tmp_path: Path) -> None:
    path = study_file(tmp_path, practice="0").rename(tmp_path / '類似 "1".toml')
    server = server_of(path)
    with served(server) as client, client.websocket_connect(SESSION) as socket:
        page = Page(socket)
        page.to_trial()
        page.answer()
        client.get("/operator", params={"key": server.operator_key})
        answer = client.get("/data.zip")
    assert answer.status_code == 200
    assert unquote(answer.headers["content-disposition"]) == "attachment; filename*=UTF-8''類似 \"1\".zip"


def test_the_operator_is_told_that_the_noise_has_ended(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path))
    for noise, ended in ((None, False), (SimpleNamespace(running=True), False), (SimpleNamespace(running=False), True)):
        server.noise = noise  # type: ignore[assignment]
        with served(server) as client:
            client.get("/operator", params={"key": server.operator_key})
            with client.websocket_connect(f"{WS}/operate") as socket:
                assert json.loads(socket.receive_text())["noise_ended"] is ended


def page_of(connection: Connection, **joining: Any) -> Page:
    """A participant's page at a real connection, as `Page` has it at a test client's."""

    class Socket:
        send_text = send_bytes = staticmethod(connection.send)

        @staticmethod
        def receive() -> dict[str, Any]:
            received = connection.recv(timeout=20)
            return {"type": "websocket.send", "text" if isinstance(received, str) else "bytes": received}

    return Page(Socket(), **joining)


def test_a_page_that_reads_nothing_holds_nobody_up(tmp_path: Path) -> None:
    """A tablet strokes and takes nothing that it is sent, on a real socket of small buffers: its strokes are stored, what waits
    for it is bounded, its participant answers on another screen, another participant goes on.
    """
    server = server_of(study_file(tmp_path, practice="0", screens="2"))
    with contextlib.ExitStack() as stack:
        listener = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 4096)
        port = listener.getsockname()[1]
        app = server.app(Access(LOOPBACK, port))
        running = uvicorn.Server(uvicorn.Config(app, log_level="warning", ws="websockets-sansio", ws_max_size=8192))
        thread = threading.Thread(target=running.run, kwargs={"sockets": [listener]})
        thread.start()
        stack.callback(thread.join, 20)
        stack.callback(lambda: setattr(running, "should_exit", True))

        def connect(**options: Any) -> Connection:
            raw = stack.enter_context(socket.socket())
            raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
            raw.connect(("127.0.0.1", port))
            there = f"127.0.0.1:{port}"
            return stack.enter_context(
                connect_page(f"ws://{there}/session", sock=raw, origin=Origin(f"http://{there}"), **options)
            )

        screen = page_of(connect(), role="answer")
        screen.to_trial()
        tablet = page_of(connect(max_queue=1, close_timeout=0.1), code=screen.code, role="stroke", rate_hz=192_000)
        (page,) = [page for page in server.pages if page.strokes]
        deadline, n = time.monotonic() + 20, 0
        while page.tablet.blocks.n_unsent < 200:  # the socket took nothing for a second and a half
            tablet.stroke(10)
            n += 10
            time.sleep(0.05)
            assert time.monotonic() < deadline
        other = page_of(connect())
        begin = time.monotonic()
        other.answer()
        screen.answer(61.0)
        assert screen.step["id"] == "trial:2"
        assert time.monotonic() - begin < 2.0
        assert page.tablet.blocks._waiting.qsize() <= MAX_WAITING_BLOCKS
        for _ in range(MAX_WAITING_TEXTS + 1):
            page.say({"step": screen.step})
        assert page._waiting.qsize() <= MAX_WAITING_TEXTS + 1
        again = page_of(connect(), code=screen.code, role="stroke", rate_hz=8000)  # and the tablet's next page joins
        assert again.step["id"] == "trial:2"
        assert server.store.strokes(1, 1).shape == (n, 4)
    assert not thread.is_alive()


NETWORK = Access(("192.0.2.7",), 8443, "token", other_token="other")


class Devices:
    """Devices of a network, and the operator, at one server."""

    def __init__(self, server: StudyServer, client: TestClient) -> None:
        self.server, self.client = server, client

    def connect(self, path: str, **cookies: str) -> Any:
        cookie = "; ".join(f"{name.replace('_', '-')}={secret}" for name, secret in cookies.items())
        headers = {"cookie": cookie, "origin": "https://192.0.2.7:8443"}
        return self.client.websocket_connect(f"wss://192.0.2.7:8443/{path}", headers=headers)

    def new(self) -> str:
        """Secret of a device that came by a link."""
        return self.server.admitted.add()

    @contextlib.contextmanager
    def page(self, device: str, **joining: Any) -> Iterator[Page]:
        with self.connect("session", foten=device) as socket:
            yield Page(socket, **joining)

    @contextlib.contextmanager
    def asking(self, device: str, **joining: Any) -> Iterator[tuple[Any, int]]:
        """A page that has to ask, and the number of its request."""
        with self.connect("session", foten=device) as socket:
            socket.send_text(json.dumps({"do": "join", **joining}))
            said = json.loads(socket.receive_text())
            assert set(said) == {"asks"}
            yield socket, said["asks"]

    @contextlib.contextmanager
    def operator(self) -> Iterator[Any]:
        """What an operator's page says, until what it is shown of the only participant, or is refused, is as a function wants."""
        secrets = {"foten": self.new(), OPERATOR_COOKIE.replace("-", "_"): self.server.admitted.add(OPERATOR)}
        with self.connect("operate", **secrets) as socket:

            def operate(wanted: Callable[[dict[str, Any]], bool], **message: Any) -> None:
                if message:
                    number = {"number": 1} if "request" in message else {}
                    socket.send_text(json.dumps({**number, **message}))
                while True:
                    said = json.loads(socket.receive_text())
                    if any(map(wanted, said.get("sessions") or [said])):
                        return

            yield operate


@contextlib.contextmanager
def on_the_network(server: StudyServer) -> Iterator[Devices]:
    with TestClient(server.app(NETWORK), base_url="https://192.0.2.7:8443") as client:
        yield Devices(server, client)


def closed_by(socket: Any) -> int:
    while (message := socket.receive())["type"] != "websocket.close":
        pass
    return int(message["code"])


def test_who_knows_a_code_goes_on_where_another_device_was_once_the_operator_allows_it(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path))
    with on_the_network(server) as devices, devices.operator() as operate:
        tablet, other = devices.new(), devices.new()
        with devices.page(tablet, fresh="KXWQA") as page:
            with devices.asking(other, code="kxwqa") as (socket, request):
                operate(lambda shown: shown.get("asks") == request)
                socket.send_text(json.dumps({"do": "done", "step": "consent"}))
                assert "before a code was given" in json.loads(socket.receive_text())["refused"]
                page.answer()  # the page that is there goes on
                assert page.step["kind"] == "questions"
                operate(lambda shown: "asks" not in shown, do="refuse", request=request)
                assert closed_by(socket) == NOT_ALLOWED
            with devices.page(
                tablet, code="KXWQA"
            ) as again:  # the same device takes over, as a page that is loaded again
                assert closed_by(page.socket) == ELSEWHERE
                for joining in ({"code": "KXWQA"}, {"fresh": "KXWQA"}, {"code": "KXWQA", "role": "answer"}):
                    with devices.asking(other, **joining):
                        pass
                with devices.asking(other, code="KXWQA") as (socket, request):
                    assert request == 5
                    operate(lambda said: "does not ask any more" in said.get("refused", ""), do="allow", request=4)
                    operate(lambda shown: "asks" not in shown, do="allow", request=request)
                    assert closed_by(socket) == JOIN_AGAIN
                again.answer()  # it is there until the other one has come
            with devices.page(other, code="KXWQA") as page:
                assert page.step["kind"] == "instructions"
                with devices.asking(tablet, code="KXWQA") as (_, request):
                    operate(lambda shown: shown.get("asks") == request and shown["pages"] == ["all"])
    assert server.store.done(1) == {"consent", "questions:start"}


def test_the_first_device_of_each_role_joins_freely_and_they_stay_theirs_after_a_restart(tmp_path: Path) -> None:
    path, known = study_file(tmp_path, screens="2"), tmp_path / "devices.json"
    server = server_of(path, Admitted(known))
    with on_the_network(server) as devices:
        tablet, screen, other = devices.new(), devices.new(), devices.new()
        with (
            devices.page(tablet, fresh="KXWQA", role="stroke"),
            devices.page(screen, code="KXWQA", role="answer") as page,
        ):
            page.answer()
            for role in ("all", "stroke", "answer"):
                with devices.asking(other, code="KXWQA", role=role):
                    pass
            with devices.asking(tablet, code="KXWQA"):  # as the only page, in the screen's place
                pass
    server.store.close()
    assert not any(secret in known.read_text() for secret in (tablet, screen, other))
    server = server_of(path, Admitted(known))
    said: list[str] = []
    server.participants.say = said.append
    with on_the_network(server) as devices:
        with devices.asking(other, code="KXWQA", role="stroke"), devices.page(tablet, code="KXWQA", role="stroke"):
            pass
        with devices.page(screen, code="KXWQA", role="answer") as page:
            assert page.step["kind"] == "questions"
        # No operator's page is open: who began the server is told.
        assert len(said) == 1
        assert said[0].startswith("participant 1, KXWQA: another device asks to go on, request 1; allow it at https")
        assert said[0].endswith(f"/operator?token=other&key={server.operator_key}")


def test_a_disk_that_refuses_the_devices_shuts_none_out(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path), Admitted(tmp_path / "no folder" / "devices.json"))
    with (
        on_the_network(server) as devices,
        devices.page(devices.new(), fresh="KXWQA") as page,
        devices.asking(devices.new(), code="KXWQA"),
    ):
        page.answer()
    assert server.store.done(1) == {"consent"}


def test_a_page_that_joins_again_is_no_second_participant(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path))
    with served(server) as client:
        for _ in range(2):
            with client.websocket_connect(SESSION) as socket:
                assert Page(socket, fresh="KXWQA").code == "KXWQA"
        with client.websocket_connect(SESSION) as socket:
            socket.send_text(json.dumps({"do": "join", "fresh": "ab"}))
            assert "expected 5 letters" in json.loads(socket.receive_text())["refused"]
    assert server.store.codes() == {"KXWQA": 1}


def test_the_operators_page_is_the_operators(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path))
    with served(server) as client:
        assert client.get("/operator").status_code == 403
        assert client.get("/operator", params={"key": "wrong"}).status_code == 403
        assert client.get("/operator.html").status_code == 404
        assert client.get("/codes/AAAAA.svg").status_code == 404
        with pytest.raises(WebSocketDisconnect), client.websocket_connect(f"{WS}/operate"):
            pass
        moved = client.get("/operator", params={"key": server.operator_key}, follow_redirects=False)
        assert (moved.status_code, moved.headers["location"]) == (303, "/operator")
        assert "httponly" in moved.headers["set-cookie"].lower()
        assert "New participant" in client.get("/operator").text
        assert client.get("/codes/AAAAA.svg").status_code == 404  # there is no such participant


def test_a_clock_that_is_set_back_changes_no_order_and_no_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By an hour, between a trial's being shown and its answer, and once more after a restart."""
    path, clock = study_file(tmp_path, practice="0", min_seconds="1.5"), time.time
    server = server_of(path)
    with joined(server, rate_hz=8000) as page:
        page.to_trial()
        page.stroke(30)
        page.stroke_until_it_sounds()
        monkeypatch.setattr(time, "time", lambda: clock() - 3600)
        assert "Explore both surfaces" in page.answer(11.0)["refused"]
        time.sleep(1.3)
        page.answer(11.0)
        page.bytes = 0
        page.stroke_until_it_sounds()
        code = page.code
    monkeypatch.setattr(time, "time", lambda: clock() - 7200)
    server.store.close()
    server = server_of(path)
    with joined(server, code=code, rate_hz=8000) as page:
        # From the restart on: how long it had been shown is not known.
        assert "Explore both surfaces" in page.answer(22.0)["refused"]
        time.sleep(1.3)
        page.answer(22.0)
        while page.step["kind"] != "end":
            if page.step["kind"] == "trial":
                page.stroke_until_it_sounds()
                time.sleep(1.3)
            page.answer(33.0)
    rows = server.store.ratings()
    assert [(row["trial"], row["rating"]) for row in rows] == [(1, 11.0), (2, 22.0), (3, 33.0), (4, 33.0)]
    assert {row["response_s"] for row in rows} == {2.5}  # as the page counts
    assert rows[0]["at"] > rows[1]["at"]  # as the clock said
    assert rows[0]["measured"]["contact_s"] == pytest.approx(0.38, abs=0.01)
    assert len(server.store.strokes(1, 1)) == 40
    assert server.store.check() == []


def test_answers_stay_in_the_order_in_which_they_were_given(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    server, clock = server_of(study_file(tmp_path)), time.time
    server.store.join("KXWQA")
    for n in range(3):
        monkeypatch.setattr(time, "time", lambda n=n: clock() - 3600 * n)
        server.store.take_step(1, f"questions:{n}", answers={f"question {n}": "fine"})
    assert [answer["question"] for answer in server.store.answers()] == ["question 0", "question 1", "question 2"]


def test_nothing_is_lost_while_the_file_cannot_be_written(tmp_path: Path) -> None:
    """A medium that turns read-only in the middle of a trial, as SQLite says it: strokes, when the hand went over, since when
    the next trial is shown, and that the participant came to the end, are written once it can be again.
    """
    path = study_file(tmp_path, practice="0", operator="true")
    server = server_of(path)

    def set_read_only(on: bool) -> None:
        server.store._connection.execute(f"PRAGMA query_only = {'ON' if on else 'OFF'}")

    with served(server) as client, client.websocket_connect(SESSION) as socket:
        code = client.portal.call(server.participants.begin).code
        session, page = server.sessions[1], Page(socket, code=code, rate_hz=8000)

        def go() -> None:
            client.portal.call(session.hold, False)
            page.step = page.until("step")["step"]

        page.to_trial()
        set_read_only(True)
        begin = time.time()
        go()
        for side in ("virtual", "real", "virtual"):
            if side != page.step["side"]:
                page.say(do="side", side=side)
                page.step = page.until("step")["step"]
            page.stroke(10)
        refused = page.answer(61.0)
        assert refused["refused"].startswith("Not stored yet. Your answer is kept here")
        assert "study.db: the disk is full or cannot be written" in session.trouble
        assert refused["again"]
        assert session.for_operator()["n_unsaved"] == 3  # and the strokes of the trial that goes on
        assert server.store.switches(1, 1) == []
        set_read_only(False)
        end = time.time()
        page.answer(61.0)
        assert "n_unsaved" not in session.for_operator()
        assert (page.step["id"], server.store.switches(1, 1), len(server.store.strokes(1, 1))) == (
            "trial:2",
            ["real", "virtual"],
            20,
        )
        shown = server.store.shown(1, 1)
        assert shown is not None
        assert begin - 0.01 <= shown <= end
        while page.step["kind"] == "trial":
            go()
            page.answer(50.0)
        write = server.store.take_step

        def take_step(number: int, step: str, **answers: Any) -> bool:
            set_read_only(step == "end")  # as soon as the last answer is stored
            return write(number, step, **answers)

        server.store.take_step = take_step  # type: ignore[method-assign]
        while page.step["kind"] != "end":
            page.answer()
        assert server.store.counts()[1]["ended"] == 0
        server.store.take_step = write  # type: ignore[method-assign]
        set_read_only(False)
    server.store.close()
    with joined(server_of(path), code=code) as page:  # that the server did not come to
        assert page.step["kind"] == "end"
    with Store(tmp_path / "study.db") as store:
        assert store.counts()[1]["ended"] == 1
        assert [row["rating"] for row in store.ratings()] == [61.0, 50.0, 50.0, 50.0]


def test_the_real_surface_is_asked_for_before_each_rating_where_the_study_says_so(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path, practice="0", real_checked="true"))
    with joined(server, rate_hz=8000) as page:
        page.to_trial()
        for _ in range(2):
            assert page.step["lacks_real"]
            assert page.answer(33.0)["refused"] == "Tap “real surface” when you touch the real one"
            page.say(do="side", side="real")
            page.step = page.until("step")["step"]
            assert not page.step["lacks_real"]
            page.answer(33.0)
    assert len(server.store.ratings()) == 2


def test_a_participant_is_refused_in_the_language_of_the_study(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Until all places are taken; the operator is told in English what is the matter."""
    server = server_of(study_file(tmp_path, practice="0", participants=1, language="de", min_seconds="0.5"))
    german = read_language("de")

    def refused(**joining: Any) -> str:
        with client.websocket_connect(SESSION) as socket:
            socket.send_text(json.dumps({"do": "join", **joining}))
            return str(json.loads(socket.receive_text())["refused"])

    with served(server) as client, client.websocket_connect(SESSION) as socket:
        page = Page(socket, rate_hz=8000)
        assert page.answer()["step"]["kind"] == "questions"
        assert page.done(answers={"age": "old"})["refused"] == german.say("not_a_number", question=german.new["age"])
        page.to_trial()
        assert page.answer()["refused"] == "Erkunden Sie zuerst 1\u00a0s lang beide Oberflächen"
        time.sleep(0.5)
        assert page.answer()["refused"] == german.words["stroke_first"]
        monkeypatch.setattr(server.study, "player", lambda _: (_ for _ in ()).throw(OSError("no such device")))
        page.stroke(1)
        assert page.until("refused")["refused"] == german.words["cannot_play"]
        assert server.sessions[1].for_operator()["trouble"] == "nothing can be played: no such device"
        assert refused(code="AAAAA") == german.words["no_such_code"]
        for fresh in ("ABCDE", "ABCDF"):  # and two more are planned than were asked for
            server.store.join(fresh)
        assert refused() == german.words["all_begun"]
        server.store._connection.execute("PRAGMA query_only = ON")
        assert refused() == german.words["cannot_begin"]
        cookie = {"cookie": f"{OPERATOR_COOKIE}={server.admitted.add(OPERATOR)}"}
        with client.websocket_connect(f"{WS}/operate", headers=cookie) as operator:
            operator.send_text(json.dumps({"do": "begin"}))
            while "refused" not in (document := json.loads(operator.receive_text())):
                pass
            assert "the disk is full or cannot be written" in document["refused"]


def test_the_page_comes_with_its_words(tmp_path: Path) -> None:
    """And nothing of them, nor of the title, is taken for HTML."""
    path = study_file(tmp_path, language="ja", title='"a < b & \\"c\\""')
    path.write_text(path.read_text(encoding="utf-8") + '[words]\nnext = "</script>&\\"$x"\n', encoding="utf-8")
    with served(server_of(path)) as client:
        page = client.get("/").text
        assert client.get("/study.html").text == page
    words = json.loads(re.findall(r'<script type="application/json" id="words">(.*?)</script>', page)[0])
    assert words == {**read_language("ja").words, "next": '</script>&"$x'}
    assert '<html lang="ja" dir="ltr">' in page
    assert page.count("a &lt; b &amp; &quot;c&quot;") == 2
    assert "$" not in page.replace("$x", "")


def test_a_device_that_was_not_let_in_is_refused_in_the_language_of_the_study(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path, language="zh"))
    access = access_to("0.0.0.0", 8000, ("192.0.2.1",))
    with TestClient(server.app(access), base_url="https://192.0.2.1:8000") as client:
        assert client.get("/?token=used").text == f"{read_language('zh').words['link_used']}\n"


def test_a_full_disk_is_said_to_the_page_and_the_answer_can_be_given_again(tmp_path: Path) -> None:
    server = server_of(study_file(tmp_path, practice="0"))
    with joined(server) as page:
        page.to_trial()
        server.store._connection.execute("PRAGMA query_only = ON")
        refused = page.answer(33.0)
        assert "Not stored yet. Your answer is kept here" in refused["refused"]
        assert server.sessions[1].for_operator()["trouble"].startswith("study.db: the disk is full")
        assert refused["again"]
        server.store._connection.execute("PRAGMA query_only = OFF")
        page.answer(33.0)
        assert page.step["id"] == "trial:2"
    assert [row["rating"] for row in server.store.ratings()] == [33.0]


def test_a_database_is_of_its_very_study(tmp_path: Path) -> None:
    path = study_file(tmp_path)
    database = tmp_path / "study.db"
    load_study(path).open_store(database, simulated=True).close()
    with pytest.raises(ValueError, match="holds simulated ratings, which stay apart"):
        load_study(path).open_store(database)
    text = path.read_text(encoding="utf-8")
    path.write_text(text + "\n# another comment\n", encoding="utf-8")
    with pytest.raises(ValueError, match="has changed since"):
        load_study(path).open_store(database, simulated=True)
    path.write_text(text, encoding="utf-8")
    load_study(path).open_store(database, simulated=True).close()
    texture = tmp_path / "artificial-grass-ar.foten"
    texture.write_bytes((tmp_path / "steel-mesh-1-dstn.foten").read_bytes())
    with pytest.raises(ValueError, match="ar of artificial-grass is another file than when"):
        load_study(path).open_store(database, simulated=True)
    texture.write_bytes(b"no texture")
    with pytest.raises(ValueError, match=r"artificial-grass-ar\.foten"):
        load_study(path)


def test_a_page_has_no_device_of_this_machine(tmp_path: Path) -> None:
    path = study_file(tmp_path)
    text = path.read_text(encoding="utf-8").replace('to = "page" ', 'to = "page"\ngain = 2.0')
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"\[output\] plays in the page, which has no device, gain or actuator"):
        load_study(path)


def test_levels_are_matched_and_stored(tmp_path: Path) -> None:
    study = load_study(study_file(tmp_path, n_textures=3))
    listed = study.stimuli
    assert max(abs(stimulus.gain_db) for stimulus in listed) > 0.3
    assert all(abs(stimulus.gain_db) <= 30 for stimulus in listed)
    for t, texture in enumerate(study.design.textures):  # with them, nothing is left to match
        renderers = [Renderer(file) for file in texture.files.values()]
        gains = [stimulus.gain_db for stimulus in listed if stimulus.texture == t]
        scales = [
            10 ** (db / 20) / r.native_texture.info.acceleration_sd for db, r in zip(gains, renderers, strict=True)
        ]
        np.testing.assert_allclose(gains_db(renderers, scales), 0.0, atol=1e-9)
    with study.open_store(tmp_path / "study.db") as store:
        assert list(store.stimuli().values()) == listed
    unmatched = load_study(study_file(tmp_path, match_levels="false", to='"null"'))
    assert {stimulus.gain_db for stimulus in unmatched.stimuli} == {0.0}


def test_texts_that_no_speaker_has_read_are_a_doubt(tmp_path: Path) -> None:
    assert load_study(study_file(tmp_path)).doubts == []
    assert load_study(study_file(tmp_path, language="de")).doubts == [
        "the German texts have not been reviewed by a speaker"
    ]
