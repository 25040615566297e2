"""What a listener can tell under a hand that nothing is reported of: what to choose by.

As the evaluation's, of band energies, over another 240 s of a simulated texture by a third hand: neither the one that was
learned from nor that of the reported figures.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from foten.evaluate.listener import N_LISTENERS, long_stroke, renderings, vibrations
from foten.experiments.truth import long_strokes
from foten.families.texture_file import Texture
from foten.recording.recording import Recording
from foten.runtime.native import NativeTexture

HAND_NUMBER = 2


def validation_listener(texture: Texture, recording: Recording) -> dict[str, Any]:
    """Return `area`, the mean area under three listeners' curves; nothing of what was not simulated, or has no excitation."""
    strokes = long_strokes(recording, texture, 1, HAND_NUMBER) if texture.has_excitation else ()
    if not strokes:
        return {}
    from foten.networks.listener import listener_auc

    recorded = long_stroke(strokes[0])
    rendered = renderings(NativeTexture(texture.to_bytes()), recorded)
    runs = [recorded.with_acceleration(rendered(seed)) for seed in range(N_LISTENERS)]
    areas = [listener_auc(*vibrations(recorded, run, waveform=False), seed=seed) for seed, run in enumerate(runs)]
    return {"area": float(np.mean(areas))}
