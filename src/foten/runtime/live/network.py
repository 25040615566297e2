"""Packets of samples to another program: UDP and OSC."""

from __future__ import annotations

import socket
import struct

from foten.runtime.live.paced import Paced, Samples


class UdpSink(Paced):
    """Packets to another program, all little-endian: b"FOT1", the count of packets before, the rate
    [Hz, float32], the samples in it; then they.
    """

    def __init__(self, host: str, port: int, rate_hz: float, ratio: float = 1.0) -> None:
        super().__init__(rate_hz, ratio=ratio)
        self._to = _address(host, port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._n = 0

    def take(self, block: Samples) -> None:
        """Send a block."""
        head = struct.pack("<4sIfI", b"FOT1", self._n & 0xFFFFFFFF, self.rate_hz, block.size)
        self._socket.sendto(head + block.astype("<f4").tobytes(), self._to)
        self._n += 1

    def stop(self) -> None:
        """End, and close the socket."""
        super().stop()
        self._socket.close()


class OscSink(Paced):
    """OSC messages: `address` with the count of messages, the rate [Hz] and a blob of little-endian float32.

    Source: Open Sound Control 1.0; types `ifb`, big-endian, padded to four bytes.
    """

    def __init__(self, host: str, port: int, rate_hz: float, address: str = "/foten", ratio: float = 1.0) -> None:
        super().__init__(rate_hz, ratio=ratio)
        if not address.startswith("/") or not address.isascii():
            raise ValueError(f"the OSC address is {address!r}, expected one that begins with /")
        self._to = _address(host, port)
        self._head = _osc_text(address) + _osc_text(",ifb")
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._n = 0

    def take(self, block: Samples) -> None:
        """Send a block."""
        blob = block.astype("<f4").tobytes()
        self._socket.sendto(
            self._head + struct.pack(">ifI", self._n & 0x7FFFFFFF, self.rate_hz, len(blob)) + blob, self._to
        )
        self._n += 1

    def stop(self) -> None:
        """End, and close the socket."""
        super().stop()
        self._socket.close()


def _address(host: str, port: int) -> tuple[str, int]:
    try:
        address = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
    except socket.gaierror as error:
        raise OSError(f"no host {host!r} is known ({error.strerror})") from error
    return str(address[0]), int(address[1])


def _osc_text(text: str) -> bytes:
    data = text.encode() + b"\0"
    return data + b"\0" * (-len(data) % 4)
