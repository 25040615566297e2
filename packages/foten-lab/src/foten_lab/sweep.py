"""Every run of an experiment, on one machine or a cluster: Ray distributes them, this process writes a file for each."""

import itertools
import json
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import ray
from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

from foten.atomic_write import atomic_write
from foten.recording.recording import Recording
from foten.training.loop import device_name
from foten_lab.experiment import Experiment, Run, of_lines, recording_of
from foten_lab.provenance import Provenance, platform_here, provenance_of
from foten_lab.results import read_result
from foten_lab.run import execute

RETRIES = 3  # of a run whose worker or node is lost
ANSWER_S = 5.0  # in which a cluster has to answer
LEFT_S = 600.0  # after which what a worker wrote in part was left, which takes it no second
QUIET_S = 300.0  # after which a line says that it goes on
NO_CLUSTER = "no Ray cluster answers at {}: was it started with 'ray start --head' and this RAY_AUTH_TOKEN? ({})"
THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
Say = Callable[[str], None]


class Stopped(KeyboardInterrupt):
    """Sweep that was stopped, after it has said so."""


@dataclass(frozen=True)
class Planned:
    """A run in its experiment, and the file of its result."""

    run: Run
    path: Path
    about: Mapping[str, Any]  # place in the experiment and names, on which no figure depends
    provenance: Provenance  # that a result has to have
    replaces: Path | None = None  # result of other data or settings in the same place of the tables

    @property
    def checkpoint(self) -> Path:
        """File that the training goes on from when it was stopped."""
        return self.path.with_suffix(".checkpoint").absolute()

    def write(self, result: Mapping[str, Any], texture: bytes | None = None) -> None:
        """Write the result, with the names of the experiment, after its texture file, where there is one.

        Then delete its checkpoint.
        """
        if texture is not None:
            with atomic_write(self.path.with_suffix(".foten")) as part:
                part.write_bytes(texture)
        with atomic_write(self.path) as part:
            part.write_text(json.dumps({**result, **self.about}, indent=1, sort_keys=True) + "\n")
        self.checkpoint.unlink(missing_ok=True)
        if self.replaces is not None:
            for suffix in (".json", ".foten", ".checkpoint"):
                self.replaces.with_suffix(suffix).unlink(missing_ok=True)


def sweep(
    experiment: Experiment,
    results: Path,
    workers: int | None = None,
    address: str | None = None,
    gpus_per_run: float = 0.0,
    say: Say = lambda text: None,
    mixed: bool = False,
    only: Sequence[str] = (),
) -> tuple[int, int]:
    """Execute the runs of an experiment that have no result yet, and return how many were done and failed.

    On this machine, a run that was stopped continues after the last epoch that it finished, with the same result.

    Args:
        workers: runs at a time on this machine; one for each core by default. Each has one thread.
        address: of a Ray cluster, "auto" for the one that this machine is part of; None starts Ray here.
        gpus_per_run: share of a GPU that each run takes.
        mixed: keep results of other platforms, as of a sweep that goes on elsewhere.
        only: texts, of which a run's line has to contain one.

    Raises:
        ValueError: a setting or a text does not fit, or there is no such cluster.
        Stopped: by Ctrl-C or SIGTERM.
    """
    if address is not None and workers is not None:
        raise ValueError("--workers is of this machine: a cluster at --address has as many as its nodes have cores")
    results.mkdir(parents=True, exist_ok=True)
    plan, recordings = planned(experiment, results, only)
    before = signal.getsignal(signal.SIGTERM)
    done: set[Path] = set()
    n_before = 0
    try:
        platforms: Sequence[Mapping[str, str]] = [platform_here()]
        if address is not None:
            _start_ray(workers, address, gpus_per_run)
            platforms = _cluster_platforms()
        waiting = lacking(plan, results, None if mixed else platforms, say)
        n_before = len(plan) - len(waiting)
        _clean(results, {item.path for item in plan} - {item.path for item in waiting})
        say(f"{len(plan)} runs, {n_before} of them done before")
        if not waiting:
            return 0, 0
        if address is None:
            _start_ray(workers, address, gpus_per_run)
        stored = {source: ray.put(recordings[source]) for source in {item.run.source for item in waiting}}
        recordings.clear()  # held by Ray's object store from here on
        task = ray.remote(num_cpus=1, num_gpus=gpus_per_run, max_retries=RETRIES)(_guarded)
        # A node of a cluster need not have the folder.
        checkpoints = [item.checkpoint if address is None else None for item in waiting]
        pending = {
            task.remote(asdict(item.run), stored[item.run.source], checkpoint): item
            for item, checkpoint in zip(waiting, checkpoints, strict=True)
        }
        return _collected(pending, done, say)
    except KeyboardInterrupt as error:
        # Before Ray is shut down, which takes seconds.
        say(f"stopped, {n_before + len(done)} of {len(plan)} done; the same command goes on")
        raise Stopped from error
    finally:
        ray.shutdown()
        _handle_sigterm(before)


