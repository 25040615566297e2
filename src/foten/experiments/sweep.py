"""Every run of an experiment, on one machine or a cluster: Ray spreads them, this process keeps what comes back.

A result is one file named by the hash of all that it depends on, written by the process that sweeps, whole or not at all: a sweep
goes on where it stopped, may be started twice, and survives a worker or a node, whose runs Ray starts elsewhere. A recording
goes to each node once, through Ray's object store.
"""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import foten
from foten.architecture import ArArchitecture, architecture_from
from foten.atomic_write import atomic_write
from foten.datasets.hdf5 import load_recording
from foten.datasets.simulate import simulate
from foten.evaluate.evaluate import Judgement, evaluate
from foten.evaluate.figures import N_WAVEFORM, densities, scored_channels, shown_run, typical_block
from foten.evaluate.free_run import scored
from foten.experiments.experiment import Experiment, Run
from foten.experiments.tables import is_whole
from foten.experiments.truth import truth_for
from foten.recording.preprocess import PreprocessConfig
from foten.recording.recording import Recording
from foten.texture_file import Texture
from foten.train.config import TrainConfig

Waiting = tuple[int, Run, Path]
"""A run without a result: its place in the experiment, and the path that its result will have."""
RETRIES = 3  # of a run whose worker or node is lost
ANSWER_S = 5.0  # that a cluster has to answer in
THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


@dataclass(frozen=True)
class Progress:
    """How far a sweep is.

    Attributes:
        n_done, n_failed, n_left: runs; those of earlier sweeps are not counted.
        last: the run that ended, its seconds, and why it failed, "" where it did not.
        left_s: that the rest takes at this pace [s].
    """

    n_done: int
    n_failed: int
    n_left: int
    last: Run
    seconds: float
    why: str
    left_s: float


def recording_of(run: Run) -> Recording:
    """Return what a run learns from."""
    if run.seconds is None:
        return load_recording(Path(run.texture))
    return simulate(run.texture, run.seconds, seed=run.split_seed)


def execute(run: Run, recording: Recording) -> dict[str, Any]:
    """Return the result of one run: what was trained, its figures on the test blocks, and how long both took."""
    started = time.perf_counter()
    texture = _trained(run, recording)
    return _judged(run, recording, texture, time.perf_counter() - started)


def execute_together(runs: Sequence[Run], recordings: Sequence[Recording]) -> list[dict[str, Any]]:
    """Return the results of runs that differ by texture and split alone, trained as one batched model; or why there is none."""
    from foten.train.train import train_together

    first, started = runs[0], time.perf_counter()
    architecture = architecture_from(first.model, first.sizes)
    assert not isinstance(architecture, ArArchitecture)
    trained = train_together(
        recordings,
        first.model,
        architecture,
        [TrainConfig(**run.train) for run in runs],
        PreprocessConfig(**first.preprocess),
        [run.split_seed for run in runs],
    )
    seconds = (time.perf_counter() - started) / len(runs)
    found = []
    for run, recording, one in zip(runs, recordings, trained, strict=True):
        try:
            if isinstance(one, Exception):
                raise one
            found.append(_judged(run, recording, one.texture, seconds, len(runs)))
        except Exception as error:
            found.append(_failed(error))
    return found


def _judged(
    run: Run, recording: Recording, texture: Texture, seconds: float, n_together: int = 1
) -> dict[str, Any]:
    trained = time.perf_counter()
    judgement = evaluate(texture, recording, truth_for(recording, texture))
    document, metrics = judgement.document, texture.card["metrics"]
    return {
        "run": asdict(run),
        "foten": foten.__version__,
        "versions": texture.card["training"]["versions"],
        "recording_sha256": document["recording_sha256"],
        "seconds": {"training": seconds, "evaluation": time.perf_counter() - trained},
        "trained_together": n_together,
        "n_epochs": metrics.get("n_epochs"),
        "validation_mae_scaled": metrics["validation_mae_scaled"],
        "file_bytes": len(texture.to_bytes()),
        "evaluation": document,
        "signals": _signals(judgement),
    }


def _signals(judgement: Judgement) -> dict[str, Any] | None:
    """Return what pictures are drawn from: 400 samples of a typical test block, and spectra of all of them."""
    shown = shown_run(judgement)
    if shown is None:
        return None
    block, part = typical_block(judgement), scored(judgement.trace.block)
    frequencies, density = densities(judgement)
    return {
        "recorded": _rounded(scored_channels(judgement)[0][block, :N_WAVEFORM]),
        "free_run": _rounded(judgement.synthesized[shown][0, block, part][:N_WAVEFORM]),
        "frequencies_hz": _rounded(frequencies),
        "density": {"recorded": _rounded(density["recorded"]), "free_run": _rounded(density[shown])},
    }


