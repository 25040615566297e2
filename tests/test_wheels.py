"""What a release holds: one version everywhere, wheels that are what they say and need no compiler, and the package for npm."""

from __future__ import annotations

import importlib.util
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import venv
import zipfile
from collections.abc import Callable
from pathlib import Path, PurePath
from types import ModuleType
from typing import Any

import numpy as np
import pytest

import foten
from conftest import exported
from corpus import write_corpus
from foten.models.texture_file import CLOSED_LOOP_TOLERANCE, read_texture
from foten.runtime.binding import ABI, library
from foten.runtime.renderer import EXAMPLE
from foten.training.training_kernel import training_library
from random_mutants import CMAKE
from test_kernel_build import WASM, accelerations, needs_node, ran, stroke_of

ROOT = Path(__file__).parents[1]
NATIVE = ROOT / "packages/foten/native"
TOOLS = ("lief", "scikit_build_core", "ziglang")
needs_tools = pytest.mark.skipif(
    any(importlib.util.find_spec(name) is None for name in TOOLS), reason=f"needs {', '.join(TOOLS)}: make wheels"
)
AARCH64 = Path("/usr/aarch64-linux-gnu")  # of the package libc6-arm64-cross
WINE = shutil.which("wine64", path=os.pathsep.join([os.environ["PATH"], "/usr/lib/wine"]))
HERE = {("Linux", "x86_64"): "manylinux_2_17_x86_64", ("Linux", "aarch64"): "manylinux_2_17_aarch64"} | {
    ("Darwin", "x86_64"): "macosx_11_0_x86_64",
    ("Darwin", "arm64"): "macosx_11_0_arm64",
    ("Windows", "AMD64"): "win_amd64",
}
NATIVE_TAG = HERE.get((platform.system(), platform.machine()))
TAGS = sorted(HERE.values())


def script(path: Path) -> ModuleType:
    """A script of native as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[path.stem] = module  # where dataclasses look
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def wheels() -> ModuleType:
    return script(NATIVE / "wheels.py")


def test_cmake_names_every_source() -> None:
    """The wasm is built from all files of native/src; what CMake left out would be missing in the wheels alone."""
    text = (ROOT / "packages/foten/CMakeLists.txt").read_text()
    named = re.search(r"set\(sources ([^)]*)\)", text)
    assert named is not None
    sources = {path.stem for path in (NATIVE / "src").glob("*.c")}
    assert set(named[1].split()) == sources - {"kernel", "innovation_kernel"}


@needs_tools
def test_a_wheel_that_is_not_what_it_says_is_refused(wheels: ModuleType, tmp_path: Path) -> None:
    """The library of this environment, built by its own compiler for its own system, is no library of another."""
    content = Path(library()._name).read_bytes()
    assert wheels.read_library(content).exported == wheels.declared()
    for target in wheels.TARGETS:
        if target.tags[0] == NATIVE_TAG:
            continue
        wheel = tmp_path / f"foten-0-py3-none-{target.tags[0]}.whl"
        with zipfile.ZipFile(wheel, "w") as archive:
            for name in wheels.BESIDE:
                archive.writestr(f"{wheels.KERNEL}/{name}", "")
            for name in wheels.functions_of(target):
                archive.writestr(f"{wheels.KERNEL}/{name}", content)
        with pytest.raises(ValueError, match=r"is for .*, expected"):
            wheels.check(target, wheel)
    with zipfile.ZipFile(wheel, "a") as archive:
        archive.writestr(f"{wheels.KERNEL}/stray.so", "")
    with pytest.raises(ValueError, match=r"has .*stray.so, expected"):
        wheels.check(target, wheel)


@needs_tools
@pytest.mark.skipif(NATIVE_TAG is None, reason="there is no wheel for this system")
def test_each_library_of_a_wheel_exports_its_own_functions_and_no_others(wheels: ModuleType, tmp_path: Path) -> None:
    """The public one exported the functions of training too, which no wheel may."""
    (target,) = (target for target in wheels.TARGETS if target.tags[0] == NATIVE_TAG)
    functions = wheels.functions_of(target)
    contents = [Path(one._name).read_bytes() for one in (library(), training_library())]
    assert [wheels.read_library(content).exported for content in contents] == list(functions.values())
    wheel = tmp_path / "foten.whl"
    for content, wrong in zip(contents, reversed(functions), strict=True):  # the same library twice
        with zipfile.ZipFile(wheel, "w") as archive:
            for name in wheels.BESIDE:
                archive.writestr(f"{wheels.KERNEL}/{name}", "")
            for name in functions:
                archive.writestr(f"{wheels.KERNEL}/{name}", content)
        with pytest.raises(ValueError, match=rf"^{wrong} of .* exports other functions .*: .*foten_"):
            wheels.check(target, wheel)


@needs_node
def test_the_types_of_the_npm_package_name_what_the_module_has(tmp_path: Path) -> None:
    """Every member that foten.d.mts declares exists, and every method that is meant for others is declared."""
    program = tmp_path / "members.mjs"
    program.write_text(
        f"""
