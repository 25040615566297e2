"""All stages once, on a simulated recording: inspect, train, evaluate, render."""

from collections.abc import Callable
from pathlib import Path

from foten.cli.simulator_reference import reference_for
from foten.datasets.hdf5 import write_recording
from foten.evaluate.evaluate import evaluate
from foten.evaluate.report.page import write_report
from foten.models.foten_plus.config import FotenPlusConfig
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten.models.texture_file import write_texture
from foten.models.trainable import train
from foten.recording.inspection import inspect_recording
from foten.reporting.recording_pictures import write_pictures
from foten.runtime.live.sinks import write_audible, write_rendered
from foten.runtime.renderer import Renderer
from foten.runtime.stroke import recorded_stroke
from foten.simulation.simulate import simulate
from foten.training.checkpoint import Epoch
from foten.training.job import TrainingJob
from foten.training.loop import Monitor


def run_demo(
    directory: Path, key: str, seconds: float, epochs: int, seed: int, threads: int, say: Callable[[str], None]
) -> dict[str, Path]:
    """Simulate a recording, train on it, evaluate and render the texture, and return the files by name."""
    if directory.exists() and not directory.is_dir():
        raise ValueError(f"{directory} is a file, expected a folder")
    directory.mkdir(parents=True, exist_ok=True)
    say(f"1/5 simulating {seconds:g} s of stroking over {key}")
    recording = simulate(key, seconds, seed)
    paths = {"recording": directory / f"{key}.h5", "texture": directory / f"{key}.foten"}
    write_recording(recording, paths["recording"])
    say("2/5 inspecting it")
    (directory / "inspect").mkdir(exist_ok=True)
    write_pictures(recording, inspect_recording(recording), directory / "inspect")
    say(f"3/5 training foten-plus, at most {epochs} epochs")
    config = FotenPlusConfig(epochs=epochs, seed=seed, threads=threads)

    def on_epoch(line: Epoch) -> None:
        say(f"    epoch {line.epoch}: one-step validation error {line.validation_mae:.4f} sd, {line.seconds:.1f} s")

    job = TrainingJob(recording, "foten-plus", FotenPlusSizes(), config, texture_name=key)
    texture = train(job, Monitor(on_epoch=on_epoch, on_stage=lambda stage: say(f"    {stage}"))).texture
    write_texture(texture, paths["texture"])
    say("4/5 judging it on its test blocks")
    judgement = evaluate(texture, recording, reference_for(recording, texture), seed)
    paths["report"] = write_report(judgement, texture, directory / "report")
    say("5/5 rendering ten seconds of a fresh stroke")
    stroke = recorded_stroke(simulate(key, 10.0, seed + 1), texture.rate_hz)
    speed, force = stroke.conditioned(float(texture.card["lowpass_hz"]))
    acceleration = Renderer(texture, seed=seed).render(speed, force).astype(float)
    about = {"texture": key, "texture_sha256": texture.sha256(), "seed": seed}
    paths |= {"vibration": directory / "rendered.wav", "picture": directory / "rendered.png"}
    for name in ("vibration", "picture"):
        write_rendered(paths[name], acceleration, speed, force, texture.rate_hz, about)
    paths |= {"sound": directory / "rendered-48k.wav", "pictures": directory / "inspect"}
    write_audible(paths["sound"], acceleration, texture.rate_hz)
    return paths
