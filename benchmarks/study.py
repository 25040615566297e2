"""How long a study of 100 participants takes to open: the operator's page and the report, in Chromium; and to be analysed.

    python benchmarks/study.py [--participants 100] [--csv FILE]

Twelve textures by four methods, under other names those that come along, rated by simulated raters.
"""

from __future__ import annotations

import argparse
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from playwright.sync_api import sync_playwright

from foten.models.texture_file import read_texture, write_texture
from foten.runtime.renderer import EXAMPLE
from result_table import add_csv, report

TEXTURES, METHODS = 12, ("ar", "dstn", "ldhtd", "foten")
FOTEN = (sys.executable, "-c", "from foten.cli import main; main()", "study")


def prepared(folder: Path, participants: int) -> Path:
    """A study's file in a folder, with its simulated ratings beside it."""
    sources = [read_texture(path) for path in sorted(EXAMPLE.parent.glob("*.foten"))]
    for t in range(TEXTURES):
        for m, method in enumerate(METHODS):
            source = sources[(t + m) % len(sources)]
            card = {**source.card, "texture": f"surface-{t + 1}", "licence": method}
            write_texture(type(source)(card, source.tensors), folder / f"surface-{t + 1}-{method}.foten")
    study = folder / "study.toml"
    files = sorted(folder.glob("*.foten"))
    subprocess.run([*FOTEN, "new", study, *files, "--participants", str(participants)], check=True, capture_output=True)
    subprocess.run([*FOTEN, "simulate", study, "-o", folder / "study.db"], check=True, capture_output=True)
    return study


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--participants", type=int, default=100)
    add_csv(parser)
    arguments = parser.parse_args()
    chromium = next(
        (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
    )
    if chromium is None:
        sys.exit("Chromium is missing: apt install chromium")
    cells = [["", "seconds", "of"]]
    with tempfile.TemporaryDirectory() as name, sync_playwright() as playwright:
        folder = Path(name)
        study = prepared(folder, arguments.participants)
        ratings = f"{arguments.participants * TEXTURES * len(METHODS):,} ratings"
        begin = time.perf_counter()
        subprocess.run(
            [*FOTEN, "analyze", folder / "study.db", "-o", folder / "results"], check=True, capture_output=True
        )
        cells.append(["foten study analyze", f"{time.perf_counter() - begin:.1f}", ratings])
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page()
        begin = time.perf_counter()
        page.goto((folder / "results" / "report.html").as_uri(), wait_until="load")
        page.wait_for_selector("figure svg >> nth=1")
        cells.append(["the report, opened", f"{time.perf_counter() - begin:.2f}", ratings])
        command = [*FOTEN, "run", str(study), "--simulated", "--no-open", "--port", "0"]
        process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
        try:
            assert process.stderr is not None
            link = next(found[0] for line in process.stderr if (found := re.search(r"http\S+operator\S+", line)))
            begin = time.perf_counter()
            page.goto(link)
            page.wait_for_selector(f"#people li >> nth={arguments.participants - 1}", state="attached")
            taken = time.perf_counter() - begin
            cells.append(["the operator's page, opened", f"{taken:.2f}", f"{arguments.participants} participants"])
        finally:
            process.send_signal(signal.SIGTERM)
            process.communicate(timeout=30)
        browser.close()
    report(cells, arguments.csv)


if __name__ == "__main__":
    main()
