"""A captured folder to a texture, in a process of its own: `python -m foten.cli.train_capture FOLDER`.

It writes a JSON object a line to stdout: `joined`, `notes`, `stage` with `share`, `playable`, `done` or `refused`.
"""

import contextlib
import dataclasses
import json
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from foten.atomic_write import reason
from foten.datasets.hdf5 import write_recording
from foten.datasets.importing import import_capture
from foten.datasets.options import ImportOptions
from foten.dsp.perception import smallest_rate
from foten.models.foten_plus.config import WITHHELD, FotenPlusConfig, withholds_recording
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import Texture, write_texture
from foten.models.trainable import train
from foten.recording.capture_folder import ABOUT, PEN, SOUND, About, file_name
from foten.recording.inspection import inspect_recording
from foten.recording.preprocess import PreprocessConfig, blocks_of
from foten.recording.recording import Recording, counted
from foten.runtime.stylus import PressureCalibration
from foten.training.checkpoint import Epoch
from foten.training.job import TrainingJob, shortest_block
from foten.training.loop import Monitor

MODEL = "foten-plus"
NICENESS = 5  # below what renders: sound that somebody strokes comes first
MAX_RATE_HZ = 2500.0  # of the texture: it carries all that skin feels
ENOUGH_BLOCKS = 12
STAGES, LATE_STAGES = 2, 3  # before a texture is playable, and after that
PLAYABLE_SHARE, FITTED_SHARE = 0.4, 0.9  # of all the work, by and large


def main() -> None:
    """Train from the folder of the command line; exit with 2 where it is refused."""
    if hasattr(os, "nice"):
        os.nice(NICENESS)
    try:
        train_captured(Path(sys.argv[1]))
    except (ValueError, OSError) as error:
        _say(refused=reason(error) if isinstance(error, OSError) else str(error))
        raise SystemExit(2) from None


def train_captured(folder: Path) -> None:
    """Import a captured sound with its events, and train on them.

    Raises:
        ValueError: the two do not belong together, or are not enough.
        OSError: a file cannot be read or written.
    """
    about = About(**json.loads((folder / ABOUT).read_text(encoding="utf-8")))
    stem = file_name(about.name)
    _say(stage="joining the clocks", share=0.02)
    units = {} if about.full_scale_m_s2 is None else {"acceleration": f"*{about.full_scale_m_s2:.9g}"}
    calibration = PressureCalibration(about.newtons, about.steepness)
    recording, clock, decisions = import_capture(
        folder / SOUND, folder / PEN, ImportOptions(units=units), calibration.force
    )
    n_late = about.n_late_events
    late = [f"{counted(n_late, 'event')} of the pen came late, and count only as touches and lifts"] if n_late else []
    history = (*recording.history, *late)
    recording = dataclasses.replace(recording, texture=about.name, sensors=about.input, history=history)
    write_recording(recording, folder / f"{stem}.h5")
    joined = {"delay_ms": 1000 * clock.delay_s, "drift_ppm": 1e6 * clock.drift}
    _say(joined={**joined, "n_taps": clock.n_taps, "residual_ms": clock.residual_ms, "text": str(clock)})
    inspection = inspect_recording(recording)
    _say(notes=[*late, *decisions, *(problem.text for problem in inspection.problems)])
    train_recording(recording, inspection.carried, folder / f"{stem}.foten")


def train_recording(recording: Recording, carried: Mapping[float, float], output: Path) -> None:
    """Train a texture at the rate that carries the recording, by the share that each rate does (`perception.carried`)."""
    rate_hz = min(MAX_RATE_HZ, smallest_rate(carried)) if carried else PreprocessConfig().rate_hz
    usable_ms = 1000 * recording.duration_s
    blocks_ms = blocks_of(1000 * shortest_block(FotenPlusSizes().window) / rate_hz)
    block_ms = next((ms for ms in blocks_ms if usable_ms >= ENOUGH_BLOCKS * ms), blocks_ms[-1])
    config = FotenPlusConfig()
    # Nothing is to be trimmed: what lies before the first stroke and after the last was left out with the taps.
    preprocess = PreprocessConfig(rate_hz=rate_hz, trim_ms=0.0, block_ms=block_ms)
    job = TrainingJob(recording, MODEL, FotenPlusSizes(), config, preprocess, texture_name=recording.texture)
    share, is_playable = 0.05, False
    if withholds_recording(recording.microphone, rate_hz, config.recorded_innovations):
        _say(notes=[WITHHELD])

    def on_stage(stage: str) -> None:
        nonlocal share
        share += (1 - FITTED_SHARE) / LATE_STAGES if is_playable else (PLAYABLE_SHARE - 0.05) / STAGES
        _say(stage=stage, share=min(share, 0.99))

    def on_playable(texture: Texture) -> None:
        nonlocal share, is_playable
        write_texture(texture, output)
        if not is_playable:  # said once, though another linear model may be nearer
            _say(playable=output.name)
        share, is_playable = max(share, PLAYABLE_SHARE), True

    def on_epoch(line: Epoch) -> None:
        nonlocal share
        share = PLAYABLE_SHARE + (FITTED_SHARE - PLAYABLE_SHARE) * line.epoch / config.epochs
        _say(stage="training its network", share=share)

    trained = train(job, Monitor(on_stage, on_epoch, on_playable))
    write_texture(trained.texture, output)
    _say(done=output.name)


def _say(**message: Any) -> None:
    with contextlib.suppress(BrokenPipeError):  # nobody listens any more: the texture is still to be kept
        print(json.dumps(message), flush=True)


if __name__ == "__main__":
    main()
