"""A copy of what the repository holds, with its own kernel, in which a test may change sources."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
# That of the extra `dev` lies beside this Python, which need not be in the path.
CMAKE = shutil.which("cmake", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))


def copy_tree(folder: Path) -> None:
    """Copy what the repository holds, and prepare the build of its kernel."""
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    ).stdout
    for name in listed.splitlines():
        if (ROOT / name).is_file():  # and not removed since
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, folder / name)
    assert CMAKE is not None
    subprocess.run(
        [CMAKE, "-S", folder, "-B", folder / "build", "-D", "FOTEN_TRAINING=ON"], check=True, capture_output=True
    )


def build(folder: Path) -> None:
    """Build a copy's kernel beside its package."""
    assert CMAKE is not None
    subprocess.run([CMAKE, "--build", folder / "build", "--parallel", "2"], check=True, capture_output=True)
    kernel = folder / "src/foten/runtime/kernel"
    kernel.mkdir(exist_ok=True)
    for name in ("libfoten", "libfoten_training"):
        shutil.copy(next((folder / "build").glob(f"{name}.*")).resolve(), kernel / f"{name}.so")
    for path in ("include/foten.h", "wasm/foten.mjs", "wasm/foten.wasm"):
        shutil.copy(folder / "native" / path, kernel)
