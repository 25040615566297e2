"""Access to the server: hosts, origins, devices that came by its link, and a certificate.

The token in a link lets one device in: it is exchanged for a secret of that device, in a cookie, and the next link has another.
"""

from __future__ import annotations

import datetime
import hmac
import ipaddress
import secrets
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from urllib.parse import urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

COOKIE = "foten"
LOOPBACK = ("127.0.0.1", "localhost", "::1")
CERTIFICATE_DAYS = 30

# Scripts, styles and connections of the page's own origin alone; nobody frames it. Compiling WebAssembly is called
# `wasm-unsafe-eval`. The page is isolated from others, which gives it precise clocks.
HEADERS = {
    "content-security-policy": "default-src 'self'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self'; "
    "img-src 'self' data: blob:; media-src 'self' blob:; object-src 'none'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-embedder-policy": "require-corp",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "microphone=(self)",
    "cache-control": "no-cache",
}


@dataclass(frozen=True)
class Access:
    """The names that the server answers to, and the token that lets the next device in; none on this machine alone."""

    hosts: tuple[str, ...]  # without ports
    port: int
    token: str | None = field(default=None, repr=False)
    on_joined: Callable[[Access], None] | None = field(default=None, repr=False, compare=False)
    """Takes the access with the next token, each time that a token was used up."""

    @property
    def scheme(self) -> str:
        """`https` where others may listen, else `http`: loopback is a secure context by itself."""
        return "http" if self.token is None else "https"

    def link(self, host: str, page: str = "", **query: str) -> str:
        """Address to open, of a page and with a query."""
        name = f"[{host}]" if ":" in host else host
        parts = urlencode(query if self.token is None else {"token": self.token, **query})
        return f"{self.scheme}://{name}:{self.port}/{page}" + (f"?{parts}" if parts else "")

    def knows(self, authority: str) -> bool:
        """Whether a Host header names this server: another name that leads here is a page of someone else."""
        try:
            parts = urlsplit(f"//{authority}")
            hosts = [host.lower() for host in self.hosts]  # as `hostname` is
            return parts.hostname in hosts and (parts.port or (80 if self.scheme == "http" else 443)) == self.port
        except ValueError:
            return False


def access_to(
    host: str, port: int, addresses: Sequence[str] = (), on_joined: Callable[[Access], None] | None = None
) -> Access:
    """Access to a server that listens at a host: with a token where that is not this machine alone."""
    if host.lower() in LOOPBACK:
        return Access(LOOPBACK, port)
    return Access(tuple(dict.fromkeys((host, *addresses, *LOOPBACK))), port, _secret(), on_joined)


class Guarded:
    """An application behind its access: wrong hosts, origins and strange devices are refused with a reason before it is asked."""

    def __init__(self, app: ASGIApp, access: Access) -> None:
        self._app, self._access = app, access  # the access is that of the newest link
        self._devices: list[str] = []  # the secrets of those that came in

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        token, known = connection.query_params.get("token"), self._knows(connection.cookies.get(COOKIE))
        if why := self._refused(connection.headers, scope, token, known):
            await _refuse(scope, receive, send, why)
            return
        if token is not None and self._access.token is not None and scope.get("method") == "GET":
            if not known and _ahead(connection.headers):
                await _refuse(scope, receive, send, "open the link: it lets in who opens it, not who looks ahead", 503)
            else:
                await self._enter(connection, receive, send, known)
            return

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                fields = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    fields.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_with_headers)

    async def _enter(self, connection: HTTPConnection, receive: Receive, send: Send, known: bool) -> None:
        """Send a device on to the address without the token, where others could read it; a new one gets a secret of its own."""
        scope, query = connection.scope, [item for item in connection.query_params.multi_items() if item[0] != "token"]
        path = "/" + scope["path"].lstrip("/")  # one slash in front: two would be the address of another host
        response = RedirectResponse(f"{path}?{urlencode(query)}" if query else path, status_code=303)
        if known:
            await response(scope, receive, send)
            return
        access = self._access = replace(self._access, token=_secret())
        self._devices.append(_secret())
        # A cookie that scripts cannot read. `lax`, as `strict` ones stay away from a page that was opened by a link on another.
        response.set_cookie(COOKIE, self._devices[-1], httponly=True, samesite="lax", secure=True)
        try:
            await response(scope, receive, send)
        finally:  # the old link is used up, even where nobody took the answer
            if access.on_joined is not None:
                access.on_joined(access)

    def _knows(self, secret: str | None) -> bool:
        return secret is not None and any([is_same(secret, device) for device in self._devices])

    def _refused(self, headers: Headers, scope: Scope, token: str | None, known: bool) -> str:
        host = headers.get("host", "")
        if not self._access.knows(host):
            return f"this server does not answer to {host[:80]!r}: open the link that it printed"
        origin = headers.get("origin")
        expected = f"{self._access.scheme}://{host}"
        asks = scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        if not asks and str(origin).lower() != expected.lower():
            return f"the origin is {str(origin)[:80]!r}, expected this server's own page"
        expected_token = self._access.token
        if not known and expected_token is not None and not (asks and token and is_same(token, expected_token)):
            what = "the token is missing, wrong or used, as a link lets one device in"
            return f"{what}: open the newest link, or scan the newest code, that the server printed"
        return ""


def _secret() -> str:
    return secrets.token_urlsafe(24)


def is_same(secret: str, expected: str) -> bool:
    """Whether a secret is the expected one, in a time that says nothing of either."""
    return hmac.compare_digest(secret.encode(), expected.encode())


def _ahead(headers: Headers) -> bool:
    """Whether a browser prefetches a page that nobody opened yet."""
    purpose = [headers.get(name, "") for name in ("sec-purpose", "purpose", "x-purpose", "x-moz")]
    return any(word in header.lower() for header in purpose for word in ("prefetch", "prerender", "preview"))


async def _refuse(scope: Scope, receive: Receive, send: Send, why: str, status: int = 403) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": why[:120]})
        return
    await PlainTextResponse(f"{why}\n", status_code=status)(scope, receive, send)


def write_certificate(folder: Path, hosts: Iterable[str]) -> tuple[Path, Path]:
    """Write a certificate for some hosts, signed by its own new key; the paths of certificate and key.

    A tablet gives a page the pen's pressure and low-latency sound only over HTTPS; it asks once whether to trust this one.
    """
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes
    from cryptography.hazmat.primitives import serialization as form
    from cryptography.hazmat.primitives.asymmetric import ec

    def general_name(host: str) -> x509.GeneralName:
        try:
            return x509.IPAddress(ipaddress.ip_address(host))
        except ValueError:
            return x509.DNSName(host)

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "foten on this network")])
    now = datetime.datetime.now(datetime.UTC)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(hours=1))
        .not_valid_after(now + datetime.timedelta(days=CERTIFICATE_DAYS))
        .add_extension(x509.SubjectAlternativeName(map(general_name, hosts)), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    paths = folder / "certificate.pem", folder / "key.pem"
    paths[0].write_bytes(certificate.public_bytes(form.Encoding.PEM))
    paths[1].touch(mode=0o600)
    paths[1].write_bytes(key.private_bytes(form.Encoding.PEM, form.PrivateFormat.PKCS8, form.NoEncryption()))
    return paths
