"""A texture in real time: the ring, the thread that fills it, what is counted, and the sinks; devices are fakes."""

from __future__ import annotations

import json
import re
import socket
import struct
import subprocess
import sys
import threading
import time
import warnings
import wave
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import wavfile
from scipy.signal import butter, lfilter

from conftest import check_figures
from foten.cli.command_line import _status
from foten.models.texture_file import Texture
from foten.runtime.actuator import ActuatorProfile
from foten.runtime.live import devices
from foten.runtime.live.devices import DaqSink, NullSink, OscSink, SoundSink, UdpSink
from foten.runtime.live.live import Live, LiveStatistics, Ring, Timing
from foten.runtime.live.play import along, circling, gain_for, holding, rate_for, rendering, sink_of, write_wav
from foten.runtime.live.sinks import AUDIBLE_PEAK, picture, write_audible, write_rendered
from foten.runtime.renderer import Renderer
from foten.runtime.stroke import Stroke


@given(size=st.integers(1, 20), n_fade=st.integers(1, 9), steps=st.lists(st.tuples(st.booleans(), st.integers(0, 25))))
@settings(max_examples=100, deadline=None)
def test_a_ring_gives_back_what_went_in_and_then_fades(size: int, n_fade: int, steps: list[tuple[bool, int]]) -> None:
    """Oracle: a list, and sample by sample a gain that rises where there is one, and falls from the last where there is none."""
    ring, waiting, n, step, last = Ring(size, n_fade), [], 0, n_fade, 0.0
    for write, k in steps:
        if write:
            samples = np.arange(n, n + k, dtype=np.float32)
            taken = ring.write(samples)
            assert taken == min(k, size - len(waiting))
            waiting += list(samples[:taken])
            n += k
        else:
            out = np.full(k, -1, dtype=np.float32)
            had = ring.read_into(out)
            assert had == min(k, len(waiting))
            expected = []
            for i in range(k):
                last = waiting[i] if i < had else last
                step = min(step + 1, n_fade) if i < had else max(step - 1, 0)
                expected.append(last * (0.5 - 0.5 * np.cos(np.pi * step / n_fade)))
            np.testing.assert_allclose(out, expected, rtol=1e-6, atol=1e-6)  # float32
            waiting = waiting[had:]
        assert ring.level == len(waiting)


def test_a_ring_between_two_threads_loses_nothing() -> None:
    ring, n, got = Ring(97, 1), 200_000, []

    def write() -> None:
        at = 0
        while at < n:
            taken = ring.write(np.arange(at, min(n, at + 31), dtype=np.float32))
            at += taken
            if not taken:
                time.sleep(0)  # else each of the two waits for the other's turn to end

    writer = threading.Thread(target=write)
    writer.start()
    out, total = np.empty(53, dtype=np.float32), 0
    while total < n:
        had = ring.read_into(out)
        got.append(out[:had].copy())
        total += had
        if not had:
            time.sleep(0)
    writer.join()
    np.testing.assert_array_equal(np.concatenate(got), np.arange(n, dtype=np.float32))


def test_percentiles_are_those_of_what_was_counted() -> None:
    """Oracle: NumPy's, within the 2.3 % of a bin."""
    times = np.random.default_rng(0).lognormal(np.log(3e-5), 0.7, 20_000)
    timing = Timing()
    for value in times:
        timing.add(float(value))
    for percent in (50, 99, 99.9):
        assert timing.percentile_s(percent) == pytest.approx(np.percentile(times, percent), rel=0.03)
    assert timing.percentile_s(100) == timing.largest_s == times.max()
    assert np.isnan(Timing().percentile_s(50))


def test_after_a_machine_stood_still_no_sink_makes_up_for_it() -> None:
    """It took all that it had missed at once, and the ring ran empty."""
    took: list[float] = []

    class Stalled(NullSink):
        def take(self, block: np.ndarray) -> None:
            took.append(time.perf_counter())
            if len(took) == 10:
                time.sleep(0.4)

    sink = Stalled(1000.0)
    sink.start(lambda out: None)
    while len(took) < 20:
        time.sleep(0.001)
    sink.stop()
    assert took[19] - took[10] > 7 * 0.004
    assert sink.n_late >= 90  # of 4 ms each