import {{ readFileSync }} from "node:fs";
import {{ Foten }} from "{(WASM / "foten.mjs").as_uri()}";
const foten = await Foten.load(readFileSync("{WASM / "foten.wasm"}"));
const texture = foten.texture(readFileSync("{EXAMPLE}"));
const renderer = texture.renderer();
const members = {{}};
for (const object of [foten, texture, renderer, renderer.stylus()]) {{
  const {{ prototype, name }} = object.constructor;
  const called = Object.getOwnPropertyNames(prototype).concat(Object.getOwnPropertyNames(object.constructor));
  members[name] = {{ called, held: Object.keys(object) }};
}}
console.log(JSON.stringify(members));
"""
    )
    declared = dict(re.findall(r"class (\w+) \{(.*?)\n\}", (WASM / "foten.d.mts").read_text(), flags=re.DOTALL))
    internal = {"constructor", "text", "take", "within", "grow", "rendered", "length", "name", "prototype"}
    for name, members in json.loads(ran("node", program)).items():
        public = set(re.findall(r"^  (?:static |readonly )*(\w+)[(:?]", declared[name], flags=re.MULTILINE))
        assert public <= {*members["called"], *members["held"]}, name
        assert set(members["called"]) - internal <= public, name


@needs_node
@pytest.mark.skipif(shutil.which("npm") is None, reason="needs npm")
def test_the_npm_package_renders_what_python_does(tmp_path: Path) -> None:
    """Packed as it would be published, unpacked as a dependency. Not to the byte: it is another instruction set."""
    folder = tmp_path / "package"
    script(WASM / "pack.py").write_package(folder)
    (packed,) = json.loads(ran("npm", "pack", "--json", "--silent", "--offline", cwd=folder))
    modules = tmp_path / "node_modules"
    modules.mkdir()
    with tarfile.open(folder / packed["filename"]) as archive:
        archive.extractall(modules, filter="data")
    (modules / "package").rename(modules / "foten")
    program = (ROOT / "examples" / "node" / "stroke.mjs").read_text()
    program = program.replace('"../../packages/foten/native/wasm/foten.mjs"', '"foten"')
    program = program.replace(
        'new URL("../../packages/foten/native/wasm/foten.wasm", import.meta.url)',
        'new URL(import.meta.resolve("foten/foten.wasm"))',
    )
    (tmp_path / "stroke.mjs").write_text(program)
    assert "native" not in program
    expected = stroke_of(EXAMPLE)
    rendered = accelerations(ran("node", tmp_path / "stroke.mjs", EXAMPLE, cwd=tmp_path))
    np.testing.assert_allclose(rendered, expected, atol=CLOSED_LOOP_TOLERANCE * np.abs(expected).max())


@pytest.fixture(scope="module")
def built(wheels: ModuleType, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """A function from a tag to its wheel, built once; building checks it."""
    out = tmp_path_factory.mktemp("wheels")

    def built(tag: str) -> Path:
        if not list(out.glob(f"*{tag}.whl")):
            ran(sys.executable, NATIVE / "wheels.py", "--out", out, tag)
        (wheel,) = out.glob(f"*{tag}.whl")
        return wheel

    return built


def installed(wheel: Path, folder: Path) -> dict[str, Any]:
    """What a wheel renders from a fresh environment that has no compiler in its path."""
    environment = folder / "environment"
    venv.create(environment, with_pip=True)
    programs = environment / ("Scripts" if os.name == "nt" else "bin")
    assert all(shutil.which(name, path=programs) is None for name in ("cc", "gcc", "clang", "zig", "cmake", "ninja"))
    variables = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "CC")}

    def run(*arguments: str | Path) -> str:
        command = [str(programs / "python"), *map(str, arguments)]
        done = subprocess.run(
            command, cwd=folder, env={**variables, "PATH": str(programs)}, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr + done.stdout
        return done.stdout

    pip = ("-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--only-binary", ":all:")
    run(*pip, "--constraint", ROOT / "constraints.txt", wheel)
    result: dict[str, Any] = json.loads(run(NATIVE / "tests" / "installed.py"))
    assert Path(result["library"]).is_relative_to(environment)
    assert result["worst"] <= CLOSED_LOOP_TOLERANCE
    return result


@needs_tools
@pytest.mark.slow
@pytest.mark.skipif(NATIVE_TAG is None, reason="there is no wheel for this system")
def test_a_wheel_renders_without_a_compiler(built: Callable[[str], Path], tmp_path: Path) -> None:
    """Installed into a fresh environment with nothing but Python in the path; how long it takes, `benchmarks/install.py` says."""
    assert NATIVE_TAG is not None
    result = installed(built(NATIVE_TAG), tmp_path)
    assert result["bytes"] < result["numpy_bytes"] / 5


@needs_tools
@pytest.mark.slow
@pytest.mark.skipif(NATIVE_TAG is None, reason="there is no wheel for this system")
def test_the_wheel_at_hand_exports_what_it_should_and_renders(wheels: ModuleType, tmp_path: Path) -> None:
    """By this machine's own compiler, as pip builds it: whom its tag promises nothing to, so that is not checked."""
    (target,) = (target for target in wheels.TARGETS if target.tags[0] == NATIVE_TAG)
    pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check")
    ran(*pip, "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path, *sorted(ROOT.glob("packages/*/")))
    built = {path.name.partition("-")[0]: path for path in tmp_path.glob("*.whl")}
    assert built.keys() == {"foten", "foten_study", "foten_lab"}
    for name, path in built.items():
        with zipfile.ZipFile(path) as archive:
            licences = (read for read in archive.namelist() if ".dist-info/licenses/" in read)
            texts = {PurePath(read).name: archive.read(read).decode() for read in licences}
        assert texts["LICENSE"] == (ROOT / "LICENSE").read_text()
        # The word vectors are not under the project's own licence.
        assert ("Public Domain Dedication and License 1.0" in texts["NOTICE"]) == (name == "foten_lab")
    wheels.check_functions(target, built["foten"])
    installed(built["foten"], tmp_path)


def test_the_top_of_the_repository_says_what_to_install() -> None:
    code = "import no_package; no_package.build_wheel('.')"
    environment = {**os.environ, "PYTHONPATH": str(ROOT / "packages")}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, check=False)
    assert (
        done.stderr.decode().strip().startswith("this repository holds three packages: pip install './packages/foten[")
    )


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_corpus(tmp_path_factory.mktemp("corpus"))


@pytest.fixture(scope="module")
def textures(tmp_path_factory: pytest.TempPathFactory, corpus: list[Path]) -> list[Path]:
    """The files that the kernel runs itself: networks of full size and the smallest, in the loop and beside it."""
    folder = tmp_path_factory.mktemp("textures")
    for key in ("foten", "foten-plus", "ten", "ar"):
        (folder / f"{key}.foten").write_bytes(exported(key).to_bytes())
    return [EXAMPLE, *sorted(folder.iterdir()), *(path for path in corpus if not path.stem.startswith("graph"))]


@needs_tools
@pytest.mark.slow
@pytest.mark.parametrize("tag", TAGS)
def test_the_library_of_a_wheel_renders_what_python_does(
    wheels: ModuleType, built: Callable[[str], Path], textures: list[Path], tmp_path: Path, tag: str
) -> None:
    """Of every system: its format and symbols, as it is built; and a C program with it, where this machine can run one.

    Loading replays the golden windows: NEON through QEMU, Windows through Wine. A stroke of `foten-plus` or `ar` is the same
    to its end. The paper's networks feed what float32 rounds back, which may grow: they are compared for the 64 samples that
    a texture file is proved for.
    """
    target = next(target for target in wheels.TARGETS if target.tags[0] == tag)
    wheel = built(tag)
    runners = {NATIVE_TAG: []}
    if WINE:
        runners["win_amd64"] = [WINE]
    if AARCH64.exists() and shutil.which("qemu-aarch64"):
        runners.setdefault("manylinux_2_17_aarch64", ["qemu-aarch64", "-L", str(AARCH64)])
    if tag not in runners:
        pytest.skip(f"{tag} was built and checked; this machine has nothing that runs it")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(tmp_path)
    kernel = tmp_path / wheels.KERNEL
    shutil.copy(kernel / target.file_name, tmp_path)
    program = tmp_path / "stroke.exe"
    ran(
        *(wheels.zig(), "cc", "-target", target.zig, "-O2", "-I", kernel, "-Wl,-rpath,."),
        *(ROOT / "examples" / "c" / "stroke.c", target.file_name, "-o", program),
        cwd=tmp_path,
    )
    arm = target.kind.split()[1] in ("AARCH64", "ARM64")
    for isa in ("neon", "portable") if arm else ("avx512", "avx2", "portable"):
        for texture in textures:
            expected = stroke_of(texture)
            table = ran(
                *runners[tag],
                program,
                texture,
                cwd=tmp_path,
                FOTEN_ISA=isa,
                WINEDEBUG="-all",
                WINEPREFIX=tmp_path / "wine",
            )
            compared = slice(None if read_texture(texture).card["model"] in ("foten-plus", "ar") else 64)
            error = np.abs(accelerations(table) - expected)[compared].max() / np.abs(expected).max()
            print(f"{tag} {isa} {texture.stem}: {error:.1e}")
            assert error < CLOSED_LOOP_TOLERANCE


@needs_tools
@pytest.mark.slow
@pytest.mark.skipif(CMAKE is None or shutil.which("qemu-aarch64") is None, reason="needs CMake and qemu-aarch64")
def test_the_tests_of_the_kernel_pass_on_arm(
    wheels: ModuleType, textures: list[Path], corpus: list[Path], tmp_path: Path
) -> None:
    """Linked statically, so that QEMU needs nothing of that system."""
    assert CMAKE is not None
    chain = ("--toolchain", NATIVE / "zig.cmake", f"-DFOTEN_ZIG={wheels.zig()}", "-DFOTEN_TARGET=aarch64-linux-musl")
    ran(CMAKE, "-S", ROOT / "packages/foten", "-B", tmp_path, *chain, "-DFOTEN_TESTS=ON")
    ran(CMAKE, "--build", tmp_path, "--parallel", "2")
    for isa in ("neon", "portable"):
        out = ran("qemu-aarch64", tmp_path / "hot_path", *textures, FOTEN_ISA=isa)
        assert out.strip() == f"nothing allocated while rendering {len(textures)} files"
        ran("qemu-aarch64", tmp_path / "fuzz_file", "3000", *corpus, FOTEN_ISA=isa)
        result = json.loads(ran("qemu-aarch64", tmp_path / "contacts", EXAMPLE, "0", "2", "10000", FOTEN_ISA=isa))
        assert result["isa"] == isa


def found(path: str, pattern: str) -> str:
    match = re.search(pattern, (ROOT / path).read_text(), re.MULTILINE)
    assert match is not None, f"{path} has no {pattern}"
    return match[1]


def test_workflows_name_actions_by_one_commit_each() -> None:
    """A tag can be moved to other code, a commit cannot."""
    lines = "".join(path.read_text() for path in (ROOT / ".github/workflows").glob("*.yml"))
    used = set(re.findall(r"uses: *(.*)", lines))
    pinned = {re.fullmatch(r"([\w/-]+)@[0-9a-f]{40} # v\d+\.\d+\.\d+", line) for line in used}
    assert None not in pinned
    assert len({match[1] for match in pinned if match}) == len(used)


def test_the_release_job_installs_by_hash_what_the_constraints_name() -> None:
    text = (ROOT / ".github/release-requirements.txt").read_text()
    pins = re.findall(r"^([\w-]+==\S+) --hash=sha256:[0-9a-f]{64}$", text, flags=re.MULTILINE)
    assert len(pins) == sum(not line.startswith("#") for line in text.splitlines())
    constraints = (ROOT / "constraints.txt").read_text().split()
    tools = ("cmake", "lief", "ninja", "scikit-build-core", "ziglang")  # of the extra wheels
    assert {pin for pin in constraints if pin.split("==")[0] in tools} <= set(pins)


def test_the_version_is_the_same_everywhere() -> None:
    assert {
        foten.__version__,
        *(tomllib.loads(path.read_text())["project"]["version"] for path in ROOT.glob("packages/*/pyproject.toml")),
        json.loads((ROOT / "packages/foten/src/foten/export/unity_package/package.json").read_text())["version"],
        found("packages/foten/native/include/foten.h", r'^#define FOTEN_VERSION "(.+)"'),
        library().foten_version().decode(),
        found("packages/foten/CMakeLists.txt", r"PROPERTIES VERSION (\S+) SOVERSION"),
        found("CITATION.cff", r"^version: (\S+)"),
    } == {foten.__version__}


def test_the_binary_interface_is_the_same_everywhere() -> None:
    assert {
        found("packages/foten/native/include/foten.h", r"^#define FOTEN_ABI (\d+)"),
        str(library().foten_abi()),
        str(ABI),
        found("packages/foten/CMakeLists.txt", r"SOVERSION (\d+)"),
        found("packages/foten/native/wasm/foten.mjs", r"^const ABI = (\d+)"),
        found("packages/foten/src/foten/export/unity_package/Runtime/Foten.cs", r"const int Abi = (\d+)"),
    } == {str(ABI)}
