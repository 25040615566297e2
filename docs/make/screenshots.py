"""Screenshots: of every page of the built site at phone and desktop size, or of foten's own pages for README and the site.

    python docs/make/screenshots.py [--pages]

Those of the site go into build/screenshots, to be looked at; they need Chromium: without it, this says so and does nothing. With
--pages, docs/pictures/page.webp and page-*.webp are made, which need Playwright too (`pip install '.[browser]'`). The pages are
served on this machine and end with the script.
"""

import argparse
import contextlib
import functools
import http.server
import io
import math
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from PIL import Image

import foten

ROOT = Path(__file__).resolve().parents[2]
SITE, OUT = ROOT / "build" / "site", ROOT / "build" / "screenshots"
SIZES = {"phone": (500, 1100), "desktop": (1440, 1100)}  # headless Chromium is no narrower than 500
OPTIONS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--hide-scrollbars",
    "--disable-background-networking",
    "--no-first-run",
]
PICTURES = ROOT / "docs" / "pictures"
SIZE = {"width": 1280, "height": 760}
MICROPHONE = ["--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream"]
FOTEN = (sys.executable, "-c", "from foten.cli import main; main()")


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *arguments: object) -> None:
        pass


def of_site(program: str) -> None:
    """Screenshots of the site, by Chromium alone."""
    OUT.mkdir(parents=True, exist_ok=True)
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(SITE)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        for page in sorted(SITE.rglob("index.html")):
            name = page.parent.relative_to(SITE).as_posix().replace("/", "-").strip("-.") or "home"
            url = f"http://127.0.0.1:{server.server_port}/{page.parent.relative_to(SITE).as_posix()}/"
            for size, (width, height) in SIZES.items():
                with tempfile.TemporaryDirectory() as profile:
                    picture = OUT / f"{name}-{size}.png"
                    command = [program, *OPTIONS, f"--user-data-dir={profile}", f"--window-size={width},{height}"]
                    subprocess.run(
                        [*command, f"--screenshot={picture}", url], check=True, capture_output=True, timeout=60
                    )
                    print(picture.relative_to(ROOT))
    finally:
        server.shutdown()


def take(page: Any, name: str) -> None:
    """Write a screenshot."""
    image = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
    image.save(PICTURES / f"{name}.webp", quality=45, method=6)


def stroked(page: Any, name: str) -> None:
    """A texture under a pen that has drawn half of an eight."""
    page.click(f"#textures .swatch >> text={name}")
    page.wait_for_timeout(2500)  # the stroke by which a texture introduces itself
    box, devtools = page.locator("#pad").bounding_box(), page.context.new_cdp_session(page)
    n = 420
    for i in range(n):
        phase = 4.1 * math.pi * i / n
        x = box["x"] + box["width"] * (0.5 + 0.3 * math.sin(phase))
        y = box["y"] + box["height"] * (0.5 + 0.28 * math.sin(2 * phase))
        kind = "mousePressed" if i == 0 else "mouseMoved"
        pen = {"pointerType": "pen", "force": 0.45 + 0.25 * math.sin(phase / 2), "button": "left", "buttons": 1}
        devtools.send("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, "clickCount": 1, **pen})
        page.wait_for_timeout(8)


@contextlib.contextmanager
def served(*arguments: str) -> Iterator[list[str]]:
    """A command that serves, and the links that it prints."""
    command = [*FOTEN, *arguments]
    server = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        links: list[str] = []
        assert server.stderr is not None
        for line in server.stderr:
            links += re.findall(r"http://\S+", line)
            if "Ctrl-C" in line:
                break
        yield links
    finally:
        server.terminate()
        server.wait()


def of_pages(program: str) -> None:
    """Pictures of the pages of textures, of a capture, of a study and of a user's profile."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=program, args=["--no-sandbox", *MICROPHONE])
        context = browser.new_context(viewport=SIZE, permissions=["microphone"], color_scheme="light")
        with served("serve", "--no-open", "--port", "0") as (link, *_):
            of_textures(context.new_page(), link)
        with tempfile.TemporaryDirectory() as folder, of_a_study(Path(folder)) as (operator, participants, *_):
            of_participants(context.new_page(), context.new_page(), operator, participants)
        with tempfile.TemporaryDirectory() as folder:
            profile = str(Path(folder) / "me.json")
            with served("adapt", "--no-open", "--port", "0", "-o", profile) as (link, *_):
                of_a_user(browser.new_context(viewport=SIZE, color_scheme="light").new_page(), link)
        browser.close()


def of_a_user(page: Any, link: str) -> None:
    """Three lights that were on."""
    page.goto(link)
    page.wait_for_selector("html[data-ready]")
    page.click("#go")
    page.wait_for_selector("#lights button:not([disabled])")
    take(page, "page-adapt")


def of_textures(page: Any, link: str) -> None:
    """The page of textures, and the one that captures."""
    page.goto(link)
    page.wait_for_selector("html[data-ready]")
    stroked(page, "Jeans")
    take(page, "page")
    page.click("#capture-one")
    page.wait_for_timeout(1500)
    # The browser's make-believe microphone beeps.
    page.evaluate("document.querySelector('#trouble').style.visibility = 'hidden'")
    page.evaluate("document.querySelector('#hears i').style.setProperty('clip-path', 'inset(0 45% 0 0)', 'important')")
    take(page, "page-capture")


@contextlib.contextmanager
def of_a_study(folder: Path) -> Iterator[list[str]]:
    """The links of a study of two methods."""
    methods = [folder / name for name in ("steel-mesh-1.foten", "steel-mesh-1_ar.foten")]
    for path in methods:
        shutil.copy(foten.EXAMPLE.with_name(path.name), path)
    study = str(folder / "mesh.toml")
    new = [*FOTEN, "study", "new", study, *map(str, methods)]
    subprocess.run([*new, "--title", "Is it the mesh?"], check=True, capture_output=True)
    with served("study", "run", study, "--port", "0") as links:
        yield links


def of_participants(page: Any, other: Any, operator: str, participants: str) -> None:
    """A trial as a participant sees it, and the operator's page meanwhile."""
    page.goto(participants)
    page.wait_for_selector("html[data-ready]")
    page.click("button.big")
    for text in ("I agree", "Next", "Start"):
        page.click(f"button.big >> text={text}", timeout=40_000)
        page.wait_for_timeout(300)
    page.wait_for_selector("#pad")
    page.wait_for_timeout(800)
    box = page.locator("#pad").bounding_box()
    page.mouse.move(box["x"] + 0.3 * box["width"], box["y"] + 0.5 * box["height"])
    page.mouse.down()
    for i in range(60):
        page.mouse.move(
            box["x"] + (0.3 + 0.006 * i) * box["width"], box["y"] + (0.5 + 0.1 * math.sin(i / 8)) * box["height"]
        )
        page.wait_for_timeout(8)
    take(page, "page-study")
    other.goto(operator)
    other.wait_for_timeout(2500)
    take(other, "page-operator")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pages", action="store_true", help="of foten's own pages, for README and the site")
    with_pages = parser.parse_args().pages
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if program is None and with_pages:
        sys.exit("there is no Chromium: apt install chromium")
    if program is None:
        print("no screenshots: there is no Chromium")
    elif with_pages:
        of_pages(program)
    else:
        of_site(program)


if __name__ == "__main__":
    main()
