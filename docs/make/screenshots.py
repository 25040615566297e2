"""Make a screenshot of every page of the built site at phone and desktop size, into build/screenshots: to be looked at.

    python docs/make/screenshots.py

Needs Chromium; without it, this says so and does nothing.
"""

from __future__ import annotations

import functools
import http.server
import shutil
import subprocess
import tempfile
import threading
from pathlib import Path

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


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *arguments: object) -> None:
        pass


def main() -> None:
    program = next(
        (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
    )
    if program is None:
        print("no screenshots: there is no Chromium")
        return
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


if __name__ == "__main__":
    main()
