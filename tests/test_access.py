"""Who may talk to the server: hosts, origins, devices that came by a link, and the certificate."""

from __future__ import annotations

import os
import ssl
import stat
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette")
from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from foten.runtime.renderer import EXAMPLE
from foten.studio.access import Access, Admitted, access_to, certificate_for, private_folder, write_certificate
from foten.studio.shelf import Shelf
from foten.studio.studio_server import Studio
from test_studio_server import HERE, LOCAL, WS


@pytest.fixture
def studio() -> Studio:
    return Studio(Shelf([EXAMPLE]))


def test_a_page_that_another_name_leads_to_is_refused(studio: Studio) -> None:
    """A name of someone else's that resolves to this machine would let their page read ours."""
    with TestClient(studio.app(LOCAL), base_url=HERE) as client:
        for host in ("evil.example:8000", "127.0.0.1:8001", "127.0.0.1", "[::1", ""):
            answer = client.get("/textures.json", headers={"host": host})
            assert answer.status_code == 403
            assert "does not answer to" in answer.text
        for host in ("localhost:8000", "[::1]:8000"):
            assert client.get("/textures.json", headers={"host": host}).status_code == 200


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_a_page_of_another_origin_gets_nothing_but_the_opened_page(studio: Studio, site: str) -> None:
    """By an image's tag, say; a link on it opens the page."""
    with TestClient(studio.app(LOCAL), base_url=HERE) as client:
        asked = client.get("/gains", headers={"sec-fetch-site": site, "sec-fetch-mode": "no-cors"})
        assert asked.status_code == 403
        assert asked.text == "a page of another origin asks for this, expected this server's own page\n"
        opened = {"sec-fetch-site": site, "sec-fetch-mode": "navigate"}
        assert client.get("/", headers={**opened, "sec-fetch-dest": "iframe"}).status_code == 403
        assert client.get("/", headers={**opened, "sec-fetch-dest": "document"}).status_code == 200
        for own in ("same-origin", "none"):
            assert client.get("/", headers={"sec-fetch-site": own}).status_code == 200


@pytest.mark.parametrize("origin", ["http://evil.example", "https://127.0.0.1:8000", "http://127.0.0.1:8001", None])
def test_a_socket_from_another_page_is_refused(studio: Studio, origin: str | None) -> None:
    headers = {} if origin is None else {"origin": origin}
    with TestClient(studio.app(LOCAL), base_url=HERE) as client:
        connection = client.websocket_connect(f"{WS}/stroke", headers=headers)
        with pytest.raises(WebSocketDisconnect) as refused, connection:
            pass
    assert refused.value.code == 1008
    assert "origin" in refused.value.reason


def test_a_certificate_is_for_the_hosts_and_its_key_is_for_the_owner_alone(tmp_path: Path) -> None:
    certificate, key = write_certificate(tmp_path, ["192.0.2.7", "localhost"])
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(certificate, key)
    names = ssl._ssl._test_decode_cert(str(certificate))["subjectAltName"]  # type: ignore[attr-defined]
    assert names == (("IP Address", "192.0.2.7"), ("DNS", "localhost"))
    if os.name == "posix":
        assert key.stat().st_mode & 0o077 == 0


def test_a_certificate_is_kept_while_it_holds_for_the_hosts(tmp_path: Path) -> None:
    first = certificate_for(tmp_path, ["192.0.2.7", "localhost"])[0].read_bytes()
    assert certificate_for(tmp_path, ["localhost"])[0].read_bytes() == first
    second = certificate_for(tmp_path, ["192.0.2.8"])[0].read_bytes()
    assert second != first
    (tmp_path / "certificate.pem").write_text("none")
    certificate, key = certificate_for(tmp_path, ["192.0.2.8"])
    ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(certificate, key)
    if os.name == "posix":
        assert key.stat().st_mode & 0o077 == 0


def test_who_was_let_in_is_known_to_the_next_server_by_a_hash(tmp_path: Path) -> None:
    path = tmp_path / "devices.json"
    secret, key = Admitted(path).add(), Admitted(path).add("operator")
    again = Admitted(path)
    assert again.knows(secret)
    assert again.knows(key, "operator")
    for other, kind in ((secret, "operator"), (key, "device"), ("x", "device"), ("", "device"), ("\udc80é", "device")):
        assert not again.knows(other, kind)
    assert not again.knows(None)
    assert secret not in path.read_text()
    if os.name == "posix":
        assert path.stat().st_mode & 0o077 == 0
    path.write_text("[3]")
    with pytest.raises(ValueError, match="holds no devices that were let in"):
        Admitted(path)


