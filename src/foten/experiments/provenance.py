"""Provenance of a result: digests of the modules that a run imports, of its data and configuration, and its platform."""

from __future__ import annotations

import ast
import hashlib
import platform
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import torch

import foten
from foten.experiments.experiment import MEASURES, Run
from foten.models.trainable import TRAINABLE
from foten.runtime.binding import LIBRARIES, isa, kernel_file

EXECUTES = "foten.experiments.run"  # any run
KERNEL = "kernel/"  # before the names of its libraries: beside modules all that a run reads of the package
N_DIGITS = 16  # of a digest; two of a thousand are the same by chance in 1 of 10¹³


@dataclass(frozen=True)
class Provenance:
    """Everything that a result depends on."""

    sources: Mapping[str, str]  # digests by name: modules of the import closure, libraries of the kernel
    data: str  # digest of the recording
    configuration: str  # digest of the settings
    platform: Mapping[str, str]

    @property
    def code(self) -> str:
        """Digest of all sources."""
        return digest(repr(sorted(self.sources.items())).encode())

    @property
    def name(self) -> str:
        """Name of the result's file."""
        return digest(f"{self.data} {self.configuration}".encode())

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "code": self.code}

    def differences(self, other: Mapping[str, Any]) -> list[str]:
        """Names of what differs from another result: code and platform with their parts, data, configuration."""
        code, platform = (
            sorted({name for name, _ in mine.items() ^ other[part].items()})
            for part, mine in (("sources", self.sources), ("platform", self.platform))
        )
        more = f" and {len(code) - 1} more" if len(code) > 1 else ""
        parts = [f"code ({code[0]}{more})"] if code else []
        parts += [part for part in ("data", "configuration") if getattr(self, part) != other[part]]
        return parts + ([f"platform ({', '.join(platform)})"] if platform else [])


def provenance_of(run: Run, recording_sha256: str) -> Provenance:
    """Provenance of a run that is executed here and now."""
    return Provenance(sources_of(run.model, tuple(run.measures)), recording_sha256, run.configuration, platform_here())


@cache
def sources_of(model: str, measures: tuple[str, ...]) -> dict[str, str]:
    """Digests of the modules that a run of a model executes, by name, and of the kernel's libraries."""
    fits = {key: entry.fit.partition(":")[0] for key, entry in TRAINABLE.items()}
    entries = {EXECUTES, fits[model], *(MEASURES[name] for name in measures)}
    others = {*fits.values(), *MEASURES.values()} - entries
    modules = closure(entries, Path(foten.__file__).parent, others)
    beside = kernel_file(*LIBRARIES).parent.iterdir()
    libraries = {KERNEL + path.name: path for path in beside if path.suffix in (".so", ".dylib", ".dll")}
    return {name: digest(path.read_bytes()) for name, path in sorted({**modules, **libraries}.items())}


def closure(entries: Iterable[str], root: Path, others: Collection[str] = ()) -> dict[str, Path]:
    """Files of some modules of a package and of all that they import, by name.

    Args:
        root: folder of the package.
        others: modules that only other runs execute; they do not count where a function imports them.
    """
    files: dict[str, Path] = {}
    waiting = list(entries)
    while waiting:
        name = waiting.pop()
        path = file_of(name, root)
        if path is None or name in files:
            continue
        files[name] = path
        at_once, all_names = _imports(path)
        waiting += at_once | (all_names - set(others))
        waiting.append(name.rpartition(".")[0])  # the package that it lies in is imported first
    return files


@cache
def _imports(path: Path) -> tuple[frozenset[str], frozenset[str]]:
    """Modules that a module imports at once, and those with its functions."""
    tree = ast.parse(path.read_bytes())
    return frozenset(imported(tree, within_functions=False)), frozenset(imported(tree))


def file_of(module: str, root: Path) -> Path | None:
    """Source of a module of a package; None where it has none, as of another package or of a name in a module."""
    package, *parts = module.split(".")
    path = root.joinpath(*parts)
    if package != root.name:
        return None
    if (path / "__init__.py").exists():
        return path / "__init__.py"
    return path.with_suffix(".py") if parts and path.with_suffix(".py").exists() else None


def imported(tree: ast.AST, within_functions: bool = True) -> Iterator[str]:
    """Yield the modules that the code under a node imports, and names from them; not those for type checkers."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) and not within_functions:
            continue
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            waiting += node.orelse
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.module is not None, "imports are absolute"
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        else:
            waiting += ast.iter_child_nodes(node)


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
