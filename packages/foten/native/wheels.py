"""Build wheels for Linux, macOS and Windows on one machine, and the source distribution that they come from.

    python packages/foten/native/wheels.py [--out dist] [TAG ...]

A tag names a wheel to build, as win_amd64; without any it builds all of them. Needs
`pip install './packages/foten[wheels]'`: Zig's C compiler, which has the headers and stubs of every system, and lief, which reads
the libraries of every system. The kernel uses nothing of Python's, so that one wheel serves every version. Each is checked for
what its name promises.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import tarfile
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path

import lief
from scikit_build_core import build as backend

lief.logging.disable()  # it reports what a file does not have, as stamps of time

ROOT = Path(__file__).parents[1]
DIST = ROOT.parents[1] / "dist"
KERNEL = "foten/runtime/kernel"
BESIDE = ("foten.h", "foten.mjs", "foten.wasm")  # the libraries, whatever the system
INSTRUCTION_SETS = {
    **dict.fromkeys(("X86_64", "AMD64"), ("portable", "avx2", "avx512")),
    **dict.fromkeys(("AARCH64", "ARM64"), ("portable", "neon")),
}

# What the linker adds to every library of macOS.
OF_THE_LINKER = {"__mh_dylib_header", "___dso_handle"}
# All that a wheel may ask for: two of the libraries that PEP 599 allows, and what every macOS and Windows 10 has.
SYSTEM_LIBRARIES = r"lib[cm]\.so\.6|/usr/lib/libSystem\.B\.dylib|KERNEL32\.dll|api-ms-win-crt-[a-z0-9-]+\.dll"


@dataclass(frozen=True)
class Target:
    """A system that a wheel is for."""

    zig: str  # as Zig names it, with the oldest version of the system or its C library
    tags: tuple[str, ...]  # as wheels name it
    suffix: str  # of libraries
    kind: str  # format and processor, as lief names them

    @property
    def file_name(self) -> str:
        """Name of the public library's file."""
        return f"libfoten.{self.suffix}"


# The oldest systems that Zig and NumPy both know: glibc 2.17, macOS 11, Windows with the universal C runtime.
TARGETS = (
    Target("x86_64-linux-gnu.2.17", ("manylinux_2_17_x86_64", "manylinux2014_x86_64"), "so", "ELF X86_64"),
    Target("aarch64-linux-gnu.2.17", ("manylinux_2_17_aarch64", "manylinux2014_aarch64"), "so", "ELF AARCH64"),
    Target("x86_64-macos.11.0", ("macosx_11_0_x86_64",), "dylib", "MACHO X86_64"),
    Target("aarch64-macos.11.0", ("macosx_11_0_arm64",), "dylib", "MACHO ARM64"),
    Target("x86_64-windows-gnu", ("win_amd64",), "dll", "PE AMD64"),
)


def zig() -> Path:
    """Path of Zig in the package ziglang."""
    import ziglang

    return Path(ziglang.__file__).with_name("zig.exe" if os.name == "nt" else "zig")


def declared() -> set[str]:
    """Names of the functions that foten.h declares."""
    header = (ROOT / "native" / "include" / "foten.h").read_text(encoding="utf-8")
    return set(re.findall(r"^FOTEN_API [^(]*?(\w+)\(", header, flags=re.MULTILINE))


def functions_of(target: Target) -> dict[str, set[str]]:
    """Names of the functions that each library of a wheel exports, by its file's name.

    The public one those of `foten.h`, training's each of its own once for an instruction set.
    """
    source = "".join(path.read_text(encoding="utf-8") for path in (ROOT / "native" / "training").glob("*.c"))
    names = re.findall(r"^EXPORTED\((\w+)\)", source, flags=re.MULTILINE)
    sets = INSTRUCTION_SETS[target.kind.split()[1]]
    training = {f"{name}_{isa}" for name in names for isa in sets}
    return {target.file_name: declared(), f"libfoten_training.{target.suffix}": training}


def committed() -> str:
    """Time of the last commit [s since 1970], for the same bytes from the same sources; where git is not, 1980."""
    command = ["git", "log", "-1", "--format=%ct"]
    try:
        return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return "315532800"  # the earliest that a zip file can say


def built_source(out: Path) -> Path:
    """Build the source distribution from the working tree and return its path."""
    os.chdir(ROOT)
    return out / backend.build_sdist(str(out))


def built(target: Target, source: Path, out: Path) -> Path:
    """Build a target's wheel from the unpacked source distribution and return its path."""
    defined = {"CMAKE_TOOLCHAIN_FILE": source / "native" / "zig.cmake", "FOTEN_TARGET": target.zig, "FOTEN_ZIG": zig()}
    settings = {
        "cmake.args": [f"-D{name}={value}" for name, value in defined.items()],
        "wheel.tags": [f"py3-none-{tag}" for tag in target.tags],
        "install.strip": "false",  # that of this machine knows no other; Zig's linker does it
    }
    os.chdir(source)
    return out / backend.build_wheel(str(out), settings)


@dataclass(frozen=True)
class Library:
    """What a library says of itself, whatever the system."""

    size: int  # bytes
    kind: str  # as that of a target
    oldest: tuple[int, ...]  # version of the C library, or of macOS, that it asks for at least; () on Windows
    needed: frozenset[str]
    exported: frozenset[str]
    signed: bool