def _rounded(values: Any) -> list[float]:
    """Return numbers as a picture needs them, five digits each."""
    return [float(f"{value:.5g}") for value in values]


def _trained(run: Run, recording: Recording) -> Texture:
    preprocess = PreprocessConfig(**run.preprocess)
    if run.model == "ar":
        from foten.train.local import train_local

        return train_local(recording, preprocess, split_seed=run.split_seed).texture
    from foten.train.train import train_texture

    architecture = architecture_from(run.model, run.sizes)
    assert not isinstance(architecture, ArArchitecture)
    config = TrainConfig(**run.train)
    trained = train_texture(recording, run.model, architecture, config, preprocess, split_seed=run.split_seed)
    if trained.progress.interrupted:
        raise KeyboardInterrupt
    return trained.texture


def sweep(
    experiment: Experiment,
    results: Path,
    workers: int | None = None,
    address: str | None = None,
    gpus_per_run: float = 0.0,
    on_progress: Callable[[Progress], None] = lambda progress: None,
    say: Callable[[str], None] = lambda text: None,
    together: int = 1,
) -> tuple[int, int]:
    """Execute the runs of an experiment that have no result yet, and keep one file each.

    Args:
        experiment: what to run.
        results: folder of the result files.
        workers: runs at a time on this machine; one a core by default. Each has one thread.
        address: of a Ray cluster, "auto" for the one that this machine is part of; None starts Ray here.
        gpus_per_run: share of a GPU that each run takes.
        on_progress: called after each run.
        say: called with what goes on.
        together: textures that are trained as one batched model at most, where the model can be (`TOGETHER`).

    Returns:
        How many runs were done, and how many failed.

    Raises:
        ValueError: a setting does not fit, or there is no such cluster.
    """
    import ray

    if address is not None and workers is not None:
        raise ValueError(
            "--workers is of this machine: a cluster at --address has as many as its nodes have cores"
        )
    runs = experiment.runs()
    results.mkdir(parents=True, exist_ok=True)
    recordings: dict[Any, tuple[str, Recording]] = {}
    waiting, named = [], dict[Path, Run]()
    for index, run in enumerate(runs):
        if run.source not in recordings:
            recording = recording_of(run)
            recordings[run.source] = recording.sha256(), recording
        path = results / f"{run.name(recordings[run.source][0], foten.__version__)}.json"
        if path in named:
            raise ValueError(
                f"{named[path].texture} and {run.texture} are the same recording: leave one of them out"
            )
        named[path] = run
        if not _kept(path, _about(experiment, index, run), say):
            waiting.append((index, run, path))
    say(f"{len(runs)} runs, {len(runs) - len(waiting)} of them done before")
    if not waiting:
        return 0, 0
    _start_ray(workers, address, gpus_per_run)
    try:
        if gpus_per_run > ray.cluster_resources().get("GPU", 0):
            raise ValueError(f"--gpus-per-run is {gpus_per_run:g}, and Ray finds no such GPU")
        needed = {run.source for _, run, _ in waiting}
        kept = {source: ray.put(recordings[source][1]) for source in needed}
        recordings.clear()
        task = ray.remote(num_cpus=1, num_gpus=gpus_per_run, max_retries=RETRIES)(_guarded)
        pending = {
            task.remote([asdict(run) for _, run, _ in some], *(kept[run.source] for _, run, _ in some)): some
            for some in _groups(waiting, together)
        }
        return _collected(experiment, pending, on_progress)
    finally:
        ray.shutdown()


def _about(experiment: Experiment, index: int, run: Run) -> dict[str, Any]:
    """Return what a result says of its place in an experiment, on which its figures do not depend."""
    return {
        "index": index,
        "experiment": {"title": experiment.title, "note": experiment.note},
        "run": asdict(run),
    }


def _kept(path: Path, about: Mapping[str, Any], say: Callable[[str], None]) -> bool:
    """Return whether a run has a result, which from now on is called as the experiment calls it."""
    if not path.exists():
        return False
    try:
        result = json.loads(path.read_bytes())
    except ValueError:
        result = None
    if not is_whole(result):
        say(f"{path.name} is damaged, and is made again")
        return False
    if any(result.get(key) != value for key, value in json.loads(json.dumps(about)).items()):
        _write(path, {**result, **about})
    return True