def planned(
    experiment: Experiment, results: Path, only: Sequence[str] = ()
) -> tuple[list[Planned], dict[Any, Recording]]:
    """Runs of an experiment with the files of their results, and the recordings by source.

    Raises:
        ValueError: two runs are of the same recording and settings.
    """
    recordings: dict[Any, Recording] = {}
    plan: dict[Path, Planned] = {}
    runs = experiment.runs()
    taken = {run.place for run in of_lines(runs, only)}
    for index, run in enumerate(runs):
        if run.place not in taken:
            continue
        if run.source not in recordings:
            recordings[run.source] = recording_of(run)
        provenance = provenance_of(run, recordings[run.source].sha256())
        path = results / f"{provenance.name}.json"
        if path in plan:
            first, other = (f"{same.label!r} on {same.texture}" for same in (plan[path].run, run))
            raise ValueError(f"{first} and {other} are the same run: leave one of them out")
        titles = {"title": experiment.title, "note": experiment.note}
        plan[path] = Planned(run, path, {"index": index, "experiment": titles, "run": asdict(run)}, provenance)
    return list(plan.values()), recordings


def lacking(
    plan: Sequence[Planned], folder: Path, platforms: Sequence[Mapping[str, str]] | None, say: Say
) -> list[Planned]:
    """Runs without a result of the same code, data, configuration and one of the platforms, after a line on why; None for any.

    Results that stay take the names of the experiment. One of other data or settings is replaced where it is of this experiment.
    """
    files = {path: read_result(path) for path in folder.glob("*.json")}
    planned_paths = {item.path for item in plan}
    of_place = {
        (result["experiment"]["title"], Run(**result["run"]).place): path
        for path, result in files.items()
        if result is not None and path not in planned_paths
    }
    waiting: list[Planned] = []
    again: dict[str, list[Run]] = {}
    for item in plan:
        earlier = of_place.get((item.about["experiment"]["title"], item.run.place))
        path = item.path if item.path in files else earlier
        if path is None:
            waiting.append(item)
        elif why := _why_again(item, files[path], platforms):
            again.setdefault(why, []).append(item.run)
            waiting.append(replace(item, replaces=earlier))
        else:
            result = files[path] or {}
            if result != {**result, **json.loads(json.dumps(item.about))}:
                item.write(result)
    for why, runs in again.items():
        more = f" and {len(runs) - 1} more" if len(runs) > 1 else ""
        say(f"{runs[0].line}{more}: run again, {why}")
    return waiting


def _clean(results: Path, done: Collection[Path]) -> None:
    """Delete checkpoints of runs that are done, and parts of those that a worker wrote when it was ended."""
    for path in done:
        path.with_suffix(".checkpoint").unlink(missing_ok=True)
    for part in results.glob(".*.checkpoint.*.part"):
        with suppress(OSError):  # of a sweep beside this one
            if time.time() - part.stat().st_mtime > LEFT_S:
                part.unlink()


def _why_again(item: Planned, result: Mapping[str, Any] | None, platforms: Sequence[Mapping[str, str]] | None) -> str:
    """Reason why a result cannot stay, in words; nothing where it can."""
    if result is None:
        return f"as {item.path.name} is damaged"
    expected = (
        replace(item.provenance, platform=platform) for platform in platforms or [result["provenance"]["platform"]]
    )
    differences = min((provenance.differences(result["provenance"]) for provenance in expected), key=len)
    return f"as the result is of other {' and '.join(differences)}" if differences else ""