def read_library(content: bytes) -> Library:
    """Read an ELF, Mach-O or PE file, or raise ValueError where it is none."""
    binary = lief.parse(content)
    if isinstance(binary, lief.ELF.Binary):
        asked = [symbol.name for of in binary.symbols_version_requirement for symbol in of.get_auxiliary_symbols()]
        oldest = max((_version(name) for name in asked if name.startswith("GLIBC_")), default=())
        exported = {symbol.name for symbol in binary.exported_symbols}
        needed = set(binary.libraries)
        machine, signed = binary.header.machine_type.name, False
    elif isinstance(binary, lief.MachO.Binary):
        oldest = tuple(binary.build_version.minos[:2])
        exported = {symbol.name for symbol in binary.exported_symbols} - OF_THE_LINKER
        exported = {name.removeprefix("_") for name in exported}
        needed = {
            library.name for library in binary.libraries if not library.name.startswith("@rpath/")
        }  # its own name
        machine, signed = binary.header.cpu_type.name, binary.has_code_signature
    elif isinstance(binary, lief.PE.Binary):
        oldest = ()
        exported = {entry.name for entry in binary.get_export().entries}
        needed = set(binary.libraries)
        machine, signed = binary.header.machine.name, False
    else:
        raise ValueError("this is no library of Linux, macOS or Windows")
    return Library(
        len(content), f"{binary.format.name} {machine}", oldest, frozenset(needed), frozenset(exported), signed
    )


def _version(text: str) -> tuple[int, ...]:
    """First two numbers of GLIBC_2.2.5 or macosx_11_0_arm64; () where there are none, as in win_amd64."""
    numbers = re.match(r"[A-Za-z]+_([0-9]+)[._]([0-9]+)", text)
    return tuple(map(int, numbers.groups())) if numbers else ()


def check_functions(target: Target, wheel: Path) -> dict[str, Library]:
    """A wheel's libraries by their files' names, or raise ValueError where they are others or export other functions."""
    functions = functions_of(target)
    expected = sorted([*BESIDE, *functions])
    with zipfile.ZipFile(wheel) as archive:
        names = sorted(name for name in archive.namelist() if name.startswith(f"{KERNEL}/"))
        if names != [f"{KERNEL}/{name}" for name in expected]:
            raise ValueError(f"{wheel.name} has {', '.join(names)}, expected {', '.join(expected)} in {KERNEL}")
        libraries = {name: read_library(archive.read(f"{KERNEL}/{name}")) for name in functions}
    for name, library in libraries.items():
        if library.kind != target.kind:
            raise ValueError(f"{name} of {wheel.name} is for {library.kind}, expected {target.kind}")
        if wrong := ", ".join(sorted(library.exported ^ functions[name])):
            raise ValueError(f"{name} of {wheel.name} exports other functions than its sources declare: {wrong}")
    return libraries


def check(target: Target, wheel: Path) -> str:
    """Check a wheel and say a line about it, or raise ValueError where it is not what its name says."""
    libraries, promised = check_functions(target, wheel), _version(target.tags[0])
    for name, library in libraries.items():
        what = f"{name} of {wheel.name}"
        if library.oldest > promised:
            raise ValueError(f"{what} needs a system of version {library.oldest}, its tag promises {promised}")
        if strange := sorted(name for name in library.needed if not re.fullmatch(SYSTEM_LIBRARIES, name)):
            raise ValueError(f"{what} needs libraries that not every system has: {', '.join(strange)}")
        if target.kind == "MACHO ARM64" and not library.signed:
            raise ValueError(f"{what} is not signed, which Apple silicon does not load")
    sizes = ", ".join(f"{name} {library.size / 1e3:.0f} kB" for name, library in libraries.items())
    oldest = ".".join(map(str, max(library.oldest for library in libraries.values()))) or "any"
    return f"{wheel.name}: {wheel.stat().st_size / 1e6:.2f} MB, {sizes}, needs version {oldest}"


def main() -> None:
    parser = argparse.ArgumentParser(description="Build wheels for Linux, macOS and Windows.")
    parser.add_argument("--out", type=Path, default=DIST, help="folder to write to (default: dist)")
    parser.add_argument("tags", nargs="*", metavar="TAG", help="wheels to build, as win_amd64 (default: all)")
    arguments = parser.parse_args()
    known = {target.tags[0]: target for target in TARGETS}
    if unknown := sorted(set(arguments.tags) - set(known)):
        parser.error(f"there is no wheel {', '.join(unknown)}, expected some of {', '.join(known)}")
    out = arguments.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    os.environ.setdefault("SOURCE_DATE_EPOCH", committed())
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        source = built_source(out)
        with tarfile.open(source) as archive:
            archive.extractall(folder, filter="data")
        unpacked = Path(folder, source.name.removesuffix(".tar.gz"))
        for tag in arguments.tags or known:
            wheel = built(known[tag], unpacked, out)
            lines.append(check(known[tag], wheel))
        os.chdir(ROOT)
    print("\n".join(lines))


if __name__ == "__main__":
    main()
