"""How long a study of 100 participants takes to open: the operator's page and the report, in Chromium; and to be analysed.

    python benchmarks/study.py [--participants 100] [--csv FILE]

Twelve textures by four methods, under other names those that come along, rated by simulated raters.
"""

from __future__ import annotations

import subprocess
import tempfile
import time
from pathlib import Path

from bench import FOTEN, browser_page, parser_of, report, served
from foten.models.texture_file import read_texture, write_texture
from foten.runtime.renderer import EXAMPLE

TEXTURES, METHODS = 12, ("ar", "dstn", "ldhtd", "foten")


def foten(*arguments: str | Path) -> None:
    """Run a command of `foten study`."""
    subprocess.run([*FOTEN, "study", *arguments], check=True, capture_output=True)


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
    foten("new", study, *files, "--participants", str(participants))
    foten("simulate", study, "-o", folder / "study.db")
    return study


def main() -> None:
    parser = parser_of(__doc__)
    parser.add_argument("--participants", type=int, default=100)
    arguments = parser.parse_args()
    cells = [["", "seconds", "of"]]
    with tempfile.TemporaryDirectory() as name, browser_page() as page:
        folder = Path(name)
        study = prepared(folder, arguments.participants)
        ratings = f"{arguments.participants * TEXTURES * len(METHODS):,} ratings"
        begin = time.perf_counter()
        foten("analyze", folder / "study.db", "-o", folder / "results")
        cells.append(["foten study analyze", f"{time.perf_counter() - begin:.1f}", ratings])
        begin = time.perf_counter()
        page.goto((folder / "results" / "report.html").as_uri(), wait_until="load")
        page.wait_for_selector("figure svg >> nth=1")
        cells.append(["the report, opened", f"{time.perf_counter() - begin:.2f}", ratings])
        with served("study", "run", study, "--simulated", link=r"http\S+operator\S+") as link:
            begin = time.perf_counter()
            page.goto(link)
            page.wait_for_selector(f"#people li >> nth={arguments.participants - 1}", state="attached")
            taken = time.perf_counter() - begin
        cells.append(["the operator's page, opened", f"{taken:.2f}", f"{arguments.participants} participants"])
    report(cells, arguments.csv)


if __name__ == "__main__":
    main()
