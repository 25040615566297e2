"""What the simulator knows of a recording: further realisations, bounds of any predictor, strokes for listeners."""

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np

from foten.dsp import Array
from foten.dsp.filters import butterworth
from foten.evaluate.evaluate import SimulatorReference, trace_for
from foten.evaluate.free_run import N_SEEDS
from foten.evaluate.listener import N_LISTENERS, long_stroke, rendering, vibrations
from foten.models.texture_file import Texture
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.recording.split import Split
from foten.recording.trace import Trace
from foten.runtime.native import NativeTexture
from foten.simulation.linear_family import LINEAR_FAMILY, linear_truth, one_step_bounds
from foten.simulation.simulate import realisations

LONG_S = 240.0  # of a stroke for listeners
SETTLED_S = 0.5  # before and after what is judged: of filters, and where the clocks of sensors begin
SEED_STEP = 1_000_003  # between realisations
VALIDATION_HAND = 2  # the number of the hand that nothing is reported of
N_CACHED = 12  # realisations that a process keeps for the methods of an experiment: 2 MB each at 1 kHz
_CACHE: dict[str, Trace] = {}


def _realisations(
    recording: Recording,
    texture: Texture,
    noise_seeds: Sequence[int],
    trim_ms: float | None = None,
    block_ms: float | None = None,
    **stroke: Any,
) -> list[Trace]:
    """Further realisations, preprocessed as a texture's recording was; each is simulated once."""
    depends_on = [dict(recording.simulation or {}), texture.card["preprocess"], trim_ms, block_ms, stroke]
    keys = {seed: json.dumps([*depends_on, seed], sort_keys=True) for seed in noise_seeds}
    known = {seed: _CACHE[key] for seed, key in keys.items() if key in _CACHE}
    missing = [seed for seed in noise_seeds if seed not in known]
    if missing:
        with ThreadPoolExecutor() as pool:  # filters and transforms release the interpreter's lock
            traces = pool.map(
                lambda realisation: trace_for(texture, realisation, trim_ms, block_ms),
                realisations(recording, missing, **stroke),
            )
            known |= zip(missing, traces, strict=True)
    for seed in missing:
        for oldest in list(_CACHE)[: 1 - N_CACHED]:
            _CACHE.pop(oldest, None)
        _CACHE[keys[seed]] = known[seed]
    return [known[seed] for seed in noise_seeds]


def reference_for(
    recording: Recording,
    texture: Texture,
    trim_ms: float | None = None,
    block_ms: float | None = None,
    listener: bool = False,
) -> SimulatorReference:
    """Further realisations of a simulated stroke; of the linear family the bounds of any predictor; long strokes for a listener.

    Empty for a recording that was not simulated, or by another version of the simulator. The bounds hold at the simulated rate
    and with a causal high-pass of order 2 only.
    """
    if recording.simulation is None:
        return SimulatorReference()
    try:
        used = int(recording.simulation["noise_seed"])
        seeds = [used + SEED_STEP * k for k in range(1, N_SEEDS + 1)]
        further = _realisations(
            recording, texture, seeds, trim_ms, block_ms, spans_s=judged_spans_s(recording, texture)
        )
    except (KeyError, TypeError, ValueError) as error:
        return SimulatorReference(why_no_bound=f"the simulator's parameters in the recording cannot be used ({error})")
    strokes = long_strokes(recording, texture) if listener else ()
    config = PreprocessConfig.of_card(texture.card["preprocess"])
    known = SimulatorReference(further, strokes)
    if recording.simulation["key"] not in LINEAR_FAMILY:
        return known
    if recording["acceleration"].rate_hz != config.rate_hz:
        return replace(known, why_no_bound="known at the simulated rate alone")
    if config.highpass_order != 2 or config.zero_phase:
        return replace(known, why_no_bound="known with a causal high-pass of order 2 alone")
    trace = trace_for(texture, recording, trim_ms, block_ms)
    bound, bound_window = linear_bounds(recording, trace, config.highpass_hz, texture.window)
    return replace(known, bound=bound, bound_window=bound_window)


def judged_spans_s(recording: Recording, texture: Texture) -> list[tuple[float, float]]:
    """Start and end of what is judged of a texture's recording, with the time before in which filters settle [s].

    Empty for another recording, all of which is judged.
    """
    if texture.card["split"] is None or recording.sha256() != texture.card["recording_sha256"]:
        return []
    config, split = PreprocessConfig.of_card(texture.card["preprocess"]), Split.from_fields(texture.card["split"])
    starts_s = [(config.trim_ms + config.block_ms * block) / 1000 for block in split.test]
    return [(start - SETTLED_S, start + config.block_ms / 1000 + SETTLED_S) for start in starts_s]


def long_strokes(
    recording: Recording, texture: Texture, n: int = 1 + N_LISTENERS, hand_number: int = 1
) -> tuple[Trace, ...]:
    """N realisations of a long stroke by another hand over a simulated texture; none of what was not simulated here.

    Each hand has a stroke and places of its own; the first realisation stands for the recording, the others for controls.
    """
    if recording.simulation is None:
        return ()
    try:
        noise, stroke = (int(recording.simulation[name]) for name in ("noise_seed", "stroke_seed"))
        long = {"seconds": LONG_S, "stroke_seed": stroke + SEED_STEP * hand_number}
        seeds = [noise + SEED_STEP * (100 * hand_number + k) for k in range(n)]
        return tuple(_realisations(recording, texture, seeds, **long))
    except (KeyError, TypeError, ValueError):
        return ()


def validation_listener(texture: Texture, recording: Recording) -> dict[str, float]:
    """`area` under the curve of one listener, of band energies, to choose by, and that of one with a `person`'s limits.

    Nothing of what was not simulated, or is silent. Under another hand than that of the evaluation. Two fits of one texture
    differ by 0.015, three listeners of one fit by 0.01.
    """
    strokes = long_strokes(recording, texture, 1, VALIDATION_HAND) if texture.has_excitation else ()
    if not strokes:
        return {}
    from foten.evaluate.listener_network import listener_auc

    recorded = long_stroke(strokes[0])
    rendered = rendering(NativeTexture(texture.to_bytes()), recorded, 0)
    shown = vibrations(recorded, replace(recorded, acceleration=rendered))
    return {name: listener_auc(*shown[kind], seed=0) for name, kind in (("area", ""), ("person", "_person"))}


def linear_bounds(recording: Recording, trace: Trace, highpass_hz: float, window: int) -> tuple[Array, Array]:
    """Least expected absolute one-step errors [m/s²] from the infinite past and from a window of m, shape (n,) each.

    Of a recording of the linear family and its trace.
    """
    (b0, b1, b2, a1, a2), *_ = butterworth("highpass", highpass_hz, trace.rate_hz)
    numerator, denominator = np.array([b0, b1, b2]), np.array([1.0, a1, a2])
    return one_step_bounds(linear_truth(recording), trace.speed, trace.force, numerator, denominator, window)
