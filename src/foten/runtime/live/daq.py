"""An analogue output of National Instruments."""

from __future__ import annotations

import math
import threading
import time
from contextlib import suppress
from typing import Any

import numpy as np

from foten.runtime.live.paced import Read, check_gain

_DAQ_BUFFERED_MS = 20.0


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
        check_gain(gain)
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
                still.ao_channels.add_ao_voltage_chan(self._channel, min_val=-self._limit, max_val=self._limit)
                still.write(0.0)
        except errors.Error as error:  # worse than whatever it died of before
            self.failed = OSError(f"the NI-DAQ may not be at 0 V, switch the amplifier off: {_first_line(error)}")


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
