"""Write the WebAssembly as a package for npm: `dist/npm`, to be packed or published from there.

    python packages/foten/native/wasm/pack.py [--out dist/npm]

Name, version, description, licence and keywords are those of pyproject.toml.
"""

from __future__ import annotations

import argparse
import json
import shutil
import tomllib
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
MODULE = ("foten.mjs", "foten.d.mts", "foten.wasm")
PAGE = ROOT / "src" / "foten" / "studio" / "page"
ELEMENT = ("foten-pad.js", "pad.js", "painter.js", "shelf.js", "sound.js", "stream.js", "surface.js", "worklet.js")
"""Files of `<foten-pad>`, which import one another by name."""


def manifest() -> dict[str, Any]:
    """Content of package.json."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return {
        **{name: project[name] for name in ("name", "version", "description", "license", "keywords")},
        "type": "module",
        "exports": {
            ".": {"types": "./foten.d.mts", "default": "./foten.mjs"},
            "./foten-pad.js": {"types": "./foten-pad.d.ts", "default": "./foten-pad.js"},
            **{f"./{name}": f"./{name}" for name in ("foten.wasm", "worklet.js")},
        },
        "types": "./foten.d.mts",
        "files": [*MODULE, *ELEMENT, "foten-pad.d.ts"],
        "sideEffects": ["./foten-pad.js"],
        "engines": {"node": ">=20"},  # the oldest that it was tried with
    }


def write_package(folder: Path) -> None:
    """Write the package into a folder, which is made anew."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    files = [*(HERE / name for name in MODULE), HERE / "foten-pad.d.ts", *(PAGE / name for name in ELEMENT)]
    for path in (*files, HERE / "README.md", ROOT / "LICENSE"):
        shutil.copyfile(path, folder / path.name)
    text = json.dumps(manifest(), indent=2, ensure_ascii=False)
    (folder / "package.json").write_text(f"{text}\n", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description="Write the WebAssembly as a package for npm.")
    parser.add_argument(
        "--out", type=Path, default=ROOT.parents[1] / "dist" / "npm", help="folder to write to (default: dist/npm)"
    )
    folder = parser.parse_args().out
    write_package(folder)
    size = sum(path.stat().st_size for path in folder.iterdir())
    print(f"{folder}: {manifest()['name']} {manifest()['version']}, {size / 1e3:.0f} kB")


if __name__ == "__main__":
    main()
