"""Build the kernel as WebAssembly: `foten.wasm` from the same sources, and the digest that says which.

    python packages/foten/native/wasm/build.py [--check]

Needs the package ziglang, a C compiler for every target that pip installs: `pip install './packages/foten[wasm]'`. With --check
nothing is written, and the exit status is 1 where the committed file is not what the sources give.
"""

from __future__ import annotations

import hashlib
import subprocess
import sys
import tempfile
from pathlib import Path

HERE = Path(__file__).parent
SOURCES = HERE.parent / "src"
NAMES = [path.stem for path in sorted(SOURCES.glob("*.c"))]
FLAGS = [
    "-target",
    "wasm32-wasi",
    "-mexec-model=reactor",
    "-std=c11",
    "-O3",
    "-msimd128",
    "-mbulk-memory",
    "-ffp-contract=off",
]
FLAGS += [
    "-fno-sanitize=all",
    "-fvisibility=hidden",
    "-DFOTEN_BUILDING",
    "-DKERNEL=simd128",
    "-DLANES=4",
    "-DROWS=5",
    "-Wall",
    "-Wextra",
    "-g0",
]
LINKED = [
    "-Wl,--strip-all",
    "-Wl,--export-dynamic",
    "-Wl,--export=malloc",
    "-Wl,--export=free",
    "-Wl,-z,stack-size=65536",
]


def built() -> bytes:
    """Build the module."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "foten.wasm"
        sources = [f"{name}.c" for name in NAMES]
        # From the folder of the sources, so that no path of a machine gets into the module.
        command = [sys.executable, "-m", "ziglang", "cc", *FLAGS, "-I../include", *LINKED, "-o", str(out), *sources]
        subprocess.run(command, cwd=SOURCES, check=True)
        return out.read_bytes()


def main() -> None:
    module = built()
    digest = hashlib.sha256(module).hexdigest()
    wasm, recorded = HERE / "foten.wasm", HERE / "foten.wasm.sha256"
    if "--check" in sys.argv[1:]:
        if not wasm.exists() or wasm.read_bytes() != module or recorded.read_text().split()[0] != digest:
            sys.exit("foten.wasm is not what the sources give: run 'make wasm' and commit it")
        print(f"foten.wasm is what the sources give, {len(module)} bytes, sha256 {digest}")
        return
    wasm.write_bytes(module)
    recorded.write_text(f"{digest}  foten.wasm\n")
    print(f"foten.wasm: {len(module)} bytes, sha256 {digest}")


if __name__ == "__main__":
    main()