def _handle_sigterm(handler: Any) -> None:
    """Set the handler of SIGTERM, where this thread may: Ray's own print a trace and abort."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)


def _stoppable(start: Callable[[], None]) -> None:
    """Start Ray, and raise KeyboardInterrupt where Ctrl-C or SIGTERM came meanwhile.

    What a handler raises while Ray forks a process is lost, and at SIGTERM Ray exits.
    """
    if threading.current_thread() is not threading.main_thread():
        return start()
    received, sent = socket.socketpair()
    with received, sent:
        for end in (received, sent):
            end.setblocking(False)
        before = signal.set_wakeup_fd(sent.fileno())
        ended: SystemExit | None = None
        try:
            start()
        except SystemExit as error:
            ended = error
        finally:
            signal.set_wakeup_fd(before)
        with suppress(BlockingIOError):
            if {signal.SIGINT, signal.SIGTERM} & set(received.recv(64)):
                raise KeyboardInterrupt
        if ended is not None:
            raise ended


def _start_ray(workers: int | None, address: str | None, gpus_per_run: float) -> None:
    # Runs that ask for no GPU see none; otherwise all workers would use the first one at once.
    unseen = {} if gpus_per_run > 0 else {"CUDA_VISIBLE_DEVICES": ""}
    options: dict[str, Any] = {"address": "local", "num_cpus": workers or os.cpu_count(), "include_dashboard": False}
    if address is not None:
        _check_answered(address)
        options = {"address": address}
    options |= {"runtime_env": {"env_vars": {**THREADS, **unseen}}, "log_to_driver": False, "logging_level": "error"}
    try:
        _stoppable(lambda: ray.init(**options))
    except (ConnectionError, RuntimeError) as error:
        why = str(error).splitlines()[0]
        if address is None:
            raise ValueError(f"Ray does not start here: {why}") from error
        raise ValueError(NO_CLUSTER.format(address, why)) from error
    _handle_sigterm(signal.default_int_handler)
    if gpus_per_run > ray.cluster_resources().get("GPU", 0):
        raise ValueError(f"--gpus-per-run is {gpus_per_run:g}, and Ray finds no such GPU")


def _cluster_platforms() -> list[dict[str, str]]:
    """Platform of each node that can be given a run."""
    task = ray.remote(num_cpus=0)(lambda: platform_here())
    nodes = [node["NodeID"] for node in ray.nodes() if node["Alive"] and node["Resources"].get("CPU")]
    places = (NodeAffinitySchedulingStrategy(node, soft=False) for node in nodes)
    return list(ray.get([task.options(scheduling_strategy=place).remote() for place in places]))


def _check_answered(address: str) -> None:
    """Check that HOST:PORT accepts connections: Ray itself would try for ten minutes and ignore Ctrl-C."""
    host, _, port = address.rpartition(":")
    if "://" in address or not port.isdecimal():
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWER_S).close()
    except (OSError, OverflowError) as error:
        raise ValueError(NO_CLUSTER.format(address, error)) from error


def _guarded(run: Mapping[str, Any], recording: Recording, checkpoint: Path | None) -> tuple[dict[str, Any], bytes]:
    """Result and texture file of a run, or `failed` with the reason: Ray retries what raises, and an error here would recur."""
    try:
        checked = Run(**run)
        # Of this worker's machine, and of its sources before anybody changes them.
        provenance = provenance_of(checked, recording.sha256())
        about = {"code": provenance.code, "platform": dict(provenance.platform), "device": device_name()}
        result, texture = execute(checked, recording, checkpoint, about)
        return {**result, "provenance": provenance.to_json()}, texture.to_bytes()
    except Exception as error:
        return {"failed": f"{type(error).__name__}: {(str(error).splitlines() or [''])[0]}"}, b""


def _collected(pending: dict[Any, Planned], done: set[Path], say: Say) -> tuple[int, int]:
    """Write the results as they come, add their paths to `done`, and return how many were done and failed."""
    started = time.perf_counter()
    n_failed, n_runs = 0, len(pending)
    since = started
    while pending:
        ended, _ = ray.wait(list(pending), num_returns=1, timeout=QUIET_S)
        if not ended:
            running = [
                item.run.line for item in itertools.islice(pending.values(), int(ray.cluster_resources()["CPU"]))
            ]
            minutes = (time.perf_counter() - since) / 60
            say(f"{len(done) + n_failed}/{n_runs} for {minutes:.0f} min, likely at {'; '.join(running)}")
            continue
        ready, since = ended[0], time.perf_counter()
        item = pending.pop(ready)
        try:
            result, texture = ray.get(ready)
        except ray.exceptions.RayError as error:
            result, texture = {"failed": f"lost {RETRIES + 1} times: {str(error).splitlines()[0]}"}, b""
        if "failed" in result:
            n_failed += 1
            how = f"failed: {result['failed']}"
        else:
            how = f"{sum(result['seconds'].values()):.0f} s"
            item.write(result, texture)
            done.add(item.path)
        n = len(done) + n_failed
        left = f", about {(time.perf_counter() - started) / n * (n_runs - n) / 60:.0f} min left" if n < n_runs else ""
        say(f"{n}/{n_runs} {item.run.line}: {how}{left}")
    return len(done), n_failed
