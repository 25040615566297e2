"""What a sweep costs beside a plain loop, and whether it survives the loss of a node.

    python benchmarks/sweep.py overhead [--runs 4] [--epochs 6]
    python benchmarks/sweep.py nodes [--runs 24]

`overhead` executes the same runs one after the other in this process, then in a sweep with one worker, and prints the ratio of a
run's time, and how much of the difference is Ray's start and how much the worker's. `nodes` starts two Ray nodes of one core each
on this machine, sweeps once undisturbed and once with a node killed half-way, and compares the results: all of them there, and
equal but for the seconds.
"""

from __future__ import annotations

import argparse
import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Nodes and whoever asks them know each other by a token, which lives as long as this process.
os.environ.setdefault("RAY_AUTH_MODE", "token")
os.environ.setdefault("RAY_AUTH_TOKEN", secrets.token_hex(32))

from foten.experiments.experiment import Experiment, Method, recording_of
from foten.experiments.run import execute
from foten.experiments.sweep import sweep

RAY = shutil.which("ray", path=str(Path(sys.executable).parent)) or "ray"
HOST, PORT = "127.0.0.2", 6399  # of the loopback, where Ray does not take it for the machine's own address


def experiment(n_runs: int, epochs: int) -> Experiment:
    """Quick runs, a split each."""
    return Experiment(
        title="quick runs",
        textures=("linear-cloth",),
        methods=(Method("fnn"), Method("fnn", name="excited", sizes={"excitation": True})),
        seconds=8,
        split_seeds=tuple(range(1, (n_runs + 1) // 2 + 1)),
        train={"epochs": epochs},
        preprocess={"trim_ms": 0.0, "block_ms": 1000.0},
    )


def overhead(arguments: argparse.Namespace) -> None:
    """Print the time of a run in a plain loop and in a sweep."""
    long = Experiment(
        title="runs of some half a minute",
        textures=("linear-cloth",),
        methods=(Method("foten"),),
        seconds=24,
        split_seeds=tuple(range(1, arguments.runs + 1)),
        train={"epochs": arguments.epochs},
        preprocess={"trim_ms": 0.0, "block_ms": 1000.0},
    )
    runs = long.runs()
    execute(runs[0], recording_of(runs[0]))  # what is loaded once is not a run's
    started = time.perf_counter()
    for run in runs:
        execute(run, recording_of(run))
    plain = (time.perf_counter() - started) / len(runs)
    with tempfile.TemporaryDirectory() as folder:
        started = time.perf_counter()
        done, failed = sweep(long, Path(folder), workers=1)
        swept = (time.perf_counter() - started) / len(runs)
        assert (done, failed) == (len(runs), 0)
        results = (json.loads(path.read_text()) for path in Path(folder).glob("*.json"))
        within = sum(sum(result["seconds"].values()) for result in results) / len(runs)
    print(
        f"{len(runs)} runs: plain loop {plain:.1f} s a run, sweep {swept:.1f} s a run: {swept / plain:.3f} of it; "
        f"in the worker {within:.1f} s a run, around them {(swept - within) * len(runs):.1f} s in all"
    )


@contextmanager
def node(*options: str) -> Iterator[subprocess.Popen[bytes]]:
    """Start a Ray node of one core, and end it with everything that it started."""
    command = [RAY, "start", "--block", "--num-cpus", "1", "--node-ip-address", HOST, *options]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        yield process
    finally:
        kill(process)


def kill(process: subprocess.Popen[bytes]) -> None:
    """Kill a node as a lost machine would go: at once."""
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def results_of(folder: Path) -> dict[str, dict[str, Any]]:
    """The results by name, without what no two runs share."""
    found = {path.name: json.loads(path.read_text()) for path in folder.glob("*.json")}
    for result in found.values():
        del result["seconds"]
    return found


def nodes(arguments: argparse.Namespace) -> None:
    """Compare a sweep over two nodes with one that loses a node half-way."""
    asked = experiment(arguments.runs, 2)
    n = len(asked.runs())
    found = []
    for lost in (False, True):
        with (
            tempfile.TemporaryDirectory() as folder,
            node("--head", "--port", str(PORT), "--include-dashboard", "false"),
        ):
            time.sleep(10)
            with node("--address", f"{HOST}:{PORT}") as second:
                time.sleep(10)

                def say(text: str, lost: bool = lost, second: Any = second) -> None:
                    if lost and text.startswith(f"{n // 2}/{n} "):
                        kill(second)
                        print(f"  a node was killed after {n // 2} runs", file=sys.stderr)

                started = time.perf_counter()
                done, failed = sweep(asked, Path(folder), address=f"{HOST}:{PORT}", say=say)
                seconds = time.perf_counter() - started
            found.append(results_of(Path(folder)))
        print(
            f"{'a node lost half-way' if lost else 'undisturbed'}: {done} of {n} runs done, {failed} failed, {seconds:.0f} s"
        )
    equal = found[0] == found[1]
    print(f"results {'equal' if equal else 'differ'}, {len(found[1])} of {n} there")
    sys.exit(0 if equal and len(found[1]) == n else 1)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(required=True)
    cost = commands.add_parser("overhead")
    cost.add_argument("--runs", type=int, default=4)
    cost.add_argument("--epochs", type=int, default=6)
    cost.set_defaults(command=overhead)
    loss = commands.add_parser("nodes")
    loss.add_argument("--runs", type=int, default=24)
    loss.set_defaults(command=nodes)
    arguments = parser.parse_args()
    arguments.command(arguments)


if __name__ == "__main__":
    main()
