"""A server as a process: it listens, says where, and ends cleanly; connections that ask nothing are few and short."""

import asyncio
import contextlib
import ipaddress
import logging
import socket
import ssl
import tempfile
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path

import uvicorn
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol
from websockets.frames import Frame, Opcode

from foten.studio.access import LOOPBACK, Access, access_to, certificate_for, private_folder
from foten.studio.messages import MAX_BYTES, Allowance
from foten.studio.websocket import MAX_MESSAGES_PER_S

SHUTDOWN_S = 3
REQUEST_S = 5.0  # from a connection to its whole first request, encryption included
NEXT_REQUEST_S = 10.0  # from an answer to the whole next request; uvicorn closes after 5 s without a byte
LINGER_S = 30.0  # that an answer on its way to a slow tablet may still take, once its connection is to be closed
MAX_WAITING = 512  # connections without a request
MAX_FILES = 4096  # that are asked for, of which a connection is one
NO_FILE_S = 0.05  # to wait where the system has none left


def addresses() -> list[str]:
    """Addresses by which others on the network reach this machine, the likeliest first."""
    reached: list[str] = []
    with contextlib.suppress(OSError), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect(("192.0.2.1", 9))  # nothing is sent: the system says from which address it would be
        reached.append(probe.getsockname()[0])
    with contextlib.suppress(OSError):
        reached += [str(info[4][0]) for info in socket.getaddrinfo(socket.gethostname(), None, socket.AF_INET)]
    return [address for address in dict.fromkeys(reached) if not ipaddress.ip_address(address).is_loopback]


