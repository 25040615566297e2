"""Every run of an experiment, on one machine or a cluster: Ray distributes them, this process writes the results.

A result is one file, named by the hash of all that it depends on and written atomically by the process that sweeps. So a sweep
continues where it stopped and may be started twice. Ctrl-C and SIGTERM, by which batch queues end a job, stop it. Ray restarts
the runs of a lost worker or node elsewhere. A recording goes to each node once, through Ray's object store.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import ray

import foten
from foten.atomic_write import atomic_write
from foten.experiments.experiment import Experiment, Run, recording_of
from foten.experiments.results import read_result
from foten.experiments.run import execute, failure
from foten.recording.recording import Recording

Waiting = tuple[int, Run, Path]
"""A run without a result: its place in the experiment, and the path that its result will have."""
RETRIES = 3  # of a run whose worker or node is lost
ANSWER_S = 5.0  # in which a cluster has to answer
NO_CLUSTER = (
    "no Ray cluster answers at {}: was it started with 'ray start --head', and is RAY_AUTH_TOKEN its token? ({})"
)


class Stopped(KeyboardInterrupt):
    """A sweep that was stopped, and has said so."""


THREADS = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}


def sweep(
    experiment: Experiment,
    results: Path,
    workers: int | None = None,
    address: str | None = None,
    gpus_per_run: float = 0.0,
    say: Callable[[str], None] = lambda text: None,
) -> tuple[int, int]:
    """Execute the runs of an experiment that have no result yet, keep one file each, and return how many were done and failed.

    Args:
        workers: runs at a time on this machine; one for each core by default. Each has one thread.
        address: of a Ray cluster, "auto" for the one that this machine is part of; None starts Ray here.
        gpus_per_run: share of a GPU that each run takes.

    Raises:
        ValueError: a setting does not fit, or there is no such cluster.
        Stopped: by Ctrl-C or SIGTERM.
    """
    if address is not None and workers is not None:
        raise ValueError("--workers is of this machine: a cluster at --address has as many as its nodes have cores")
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
            raise ValueError(f"{named[path].texture} and {run.texture} are the same recording: leave one of them out")
        named[path] = run
        if not _kept(path, _about(experiment, index, run), say):
            waiting.append((index, run, path))
    say(f"{len(runs)} runs, {len(runs) - len(waiting)} of them done before")
    if not waiting:
        return 0, 0
    before = signal.getsignal(signal.SIGTERM)
    try:
        _stoppable(lambda: _start_ray(workers, address, gpus_per_run))
        _handle_sigterm(signal.default_int_handler)
        if gpus_per_run > ray.cluster_resources().get("GPU", 0):
            raise ValueError(f"--gpus-per-run is {gpus_per_run:g}, and Ray finds no such GPU")
        kept = {source: ray.put(recordings[source][1]) for source in {run.source for _, run, _ in waiting}}
        recordings.clear()  # held by Ray's object store from here on
        task = ray.remote(num_cpus=1, num_gpus=gpus_per_run, max_retries=RETRIES)(_guarded)
        pending = {task.remote(asdict(one[1]), kept[one[1].source]): one for one in waiting}
        return _collected(experiment, pending, say)
    except KeyboardInterrupt as error:
        # Before Ray is shut down, which takes seconds.
        n_done = sum(path.exists() for path in named)
        say(f"stopped, {n_done} of {len(runs)} done; the same command goes on")
        raise Stopped from error
    finally:
        ray.shutdown()
        _handle_sigterm(before)


def _handle_sigterm(handler: Any) -> None:
    """Set the handler of SIGTERM, where this thread may: Ray's own print a trace and abort."""
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, handler)


def _stoppable(start: Callable[[], None]) -> None:
    """Start Ray, and raise KeyboardInterrupt where Ctrl-C or SIGTERM came meanwhile.

    What a handler raises while Ray forks a process is lost, and at SIGTERM Ray exits. The signals' numbers are kept in any case.
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


def _about(experiment: Experiment, index: int, run: Run) -> dict[str, Any]:
    """Return a result's place in an experiment and its names, on which its figures do not depend."""
    return {"index": index, "experiment": {"title": experiment.title, "note": experiment.note}, "run": asdict(run)}


def _kept(path: Path, about: Mapping[str, Any], say: Callable[[str], None]) -> bool:
    """Return whether a run has a result, and update the names in it to those of the experiment."""
    if not path.exists():
        return False
    result = read_result(path)
    if result is None:
        say(f"{path.name} is damaged, and is made again")
        return False
    if any(result.get(key) != value for key, value in json.loads(json.dumps(about)).items()):
        _write(path, {**result, **about})
    return True


def _write(path: Path, result: Mapping[str, Any]) -> None:
    with atomic_write(path) as part:
        part.write_text(json.dumps(result, indent=1, sort_keys=True) + "\n")


def _start_ray(workers: int | None, address: str | None, gpus_per_run: float) -> None:
    # Runs that ask for no GPU see none; otherwise all workers would use the first one at once.
    unseen = {} if gpus_per_run > 0 else {"CUDA_VISIBLE_DEVICES": ""}
    options: dict[str, Any] = {"address": "local", "num_cpus": workers or os.cpu_count(), "include_dashboard": False}
    if address is not None:
        _check_answered(address)
        options = {"address": address}
    environment = {"env_vars": {**THREADS, **unseen}}
    try:
        ray.init(**options, runtime_env=environment, log_to_driver=False, logging_level="error")
    except (ConnectionError, RuntimeError) as error:
        why = str(error).splitlines()[0]
        if address is None:
            raise ValueError(f"Ray does not start here: {why}") from error
        raise ValueError(NO_CLUSTER.format(address, why)) from error


def _check_answered(address: str) -> None:
    """Check that HOST:PORT accepts connections: Ray itself would try for ten minutes and ignore Ctrl-C."""
    host, _, port = address.rpartition(":")
    if "://" in address or not port.isdecimal():
        return
    try:
        socket.create_connection((host.strip("[]"), int(port)), timeout=ANSWER_S).close()
    except (OSError, OverflowError) as error:
        raise ValueError(NO_CLUSTER.format(address, error)) from error


def _guarded(run: Mapping[str, Any], recording: Recording) -> dict[str, Any]:
    """Result of a run, or the reason why there is none: Ray retries what raises, and an error here would recur."""
    try:
        return execute(Run(**run), recording)
    except Exception as error:
        return failure(error)


def _collected(experiment: Experiment, pending: dict[Any, Waiting], say: Callable[[str], None]) -> tuple[int, int]:
    started = time.perf_counter()
    n_done = n_failed = 0
    n_runs = len(pending)
    while pending:
        (ready, *_), _ = ray.wait(list(pending), num_returns=1)
        index, run, path = pending.pop(ready)
        try:
            result = ray.get(ready)
        except ray.exceptions.RayError as error:
            result = {"failed": f"lost {RETRIES + 1} times: {str(error).splitlines()[0]}"}
        if "failed" in result:
            n_failed += 1
            ended = f"failed: {result['failed']}"
        else:
            n_done += 1
            ended = f"{sum(result['seconds'].values()):.0f} s"
            _write(path, {**result, **_about(experiment, index, run)})
        n = n_done + n_failed
        minutes = (time.perf_counter() - started) / n * (n_runs - n) / 60
        left = f", about {minutes:.0f} min left" if n < n_runs else ""
        name = f"{run.label} ({run.recipe})" if run.recipe else run.label
        say(f"{n}/{n_runs} {name}, {run.texture}, split {run.split_seed}: {ended}{left}")
    return n_done, n_failed
