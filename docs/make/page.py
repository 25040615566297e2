"""Pictures of the pages for README and the site, docs/pictures/page.jpg and page-capture.jpg: as a browser shows them.

    python docs/make/page.py

Needs Chromium and Playwright (`pip install '.[browser]'`). The page is served on this machine and ends with the script.
"""

from __future__ import annotations

import math
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from playwright.sync_api import sync_playwright

PICTURES = Path(__file__).resolve().parents[1] / "pictures"
SIZE = {"width": 1280, "height": 760}
MICROPHONE = ["--use-fake-ui-for-media-stream", "--use-fake-device-for-media-stream"]


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


def main() -> None:
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        sys.exit("there is no Chromium: apt install chromium")
    command = [sys.executable, "-c", "from foten.cli import main; main()", "serve", "--no-open", "--port", "0"]
    server = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        assert server.stderr is not None
        link = next(found[0] for line in server.stderr if (found := re.search(r"http://\S+", line)))
        with sync_playwright() as started:
            browser = started.chromium.launch(executable_path=chromium, args=["--no-sandbox", *MICROPHONE])
            context = browser.new_context(viewport=SIZE, permissions=["microphone"], color_scheme="light")
            page = context.new_page()
            page.goto(link)
            page.wait_for_selector("html[data-ready]")
            stroked(page, "Jeans")
            page.screenshot(path=PICTURES / "page.jpg", type="jpeg", quality=82)
            page.click("#capture-one")
            page.wait_for_timeout(1500)
            page.evaluate(
                "document.querySelector('#trouble').textContent = ''"
            )  # of the browser's make-believe microphone
            page.screenshot(path=PICTURES / "page-capture.jpg", type="jpeg", quality=82)
            browser.close()
    finally:
        server.terminate()
        server.wait()


if __name__ == "__main__":
    main()
