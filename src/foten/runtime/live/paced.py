"""Sinks that take samples as time passes: silence, and packets to another program, UDP and OSC."""

from __future__ import annotations

import socket
import struct
import threading
import time

import numpy as np

from foten.runtime.live.live import Read, Samples

PACKET_MS = 4.0


class NullSink:
    """Sink that plays nowhere: it takes a block every `PACKET_MS` in a thread of its own, for which subclasses have `take`.

    Blocks that a stalled machine missed are left out, as taking them at once would empty the ring; `n_late` counts them.
    """

    def __init__(self, rate_hz: float) -> None:
        self.rate_hz = float(rate_hz)
        self.n_at_once = max(1, round(PACKET_MS * rate_hz / 1000))
        self.n_late = 0
        self.failed: BaseException | None = None
        self._period_s = self.n_at_once / rate_hz
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, read: Read) -> None:
        """Begin to take samples."""
        self._thread = threading.Thread(target=self._run, args=(read,), name="foten-sink", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End after the block that is being taken."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()

    def take(self, block: Samples) -> None:
        """Do something with a block."""

    def _run(self, read: Read) -> None:
        block = np.zeros(self.n_at_once, dtype=np.float32)
        due = time.perf_counter()
        try:
            while not self._stopping.is_set():
                read(block)
                self.take(block)
                due += self._period_s
                wait = due - time.perf_counter()
                self._stopping.wait(max(0.0, wait))
                n_late = int(max(0.0, -wait) / self._period_s)
                due += n_late * self._period_s
                self.n_late += n_late
        except BaseException as error:  # raised by `Live.stop`, in the thread that waits for it
            self.failed = error


class UdpSink(NullSink):
    """Packets to another program, little-endian: b"FOT1", packets before, rate [Hz, float32], number of samples, samples."""

    def __init__(self, host: str, port: int, rate_hz: float) -> None:
        super().__init__(rate_hz)
        try:
            self._to = socket.getaddrinfo(host, port, socket.AF_INET, socket.SOCK_DGRAM)[0][4]
        except socket.gaierror as error:
            raise OSError(f"no host {host!r} is known ({error.strerror})") from error
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._n = 0

    def take(self, block: Samples) -> None:
        """Send a block."""
        samples = block.astype("<f4").tobytes()
        self._socket.sendto(self._head(len(samples)) + samples, self._to)
        self._n += 1

    def stop(self) -> None:
        """End, and close the socket."""
        super().stop()
        self._socket.close()

    def _head(self, n_bytes: int) -> bytes:
        return struct.pack("<4sIfI", b"FOT1", self._n & 0xFFFFFFFF, self.rate_hz, n_bytes // 4)


class OscSink(UdpSink):
    """OSC messages to "/foten": messages before, rate [Hz] and a blob of little-endian float32.

    Source: Open Sound Control 1.0; types `ifb`, big-endian, padded to four bytes.
    """

    def _head(self, n_bytes: int) -> bytes:
        return b"/foten\0\0,ifb\0\0\0\0" + struct.pack(">ifI", self._n & 0x7FFFFFFF, self.rate_hz, n_bytes)