class Pulled:
    """A sink that a test pulls by hand."""

    rate_hz, n_at_once = 1000.0, 1
    failed: BaseException | None = None

    def start(self, read: Any) -> None:
        self.read = read

    def stop(self) -> None:
        pass


def wait_until(holds: Callable[[], bool]) -> None:
    """Wait until something holds, ten seconds at most."""
    end = time.monotonic() + 10
    while not holds() and time.monotonic() < end:
        time.sleep(0.001)


def test_what_is_played_is_what_is_rendered_in_order(texture: Texture) -> None:
    renderer, reference = Renderer(texture, seed=2), Renderer(texture, seed=2)
    renderer.native_state.set_condition(90.0, 1.0)
    sink, out = Pulled(), np.empty(7, dtype=np.float32)
    live = Live(renderer.native_state.render, sink, block_ms=4, lead_ms=20)
    live.start()
    played = []
    for _ in range(60):
        wait_until(lambda: live._ring.level >= 7)
        sink.read(out)
        played.append(out.copy())
    live.stop()
    np.testing.assert_array_equal(np.concatenate(played), reference.render(90.0, 1.0, 420))
    assert live.statistics.n_underruns == 0
    assert live.statistics.n_samples >= 420


def test_it_renders_ahead_by_the_lead_and_no_more(texture: Texture) -> None:
    live = Live(Renderer(texture).native_state.render, Pulled(), block_ms=5, lead_ms=20)
    live.start()
    time.sleep(0.1)
    assert live._ring.level == 20
    live.stop()
    assert live.statistics.n_samples == 20


def test_what_is_lacking_fades_to_silence_and_is_counted() -> None:
    release = threading.Event()

    def render(out: np.ndarray) -> None:
        out[:] = 1.0
        if live.statistics.n_samples >= 10:
            release.wait(5)

    sink = Pulled()
    live = Live(render, sink, block_ms=5, lead_ms=10)
    live.start()
    out = np.empty(15, dtype=np.float32)
    sink.read(out)
    release.set()
    live.stop()
    falling = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, 6) / 5)  # 5 ms
    np.testing.assert_allclose(out, [*[1.0] * 10, *falling], atol=1e-7)
    assert (live.statistics.n_underruns, live.statistics.n_lacking) == (1, 5)
    assert live.statistics.n_samples >= 10


def test_what_the_sink_dies_of_is_raised() -> None:
    class Dying(NullSink):
        def take(self, block: np.ndarray) -> None:
            raise OSError("unplugged")

    live = Live(lambda out: None, Dying(1000.0))
    live.start()
    wait_until(lambda: not live.running)
    with pytest.raises(OSError, match="unplugged"):
        live.stop()


def test_a_sink_that_refuses_leaves_nothing_behind() -> None:
    class Refusing(Pulled):
        def start(self, read: Any) -> None:
            raise OSError("busy")

    usual = sys.getswitchinterval()
    live = Live(lambda out: None, Refusing())
    with pytest.raises(OSError, match="busy"):
        live.start()
    assert not live._thread.is_alive()
    assert sys.getswitchinterval() == usual
    with Live(lambda out: None, Pulled()):  # while one plays turns are short
        assert sys.getswitchinterval() < 0.2 * usual
    assert sys.getswitchinterval() == usual


def test_a_program_that_ends_without_stopping_ends_well(texture: Texture, tmp_path: Path) -> None:
    """What the thread renders from was freed under it as the interpreter ended."""
    path = tmp_path / "t.foten"
    path.write_bytes(texture.to_bytes())
    program = (
        "import sys, foten\nfrom foten.runtime.live.devices import NullSink\n"
        "r = foten.Renderer(sys.argv[1], rate=48000)\nr.native_state.set_condition(80, 0.8)\n"
        "live = foten.Live(r.native_state.render, NullSink(48000))\nlive.start()\n"
    )
    for _ in range(3):
        done = subprocess.run([sys.executable, "-c", program, str(path)], check=False, capture_output=True)
        assert (done.returncode, done.stderr) == (0, b"")


