"""A sound card, through PortAudio."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from foten.runtime.live.live import Read, Samples
from foten.runtime.live.paced import check_gain

SOUND_RATE_HZ = 48_000.0
_SOUND_BLOCK_MS = 5.0


class SoundSink:
    """The sound card, or an amplifier on it that drives an actuator.

    `n_device_underruns` counts what the card itself found missing.

    Args:
        gain: full scale for one of what is rendered; what goes beyond full scale is cut, and counted in `n_cut`.
        device: its name, or its number as an int, as `python -m sounddevice` lists them; None for the usual one.
        channel: that is played on, from 0; those before it are silent.

    Raises:
        OSError: PortAudio or the device is missing; one line says what to do.
    """

    patient = False

    def __init__(
        self, gain: float, device: str | int | None = None, rate_hz: float = SOUND_RATE_HZ, channel: int = 0
    ) -> None:
        check_gain(gain)
        self.rate_hz = float(rate_hz)
        self.n_cut = self.n_device_underruns = 0
        self.failed: BaseException | None = None
        self._stopped, self._gain, self._channel = False, gain, channel
        self._sounddevice = sound_library()
        self._mono = np.zeros(max(1, round(_SOUND_BLOCK_MS * rate_hz / 1000)), dtype=np.float32)
        self._read: Read  # from `start` on
        try:
            self._stream = self._sounddevice.OutputStream(
                samplerate=rate_hz,
                blocksize=self._mono.size,
                device=device,
                channels=channel + 1,
                dtype="float32",
                latency="low",
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
        np.clip(self._mono, -1.0, 1.0, out=out[:, self._channel])


def sound_library() -> Any:
    """Return the package sounddevice, or raise OSError where it or PortAudio is missing; one line says what to do."""
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