@pytest.mark.skipif(os.name != "posix", reason="has no owners and modes as these")
def test_secrets_that_others_may_have_put_there_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever writes the folder lets any device in; who reads it can take the server's place."""
    folder = private_folder(tmp_path / "study.access")
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    Admitted(folder / "devices.json").add()
    write_certificate(folder, ["localhost"])
    Admitted(private_folder(folder) / "devices.json")  # the next start

    def check_refused(path: Path, what: str) -> None:
        for start in (lambda: private_folder(folder), lambda: Admitted(folder / "devices.json")):
            with pytest.raises(ValueError, match=f"^{path} is {what}.* of the user .*, expected no link, and yours"):
                start()

    key = folder / "key.pem"
    for path, mode, what in ((folder, 0o750, "drwx"), (folder / "devices.json", 0o620, "-rw"), (key, 0o602, "-")):
        before = path.stat().st_mode
        path.chmod(mode)
        check_refused(path, what)
        path.chmod(before)
    (folder / "key.pem").rename(tmp_path / "key.pem")
    (folder / "key.pem").symlink_to(tmp_path / "key.pem")
    check_refused(folder / "key.pem", "l")
    folder.rename(tmp_path / "elsewhere")
    folder.symlink_to(tmp_path / "elsewhere")
    check_refused(folder, "l")
    monkeypatch.setattr(os, "geteuid", lambda: 12345)
    with pytest.raises(ValueError, match="expected no link, and yours alone"):
        private_folder(tmp_path / "of another")


def test_two_links_have_a_token_each(studio: Studio) -> None:
    access, renewed, device = on_the_network(studio)
    assert access.other_token not in (None, access.token)
    assert access.link("192.0.2.7", "operator", other=True, key="k").endswith(f"?token={access.other_token}&key=k")
    first, second = device(), device()
    assert first.get("/", params={"token": access.other_token}).status_code == 303
    assert renewed[0].token == access.token
    assert renewed[0].other_token != access.other_token
    assert second.get("/", params={"token": access.token}).status_code == 303
    assert device().get("/", params={"token": access.other_token}).status_code == 403


def on_the_network(studio: Studio) -> tuple[Access, list[Access], Any]:
    """The access to a server on a network, those that it was renewed to, and how to come there with a new device."""
    renewed: list[Access] = []
    access = access_to("192.0.2.7", 8443, on_joined=renewed.append)
    app, there = studio.app(access), "https://192.0.2.7:8443"
    return access, renewed, lambda: TestClient(app, base_url=there, headers={"origin": there}, follow_redirects=False)


def test_a_link_lets_one_device_in_by_a_cookie_and_the_next_one_has_another(studio: Studio) -> None:
    access, renewed, device = on_the_network(studio)
    first, second, third = device(), device(), device()
    assert access.token is not None
    assert access.link("192.0.2.7") == f"https://192.0.2.7:8443/?token={access.token}"
    assert access.token not in repr(access)
    for options in ({}, {"params": {"token": access.token[:-1] + "~"}}, {"headers": {"cookie": b"foten=\xe9\xff"}}):
        assert first.get("/", **options).status_code == 403
    with pytest.raises(WebSocketDisconnect), first.websocket_connect("wss://192.0.2.7:8443/stroke"):
        pass
    moved = first.get("/", params={"token": access.token})
    assert (moved.status_code, moved.headers["location"]) == (303, "/")
    cookie = moved.headers["set-cookie"].lower()
    assert all(word in cookie for word in ("httponly", "secure", "samesite=lax"))
    assert access.token.lower() not in cookie
    (newest,) = renewed
    assert newest.token not in (None, access.token)
    assert (newest.hosts, newest.port) == (access.hosts, access.port)
    refused = second.get("/", params={"token": access.token})
    assert refused.status_code == 403
    assert "open the newest link" in refused.text
    assert second.get("/", params={"token": newest.token}).status_code == 303
    assert first.get("/").status_code == second.get("/").status_code == 200
    assert first.cookies["foten"] != second.cookies["foten"]
    # The link of the second device is used up too, and a device's secret is no token.
    for token in (newest.token, first.cookies["foten"]):
        assert third.get("/", params={"token": token}).status_code == 403
    assert len(renewed) == 2


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


@pytest.mark.parametrize("headers", [{"sec-purpose": "prefetch;prerender"}, {"x-purpose": "preview"}])
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
    assert access_to("LocalHost", 8000) == access_to("127.0.0.1", 8000) == LOCAL
    # This machine alone needs no token.
    assert LOCAL.link("::1", "operator", key="k") == "http://[::1]:8000/operator?key=k"
    access = access_to("MyBox.local", 8443)
    with TestClient(studio.app(access), base_url="https://mybox.local:8443") as client:
        for host in ("mybox.local:8443", "MyBox.local:8443"):
            headers = {"host": host, "origin": "https://mybox.local:8443"}
            assert client.get("/", params={"token": access.token}, headers=headers).status_code == 200
            with client.websocket_connect("wss://mybox.local:8443/stroke", headers=headers):
                pass
        assert client.get("/", headers={"host": "other.local:8443"}).status_code == 403
