"""Put the live surface of the site's first page beside it: the element, the kernel and the shipped textures, in build/site/live.

python docs/make/live.py
"""

from __future__ import annotations

import runpy
import shutil
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
LIVE = ROOT / "build" / "site" / "live"


def main() -> None:
    runpy.run_path(str(ROOT / "native" / "wasm" / "pack.py"))["write_package"](LIVE)
    (LIVE / "textures").mkdir()
    for path in (ROOT / "src" / "foten" / "textures").glob("*.foten"):
        shutil.copy(path, LIVE / "textures")
    print(
        f"{LIVE.relative_to(ROOT)}: {sum(path.stat().st_size for path in LIVE.rglob('*') if path.is_file()) / 1e6:.1f} MB"
    )


if __name__ == "__main__":
    main()
