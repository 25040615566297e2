"""Where samples are played as time passes: a sound card, through PortAudio, an NI-DAQ, silence, and other programs."""

import math
import socket
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from foten.runtime.live.live import Read, Samples

SOUND_RATE_HZ = 48_000.0
_SOUND_BLOCK_MS = 5.0
_DAQ_BUFFERED_MS = 20.0
_DAQ_LIMIT_V = 10.0
PACKET_MS = 4.0


@dataclass(frozen=True)
class SoundDevice:
    """An output of a sound card, as PortAudio knows it."""

    number: int  # that `--device` takes
    name: str
    host: str  # the system's interface that it is played through: ALSA, Core Audio, Windows WASAPI, …
    channels: int
    default: bool  # of this machine
    latency_ms: float  # the shortest that it states
    rate_hz: float  # its usual one


def sound_devices() -> list[SoundDevice]:
    """Outputs of this machine's sound cards; OSError where sounddevice or PortAudio is missing."""
    library = sound_library()
    hosts, usual = library.query_hostapis(), _output_of(library, None)
    usual = library.default.device[1] if usual is None else usual
    devices = []
    for number, device in enumerate(library.query_devices()):
        if (channels := device["max_output_channels"]) > 0:
            host, latency_ms = hosts[device["hostapi"]]["name"], 1000 * device["default_low_output_latency"]
            rate_hz, default = device["default_samplerate"], number == usual
            devices.append(SoundDevice(number, device["name"], host, channels, default, latency_ms, rate_hz))
    return devices


def _output_of(library: Any, device: str | int | None) -> str | int | None:
    """Output to open: where Windows has WASAPI through that, whose buffer is short; elsewhere as PortAudio chooses."""
    wasapi = next((host for host in library.query_hostapis() if "WASAPI" in host["name"]), None)
    if wasapi is None or isinstance(device, int):
        return device
    if device is None:
        usual: int = wasapi["default_output_device"]
        return usual if usual >= 0 else None
    outputs = ((int(number), library.query_devices(number)) for number in wasapi["devices"])
    of_name = (n for n, of in outputs if of["max_output_channels"] > 0 and device.lower() in of["name"].lower())
    return next(of_name, device)


class SoundSink:
    """Sound card, or an amplifier on it that drives an actuator; OSError where PortAudio or the device is missing.

    Args:
        gain: full scale for 1 of what is rendered; what goes beyond full scale is cut, and counted in `n_cut`.
        device: its name, or its number as an int, as `sound_devices` lists them; None for the usual one.
        channel: that is played on, from 1; those before it are silent.
    """

    def __init__(
        self, gain: float, device: str | int | None = None, rate_hz: float = SOUND_RATE_HZ, channel: int = 1
    ) -> None:
        _check_gain(gain)
        self.rate_hz = float(rate_hz)
        self.n_cut = self.n_device_underruns = 0
        self.failed: BaseException | None = None
        self._stopped, self._gain, self._channel = False, gain, channel
        self._sounddevice = sound_library()
        self._mono = np.zeros(max(1, round(_SOUND_BLOCK_MS * rate_hz / 1000)), dtype=np.float32)
        self._read: Read
        try:
            self._stream = self._sounddevice.OutputStream(
                samplerate=rate_hz,
                blocksize=self._mono.size,
                device=_output_of(self._sounddevice, device),
                channels=channel,
                dtype="float32",
                latency="low",
                callback=self._play,
                finished_callback=self._finished,
            )
        except (ValueError, self._sounddevice.PortAudioError) as error:
            raise OSError(f"no sound: {error}; 'foten devices' lists what there is") from error
        # A device whose own buffer is longer than a block asks for several at once, for no more than it plays later.
        self.n_at_once = max(self._mono.size, math.ceil(self.latency_s * rate_hz))

    @property
    def latency_s(self) -> float:
        """Delay that the device states [s]."""
        return float(self._stream.latency)

    def start(self, read: Read) -> None:
        """Begin to play, or raise OSError where the device refuses."""
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
        self.n_device_underruns += bool(status.output_underflow)
        try:
            self._read(self._mono)
        except BaseException as error:  # raised by `Live.stop`, in the thread that waits for it
            self.failed = error
            raise
        self._mono *= self._gain
        self.n_cut += int((np.abs(self._mono) > 1).sum())
        out[:] = 0.0
        np.clip(self._mono, -1.0, 1.0, out=out[:, self._channel - 1])


def sound_library() -> Any:
    """Package sounddevice; OSError says what to install where it or PortAudio is missing."""
    try:
        import sounddevice
    except ImportError as error:
        raise OSError("playing sound needs the package sounddevice: pip install './packages/foten[audio]'") from error
    except OSError as error:
        how = "'apt install libportaudio2' on Debian and Ubuntu, 'brew install portaudio' on a Mac"
        missing = "playing sound needs PortAudio, which is not here"
        raise OSError(f"{missing}: {how}; with Windows it comes along") from error
    return sounddevice


def daq_channels() -> list[str]:
    """Analogue outputs of the NI-DAQs that are connected, as `DaqSink` takes them; none without their package or driver."""
    with suppress(OSError):
        library = _nidaqmx()
        with suppress(library.errors.Error):
            devices = library.system.System.local().devices
            return [channel.name for device in devices for channel in device.ao_physical_chans]
    return []


