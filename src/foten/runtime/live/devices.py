"""Where a live rendering is played: nowhere, a file, the sound card, an NI-DAQ, another program over UDP or OSC."""

from __future__ import annotations

import json
import math
import socket
import struct
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import atomic_write

Samples = NDArray[np.float32]
Read = Callable[[Samples], None]

SOUND_RATE_HZ = 48_000.0
PACKET_MS = 4.0
_DAQ_BUFFERED_MS = 20.0
_SOUND_BLOCK_MS = 5.0
_LARGEST_WAV = 2**32 - 4096  # bytes


class Paced:
    """A sink that takes a block every so often, in a thread of its own; what it does with it is a subclass's.

    After a machine has stood still it goes on at its pace: what it did not take meanwhile it does not take at once, which would
    empty the ring; `n_late` counts such blocks.

    Args:
        rate_hz: at which samples are taken.
        block_ms: taken at once.
        ratio: of simulated time to real time; infinite for as fast as possible.
    """

    patient = False

    def __init__(self, rate_hz: float, block_ms: float = PACKET_MS, ratio: float = 1.0) -> None:
        if not rate_hz > 0 or not block_ms > 0 or not ratio > 0:
            raise ValueError(
                f"a rate of {rate_hz} Hz in blocks of {block_ms} ms at {ratio} times, expected positive numbers"
            )
        self.rate_hz = float(rate_hz)
        self._block = np.zeros(max(1, round(block_ms * rate_hz / 1000)), dtype=np.float32)
        self._period_s = self._block.size / rate_hz / ratio
        self.n_at_once = self._block.size
        self.n_late = 0
        self.failed: BaseException | None = None
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self, read: Read) -> None:
        """Begin to take samples."""
        self._thread = threading.Thread(target=self._run, args=(read,), name="foten-sink", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End after the block that is being taken."""
        self._stopping.set()
        if self._thread is not None and self._thread.is_alive():
            self._thread.join()

    def take(self, block: Samples) -> None:
        """Do something with a block."""

    def _run(self, read: Read) -> None:
        due = time.perf_counter()
        try:
            while not self._stopping.is_set():
                read(self._block)
                self.take(self._block)
                due += self._period_s
                wait = due - time.perf_counter()
                if wait > 0:
                    self._stopping.wait(wait)
                elif self._period_s > 0:
                    n_late = int(-wait / self._period_s)
                    due += n_late * self._period_s
                    self.n_late += n_late
        except BaseException as error:  # told by `Live.stop`, in the thread that waits for it
            self.failed = error


class NullSink(Paced):
    """Plays nowhere, at the pace of a real one: for trials and for measuring."""


class WavSink(Paced):
    """A WAV file of 32-bit floats, as they are, written as fast as they are rendered; the file is there when it stops.

    Args:
        path: of the file.
        rate_hz: a whole number of samples a second.
        about: kept in the file as a comment.
        n: samples after which it is full; None for as many as come.
    """

    patient = True

    def __init__(
        self, path: Path, rate_hz: float, about: Mapping[str, Any] | None = None, n: int | None = None
    ) -> None:
        super().__init__(rate_hz, ratio=math.inf)
        if rate_hz != round(rate_hz):
            raise ValueError(f"a WAV file has a whole number of samples a second, got {rate_hz:g} Hz")
        if not path.parent.is_dir():
            raise FileNotFoundError(f"no such folder: {path.parent}")
        self.most = min(_LARGEST_WAV // 4, _LARGEST_WAV if n is None else n)
        if n is not None and n > self.most:
            raise ValueError(
                f"{n / rate_hz:.0f} s at {rate_hz:g} Hz are more than a WAV file holds, 4 GB; play fewer"
            )
        self._about = json.dumps(
            {"unit": "m/s^2", "rate_hz": rate_hz, **(about or {})}, sort_keys=True
        ).encode()
        self._stack = ExitStack()
        self._file = self._stack.enter_context(self._stack.enter_context(atomic_write(path)).open("wb"))
        self._n = 0
        self._file.write(self._header())

    @property
    def full(self) -> bool:
        """Return whether it has all samples that it is to have."""
        return self._n == self.most

    def take(self, block: Samples) -> None:
        """Append a block."""
        some = block[: self.most - self._n]
        self._file.write(some.astype("<f4").tobytes())
        self._n += some.size
        if self.full:
            self._stopping.set()

    def stop(self) -> None:
        """End, and put the file in its place; where it died, no file is left."""
        super().stop()
        if self._file.closed:
            return
        if self.failed is not None:
            self._stack.__exit__(type(self.failed), self.failed, None)
            return
        comment = self._about + b"\0" * (1 + (len(self._about) + 1) % 2)
        info = b"INFO" + b"ICMT" + struct.pack("<I", len(comment)) + comment
        self._file.write(b"LIST" + struct.pack("<I", len(info)) + info)
        size = self._file.tell()
        self._file.seek(0)
        self._file.write(self._header(size - 8))
        self._stack.close()

    def _header(self, size: int = 0) -> bytes:
        rate = round(self.rate_hz)
        chunks = (
            b"fmt "
            + struct.pack("<IHHIIHHH", 18, 3, 1, rate, 4 * rate, 4, 32, 0)
            + b"fact"
            + struct.pack("<II", 4, self._n)
        )
        return b"RIFF" + struct.pack("<I", size) + b"WAVE" + chunks + b"data" + struct.pack("<I", 4 * self._n)


class SoundSink:
    """The sound card, or an amplifier on it that drives an actuator.

    `n_device_underruns` counts what the card itself found missing.

    Args:
        gain: full scale for one of what is rendered; what goes beyond full scale is cut, and counted in `n_cut`.
        device: its name, or its number as an int, as `python -m sounddevice` lists them; None for the usual one.
        channel: that is played on, from 0; the others are silent.
        n_channels: of the device.

    Raises:
        OSError: PortAudio or the device is missing; one line says what to do.
    """

    patient = False

    def __init__(
        self,
        gain: float,
        device: str | int | None = None,
        rate_hz: float = SOUND_RATE_HZ,
        channel: int = 0,
        n_channels: int = 1,
        latency: str | float = "low",
    ) -> None:
        if not 0 <= channel < n_channels:
            raise ValueError(f"channel {channel} of {n_channels}, expected one from 0 on below that")
        _check_gain(gain)
        self.rate_hz = float(rate_hz)
        self.n_cut = self.n_device_underruns = 0
        self.failed: BaseException | None = None
        self._stopped = False
        self._gain, self._channel = gain, channel
        self._sounddevice = sound_library()
        self._mono = np.zeros(max(1, round(_SOUND_BLOCK_MS * rate_hz / 1000)), dtype=np.float32)
        self._read: Read | None = None
        try:
            self._stream = self._sounddevice.OutputStream(
                samplerate=rate_hz,
                blocksize=self._mono.size,
                device=device,
                channels=n_channels,
                dtype="float32",
                latency=latency,
                callback=self._play,
                finished_callback=self._finished,
            )
        except (ValueError, self._sounddevice.PortAudioError) as error:
            raise OSError(f"no sound: {error}; 'python -m sounddevice' lists the devices") from error
        # A device whose own buffer is longer than a block asks for several at once, for no more than it plays later.
        self.n_at_once = max(self._mono.size, math.ceil(self.latency_s * rate_hz))

    @property
    def latency_s(self) -> float:
        """Return what the device says of its own delay [s]."""
        return float(self._stream.latency)

    def start(self, read: Read) -> None:
        """Begin to play.

        Raises:
            OSError: the device refuses.
        """
        self._read = read
        try:
            self._stream.start()
        except self._sounddevice.PortAudioError as error:
            raise OSError(f"no sound: {error}; does another program play on it?") from error

    def stop(self) -> None:
        """Stop playing, and give the device back."""
        if not self._stopped:
            self._stopped = True
            self._stream.close()

    def _finished(self) -> None:
        if not self._stopped and self.failed is None:
            self.failed = OSError("the sound card stopped by itself; was it unplugged?")

    def _play(self, out: Samples, n: int, when: Any, status: Any) -> None:
        assert self._read is not None
        self.n_device_underruns += bool(status.output_underflow)
        try:
            self._read(self._mono)
        except BaseException as error:  # told by `Live.stop`, in the thread that waits for it
            self.failed = error
            raise
        self._mono *= self._gain
        self.n_cut += int((np.abs(self._mono) > 1).sum())
        out[:] = 0.0
        np.clip(self._mono, -1.0, 1.0, out=out[:, self._channel])


def _check_gain(gain: float) -> None:
    if not math.isfinite(gain):
        raise ValueError(f"the gain is {gain}, expected a finite number")


def sound_library() -> Any:
    """Return the package sounddevice.

    Raises:
        OSError: it or PortAudio is missing; one line says what to do.
    """
    try:
        import sounddevice
    except ImportError as error:
        raise OSError("playing sound needs the package sounddevice: pip install 'foten[audio]'") from error
    except OSError as error:
        raise OSError(
            "playing sound needs PortAudio, which is not here: 'apt install libportaudio2' on Debian and Ubuntu, "
            "'brew install portaudio' on a Mac; with Windows it comes along"
        ) from error
    return sounddevice


class DaqSink:
    """An analogue output of an NI-DAQ, clocked by its hardware from a buffer that is refilled as it empties.

    Args:
        channel: as "Dev1/ao0".
        gain: volts for one of what is rendered; 1 where an actuator's drive in V is.
        limit_v: range of the output; what goes beyond is cut, and counted in `n_cut`.
        library: `nidaqmx`, or what stands for it in a test.

    Raises:
        OSError: the package, its driver or the device is missing.
    """

    patient = False

    def __init__(
        self, channel: str, rate_hz: float, gain: float = 1.0, limit_v: float = 10.0, library: Any = None
    ) -> None:
        _check_gain(gain)
        if not 0 < limit_v < math.inf:
            raise ValueError(f"the output's range is ±{limit_v} V, expected a positive number")
        self.rate_hz = float(rate_hz)
        self.n_cut = 0
        self.failed: BaseException | None = None
        self._channel, self._stopped = channel, False
        self._fading = threading.Event()
        self._silent = threading.Event()
        self._gain, self._limit = gain, limit_v
        n = max(2, round(_DAQ_BUFFERED_MS * rate_hz / 2000))  # half of the buffer
        self._block = np.zeros(n, dtype=np.float32)
        self.n_at_once = 2 * n  # as it starts, and never more later
        self._library = library or _nidaqmx()
        errors = self._library.errors
        try:
            self._task = self._library.Task("foten")
        except errors.Error as error:
            raise OSError(f"no NI-DAQ: {_first_line(error)}") from error
        try:
            constants = self._library.constants
            self._task.ao_channels.add_ao_voltage_chan(channel, min_val=-limit_v, max_val=limit_v)
            self._task.timing.cfg_samp_clk_timing(
                rate=rate_hz, sample_mode=constants.AcquisitionType.CONTINUOUS, samps_per_chan=2 * n
            )
            self._task.out_stream.output_buf_size = 2 * n
            # Else the board takes from the buffer what its own memory holds, and plays that much later. Not all know how.
            with suppress(errors.Error):
                self._task.ao_channels.all.ao_data_xfer_req_cond = (
                    constants.OutputDataTransferCondition.ON_BOARD_MEMORY_EMPTY
                )
            # Without this a late block would be the last one once more.
            self._task.out_stream.regen_mode = constants.RegenerationMode.DONT_ALLOW_REGENERATION
            self._writer = self._library.stream_writers.AnalogSingleChannelWriter(
                self._task.out_stream, auto_start=False
            )
        except errors.Error as error:
            self._task.close()
            raise OSError(f"the NI-DAQ refuses {channel}: {_first_line(error)}") from error

    def start(self, read: Read) -> None:
        """Fill the buffer and start the clock.

        Raises:
            BaseException: what filling it died of; OSError where the device refuses.
        """

        def refill(*_: Any) -> int:
            try:
                read(self._block)
                volts = self._block.astype(np.float64) * self._gain
                self.n_cut += int((np.abs(volts) > self._limit).sum())
                volts = np.clip(volts, -self._limit, self._limit)
                if self._silent.is_set():
                    volts[:] = 0.0
                elif self._fading.is_set():
                    volts *= np.linspace(1.0, 0.0, volts.size)
                    self._silent.set()
                self._writer.write_many_sample(volts)
            except self._library.errors.Error as error:
                self.failed = OSError(f"the NI-DAQ takes no samples: {_first_line(error)}")
            except BaseException as error:  # told by `Live.stop`, in the thread that waits for it
                self.failed = error
            return 0

        try:
            for _ in range(2):
                refill()
                if self.failed is not None:
                    raise self.failed
            self._task.register_every_n_samples_transferred_from_buffer_event(self._block.size, refill)
            self._task.start()
        except self._library.errors.Error as error:
            raise OSError(f"the NI-DAQ does not start: {_first_line(error)}") from error

    def stop(self) -> None:
        """Fade out, stop the clock, set the output to 0 V, and give the device back.

        An output keeps the last voltage that it was told, which would heat a coil.
        """
        if self._stopped:
            return
        self._stopped = True
        errors = self._library.errors
        if self.failed is None:
            self._fading.set()
            if self._silent.wait(1.0):
                time.sleep(2 * self._block.size / self.rate_hz)  # until the fade has left the buffer
        for end in (self._task.stop, self._task.close):
            try:
                end()
            except errors.Error as error:
                self.failed = self.failed or OSError(f"the NI-DAQ ended badly: {_first_line(error)}")
        try:
            with self._library.Task("foten-still") as still:
                still.ao_channels.add_ao_voltage_chan(
                    self._channel, min_val=-self._limit, max_val=self._limit
                )
                still.write(0.0)
        except errors.Error as error:  # worse than whatever it died of before
            self.failed = OSError(
                f"the NI-DAQ may not be at 0 V, switch the amplifier off: {_first_line(error)}"
            )


def _first_line(error: Exception) -> str:
    return str(error).partition("\n")[0]


def _nidaqmx() -> Any:
    try:
        import nidaqmx
        import nidaqmx.constants
        import nidaqmx.errors
        import nidaqmx.stream_writers
    except ImportError as error:
        raise OSError(
            "an NI-DAQ needs the package nidaqmx and National Instruments' driver: pip install 'foten[daq]'"
        ) from error
    return nidaqmx


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

    def __init__(
        self, host: str, port: int, rate_hz: float, address: str = "/foten", ratio: float = 1.0
    ) -> None:
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
