"""Does a sweep survive the loss of a node, and are its results those of an undisturbed one?

    python benchmarks/sweep.py [--runs 24]

Starts two Ray nodes of one core each on this machine, sweeps once undisturbed and once with a node killed half-way, and compares
the results: all of them there, and equal but for the seconds.
"""

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

from foten_lab.experiment import Experiment, Method
from foten_lab.sweep import sweep

RAY = shutil.which("ray", path=str(Path(sys.executable).parent)) or "ray"
HOST, PORT = "127.0.0.2", 6399  # of the loopback, where Ray does not take it for the machine's own address


def experiment(n_runs: int) -> Experiment:
    """Quick runs, a split each."""
    return Experiment(
        title="quick runs",
        textures=("linear-cloth",),
        methods=(Method("fnn"), Method("fnn", name="excited", sizes={"excitation": True})),
        seconds=8,
        split_seeds=tuple(range(1, (n_runs + 1) // 2 + 1)),
        train={"epochs": 2},
        preprocess={"trim_ms": 0.0, "block_ms": 1000.0},
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
    results = {path.name: json.loads(path.read_text()) for path in folder.glob("*.json")}
    for result in results.values():
        del result["seconds"]
    return results


def main() -> None:
    """Compare a sweep over two nodes with one that loses a node half-way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=24)
    asked = experiment(parser.parse_args().runs)
    n = len(asked.runs())
    results = []
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
            results.append(results_of(Path(folder)))
        print(
            f"{'a node lost half-way' if lost else 'undisturbed'}: {done} of {n} runs done, {failed} failed, {seconds:.0f} s"
        )
    equal = results[0] == results[1]
    print(f"results {'equal' if equal else 'differ'}, {len(results[1])} of {n} there")
    sys.exit(0 if equal and len(results[1]) == n else 1)


if __name__ == "__main__":
    main()
