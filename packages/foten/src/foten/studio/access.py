"""Access to the server: hosts, origins, devices that came by its link, and a certificate.

The token in a link lets one device in: it is exchanged for a secret of that device, in a cookie, and the next link has another.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import hmac
import ipaddress
import os
import secrets
import stat
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from urllib.parse import urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import HTTPConnection
from starlette.responses import PlainTextResponse, RedirectResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from foten.atomic_write import write_json
from foten.untrusted import check_regular, parse_json

COOKIE = "foten"
LOOPBACK = ("127.0.0.1", "localhost", "::1")
CERTIFICATE_DAYS = 30
STRANGER = (
    "the token is missing, wrong or used, as a link lets one device in: open the newest link, or scan the newest code, "
    "that the server printed"
)

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
    other_token: str | None = field(default=None, repr=False)  # of another link: who uses one does not use up both

    @property
    def scheme(self) -> str:
        """`https` where others may listen, else `http`: loopback is a secure context by itself."""
        return "http" if self.token is None else "https"

    def link(self, host: str, page: str = "", other: bool = False, **query: str) -> str:
        """Address to open, of a page and with a query, by the one token or the other."""
        name = f"[{host}]" if ":" in host else host
        token = self.other_token if other else self.token
        parts = urlencode(query if token is None else {"token": token, **query})
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
    return Access(tuple(dict.fromkeys((host, *addresses, *LOOPBACK))), port, _secret(), on_joined, _secret())


class Admitted:
    """Those who were let in, by hashes of the secrets that they were given; in a file they are let in again by the next server.

    The file is in a folder for its owner alone; ValueError where it holds something else, or others may have put it there.
    """

    def __init__(self, path: Path | None = None) -> None:
        self._path = path
        self._hashes: dict[str, list[str]] = {}
        if path is not None and path.exists():
            private_folder(path.parent)
            check_regular(path)
            try:
                stored = parse_json(path.read_bytes())
                self._hashes = {str(kind): [str(one) for one in hashes] for kind, hashes in stored.items()}
            except (ValueError, AttributeError, TypeError) as error:
                raise ValueError(f"{path} holds no devices that were let in; remove it, and they ask anew") from error

    def add(self, kind: str = "device") -> str:
        """A secret for one more of a kind."""
        secret = _secret()
        self._hashes.setdefault(kind, []).append(_hash(secret))
        self._write()
        return secret

    def put(self, kind: str, secret: str) -> None:
        """Let a secret be the only one of a kind."""
        if self._hashes.get(kind) != [_hash(secret)]:
            self._hashes[kind] = [_hash(secret)]
            self._write()

    def drop(self, prefix: str) -> None:
        """Forget all of the kinds whose names begin so."""
        remaining = {kind: hashes for kind, hashes in self._hashes.items() if not kind.startswith(prefix)}
        if remaining != self._hashes:
            self._hashes = remaining
            self._write()

    def has(self, kind: str) -> bool:
        """Whether there is one of a kind."""
        return kind in self._hashes

    def _write(self) -> None:
        if self._path is not None:
            with contextlib.suppress(OSError):  # they are known to this server, and to the next once the disk has room
                write_json(self._path, self._hashes)
                self._path.chmod(0o600)

    def knows(self, secret: str | None, kind: str = "device") -> bool:
        """Whether a secret was given to one of a kind, in a time that says nothing of it."""
        return secret is not None and any([is_same(_hash(secret), known) for known in self._hashes.get(kind, [])])


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode("utf-8", "replace")).hexdigest()


class Guarded:
    """An application behind its access: wrong hosts, origins and strange devices are refused with a reason before it is asked."""

    def __init__(
        self, app: ASGIApp, access: Access, admitted: Admitted | None = None, for_strangers: str = STRANGER
    ) -> None:
        self._app, self._access = app, access  # the access is that of the newest link
        self._admitted, self._for_strangers = admitted or Admitted(), for_strangers

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        connection = HTTPConnection(scope)
        token, known = connection.query_params.get("token"), self._admitted.knows(connection.cookies.get(COOKIE))
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
        other = is_same(connection.query_params["token"], self._access.other_token or "")
        used, fresh = self._access, _secret()
        access = self._access = replace(used, other_token=fresh) if other else replace(used, token=fresh)
        # A cookie that scripts cannot read. `lax`, as `strict` ones stay away from a page that was opened by a link on another.
        response.set_cookie(COOKIE, self._admitted.add(), httponly=True, samesite="lax", secure=True)
        try:
            await response(scope, receive, send)
        finally:  # the old link is used up, even where nobody took the answer
            if access.on_joined is not None:
                access.on_joined(access)

    def _refused(self, headers: Headers, scope: Scope, token: str | None, known: bool) -> str:
        host = headers.get("host", "")
        if not self._access.knows(host):
            return f"this server does not answer to {host[:80]!r}: open the link that it printed"
        origin = headers.get("origin")
        expected = f"{self._access.scheme}://{host}"
        asks = scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        if not asks and str(origin).lower() != expected.lower():
            return f"the origin is {str(origin)[:80]!r}, expected this server's own page"
        opened = (headers.get("sec-fetch-mode"), headers.get("sec-fetch-dest")) == ("navigate", "document")
        if asks and headers.get("sec-fetch-site", "none") not in ("same-origin", "none") and not opened:
            return "a page of another origin asks for this, expected this server's own page"
        tokens = [expected for expected in (self._access.token, self._access.other_token) if expected is not None]
        if not known and tokens and not (asks and token and any([is_same(token, expected) for expected in tokens])):
            return self._for_strangers
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
        await send({"type": "websocket.close", "code": 1008, "reason": why.encode()[:120].decode(errors="ignore")})
        return
    await PlainTextResponse(f"{why}\n", status_code=status)(scope, receive, send)


def private_folder(folder: Path) -> Path:
    """A folder for its owner alone, made where there is none; ValueError where others may read it, or have put what it holds."""
    folder.mkdir(mode=0o700, exist_ok=True)
    for path in (folder, *folder.iterdir()) if os.name == "posix" else ():
        status = path.lstat()
        is_open = status.st_mode & (0o077 if path == folder else 0o022)  # others cannot read what such a folder holds
        if stat.S_ISLNK(status.st_mode) or status.st_uid != os.geteuid() or is_open:
            what = f"{path} is {stat.filemode(status.st_mode)} of the user {status.st_uid}"
            raise ValueError(f"{what}, expected no link, and yours alone: remove {folder}, and devices ask anew")
    return folder


def certificate_for(folder: Path, hosts: Iterable[str]) -> tuple[Path, Path]:
    """The paths of a certificate and its key in a folder: those that lie there, while they hold for the hosts, or new ones.

    A browser that was told to trust it need not be told again.
    """
    from cryptography import x509

    hosts, paths = list(hosts), (folder / "certificate.pem", folder / "key.pem")
    if all(path.is_file() for path in paths):
        # One of another kind is made anew.
        with contextlib.suppress(ValueError, x509.ExtensionNotFound):
            certificate = x509.load_pem_x509_certificate(paths[0].read_bytes())
            names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
            remains = certificate.not_valid_after_utc - datetime.datetime.now(datetime.UTC)
            if remains > datetime.timedelta(days=1) and {str(name.value) for name in names} >= set(hosts):
                return paths
    return write_certificate(folder, hosts)


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
    paths[1].unlink(missing_ok=True)
    paths[1].touch(mode=0o600)
    paths[1].write_bytes(key.private_bytes(form.Encoding.PEM, form.PrivateFormat.PKCS8, form.NoEncryption()))
    return paths
