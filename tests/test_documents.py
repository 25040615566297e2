"""What people read: every command of a tutorial runs, every link leads somewhere, every table is what the results give."""

from __future__ import annotations

import html
import json
import os
import re
import ssl
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from foten.models.foten.sizes import FotenSizes
from foten.models.foten_plus.config import FotenPlusConfig
from foten.models.foten_plus.sizes import FotenPlusSizes
from foten_lab.baselines.sizes import DstnSizes, FnnSizes, GanSizes, LdhtdSizes

ROOT = Path(__file__).parents[1]
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", ".github/SECURITY.md")),
    *sorted((ROOT / "docs").rglob("*.md")),
]
TUTORIALS = sorted((ROOT / "docs" / "tutorials").glob("*.md"))
FENCE = re.compile(r"(?:<!-- (?P<about>[^>]*) -->\n)?```(?P<language>\w*)\n(?P<code>.*?)```", re.S)


@dataclass(frozen=True)
class Block:
    """A fenced block of a page, and what a comment above it says of running it."""

    language: str
    code: str
    about: str  # "", "not run: why", "exit 2", "slow", "serves", "in the checkout: folders"


def blocks(page: Path) -> Iterator[Block]:
    for match in FENCE.finditer(page.read_text(encoding="utf-8")):
        yield Block(match["language"], match["code"], match["about"] or "")


def run(block: Block, folder: Path) -> None:
    """Run a block in a folder as a reader would, `foten` and `python` being those of the tests; a training has two epochs."""
    kind, _, what = block.about.partition(": ")
    for name in what.split() if kind == "in the checkout" else []:
        if not (folder / name).exists():
            (folder / name).symlink_to(ROOT / name)
    tools = folder / "bin"
    if not tools.exists():
        tools.mkdir()
        for name, program in (("foten", "-c 'from foten.cli import main; main()'"), ("python", "")):
            short = 'if [ "$1" = train ]; then set -- "$@" --epochs 2; fi'
            (tools / name).write_text(f'#!/bin/sh\n{short}\nexec {sys.executable} {program} "$@"\n')
            (tools / name).chmod(0o755)
    if block.about == "serves":
        serves(folder, tools / "foten", *block.code.split()[1:])
        return
    command = ["bash", "-e", "-c", block.code] if block.language == "sh" else [sys.executable, "-c", block.code]
    environment = {**os.environ, "PATH": f"{tools}:{os.environ['PATH']}", "RAY_DEDUP_LOGS": "0"}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    expected = 2 if block.about == "exit 2" else 0
    assert done.returncode == expected, f"{block.code}\n{done.stderr[-2000:]}"


