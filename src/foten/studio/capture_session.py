"""What a page captures of a surface: the sound of a pen on it and the pen's events, in files that `foten import --pen` reads."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import atomic_write
from foten.recording.capture_folder import ABOUT, PEN, SOUND, About, file_name
from foten.studio.messages import RefusedError

MAX_CAPTURE_S = 300.0
MAX_PEN_EVENTS = 2000 * int(MAX_CAPTURE_S)
MAX_BACK_S, MAX_LATE_SHARE = 0.1, 0.01  # of an event, in time; of all events: with more the pen has no clock


class CaptureSession:
    """Sound and events as they come in, until they are written."""

    def __init__(self, about: About) -> None:
        self.about = about
        self._sound: list[NDArray[np.float32]] = []
        self._events: list[NDArray[np.float64]] = []
        self._n_samples = self._n_events = 0
        self._latest_s = -np.inf

    @property
    def seconds(self) -> float:
        """Duration of the sound [s]."""
        return self._n_samples / self.about.rate_hz

    def add_sound(self, samples: NDArray[np.float32]) -> None:
        """Take in the next samples, of which full scale is 1.

        Raises:
            RefusedError: it is longer than `MAX_CAPTURE_S`.
        """
        if self._n_samples + samples.size > MAX_CAPTURE_S * self.about.rate_hz:
            raise RefusedError(f"the capture is longer than {MAX_CAPTURE_S:g} s")
        self._sound.append(samples)
        self._n_samples += samples.size

    def add_events(self, events: NDArray[np.float64]) -> None:
        """Take in the next events: x, y [mm], pressure, t [s], shape (n, 4); for those that come late see `in_order`.

        Raises:
            RefusedError: there are too many, or an event is more than `MAX_BACK_S` back in time.
        """
        if self._n_events + len(events) > MAX_PEN_EVENTS:
            raise RefusedError(f"the capture has more than {MAX_PEN_EVENTS} events")
        latest_s = np.maximum.accumulate(np.append(self._latest_s, events[:, 3]))
        back_s = float((latest_s[1:] - events[:, 3]).max())
        if back_s > MAX_BACK_S:
            raise RefusedError(
                f"the events are not in the order of their times: one is {1000 * back_s:.0f} ms back, "
                f"expected {1000 * MAX_BACK_S:g} at most"
            )
        self._latest_s = float(latest_s[-1])
        self._events.append(events)
        self._n_events += len(events)

    def write(self, captures: Path) -> Path:
        """Write sound, events and `About` to a new folder below `captures`; the folder.

        Raises:
            RefusedError: there is no sound, no event, or more than `MAX_LATE_SHARE` of the events came late.
            OSError: the disk refuses.
        """
        import scipy.io.wavfile

        if not self._n_samples or not self._n_events:
            raise RefusedError("there is no sound yet" if self._n_events else "the pen has not touched yet")
        events, n_late = in_order(np.concatenate(self._events))
        if n_late > MAX_LATE_SHARE * self._n_events:
            raise RefusedError(
                f"the events are not in the order of their times: {n_late} of {self._n_events} came late, "
                f"expected {100 * MAX_LATE_SHARE:g} % at most"
            )
        folder = _new_folder(captures, self.about.name)
        with atomic_write(folder / SOUND) as part:
            scipy.io.wavfile.write(part, round(self.about.rate_hz), np.concatenate(self._sound))
        with atomic_write(folder / PEN) as part:
            rows = events[:, [3, 0, 1, 2]]
            np.savetxt(part, rows, "%.6f", ",", header="t [s],x [mm],y [mm],pressure", comments="")
        about = replace(self.about, n_late_events=n_late)
        with atomic_write(folder / ABOUT) as part:
            part.write_text(json.dumps(asdict(about), indent=1) + "\n", encoding="utf-8")
        return folder


def in_order(events: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
    """Events with increasing times, shape (k, 4), and how many came late: after an event of a later time.

    A late event is left out, since the pen was there before. If it is a touch or a lift, it counts at the time of the event
    before: events come in the right order where a clock does not, and without it two touches would be one. Of events of one
    time the last counts; a touch and the lift before it may have one time.

    Args:
        events: x, y [mm], pressure, t [s] in the order in which they came, shape (n, 4).
    """
    times = np.round(events[:, 3], 6)  # as the file has them
    latest = np.maximum.accumulate(times)
    late = times < latest
    down = events[:, 2] > 0
    touches_or_lifts = down != np.append(False, down[:-1])
    ordered = np.column_stack([events[:, :3], latest])[~late | touches_or_lifts]
    last = np.append(np.diff(ordered[:, 3]) > 0, True)
    return ordered[last], int(late.sum())


def _new_folder(captures: Path, name: str) -> Path:
    stem, n = file_name(name), 1
    while True:
        folder = captures / (stem if n == 1 else f"{stem}-{n}")
        try:
            folder.mkdir(parents=True)
        except FileExistsError:
            n += 1
        else:
            return folder