class DaqSink:
    """Analogue output of an NI-DAQ, such as "Dev1/ao0", clocked by its hardware; OSError where it or its driver is missing.

    Args:
        gain: volts for one of what is rendered; what goes beyond ±10 V is cut, and counted in `n_cut`.
        library: `nidaqmx`, or what stands for it in a test.
    """

    def __init__(self, channel: str, rate_hz: float, gain: float = 1.0, library: Any = None) -> None:
        _check_gain(gain)
        self.rate_hz = float(rate_hz)
        self.n_cut = 0
        self.failed: BaseException | None = None
        self._channel, self._gain = channel, gain
        self._read: Read
        self._stopped, self._fading, self._silent = False, threading.Event(), threading.Event()
        n = max(2, round(_DAQ_BUFFERED_MS * rate_hz / 2000))  # half of the buffer
        self._block = np.zeros(n, dtype=np.float32)
        self.n_at_once = 2 * n  # as it starts, and never more later
        self._library = library or _nidaqmx()
        with self._in_one_line("no NI-DAQ"):
            self._task = self._library.Task("foten")
        try:
            with self._in_one_line(f"the NI-DAQ refuses {channel}"):
                self._set_up()
        except OSError:
            self._task.close()
            raise

    def _set_up(self) -> None:
        task, constants = self._task, self._library.constants
        task.ao_channels.add_ao_voltage_chan(self._channel, min_val=-_DAQ_LIMIT_V, max_val=_DAQ_LIMIT_V)
        continuous = constants.AcquisitionType.CONTINUOUS
        task.timing.cfg_samp_clk_timing(rate=self.rate_hz, sample_mode=continuous, samps_per_chan=self.n_at_once)
        task.out_stream.output_buf_size = self.n_at_once
        # Else the board plays later by what its own memory holds. Not all know this setting.
        with suppress(self._library.errors.Error):
            task.ao_channels.all.ao_data_xfer_req_cond = constants.OutputDataTransferCondition.ON_BOARD_MEMORY_EMPTY
        # Else a late block repeats the last one.
        task.out_stream.regen_mode = constants.RegenerationMode.DONT_ALLOW_REGENERATION
        self._writer = self._library.stream_writers.AnalogSingleChannelWriter(task.out_stream, auto_start=False)

    def start(self, read: Read) -> None:
        """Fill the buffer and start the clock; raises what rendering raised, or OSError where the device refuses."""
        self._read = read
        for _ in range(2):
            self._refill()
            if self.failed is not None:
                raise self.failed
        with self._in_one_line("the NI-DAQ does not start"):
            self._task.register_every_n_samples_transferred_from_buffer_event(self._block.size, self._refill)
            self._task.start()

    def _refill(self, *_: Any) -> int:
        try:
            self._read(self._block)
            volts = self._block.astype(np.float64) * self._gain
            self.n_cut += int((np.abs(volts) > _DAQ_LIMIT_V).sum())
            volts = np.clip(volts, -_DAQ_LIMIT_V, _DAQ_LIMIT_V)
            if self._silent.is_set():
                volts[:] = 0.0
            elif self._fading.is_set():
                volts *= np.linspace(1.0, 0.0, volts.size)
                self._silent.set()
            with self._in_one_line("the NI-DAQ takes no samples"):
                self._writer.write_many_sample(volts)
        except BaseException as error:  # raised by `Live.stop`, in the thread that waits for it
            self.failed = error
        return 0

    def stop(self) -> None:
        """Fade out, stop the clock, set the output to 0 V and close the device: its last voltage would heat a coil."""
        if self._stopped:
            return
        self._stopped = True
        if self.failed is None:
            self._fading.set()
            if self._silent.wait(1.0):
                time.sleep(self.n_at_once / self.rate_hz)  # until the fade has left the buffer
        for end in (self._task.stop, self._task.close):
            try:
                with self._in_one_line("the NI-DAQ ended badly"):
                    end()
            except OSError as error:
                self.failed = self.failed or error
        try:
            with (
                self._in_one_line("the NI-DAQ may not be at 0 V, switch the amplifier off"),
                self._library.Task("foten-still") as still,
            ):
                still.ao_channels.add_ao_voltage_chan(self._channel, min_val=-_DAQ_LIMIT_V, max_val=_DAQ_LIMIT_V)
                still.write(0.0)
        except OSError as error:  # worse than whatever it died of before
            self.failed = error

    @contextmanager
    def _in_one_line(self, what: str) -> Iterator[None]:
        """Raise the library's error, which has many lines, as an OSError of one."""
        try:
            yield
        except self._library.errors.Error as error:
            first_line = str(error).partition("\n")[0]
            raise OSError(f"{what}: {first_line}") from error


def _nidaqmx() -> Any:
    try:
        import nidaqmx.constants
        import nidaqmx.errors
        import nidaqmx.stream_writers
        import nidaqmx.system
    except ImportError as error:
        missing = "an NI-DAQ needs the package nidaqmx and National Instruments' driver"
        raise OSError(f"{missing}: pip install './packages/foten[daq]'") from error
    return nidaqmx


def _check_gain(gain: float) -> None:
    if not math.isfinite(gain):
        raise ValueError(f"the gain is {gain}, expected a finite number")


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
