"""The listener's verdict: can a network that is trained for it tell the free run from the surface?

Every other figure of a free run compares averages, and a rendering can be at the ceiling of all of them and be told apart at
once: its impacts are smeared, say. Here a small network is shown half a second of recorded or rendered vibration under one hand,
as a hand may know it, and answers which it is. It learns from the first 60 % of a long stroke and is scored on the last 30 %.

Beside it stands the control: the same listener on two true vibrations, of which it should be able to tell nothing. A rendering
is as good as it can be where its figure is the control's.

Moments at rest are hidden from it: a rendering is silent there by rule, and a sensor is not. PyTorch is loaded when it is asked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from foten.dsp import Array
from foten.dsp.bands import BAND_FRAME_MS, band_energies
from foten.dsp.level import framed
from foten.models.conditions import FADE_FORCE, FADE_SPEED
from foten.recording.trace import Trace
from foten.runtime.loops import on_all_cores
from foten.runtime.native import NativeState, NativeTexture

if TYPE_CHECKING:
    from foten.evaluate.listener_network import Vibration

N_LISTENERS = 3  # each with a seed of its own, and another rendering
TRAIN_SHARE, TEST_SHARE = 0.6, 0.3  # the first and the last part of a stroke; what lies between keeps them apart
STREAM = 2**35  # of noise, the first that listeners are played
MIN_LISTENED_S = (
    40.0  # of a stroke: 24 s to learn from, and 12 s, 100 excerpts that overlap by three quarters, to be scored on
)
FLOOR = 1e-4  # of the mean energy of a band: what is 40 dB below it counts as that
QUARTERS = ("slowest", "slow", "fast", "fastest")  # of a stroke
SD_FLOOR = 1e-6  # a band or a hand that does not vary is not divided by zero


@dataclass(frozen=True)
class LongStroke:
    """Vibration under a known hand, in pieces that each are continuous: all arrays of shape (n_pieces, n)."""

    acceleration: Array  # m/s²
    speed: Array  # mm/s
    force: Array  # N
    rate_hz: float

    @property
    def seconds(self) -> float:
        """How long all pieces last."""
        return self.acceleration.size / self.rate_hz

    def picked(self, pieces: slice) -> LongStroke:
        """Some of its pieces."""
        return LongStroke(self.acceleration[pieces], self.speed[pieces], self.force[pieces], self.rate_hz)

    def with_acceleration(self, acceleration: Array) -> LongStroke:
        """Another vibration under the same hand."""
        return LongStroke(acceleration, self.speed, self.force, self.rate_hz)


def long_stroke(trace: Trace, blocks: tuple[int, ...] | None = None) -> LongStroke:
    """A trace as one piece, or some of its blocks as a piece each."""
    if blocks is None:
        return LongStroke(trace.acceleration[None], trace.speed[None], trace.force[None], trace.rate_hz)
    return LongStroke(*trace.picked(blocks), trace.rate_hz)


def renderings(kernel: NativeTexture, recorded: LongStroke) -> Callable[[int], Array]:
    """What renders a texture under a recorded hand: seed → vibration [m/s²], of the recorded shape."""

    def rendered(seed: int) -> Array:
        run = np.empty_like(recorded.acceleration)

        def render(piece: int) -> None:
            state = NativeState(kernel, seed=seed, stream=STREAM + piece)
            run[piece] = state.render_stroke(recorded.speed[piece], recorded.force[piece])

        on_all_cores(render, len(run))
        return run

    return rendered


def listener_scores(
    recorded: LongStroke,
    rendered: Callable[[int], Array],
    others: Sequence[LongStroke] = (),
    seed: int = 0,
    on_stage: Callable[[str], None] = lambda stage: None,
) -> dict[str, Any]:
    """How well listeners tell renderings from a recording: areas under their curves, 0.5 chance, 1 certainty.

    Args:
        recorded: at least `MIN_LISTENED_S` of it.
        rendered: seed → a rendering under the recorded hand [m/s²], of the recorded shape.
        others: other true vibrations under the same hand, for the controls, one for each in turn; without any, every other
            piece of the recording stands for them, where the two halves are long enough.
        seed: of the first listener and rendering; those of the others follow.

    Returns:
        `listener_auc` and `listener_auc_waveform`, of bands alone and with the waveform, means over listeners; `…_control`, the
        same of two true vibrations, None where there is too little; `listener_auc_each`; `listener_control_of`; and
        `level_bias_db`, of the first rendering and of the first other vibration (`…_control`): `level_biases`.

    Raises:
        ValueError: the recording is too short.
    """
    from foten.evaluate.listener_network import listener_auc

    if recorded.seconds < MIN_LISTENED_S:
        raise ValueError(f"{recorded.seconds:.0f} s to listen to, expected at least {MIN_LISTENED_S:g}")
    pairs: list[tuple[LongStroke, LongStroke]] = []
    control_of = None
    if others:
        pairs, control_of = [(recorded, other) for other in others], "other realisations of the same stroke"
    elif len(recorded.speed) > 1 and recorded.seconds >= 2 * MIN_LISTENED_S:
        pairs = [(recorded.picked(slice(0, None, 2)), recorded.picked(slice(1, None, 2)))]
        control_of = "every other block of the recording"
    scores: dict[str, Any] = {}
    biases: dict[str, float] | None = None
    for name, waveform in (("listener_auc", False), ("listener_auc_waveform", True)):
        each, control = [], []
        for k in range(seed, seed + N_LISTENERS):
            on_stage(f"listener {k - seed + 1} of {N_LISTENERS}{', with the waveform' if waveform else ''}")
            run = recorded.with_acceleration(rendered(k))
            if not scores and k == seed:
                biases = level_biases(recorded, run.acceleration)
            each.append(listener_auc(*vibrations(recorded, run, waveform), seed=k))
            if pairs:
                two = vibrations(*pairs[(k - seed) % len(pairs)], waveform)
                control.append(listener_auc(*two, seed=k, same_stroke=bool(others)))
        scores[name], scores[f"{name}_each"] = float(np.mean(each)), each
        scores[f"{name}_control"] = float(np.mean(control)) if control else None
    scores["level_bias_db"] = biases
    scores["level_bias_db_control"] = level_biases(recorded, others[0].acceleration) if others else None
    return {**scores, "listener_s": recorded.seconds, "listener_control_of": control_of}


def level_biases(recorded: LongStroke, rendered: Array) -> dict[str, float] | None:
    """By how much a rendering is louder than a recording [dB]: in each quarter of the moving samples, by their speed.

    From `slowest` to `fastest`; None where the hand never moves, or one of the two is silent.
    """
    moving = (recorded.speed >= FADE_SPEED) & (recorded.force >= FADE_FORCE)
    if not moving.any():
        return None
    edges = np.quantile(recorded.speed[moving], (0.25, 0.5, 0.75))
    quarter = np.searchsorted(edges, recorded.speed[moving])
    powers = [
        np.bincount(quarter, np.square(signal[moving]), len(QUARTERS)) for signal in (rendered, recorded.acceleration)
    ]
    if not all((power > 0).all() for power in powers):
        return None
    return dict(zip(QUARTERS, (10 * np.log10(powers[0] / powers[1])).tolist(), strict=True))


def vibrations(first: LongStroke, second: LongStroke, waveform: bool) -> tuple[Vibration, Vibration]:
    """Two vibrations as a listener is shown them, standardised by what both are in the part that it learns from."""
    from foten.evaluate.listener_network import EXCERPT, Vibration

    both = (first, second)
    energies = [band_energies(stroke.acceleration, stroke.rate_hz) for stroke in both]  # (n_pieces, bands, frames)
    floor = FLOOR * np.mean([energy.mean(axis=(0, 2)) for energy in energies], axis=0)[:, None]
    moving = [_moving(stroke) for stroke in both]  # (n_pieces, frames)
    starts = [_starts(len(moves), moves.shape[1], EXCERPT) for moves in moving]
    logs = [np.log(energy + floor + np.finfo(float).tiny) for energy in energies]
    of_bands = _standardisation(logs, moving, starts)
    speed_forces = [_speed_force(stroke) for stroke in both]
    of_speed_force = _standardisation(speed_forces, [np.ones_like(moves) for moves in moving], starts)
    scale = float(np.sqrt(np.mean([np.square(stroke.acceleration).mean() for stroke in both]))) or 1.0
    shown_vibrations = []
    for stroke, log, speed_force, moves, (train, test) in zip(both, logs, speed_forces, moving, starts, strict=True):
        shown = np.where(moves[:, None], _standardised(log, of_bands), 0.0)
        frames = np.concatenate([shown, _standardised(speed_force, of_speed_force)], axis=1)
        samples = None
        if waveform:
            cut = framed(stroke.acceleration, BAND_FRAME_MS, stroke.rate_hz)
            samples = np.arcsinh(2 * cut / scale) * moves[..., None]
            samples = samples.reshape(-1, cut.shape[-1])
        shown_vibrations.append(Vibration(np.moveaxis(frames, 1, 0).reshape(frames.shape[1], -1), samples, train, test))
    return shown_vibrations[0], shown_vibrations[1]


def _moving(stroke: LongStroke) -> NDArray[np.bool_]:
    """In which frames a rendering does not fade, (n_pieces, frames)."""
    speed, force = (
        framed(channel, BAND_FRAME_MS, stroke.rate_hz).min(axis=-1) for channel in (stroke.speed, stroke.force)
    )
    return np.asarray((speed >= FADE_SPEED) & (force >= FADE_FORCE))


def _speed_force(stroke: LongStroke) -> Array:
    """Log speed and log force of each frame, (n_pieces, 2, frames)."""
    speed, force = (
        framed(channel, BAND_FRAME_MS, stroke.rate_hz).mean(axis=-1) for channel in (stroke.speed, stroke.force)
    )
    return np.stack([np.log(speed + 2.0), np.log(force + 0.05)], axis=1)


def _starts(n_pieces: int, n_frames: int, excerpt: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The frames with which excerpts to learn from, and to be scored on, begin: each within one piece."""
    from foten.evaluate.listener_network import HOP

    n = n_pieces * n_frames
    first = np.arange(n)
    inside = first[first % n_frames <= n_frames - excerpt]
    train = inside[inside + excerpt <= TRAIN_SHARE * n]
    later = inside[inside >= (1 - TEST_SHARE) * n]
    return train, later[(later % n_frames) % HOP == 0]


def _standardisation(
    channels: list[Array], counted: list[NDArray[np.bool_]], starts: list[tuple[NDArray[np.int64], Any]]
) -> tuple[Array, Array]:
    """Mean and standard deviation of each channel over the counted frames that are learned from."""
    known = []
    for channel, counts, (train, _) in zip(channels, counted, starts, strict=True):
        flat, until = np.moveaxis(channel, 1, 0).reshape(channel.shape[1], -1), train[-1] + 1
        known.append(flat[:, :until][:, counts.ravel()[:until]])
    joined = np.concatenate(known, axis=1)
    if not joined.shape[1]:
        raise ValueError("the hand is at rest where a listener is to learn, expected strokes")
    return joined.mean(axis=1), np.maximum(joined.std(axis=1), SD_FLOOR)


def _standardised(channels: Array, by: tuple[Array, Array]) -> Array:
    mean, sd = by
    return np.asarray((channels - mean[:, None]) / sd[:, None])
