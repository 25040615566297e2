"""What a page captures of a surface: the sound of a pen on it and the pen's events, in files that `foten import --pen` reads."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foten.atomic_write import atomic_write
from foten.recording.captured import ABOUT, PEN, SOUND, About, file_name
from foten.studio.messages import RefusedError

LONGEST_S = 300.0
MOST_PEN_EVENTS = 2000 * int(LONGEST_S)


class Capture:
    """A sound and events as they come in, until they are written."""

    def __init__(self, about: About) -> None:
        self.about = about
        self._sound: list[NDArray[np.float32]] = []
        self._events: list[NDArray[np.float64]] = []
        self._n_samples = self._n_events = 0

    @property
    def seconds(self) -> float:
        """Return how long the sound is."""
        return self._n_samples / self.about.rate_hz

    def add_sound(self, samples: NDArray[np.float32]) -> None:
        """Take in the next samples, of which full scale is 1.

        Raises:
            RefusedError: it is longer than `LONGEST_S`.
        """
        if self._n_samples + samples.size > LONGEST_S * self.about.rate_hz:
            raise RefusedError(f"the capture is longer than {LONGEST_S:g} s")
        self._sound.append(samples)
        self._n_samples += samples.size

    def add_events(self, events: NDArray[np.float64]) -> None:
        """Take in the next events: x, y [mm], pressure, t [s], shape (n, 4).

        Raises:
            RefusedError: there are too many, or the time does not increase.
        """
        if self._n_events + len(events) > MOST_PEN_EVENTS:
            raise RefusedError(f"the capture has more than {MOST_PEN_EVENTS} events")
        before = self._events[-1][-1:, 3] if self._events else np.full(1, -np.inf)
        if not (np.diff(np.concatenate([before, events[:, 3]])) >= 0).all():
            raise RefusedError("the events are not in the order of their times")
        self._events.append(events)
        self._n_events += len(events)

    def write(self, captures: Path) -> Path:
        """Write sound, events and what was said of them to a new folder below `captures`, and return the folder.

        Raises:
            RefusedError: there is no sound, or no event.
            OSError: the disk refuses.
        """
        import scipy.io.wavfile

        if not self._n_samples or not self._n_events:
            raise RefusedError("there is no sound yet" if self._n_events else "the pen has not touched yet")
        folder = _new_folder(captures, self.about.name)
        with atomic_write(folder / SOUND) as part:
            scipy.io.wavfile.write(part, round(self.about.rate_hz), np.concatenate(self._sound))
        events = np.concatenate(self._events)
        # A touch and the lift of the one before may have one time: the later of them counts.
        last = np.append(np.diff(events[:, 3]) > 0, True)
        with atomic_write(folder / PEN) as part:
            rows = events[last][:, [3, 0, 1, 2]]
            np.savetxt(part, rows, "%.6f", ",", header="t [s],x [mm],y [mm],pressure", comments="")
        with atomic_write(folder / ABOUT) as part:
            part.write_text(json.dumps(asdict(self.about), indent=1) + "\n", encoding="utf-8")
        return folder


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