def serves(folder: Path, *command: str | Path) -> None:
    """Start a server, ask it for its page by the link that it prints, and end it."""
    process = subprocess.Popen(
        [*command, "--no-open", "--port", "0"], cwd=folder, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        assert process.stderr is not None
        link = next(found[0] for line in process.stderr if (found := re.search(r"https?://\S+", line)))
        own = ssl.create_default_context()
        own.check_hostname, own.verify_mode = False, ssl.CERT_NONE  # as a tablet does that was told to
        opener = urllib.request.build_opener(
            urllib.request.HTTPSHandler(context=own),
            urllib.request.HTTPCookieProcessor(),
            urllib.request.ProxyHandler({}),
        )
        with opener.open(link, timeout=30) as answer:
            assert re.search(rb"<title>(foten|foten: your hand|Operator)</title>", answer.read())
    finally:
        process.terminate()
        process.communicate(timeout=30)


# Of training and of edits that are judged: their commands are run at night.
LONG = ("capture", "recordings", "study", "tool", "user")


def runnable(page: Path, slow: bool) -> list[Block]:
    """Commands of a page without its slow ones, or all of them where it has slow ones."""
    some = [b for b in blocks(page) if b.language in ("sh", "python") and not b.about.startswith("not run")]
    quick = [block for block in some if block.about != "slow"]
    return quick if not slow else some if len(some) > len(quick) else []


@pytest.mark.parametrize(
    "page", [pytest.param(page, id=page.stem, marks=[pytest.mark.slow] * (page.stem in LONG)) for page in TUTORIALS]
)
def test_every_command_of_a_tutorial_runs(page: Path, tmp_path: Path) -> None:
    for block in runnable(page, slow=False):
        run(block, tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=[page.stem for page in TUTORIALS])
def test_every_long_command_of_a_tutorial_runs(page: Path, tmp_path: Path) -> None:
    for block in runnable(page, slow=True):
        run(block, tmp_path)


def test_what_the_readme_shows_in_python_runs(tmp_path: Path) -> None:
    (block,) = [block for block in blocks(ROOT / "README.md") if block.language == "python"]
    run(block, tmp_path)


def anchors(page: Path) -> set[str]:
    text = page.read_text(encoding="utf-8")
    headings = map(html.unescape, re.findall(r"^#+ (.+)$", text, re.M))
    documented = set(re.findall(r"^::: (\S+)$", text, re.M))
    return documented | {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_every_link_leads_somewhere(page: Path) -> None:
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    targets = re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r'src="([^"]+)"', text)
    for target in targets:
        if target.startswith(("https://", "live/")):  # which `make docs` makes, and a browser test tries
            continue
        name, _, anchor = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        assert path.exists(), target
        assert path.is_relative_to(ROOT), target
        if anchor:
            assert anchor in anchors(path), target


@pytest.mark.parametrize("page", PAGES, ids=[page.name for page in PAGES])
def test_a_table_is_one_that_people_read(page: Path) -> None:
    """At most 8 columns, and 12 rows and a mean; the rest is CSV."""
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    for table in re.findall(r"(?:^\|.*\|$\n?)+", text, re.M):
        head, _, *rows = table.strip().splitlines()
        assert head.count("|") - 1 <= 8, head
        assert len([row for row in rows if not row.startswith("| mean ")]) <= 12, head


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120


def test_tables_are_what_the_results_give() -> None:
    command = [sys.executable, str(ROOT / "docs" / "make" / "tables.py"), "--check"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_pages_of_results_have_their_figures_from_the_csv_files() -> None:
    """What is written by hand has no number of two decimals, no error, and in *Results* no decibels.

    Settings and what others have measured are written by hand.
    """
    others = {"0.149", "92.15", "0.03", "0.14", "2.27", "0.56", "0.24", "0.32", "0.9997", "0.005", "0.05"}
    others |= {"0.95", "0.33"}  # powers of the law
    others |= {"3.11"}  # of Python
    generated = re.compile(r"<!-- ([\w-]+) -->.*?<!-- /\1 -->", re.DOTALL)
    code = re.compile("```.*?```|`[^`]*`", re.DOTALL)
    pages = ("results", "compared", "listener", "model", "concepts", "differences", "reproduce")
    for path in (*(ROOT / "docs" / f"{page}.md" for page in pages), ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md"):
        name, text = path.stem, code.sub("", generated.sub("", path.read_text(encoding="utf-8")))
        prose = "\n".join(line for line in text.splitlines() if not line.startswith("|"))  # tables of others' figures
        assert set(re.findall(r"\d+\.\d\d+", prose)) <= others, name
        assert not re.search(r"\d ± ", prose), name
        assert name != "results" or not re.search(r"(?<!within) \d+ dB", prose), name


def test_what_documents_say_of_sizes_is_what_the_systems_have() -> None:
    """Of LDHTD beside its public code, and of the memory that systems have by themselves (*Compared systems*)."""
    text = (ROOT / "docs" / "compared.md").read_text(encoding="utf-8")
    ours = LdhtdSizes()
    for sentence in (
        f"one LSTM of 1 layer and {ours.recurrent} units",
        f"a decoder layer of width {ours.d_model} that",
        f"speed and force of the last {ours.window} samples",
        f"| {ours.n_heads} heads, feed-forward {ours.d_feedforward} |\n",
        f"up to {FotenPlusSizes(order=FotenPlusConfig().max_order).history} samples and the state",
        f"the others see {FotenSizes().window} to {FnnSizes().window} (the GAN {GanSizes().window})",
    ):
        assert sentence in text, sentence
    windows = [sizes().window for sizes in (FotenSizes, LdhtdSizes, DstnSizes, FnnSizes)]
    assert windows == sorted(windows)


def test_a_spectral_encoder_cannot_tell_bins_apart() -> None:
    """Without positions, as *Differences* says: bins in another order are encoded alike, in that order."""
    torch = pytest.importorskip("torch")
    from foten.models.foten.network import SpectralBranch

    torch.manual_seed(0)
    branch = SpectralBranch(FotenSizes()).double()
    bins, order = torch.randn(3, 11, dtype=torch.float64), torch.randperm(11)
    encoded, reordered = branch._encode("phase", bins), branch._encode("phase", bins[:, order])
    torch.testing.assert_close(reordered, encoded[:, order], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_the_notebook_runs_from_top_to_bottom(tmp_path: Path) -> None:
    """Its last lines are shown by Jupyter, which the tests do without; outputs are not kept, so none is out of date."""
    pytest.importorskip("torch")
    notebook = json.loads((ROOT / "examples" / "train.ipynb").read_text(encoding="utf-8"))
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert all(cell["outputs"] == [] and cell["execution_count"] is None for cell in cells)
    program = "\n".join("".join(cell["source"]) for cell in cells)
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "usable" in done.stdout
    assert (tmp_path / "twin.foten").exists()