def _write(path: Path, result: Mapping[str, Any]) -> None:
    with atomic_write(path) as part:
        part.write_text(json.dumps(result, indent=1, sort_keys=True) + "\n")


def _start_ray(workers: int | None, address: str | None, gpus_per_run: float) -> None:
    import ray

    quiet: dict[str, Any] = {"log_to_driver": False, "logging_level": "error"}
    # What asks for no GPU sees none: else all workers would be on the first one at once.
    unseen = {} if gpus_per_run > 0 else {"CUDA_VISIBLE_DEVICES": ""}
    environment = {"env_vars": {**THREADS, **unseen}}
    if address is not None:
        _check_answered(address)
    try:
        if address is None:
            ray.init(
                address="local",
                num_cpus=workers or os.cpu_count(),
                include_dashboard=False,
                runtime_env=environment,
                **quiet,
            )
        else:
            ray.init(address=address, runtime_env=environment, **quiet)
    except (ConnectionError, RuntimeError) as error:
        if address is None:
            raise ValueError(f"Ray does not start here: {str(error).splitlines()[0]}") from error
        raise ValueError(f"{_no_cluster(address)} ({str(error).splitlines()[0]})") from error


def _no_cluster(address: str) -> str:
    return f"no Ray cluster answers at {address}: was it started with 'ray start --head', and is RAY_AUTH_TOKEN its token?"


def _check_answered(address: str) -> None:
    """Check that somebody listens at HOST:PORT: Ray itself would ask for ten minutes, and heed no Ctrl-C.

    Raises:
        ValueError: nobody does.
    """
    host, _, port = address.rpartition(":")
    if "://" in address or not port.isdecimal():
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWER_S).close()
    except (OSError, OverflowError) as error:
        raise ValueError(f"{_no_cluster(address)} ({error})") from error


def _groups(waiting: Sequence[Waiting], together: int) -> list[list[Waiting]]:
    """Return the runs by what one worker does at a time, in their order: one, or several that can be trained together."""
    from foten.train.together import TOGETHER

    found: list[list[Waiting]] = []
    open_groups: dict[str, list[Waiting]] = {}
    for one in waiting:
        run = one[1]
        alike = {"sizes": run.sizes, "train": {**run.train, "seed": 0}, "preprocess": run.preprocess}
        key = json.dumps({"model": run.model, **alike}, sort_keys=True)
        can = run.model in TOGETHER and run.train["threads"] == 1 and run.train["average"] == 0
        if can and len(open_groups.get(key, ())) % together:
            open_groups[key].append(one)
        else:
            found.append([one])
            open_groups[key] = found[-1]
    return found


def _guarded(runs: Sequence[Mapping[str, Any]], *recordings: Recording) -> list[dict[str, Any]]:
    """Return the runs' results, or why there is none: an error of ours would be the same on another worker."""
    try:
        some = [Run(**run) for run in runs]
        return execute_together(some, recordings) if len(some) > 1 else [execute(some[0], recordings[0])]
    except Exception as error:  # is told beside the run, of which the others are independent
        return [_failed(error)] * len(runs)


def _failed(error: Exception) -> dict[str, Any]:
    said = str(error).splitlines() or [""]
    return {"failed": f"{type(error).__name__}: {said[0]}"}


def _collected(
    experiment: Experiment,
    pending: dict[Any, list[Waiting]],
    on_progress: Callable[[Progress], None],
) -> tuple[int, int]:
    import ray

    started = time.perf_counter()
    n_done = n_failed = 0
    while pending:
        (ready, *_), _ = ray.wait(list(pending), num_returns=1)
        some = pending.pop(ready)
        n_left = sum(map(len, pending.values())) + len(some)
        try:
            results = ray.get(ready)
        except ray.exceptions.RayError as error:
            results = [{"failed": f"lost {RETRIES + 1} times: {str(error).splitlines()[0]}"}] * len(some)
        for (index, run, path), result in zip(some, results, strict=True):
            why = str(result.get("failed", ""))
            if why:
                n_failed += 1
            else:
                _write(path, {**result, **_about(experiment, index, run)})
                n_done += 1
            n_left -= 1
            seconds = sum(result["seconds"].values()) if "seconds" in result else 0.0
            pace = (time.perf_counter() - started) / (n_done + n_failed)
            on_progress(Progress(n_done, n_failed, n_left, run, seconds, why, pace * n_left))
    return n_done, n_failed