def test_a_late_block_is_counted() -> None:
    def render(out: np.ndarray) -> None:
        time.sleep(0.03)

    live = Live(render, Pulled(), block_ms=10, lead_ms=20)
    live.start()
    live.stop()
    assert live.statistics.n_missed >= 2
    assert "late" in live.statistics.line()
    assert LiveStatistics().line()


@pytest.mark.parametrize(("block", "lead"), [(0, 10), (20, 10), (2, 2000)])
def test_leads_that_cannot_be_are_refused(block: float, lead: float) -> None:
    with pytest.raises(ValueError, match="expected 0 < block"):
        Live(lambda out: None, Pulled(), block, lead)


def test_a_wav_is_what_was_played_up_to_ctrl_c(texture: Texture, tmp_path: Path) -> None:
    """Oracle: SciPy's reader."""
    from scipy.io import wavfile

    path, expected = tmp_path / "out.wav", Renderer(texture, rate=8000, seed=1).render(90.0, 1.0, 16_000)

    def interrupted(at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if at[0] >= 2000:
            raise KeyboardInterrupt
        return holding(90.0, 1.0)(at)

    for conditions, seconds in ((holding(90.0, 1.0), 2.0), (interrupted, 5.0)):
        samples, ended = write_wav(Renderer(texture, 8000, seed=1), conditions, seconds, path, {"texture": "t"})
        assert ended == (conditions is interrupted)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the comment's chunk, which SciPy does not know
            rate, written = wavfile.read(path)
        assert (rate, written.dtype) == (8000, np.float32)
        np.testing.assert_array_equal(written, samples)
        np.testing.assert_array_equal(written, expected)
    assert b'"texture": "t"' in path.read_bytes()
    with pytest.raises(ValueError, match="4 GB"):
        write_wav(Renderer(texture, 48_000), interrupted, 86_400.0, tmp_path / "x.wav", {})


def received(kind: type[UdpSink | OscSink], n: int) -> list[bytes]:
    """The first n packets of a sink at 1 kHz, each of whose blocks counts from 0."""

    def read(out: np.ndarray) -> None:
        out[:] = np.arange(out.size)

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listening:
        listening.bind(("127.0.0.1", 0))
        listening.settimeout(10)
        sink = kind("127.0.0.1", listening.getsockname()[1], 1000.0)
        sink.start(read)
        packets = [listening.recv(65_536) for _ in range(n)]
        sink.stop()
    return packets


def test_packets_and_messages_hold_the_samples() -> None:
    """OSC oracle: the specification's layout, taken apart by hand."""
    for count, packet in enumerate(received(UdpSink, 3)):
        assert struct.unpack("<4sIfI", packet[:16]) == (b"FOT1", count, 1000.0, 4)
        np.testing.assert_array_equal(np.frombuffer(packet[16:], "<f4"), np.arange(4))
    (message,) = received(OscSink, 1)
    assert len(message) % 4 == 0
    assert message[:8] == b"/foten\0\0"
    assert message[8:16] == b",ifb\0\0\0\0"
    assert struct.unpack(">ifI", message[16:28]) == (0, 1000.0, 16)
    np.testing.assert_array_equal(np.frombuffer(message[28:], "<f4"), np.arange(4))


class FakeSound:
    """What of sounddevice's interface the sink uses, with a device that plays 20 ms later; no PortAudio, no card."""

    class PortAudioError(Exception):
        pass

    latency = 0.02
    default = SimpleNamespace(device=(0, 1))
    hosts: tuple[dict[str, Any], ...] = ({"name": "ALSA", "devices": [0, 1], "default_output_device": 1},)
    cards: tuple[tuple[str, int, int], ...] = (("Microphone", 0, 0), ("Speakers", 2, 0))  # name, outputs, host

    def query_hostapis(self) -> tuple[dict[str, Any], ...]:
        return self.hosts

    def query_devices(self, number: int | None = None) -> Any:
        latency = {"default_low_output_latency": 0.01, "default_samplerate": 48_000.0}
        listed = [{"name": name, "max_output_channels": n, "hostapi": host, **latency} for name, n, host in self.cards]
        return listed if number is None else listed[number]

    def OutputStream(self, **asked: Any) -> FakeSound:  # noqa: N802, sounddevice calls it so
        self.asked = asked
        return self

    def start(self) -> None:
        pass

    def close(self) -> None:
        pass

    def call(self) -> np.ndarray:
        """What the card plays next, shape (n, n_channels)."""
        out = np.full((self.asked["blocksize"], self.asked["channels"]), np.nan, dtype=np.float32)
        self.asked["callback"](out, len(out), None, SimpleNamespace(output_underflow=False))
        return out


@pytest.fixture
def sound(monkeypatch: pytest.MonkeyPatch) -> FakeSound:
    fake = FakeSound()
    monkeypatch.setattr(devices, "sound_library", lambda: fake)
    return fake


def test_a_card_that_fills_its_buffer_at_once_finds_all_of_it(sound: FakeSound) -> None:
    live = Live(lambda out: out.fill(0.5), SoundSink(0.5, rate_hz=48_000.0, channel=2))
    live.start()
    played = [sound.call() for _ in range(4)]  # 20 ms in blocks of 5
    live.stop()
    assert live.statistics.n_underruns == 0
    np.testing.assert_array_equal(np.concatenate(played), np.tile([0.0, 0.25], (960, 1)))


def test_what_is_beyond_full_scale_is_cut_and_counted(sound: FakeSound) -> None:
    sink = SoundSink(2.0, rate_hz=48_000.0)
    sink.start(lambda out: out.fill(0.7))
    np.testing.assert_array_equal(sound.call(), np.ones((240, 1)))
    assert sink.n_cut == 240


def test_a_device_is_a_name_or_a_number(sound: FakeSound) -> None:
    """PortAudio's numbers are ints: "3" was looked for among the names."""
    for device, asked in (("3", 3), ("USB 3", "USB 3"), (None, None)):
        sink_of("sound", 48_000.0, 1.0, device=device)
        assert sound.asked["device"] == asked


def test_windows_plays_through_wasapi_and_devices_are_listed(
    sound: FakeSound, capsys: pytest.CaptureFixture[str]
) -> None:
    """The same card is there once for each interface of the system, MME first, which is late by 100 ms and more."""
    assert _status(["devices"]) == 0
    assert re.search(r"1 +Speakers +ALSA +2 +10 +48000 +default", capsys.readouterr().out)
    microphone = ("Microphone (USB Audio)", 0, 1)
    sound.cards = ("Speakers (USB Audio)", 2, 0), ("Headphones", 2, 1), microphone, ("Speakers (USB Audio)", 2, 1)
    sound.hosts = (
        {"name": "MME", "devices": [0], "default_output_device": 0},
        {"name": "Windows WASAPI", "devices": [1, 2, 3], "default_output_device": 1},
    )
    for device, asked in ((None, 1), ("usb audio", 3), ("0", 0), ("MME's own", "MME's own")):
        sink_of("sound", 48_000.0, 1.0, device=device)
        assert sound.asked["device"] == asked
    assert [device.default for device in devices.sound_devices()] == [False, True, False]


@pytest.mark.parametrize("gain", [float("nan"), float("inf")])
def test_a_gain_that_is_no_number_reaches_no_hardware(sound: FakeSound, gain: float) -> None:
    daq = FakeDaq()
    for make in (lambda: SoundSink(gain), lambda: DaqSink("Dev1/ao0", 1000.0, gain, library=daq)):
        with pytest.raises(ValueError, match="expected a finite number"):
            make()


class FakeDaq:
    """What of nidaqmx's interface the sink uses, as version 1.7 has it; no driver, no device."""

    class Error(Exception):
        pass

    def __init__(self, fails: str = "", every_s: float = 0.001) -> None:
        self.fails, self.every_s, self.written, self.log = fails, every_s, [], []
        self.errors = SimpleNamespace(Error=FakeDaq.Error)
        self.constants = SimpleNamespace(
            AcquisitionType=SimpleNamespace(CONTINUOUS="continuous"),
            RegenerationMode=SimpleNamespace(DONT_ALLOW_REGENERATION="no"),
            OutputDataTransferCondition=SimpleNamespace(ON_BOARD_MEMORY_EMPTY="empty"),
        )
        self.stream_writers = SimpleNamespace(AnalogSingleChannelWriter=self._writer)
        self.out_stream = SimpleNamespace()
        self.ao_channels = SimpleNamespace(add_ao_voltage_chan=self._channel, all=SimpleNamespace())
        self.timing = SimpleNamespace(cfg_samp_clk_timing=lambda **fields: self.log.append(("clock", fields)))

    def Task(self, name: str) -> FakeDaq:  # noqa: N802, nidaqmx calls it so
        if self.fails == "driver":
            raise FakeDaq.Error("no driver\nand more lines")
        return self

    def _channel(self, name: str, **fields: Any) -> None:
        if self.fails == "channel":
            raise FakeDaq.Error("no such channel")
        self.log.append((name, fields))

    def _writer(self, stream: Any, auto_start: bool) -> Any:
        return SimpleNamespace(write_many_sample=self._take)

    def _take(self, volts: np.ndarray) -> None:
        if self.fails == "samples":
            raise FakeDaq.Error("invalid buffer")
        self.written.append(volts.copy())

    def register_every_n_samples_transferred_from_buffer_event(self, n: int, callback: Any) -> None:
        self.n, self.callback = n, callback

    def start(self) -> None:
        self.log.append("start")
        self.playing = threading.Event()
        self.clock = threading.Thread(target=self._run, daemon=True)
        self.clock.start()

    def _run(self) -> None:
        while not self.playing.wait(self.every_s):
            self.callback(None, None, None, None)

    def stop(self) -> None:
        self.playing.set()
        self.clock.join()
        self.log.append("stop")
        if self.fails == "stop":
            raise FakeDaq.Error("underflow")

    def write(self, volts: float) -> None:
        if self.fails == "still":
            raise FakeDaq.Error("gone")
        self.log.append(("volts", volts))

    def __enter__(self) -> FakeDaq:
        return self

    def close(self, *_: object) -> None:
        self.log.append("close")

    __exit__ = close


def test_a_daq_is_filled_before_it_starts_and_again_as_it_empties() -> None:
    daq, n = FakeDaq(), 0

    def read(out: np.ndarray) -> None:
        nonlocal n
        out[:] = n + np.arange(out.size)
        n += out.size

    sink = DaqSink("Dev1/ao0", 10_000.0, gain=0.05, library=daq)
    sink.start(read)
    assert "start" in daq.log
    assert len(daq.written) >= 2
    assert daq.out_stream.output_buf_size == 2 * daq.n == sink.n_at_once == 200
    assert daq.out_stream.regen_mode == "no"
    assert daq.ao_channels.all.ao_data_xfer_req_cond == "empty"
    while len(daq.written) < 5:
        time.sleep(0.001)
    sink.stop()
    sink.stop()  # a second time nothing happens
    # An output keeps its last voltage: it fades, and 0 V is written once more.
    assert [line for line in daq.log if isinstance(line, str)] == ["start", "stop", "close", "close"]
    assert daq.log[-2] == ("volts", 0.0)
    volts = np.concatenate(daq.written)
    np.testing.assert_allclose(volts[:500], np.minimum(0.05 * np.arange(500), 10.0), rtol=1e-6)
    faded = int(np.flatnonzero(volts)[-1]) // 100 * 100 + np.arange(100)
    expected = np.linspace(1, 0, 100) * np.minimum(0.05 * faded, 10.0)
    np.testing.assert_allclose(volts[faded], expected, rtol=1e-5, atol=1e-6)
    assert sink.n_cut == (0.05 * np.arange(n, dtype=np.float32) > 10).sum()


@pytest.mark.parametrize(
    ("fails", "message"), [("stop", "the NI-DAQ ended badly: underflow"), ("still", "switch the amplifier off: gone")]
)
def test_a_daq_that_does_not_stop_well_is_set_to_no_voltage_or_says_what_to_do(fails: str, message: str) -> None:
    daq = FakeDaq(fails)
    sink = DaqSink("Dev1/ao0", 10_000.0, library=daq)
    sink.start(lambda out: out.fill(1.0))
    sink.stop()
    assert daq.log[-2] == ("volts", 0.0) or fails == "still"
    assert message in str(sink.failed)


def test_a_daq_that_takes_no_samples_is_not_started() -> None:
    daq = FakeDaq("samples")
    with pytest.raises(OSError, match="takes no samples: invalid buffer"):
        DaqSink("Dev1/ao0", 10_000.0, library=daq).start(lambda out: out.fill(0.0))
    assert "start" not in daq.log


def test_the_stand_in_has_the_names_of_the_library() -> None:
    pytest.importorskip("nidaqmx")
    import nidaqmx
    from nidaqmx import constants, errors, stream_writers
    from nidaqmx.task.channels import AOChannel
    from nidaqmx.task.collections import AOChannelCollection

    for of, names in (
        (nidaqmx.Task, ("register_every_n_samples_transferred_from_buffer_event", "start", "stop", "close", "write")),
        (nidaqmx.Task, ("ao_channels", "timing", "out_stream", "__enter__", "__exit__")),
        (AOChannelCollection, ("add_ao_voltage_chan", "all")),
        (AOChannel, ("ao_data_xfer_req_cond",)),
        (constants.AcquisitionType, ("CONTINUOUS",)),
        (constants.RegenerationMode, ("DONT_ALLOW_REGENERATION",)),
        (constants.OutputDataTransferCondition, ("ON_BOARD_MEMORY_EMPTY",)),
        (stream_writers.AnalogSingleChannelWriter, ("write_many_sample",)),
        (errors, ("Error",)),
    ):
        for name in names:
            assert hasattr(of, name), f"{of} has no {name}"


@pytest.mark.parametrize(("fails", "message"), [("driver", "no NI-DAQ: no driver$"), ("channel", "refuses Dev9/ao9")])
def test_a_daq_that_is_not_there_is_one_line(fails: str, message: str) -> None:
    daq = FakeDaq(fails)
    with pytest.raises(OSError, match=message):
        DaqSink("Dev9/ao9", 1000.0, library=daq)
    assert fails == "driver" or daq.log[-1] == "close"


def test_a_circle_is_over_the_middle_of_the_trained_range() -> None:
    speed, force = circling((10.0, 200.0), (0.2, 2.0), 1000.0)(np.arange(20_000))
    assert speed.min() > 10
    assert speed.max() < 200
    assert np.ptp(force) > 1


def test_a_stroke_is_played_over_and_over_without_a_step() -> None:
    """Physics: the hand goes over as fast as the low-pass, SciPy's, lets a step be. Oracle: the stroke laid end to end."""
    speed, force = np.linspace(20.0, 120.0, 500), np.linspace(0.5, 1.5, 500)
    condition = along(Stroke(speed[None], force, 1000.0), 20.0)
    once = Stroke(speed[None], force, 1000.0).conditioned(20.0)
    np.testing.assert_array_equal(condition(np.arange(500)), once)
    thrice = Stroke(np.tile(speed, 3)[None], np.tile(force, 3), 1000.0).conditioned(20.0)
    np.testing.assert_allclose(condition(np.arange(1500)), thrice, rtol=1e-9)
    fastest = np.diff(lfilter(*butter(2, 20.0, fs=1000.0), np.ones(200))).max()
    assert (np.abs(np.diff(condition(np.arange(1500)))).max(axis=1) <= fastest * np.array([100.0, 1.0])).all()


@pytest.mark.parametrize("rate", [None, 8000.0, 44_100.0, 300.0])
def test_what_is_played_is_the_stroke_that_is_rendered(texture: Texture, rate: float | None) -> None:
    """The hand was looked at once in each block, and its steps were felt."""
    speed, force = np.linspace(20.0, 180.0, 400), np.linspace(0.5, 1.5, 400)
    condition = along(Stroke(speed[None], force, 1000.0), 20.0)
    render, blocks = rendering(Renderer(texture, rate, seed=3), condition), []
    at_once = Renderer(texture, rate, seed=3).render(*condition(np.arange(400)))
    for size in np.random.default_rng(0).integers(0, 40, 400):
        blocks.append(np.empty(size, dtype=np.float32))
        render(blocks[-1])
        if sum(block.size for block in blocks) > at_once.size - 100:
            break
    played = np.concatenate(blocks)
    assert played.size > 15
    np.testing.assert_array_equal(played, at_once[: played.size])


def test_rates_gains_and_sinks_by_name(tmp_path: Path) -> None:
    assert rate_for("sound", None, 1000.0) == 48_000
    assert rate_for("null", None, 1000.0) == 8000
    assert rate_for("daq:Dev1/ao0", None, 10_000.0) == 10_000
    assert rate_for("null", 2500.0, 1000.0) == 2500
    assert gain_for(None, None, 2.0, "sound") == 0.05
    assert gain_for(None, 3.0, 2.0, "sound") == 3
    for where in ("null", "x.wav", "udp:x:1", "osc:x:1"):
        with pytest.raises(ValueError, match="takes what is rendered as it is"):
            gain_for(None, 3.0, 2.0, where)
        for asked in ({"device": "3"}, {"channel": 0}):
            with pytest.raises(ValueError, match="are a sound card's"):
                sink_of(where, 8000, 1.0, **asked)
    assert gain_for(None, None, 2.0, "udp:x:1") == 1
    volts, full = ActuatorProfile(unit="V"), ActuatorProfile(unit="full scale")
    assert gain_for(volts, None, 2.0, "daq:x") == gain_for(full, None, 2.0, "sound") == 1
    for profile, where in ((None, "daq:x"), (volts, "sound"), (full, "daq:x"), (ActuatorProfile(unit="A"), "daq:x")):
        with pytest.raises(ValueError, match="--gain"):
            gain_for(profile, None, 2.0, where)
    for name, kind in (("null", NullSink), ("udp:127.0.0.1:9000", UdpSink), ("osc:localhost:9000", OscSink)):
        sink = sink_of(name, 8000, 1.0)
        assert isinstance(sink, kind)
        sink.stop()
    for name in ("", "udp:", "udp:host", "udp:host:99999", "osc:host:x", "daq:", "speaker"):
        with pytest.raises(ValueError, match="cannot play to"):
            sink_of(name, 8000, 1.0)
    with pytest.raises(OSError, match="no host"):
        sink_of("udp:nohost.invalid:9000", 8000, 1.0)


ABOUT = {"texture": "dënim", "seed": 3}


def signal(n: int = 1000, rate: float = 1000.0) -> np.ndarray:
    return 3.7 * np.sin(2 * np.pi * 100 * np.arange(n) / rate)


def test_formats_agree_and_keep_units(tmp_path: Path) -> None:
    a, speed, force = signal(), np.linspace(20.0, 150.0, 1000), np.linspace(0.5, 1.5, 1000)
    for suffix in ("wav", "csv", "npz", "png"):
        write_rendered(tmp_path / f"a.{suffix}", a, speed, force, 1000.0, ABOUT)
    rate, samples = wavfile.read(tmp_path / "a.wav")
    assert rate == 1000
    assert np.array_equal(samples, a.astype(np.float32))
    data = (tmp_path / "a.wav").read_bytes()
    assert struct.unpack("<I", data[4:8])[0] == len(data) - 8
    comment = data[data.index(b"ICMT") + 8 :].split(b"\0")[0]
    assert json.loads(comment)["unit"] == "m/s^2"
    assert (tmp_path / "a.csv").read_text().startswith("t [s],acceleration [m/s^2],speed [mm/s],force [N]\n0,")
    written = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(written[:, 1:], np.stack([a, speed, force], axis=1), rtol=1e-8, atol=1e-8)  # nine digits
    with np.load(tmp_path / "a.npz", allow_pickle=False) as stored:
        np.testing.assert_array_equal([stored[name] for name in ("acceleration", "speed", "force")], [a, speed, force])
    assert (tmp_path / "a.png").read_bytes()[:4] == b"\x89PNG"
    check_figures({"rendered": picture(a, speed, force, 1000.0, ABOUT)})


def test_audible_sound_keeps_the_tone(tmp_path: Path) -> None:
    """A 100 Hz tone at 1 kHz is a 100 Hz tone at 48 kHz, its peak at 0.7 of full scale."""
    gain = write_audible(tmp_path / "s.wav", signal(), 1000.0)
    with wave.open(str(tmp_path / "s.wav")) as file:
        assert (file.getframerate(), file.getsampwidth(), file.getnchannels()) == (48000, 2, 1)
        pcm = np.frombuffer(file.readframes(-1), "<i2") / 32767
    expected = gain * 3.7 * np.sin(2 * np.pi * 100 * np.arange(48000) / 48000)
    # Away from the ends, where the interpolator looks past the signal: 16 bits and the sinc's window.
    assert np.abs(pcm - expected)[2000:-2000].max() < 2e-4
    assert np.abs(pcm).max() == pytest.approx(AUDIBLE_PEAK, rel=1e-3)


@pytest.mark.parametrize(
    ("rate", "tone", "highest"), [(1000.0, 100.0, 500.0), (10_000.0, 100.0, 1000.0), (10_000.0, 3000.0, 3000.0)]
)
def test_a_spectrogram_covers_the_time_of_its_axes(rate: float, tone: float, highest: float) -> None:
    """And the frequencies that have power; its first and last columns show the tone, as all do."""
    n = round(rate) + 1
    a = np.cos(2 * np.pi * tone * np.arange(n) / rate)  # whole periods of a cosine: mirrored at its ends it goes on
    _, axes, *_ = picture(a, a, a, rate, ABOUT).axes
    (image,) = axes.images
    left, right, low, high = image.get_extent()
    assert left <= axes.get_xlim()[0] < axes.get_xlim()[1] <= right
    assert axes.get_ylim() == (0, pytest.approx(highest, abs=35))
    assert ("99.9 %" in axes.get_ylabel()) == (highest < rate / 2)
    cells = np.asarray(image.get_array())
    loudest = low + (cells.argmax(axis=0) + 0.5) * (high - low) / len(cells)
    np.testing.assert_allclose(loudest, tone, atol=(high - low) / len(cells))
    np.testing.assert_allclose(cells.max(axis=0), 0, atol=0.1)  # dB re loudest


def test_silence_is_written_as_silence(tmp_path: Path) -> None:
    assert write_audible(tmp_path / "z.wav", np.zeros(100), 1000.0) == 1.0
    for suffix in ("wav", "csv", "npz", "png"):
        write_rendered(tmp_path / f"z.{suffix}", np.zeros(100), np.zeros(100), np.zeros(100), 1000.0, ABOUT)
        assert (tmp_path / f"z.{suffix}").stat().st_size > 0


def test_same_arrays_same_bytes(tmp_path: Path) -> None:
    a = signal()
    for suffix in ("wav", "csv", "npz", "png"):
        for name in ("a", "b"):
            write_rendered(tmp_path / f"{name}.{suffix}", a, a, a, 1000.0, ABOUT)
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_a_failed_write_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="at most 48000 Hz"):
        write_audible(tmp_path / "a.wav", signal(), 96_000.0)
    with pytest.raises(ValueError, match=r"expected \.wav, \.csv, \.npz or \.png"):
        write_rendered(tmp_path / "a.flac", signal(), signal(), signal(), 1000.0, ABOUT)
    assert not list(tmp_path.iterdir())
