"""What benchmarks share: calls that are timed, servers and the browser that asks them, tables as Markdown and CSV."""

from __future__ import annotations

import argparse
import csv
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from foten.atomic_write import atomic_write
from foten.models.texture_file import Texture, read_texture, write_texture
from foten.reporting.table import Table

if TYPE_CHECKING:
    from foten.training.job import TrainingJob

ROOT = Path(__file__).parents[1]
FOTEN = (sys.executable, "-c", "from foten.cli import main; main()")


def parser_of(description: str | None) -> argparse.ArgumentParser:
    """Parser of a benchmark's options, one of which keeps its table."""
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--csv", type=Path, metavar="FILE", help="keep the table as CSV there")
    return parser


def report(cells: Sequence[Sequence[str]], path: Path | None = None) -> None:
    """Print a table, its heading first, and write it to a path where one is given."""
    table = Table.of(cells[0], cells[1:])
    print(table.markdown(), end="")
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        table.write(path, "csv")


def read_rows(path: Path) -> list[dict[str, str]]:
    """Rows that `write_rows` wrote; none where there is no file."""
    return list(csv.DictReader(path.open(encoding="utf-8"))) if path.is_file() else []


def write_rows(rows: Sequence[Mapping[str, str]], path: Path) -> None:
    """Write rows that may lack some of the columns, at once."""
    columns = list(dict.fromkeys(name for row in rows for name in row))
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as part, part.open("w", newline="") as file:
        table = csv.DictWriter(file, columns, restval="", lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


def stored(path: Path, simulate: Callable[[], Mapping[str, Any]]) -> dict[str, np.ndarray]:
    """Arrays of an .npz file, simulated once."""
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        arrays = simulate()
        with atomic_write(path) as part, part.open("wb") as file:
            np.savez(file, **arrays)
    with np.load(path) as file:
        return dict(file)


def untrained(model: str, *arguments: Any, **card: Any) -> Texture:
    """Texture of a network that nobody trained, as the tests make it: its time is the same."""
    sys.path.insert(0, str(ROOT / "tests"))
    from conftest import exported

    return exported(model, *arguments, **card)


def trained(path: Path, job: Callable[[], TrainingJob]) -> Texture:
    """Texture in a file, trained once, on one thread."""
    if not path.is_file():
        import torch

        from foten.models.trainable import train

        torch.set_num_threads(1)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_texture(train(job()).texture, path)
    return read_texture(path)


def times_us(call: Callable[[], object], n: int, n_warm: int = 0) -> list[float]:
    """How long each of n calls takes [µs], after some that are not counted."""
    for _ in range(n_warm):
        call()
    times = []
    for _ in range(n):
        begin = time.perf_counter_ns()
        call()
        times.append((time.perf_counter_ns() - begin) / 1000)
    return times


@contextmanager
def served(*arguments: str | Path, link: str = r"http://\S+") -> Iterator[str]:
    """A command of foten that serves at any port, and the first of its links that fits."""
    command = [*FOTEN, *map(str, arguments), "--no-open", "--port", "0"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stderr is not None
        links = (match[0] for line in process.stderr if (match := re.search(link, line)))
        first = next(links, None)
        if first is None:
            sys.exit("the server did not start")
        yield first
    finally:
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=30)


@contextmanager
def browser_page(*flags: str) -> Iterator[Any]:
    """A page in Chromium."""
    from playwright.sync_api import sync_playwright

    programs = filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome")))
    if (chromium := next(programs, None)) is None:
        sys.exit("Chromium is missing: apt install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", *flags])
        yield browser.new_page()
        browser.close()
