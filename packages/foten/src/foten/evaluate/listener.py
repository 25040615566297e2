"""The listener's score: how well a network that is trained for it tells a rendering from a recording.

Moments at rest are hidden, where a rendering is silent and a sensor is not. PyTorch is loaded when a listener is trained.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.level import BAND_FRAME_MS, ENERGY_FLOOR, N_BANDS, band_energies, envelope_edges, framed
from foten.dsp.perception import band_thresholds, internal_noise_db
from foten.models.conditions import MOVING_FORCE, MOVING_SPEED
from foten.recording.trace import Trace
from foten.runtime.loops import Excluded, render_strokes
from foten.runtime.native import NativeTexture

if TYPE_CHECKING:
    from foten.evaluate.listener_network import Vibration

N_LISTENERS = 3  # each with a seed of its own, and another rendering
TRAIN_SHARE, TEST_SHARE = 0.6, 0.3  # the first and the last part of a stroke; what lies between keeps them apart
STREAM = 2**35  # of noise, the first that listeners are played
MIN_LISTENED_S = 40.0  # of a stroke: 24 s to learn from, and 12 s to score, in 100 excerpts that overlap
NOTHING = 1e-12  # of a threshold, an energy that is not felt
SOFTENING = np.array([[2.0], [0.05]])  # added to speed [mm/s] and force [N] before their logarithm
KINDS = {"": "", "_waveform": ", with the waveform", "_person": ", with a person's limits"}  # of listeners
SD_FLOOR = 1e-6  # a band or a hand that does not vary is not divided by zero
# Of a person's noise, for a band that varies less: its noise would drown the others. A step of 2 dB in all bands, of which two
# were far below threshold, was right in 0.60 of pairs without it, in 0.67 with it; 1/2 and 1 give the same within chance.
FELT_SD_FLOOR = 0.25


def long_stroke(trace: Trace, blocks: Sequence[int] | None = None) -> Trace:
    """Trace for a listener: as one continuous piece, its only block, or some of its blocks as a piece each."""
    if blocks is None:
        return replace(trace, block=len(trace))
    acceleration, speed, force = (channel.ravel() for channel in trace.picked(blocks))
    return Trace(acceleration, speed, force, trace.rate_hz, trace.block)


def rendering(kernel: NativeTexture, recorded: Trace, seed: int, excluded: Excluded = ()) -> Array:
    """Texture rendered under recorded speed and force [m/s²], shape (n,); `excluded` of each piece as of `render_strokes`."""
    speed, force = recorded.blocks(recorded.speed), recorded.blocks(recorded.force)
    return render_strokes(kernel, seed, speed, force, STREAM, excluded=excluded)[0].ravel()


def listener_scores(
    recorded: Trace,
    rendered: Callable[[int], Array],
    others: Sequence[Trace] = (),
    seed: int = 0,
    on_stage: Callable[[str], None] = lambda stage: None,
    in_m_s2: bool = True,
) -> dict[str, Any]:
    """Areas under the curves of listeners that tell renderings from a recording: 0.5 is chance, 1 certainty.

    `listener_auc…` of each of `KINDS`, means over listeners, and `…_control`, the same of two true vibrations, None where there
    is too little; `listener_control_of`; `listener_s`. ValueError where the recording, or a piece of it, is too short.

    Args:
        recorded: at least `MIN_LISTENED_S` of it, in pieces (`long_stroke`).
        rendered: seed → a rendering under the recorded speed and force [m/s²], shape (n,).
        others: further true vibrations of the stroke, for the controls in turn; without any, one half of the pieces of the
            recording beside the other, where they are long enough.
        seed: of the first listener and rendering; those of the others follow.
        in_m_s2: whether accelerations are in m/s², so that a person's threshold is known.
    """
    from foten.evaluate.listener_network import EXCERPT, listener_auc

    excerpt_ms, piece_ms = EXCERPT * BAND_FRAME_MS, 1000 * recorded.block / recorded.rate_hz
    if piece_ms < excerpt_ms:
        raise ValueError(f"pieces of {piece_ms:g} ms to listen to, expected at least {excerpt_ms:g} ms")
    seconds = len(recorded) / recorded.rate_hz
    if seconds < MIN_LISTENED_S:
        raise ValueError(f"{seconds:.0f} s to listen to, expected at least {MIN_LISTENED_S:g}")
    pairs: list[tuple[Trace, Trace]] = []
    control_of = None
    if others:
        pairs, control_of = [(recorded, other) for other in others], "other realisations of the same stroke"
    elif recorded.n_blocks > 1 and seconds >= 2 * MIN_LISTENED_S:
        halves = (long_stroke(recorded, range(first, recorded.n_blocks, 2)) for first in (0, 1))
        pairs, control_of = [(next(halves), next(halves))], "every other block of the recording"
    areas: dict[str, list[float]] = {f"listener_auc{kind}{of}": [] for kind in KINDS for of in ("", "_control")}
    for k in range(seed, seed + N_LISTENERS):
        shown = vibrations(recorded, replace(recorded, acceleration=rendered(k)), in_m_s2)
        true = vibrations(*pairs[(k - seed) % len(pairs)], in_m_s2) if pairs else {}
        for kind, name in KINDS.items():
            on_stage(f"listener {k - seed + 1} of {N_LISTENERS}{name}")
            areas[f"listener_auc{kind}"].append(listener_auc(*shown[kind], seed=k))
            if true:
                control = listener_auc(*true[kind], seed=k, same_stroke=bool(others))
                areas[f"listener_auc{kind}_control"].append(control)
    means = {name: float(np.mean(each)) if each else None for name, each in areas.items()}
    return {**means, "listener_s": seconds, "listener_control_of": control_of}


def vibrations(
    first: Trace, second: Trace, in_m_s2: bool = True, excerpt: int | None = None
) -> dict[str, tuple[Vibration, Vibration]]:
    """Two vibrations as the listeners of `KINDS` are shown them, standardised by both in the part that they learn from.

    Excerpts have so many frames, half a second by default. A person feels energies above a threshold: of held tools where they
    are in m/s², and 40 dB below the mean in any unit.
    """
    from foten.evaluate.listener_network import EXCERPT, Limits, Vibration

    excerpt = excerpt or EXCERPT
    both = (first, second)
    # Shapes are (n_pieces, channels, frames) from here on.
    energies = [band_energies(stroke.blocks(stroke.acceleration), stroke.rate_hz) for stroke in both]
    floor = ENERGY_FLOOR * np.mean([energy.mean(axis=(0, 2)) for energy in energies], axis=0)[:, None]
    conditions = [_conditions(stroke) for stroke in both]
    # Where a rendering does not fade, (n_pieces, frames).
    moving = [((lowest[:, 0] >= MOVING_SPEED) & (lowest[:, 1] >= MOVING_FORCE)) for _, lowest in conditions]
    starts = [_starts(len(moves), moves.shape[1], excerpt) for moves in moving]
    floor += np.finfo(float).tiny
    threshold = np.maximum(floor, band_thresholds(envelope_edges(first.rate_hz))[:, None]) if in_m_s2 else floor
    logs = [np.log(energy + floor) for energy in energies]
    bands = [(log - mean) / sd for mean, sd in [_statistics(logs, moving, starts)] for log in logs]
    speed_forces = [np.log(mean + SOFTENING) for mean, _ in conditions]
    mean, sd = _statistics(speed_forces, [np.ones_like(moves) for moves in moving], starts)
    speed_forces = [(each - mean) / sd for each in speed_forces]
    noise = internal_noise_db(N_BANDS) * np.log(10) / 10
    mean, sd = _statistics([np.log1p(energy / threshold) for energy in energies], moving, starts)
    limits = Limits(noise, mean, np.maximum(sd, FELT_SD_FLOOR * noise))
    scale = float(np.sqrt(np.mean([np.square(stroke.acceleration).mean() for stroke in both]))) or 1.0
    shown: dict[str, list[Vibration]] = {kind: [] for kind in KINDS}
    for k, (stroke, moves, (train, test)) in enumerate(zip(both, moving, starts, strict=True)):
        frames = np.concatenate([np.where(moves[:, None], bands[k], 0.0), speed_forces[k]], axis=1)
        shown[""].append(Vibration(_joined(frames), None, train, test, excerpt=excerpt))
        cut = framed(stroke.blocks(stroke.acceleration), BAND_FRAME_MS, stroke.rate_hz)
        samples = (np.arcsinh(2 * cut / scale) * moves[..., None]).reshape(-1, cut.shape[-1])
        shown["_waveform"].append(Vibration(_joined(frames), samples, train, test, excerpt=excerpt))
        levels = np.log(np.where(moves[:, None], energies[k] / threshold, 0.0) + NOTHING)
        frames = np.concatenate([levels, speed_forces[k]], axis=1)
        shown["_person"].append(Vibration(_joined(frames), None, train, test, limits, excerpt))
    return {kind: (first, second) for kind, (first, second) in shown.items()}


def _conditions(stroke: Trace) -> tuple[Array, Array]:
    """Mean and lowest speed and force of each frame, (n_pieces, 2, frames) each."""
    channels = np.stack([stroke.blocks(stroke.speed), stroke.blocks(stroke.force)], axis=1)
    frames = framed(channels, BAND_FRAME_MS, stroke.rate_hz)
    return frames.mean(axis=-1), frames.min(axis=-1)


def _starts(n_pieces: int, n_frames: int, excerpt: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Frames with which excerpts to learn from, and to be scored on, begin: each within one piece."""
    from foten.evaluate.listener_network import HOP

    n = n_pieces * n_frames
    first = np.arange(n)
    inside = first[first % n_frames <= n_frames - excerpt]
    train = inside[inside + excerpt <= TRAIN_SHARE * n]
    later = inside[inside >= (1 - TEST_SHARE) * n]
    return train, later[(later % n_frames) % HOP == 0]


def _statistics(
    channels: list[Array], counted: list[NDArray[np.bool_]], starts: list[tuple[NDArray[np.int64], Any]]
) -> tuple[Array, Array]:
    """Mean and standard deviation of channels (n_pieces, channels, frames) over the counted frames that are learned from."""
    known = []
    for channel, counts, (train, _) in zip(channels, counted, starts, strict=True):
        until = train[-1] + 1
        known.append(_joined(channel)[:, :until][:, counts.ravel()[:until]])
    joined = np.concatenate(known, axis=1)
    if not joined.shape[1]:
        raise ValueError("the hand is at rest where a listener is to learn, expected strokes")
    return joined.mean(axis=1)[:, None], np.maximum(joined.std(axis=1), SD_FLOOR)[:, None]


def _joined(channels: Array) -> Array:
    """Pieces one after the other: (n_pieces, channels, frames) → (channels, n_pieces·frames)."""
    return np.moveaxis(channels, 1, 0).reshape(channels.shape[1], -1)