def listening(host: str, port: int) -> socket.socket:
    """Socket that listens at a host and port, 0 for any that is free; OSError says in a line why it cannot."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
    except (OSError, OverflowError) as error:
        listener.close()
        hint = "is another studio running? --port 0 takes a free one" if port else "is that address this machine's?"
        raise OSError(f"cannot listen at {host}, port {port}: {hint}") from error
    listener.listen(1024)  # a tablet that is not let into the queue tries again after a second
    return listener


def serve(
    app: Callable[[Access], ASGIApp],
    host: str,
    port: int,
    announce: Callable[[Access, str, bool], None],
    folder: Path | None = None,
) -> None:
    """Serve until Ctrl-C or SIGTERM; OSError where it cannot listen there.

    Args:
        app: gives the application, behind its access.
        announce: takes the access, the host to open, and whether a device came in by the link before: once it listens, and
            with each new link.
        folder: where the certificate is kept, for the owner alone; None for one that ends with the server.
    """
    with listening(host, port) as listener, contextlib.ExitStack() as stack:
        port = listener.getsockname()[1]
        others = addresses() if host in ("0.0.0.0", "::") else []
        # Of this machine's names the address that it listens at: another server may answer to `localhost`.
        listens_at = str(listener.getsockname()[0]) if host.lower() in LOOPBACK else host
        shown = others[0] if others else listens_at
        access = access_to(host, port, others, lambda renewed: announce(renewed, shown, True))
        files: dict[str, str] = {}
        if access.token is not None:
            folder = folder or Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="foten-")))
            certificate, key = certificate_for(private_folder(folder), access.hosts)
            files = {"ssl_certfile": str(certificate), "ssl_keyfile": str(key)}
        connections = Connections(app(access), min(MAX_WAITING, _allowed_files() // 2))
        config = uvicorn.Config(
            connections,
            http="h11",  # bounds a head; another parser that happens to be installed may not
            proxy_headers=False,  # a connection is known by its own address
            log_level="warning",
            access_log=False,
            server_header=False,
            ws=_WebSocket,
            ws_max_size=2 * MAX_BYTES,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=SHUTDOWN_S,
            **files,  # type: ignore[arg-type]
        )
        logging.getLogger("uvicorn.error").addFilter(partial(_is_rare, Counter()))  # once it was configured
        _Server(config, connections, lambda: announce(access, shown, False)).run(sockets=[listener])


def _allowed_files() -> int:
    """How many files this process may have open, after its limit was raised as far as it may be."""
    try:
        import resource
    except ImportError:  # Windows
        return MAX_FILES
    allowed, limit = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = MAX_FILES if limit == resource.RLIM_INFINITY else min(MAX_FILES, limit)
    if allowed == resource.RLIM_INFINITY or allowed >= wanted:
        return wanted if allowed == resource.RLIM_INFINITY else allowed
    with contextlib.suppress(OSError, ValueError):
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, limit))
        return wanted
    return allowed


class _Connection:
    """A connection, from when it is accepted."""

    def __init__(self, accepted: socket.socket, peer: tuple[str, int]) -> None:
        self.socket, self.peer = accepted, peer
        self.task: asyncio.Task[None] | None = None  # that makes it ready
        self.transport: asyncio.Transport | None = None  # once it is ready
        self.timer: asyncio.TimerHandle | None = None  # while it waits
        self.n_requests = 0  # that are being answered
        self.was_asked = self.lingers = False


class Connections:
    """An application with the connections that ask it.

    A connection waits while none of its requests is being answered: to be encrypted, for a whole request with its body, or
    for the next one. It may wait for so long, and so many may wait: one more takes the place of the oldest, of the address
    that has the most. An open WebSocket is a request that is being answered.
    """

    def __init__(self, app: ASGIApp, max_waiting: int) -> None:
        self._app, self._max_waiting = app, max_waiting
        self._by_peer: dict[tuple[str, int], _Connection] = {}
        self._waiting: dict[_Connection, None] = {}  # the oldest first

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        connection = self._by_peer.get(tuple(scope.get("client") or ()))
        if connection is None:
            await self._app(scope, receive, send)
            return
        if scope["type"] == "http":
            whole = await _whole(receive)
            if whole is None:
                why, headers = f"expected a body of {MAX_BYTES} bytes at most\n", {"connection": "close"}
                await PlainTextResponse(why, 413, headers)(scope, receive, send)
                return
            receive = whole
        connection.n_requests += 1
        connection.was_asked = True
        self._stop_waiting(connection)
        try:
            await self._app(scope, receive, send)
        finally:
            connection.n_requests -= 1
            if not connection.n_requests:
                self._wait(connection, NEXT_REQUEST_S)

    async def accept(
        self, listener: socket.socket, protocol: Callable[[], asyncio.Protocol], encryption: ssl.SSLContext | None
    ) -> None:
        """Accept connections for ever."""
        loop = asyncio.get_running_loop()
        listener.setblocking(False)
        while True:
            try:
                accepted, address = await loop.sock_accept(listener)
            except OSError:  # there is no file left, or who asked is gone
                self._drop_oldest()
                await asyncio.sleep(NO_FILE_S)
                continue
            for gone in [connection for connection in self._waiting if connection.socket.fileno() < 0]:
                self._forget(gone)
            if len(self._waiting) >= self._max_waiting:
                self._drop_oldest()
            connection = _Connection(accepted, address[:2])
            self._by_peer[connection.peer] = connection
            connection.task = asyncio.create_task(self._connect(connection, protocol, encryption))
            self._wait(connection, REQUEST_S)
            await asyncio.sleep(0)  # a socket that is there already is accepted without a pause

    async def _connect(
        self, connection: _Connection, protocol: Callable[[], asyncio.Protocol], encryption: ssl.SSLContext | None
    ) -> None:
        try:
            connection.transport, _ = await asyncio.get_running_loop().connect_accepted_socket(
                protocol,
                connection.socket,
                ssl=encryption,
                ssl_handshake_timeout=None if encryption is None else REQUEST_S,
            )
        except OSError:  # gone, or it speaks something else
            connection.socket.close()

    def _wait(self, connection: _Connection, for_s: float) -> None:
        self._waiting[connection] = None
        connection.timer = asyncio.get_running_loop().call_later(for_s, self._expire, connection)

    def _stop_waiting(self, connection: _Connection) -> None:
        self._waiting.pop(connection, None)
        if connection.timer is not None:
            connection.timer.cancel()

    def _forget(self, connection: _Connection) -> None:
        self._stop_waiting(connection)
        if self._by_peer.get(connection.peer) is connection:
            del self._by_peer[connection.peer]

    def _expire(self, connection: _Connection) -> None:
        if connection.transport is not None and connection.was_asked and not connection.lingers:
            connection.lingers = True
            connection.transport.close()  # once what was written has left
            self._wait(connection, LINGER_S)
        else:
            self._drop(connection)

    def _drop(self, connection: _Connection) -> None:
        self._forget(connection)
        if connection.transport is not None:
            connection.transport.abort()
        elif connection.task is not None:
            connection.task.cancel()

    def _drop_oldest(self) -> None:
        counts = Counter(connection.peer[0] for connection in self._waiting)
        max_count = max(counts.values(), default=0)
        for connection in self._waiting:
            if counts[connection.peer[0]] == max_count:
                self._drop(connection)
                return


async def _whole(receive: Receive) -> Receive | None:
    """What gives the body of a request at once; None where it breaks off, or has more than `MAX_BYTES`, which no answer needs."""
    body, goes_on = b"", True
    while goes_on:
        message = await receive()
        body, goes_on = body + message.get("body", b""), message.get("more_body", False)
        if message["type"] == "http.disconnect" or len(body) > MAX_BYTES:
            return None
    whole: asyncio.Queue[Message] = asyncio.Queue()
    whole.put_nowait({"type": "http.request", "body": body})
    return whole.get


def _is_rare(counts: Counter[object], record: logging.LogRecord) -> bool:
    """Whether a line of uvicorn's comes for the first time, or ten times as often as when it was shown last."""
    kind = str(record.msg), record.exc_info and record.exc_info[0]
    counts[kind] += 1
    if (n := counts[kind]) > 1:
        record.msg, record.exc_info = f"{kind[0].rstrip()} ({n} times)", None
    return str(n).strip("0") == "1"


class _WebSocket(WebSocketsSansIOProtocol):
    """A WebSocket that is cut where many frames come that no page counts: pings, pieces of messages, and all after its end."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        self._uncounted = Allowance(MAX_MESSAGES_PER_S)

    def handle_events(self) -> None:
        opcodes = [event.opcode for event in self.conn.events if isinstance(event, Frame)]
        if self._uncounted.take(sum(self.close_sent or code not in (Opcode.TEXT, Opcode.BINARY) for code in opcodes)):
            super().handle_events()
        else:
            self.transport.abort()


class _Server(uvicorn.Server):
    """A server whose connections are accepted here, which says when it has started."""

    def __init__(self, config: uvicorn.Config, connections: Connections, on_start: Callable[[], None]) -> None:
        super().__init__(config)
        self._connections, self._on_start = connections, on_start

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets=[])
        if not self.started:
            return
        assert sockets is not None

        kind: Callable[..., asyncio.Protocol] = self.config.http_protocol_class
        protocol = partial(kind, config=self.config, server_state=self.server_state, app_state=self.lifespan.state)
        self._accepting = asyncio.create_task(self._connections.accept(sockets[0], protocol, self.config.ssl))
        self._on_start()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._accepting.cancel()
        await asyncio.wait({self._accepting})
        for connection in list(self._connections._waiting):  # no answer is cut off
            self._connections._expire(connection)
        await super().shutdown(sockets=sockets)
