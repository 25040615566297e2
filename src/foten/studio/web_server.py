"""A server as a process: it listens, says where, and ends cleanly."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
import tempfile
from collections.abc import Callable
from pathlib import Path

import uvicorn
from starlette.types import ASGIApp

from foten.studio.access import LOOPBACK, Access, access_to, certificate_for
from foten.studio.messages import MAX_BYTES

SHUTDOWN_S = 3


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
    """Socket that listens at a host and port, 0 for any that is free.

    Raises:
        OSError: the host is not this machine's, or the port is taken; one line says which.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((host, port))
    except (OSError, OverflowError) as error:
        listener.close()
        hint = (
            "is another studio running? --port 0 takes any that is free" if port else "is that address this machine's?"
        )
        raise OSError(f"cannot listen at {host}, port {port}: {hint}") from error
    listener.listen(128)
    return listener


def serve(
    app: Callable[[Access], ASGIApp],
    host: str,
    port: int,
    announce: Callable[[Access, str, bool], None],
    folder: Path | None = None,
) -> None:
    """Serve until Ctrl-C or SIGTERM.

    Args:
        app: gives the application, behind its access.
        announce: takes the access, the host to open, and whether a device came in by the link before: once it listens, and
            with each new link.
        folder: where the certificate is kept, for the owner alone; None for one that ends with the server.

    Raises:
        OSError: it cannot listen there.
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
            folder.mkdir(mode=0o700, exist_ok=True)
            certificate, key = certificate_for(folder, access.hosts)
            files = {"ssl_certfile": str(certificate), "ssl_keyfile": str(key)}
        config = uvicorn.Config(
            app(access),
            log_level="warning",
            access_log=False,
            server_header=False,
            ws="websockets-sansio",
            ws_max_size=2 * MAX_BYTES,
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=SHUTDOWN_S,
            **files,  # type: ignore[arg-type]
        )
        _Server(config, lambda: announce(access, shown, False)).run(sockets=[listener])


class _Server(uvicorn.Server):
    """A server that says when it has started."""

    def __init__(self, config: uvicorn.Config, on_start: Callable[[], None]) -> None:
        super().__init__(config)
        self._on_start = on_start

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets=sockets)
        if self.started:
            self._on_start()
