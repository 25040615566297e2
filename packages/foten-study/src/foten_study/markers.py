"""Markers of a study in a Lab Streaming Layer stream, for recorders of other signals: EEG, motion, skin.

Source: Kothe et al., Imaging Neuroscience 3 (2025), for the layer.
"""

from __future__ import annotations

import json
from typing import Any

NAME, KIND = "foten-study", "Markers"


class Markers:
    """A stream of markers, each a JSON object with `event`: trial, contact, lift or answer, participant, trial and texture.

    Methods are not named: whoever watches the stream stays blind. `ratings.csv` has them by participant and trial.

    Raises:
        ValueError: pylsl is not installed.
        OSError: the library that it loads is not there.
    """

    def __init__(self, title: str) -> None:
        try:
            import pylsl
        except ImportError as error:
            raise ValueError("--lsl needs pylsl: pip install './packages/foten-study[lsl]'") from error
        except RuntimeError as error:
            raise OSError(f"pylsl does not find its library, liblsl: {str(error).splitlines()[0]}") from error
        info = pylsl.StreamInfo(NAME, KIND, 1, pylsl.IRREGULAR_RATE, "string", f"{NAME}-{title}")
        self._outlet = pylsl.StreamOutlet(info)

    def send(self, event: str, **about: Any) -> None:
        """Send a marker; it is stamped now."""
        self._outlet.push_sample([json.dumps({"event": event, **about})])
