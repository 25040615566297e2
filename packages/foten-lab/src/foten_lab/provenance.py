"""Provenance of a result: the code by git's trees, the recording, the settings, and the platform."""

import hashlib
import platform
import subprocess
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

import foten
from foten.runtime.binding import isa
from foten_lab.experiment import Run

SOURCES = {
    "foten": "packages/foten/src",
    "foten-study": "packages/foten-study/src",
    "foten-lab": "packages/foten-lab/src",
    "native": "packages/foten/native",
}
"""Folders of the repository whose content is the code of a result."""
N_DIGITS = 16  # of a digest; two of a thousand are the same by chance in 1 of 10¹³
N_TREE_DIGITS = 12  # of a tree's hash, as `git rev-parse HEAD:FOLDER` begins


@dataclass(frozen=True)
class Provenance:
    """Everything that a result depends on."""

    code: str  # as `code_here`
    data: str  # digest of the recording
    configuration: str  # digest of the settings
    platform: Mapping[str, str]

    @property
    def name(self) -> str:
        """Name of the result's file."""
        return digest(f"{self.data} {self.configuration}".encode())

    def to_json(self) -> dict[str, Any]:
        return asdict(self)

    def differences(self, other: Mapping[str, Any]) -> list[str]:
        """Names of what differs from another result: code, data, configuration, platform with its parts."""
        parts = [part for part in ("code", "data", "configuration") if getattr(self, part) != other[part]]
        platform = sorted({name for name, _ in self.platform.items() ^ other["platform"].items()})
        return parts + ([f"platform ({', '.join(platform)})"] if platform else [])


def provenance_of(run: Run, recording_sha256: str) -> Provenance:
    """Provenance of a run that is executed here and now."""
    return Provenance(code_here(), recording_sha256, run.configuration, platform_here())


@cache
def code_here() -> str:
    """Code that runs: git's trees of `SOURCES`, and a digest of what is modified; of an installed package its version.

    Any edit within these folders makes another tree, one of a comment too.
    """
    source = Path(foten.__file__).parents[1]
    no_checkout = f"{foten.__version__}, no checkout"
    try:
        root = Path(_git(source, "rev-parse", "--show-toplevel").decode().strip())
        if root / SOURCES["foten"] != source:  # installed somewhere within another repository
            return no_checkout
        trees = _git(root, "rev-parse", *(f"HEAD:{folder}" for folder in SOURCES.values())).decode().split()
        changes = _git(root, "diff", "HEAD", "--binary", "--", *SOURCES.values())
        untracked = _git(root, "ls-files", "-z", "--others", "--exclude-standard", "--", *SOURCES.values()).decode()
    except (OSError, subprocess.CalledProcessError):
        return no_checkout
    new = [name.encode() + (root / name).read_bytes() for name in untracked.split("\0") if name]
    code = ", ".join(f"{name} {tree[:N_TREE_DIGITS]}" for name, tree in zip(SOURCES, trees, strict=True))
    return f"{code}, modified {digest(changes + b''.join(new))}" if changes or new else code


def _git(folder: Path, *arguments: str) -> bytes:
    return subprocess.run(["git", "-C", str(folder), *arguments], check=True, capture_output=True).stdout


@cache
def platform_here() -> dict[str, str]:
    """Machine, processor, versions, and the kernel's instruction set."""
    return {
        "machine": f"{platform.system()} {platform.machine()}",
        "processor": processor(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "torch": str(torch.__version__),
        "kernel": isa(),
    }


def processor() -> str:
    """Name of the processor."""
    described = Path("/proc/cpuinfo")
    lines = described.read_text(encoding="utf-8").splitlines() if described.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor())


def digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:N_DIGITS]
