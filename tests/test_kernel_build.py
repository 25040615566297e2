"""The kernel as a C or C++ program, a page or Node has it: built here, under sanitizers too, and the same everywhere."""

from __future__ import annotations

import csv
import hashlib
import importlib.util
import io
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from conftest import exported
from corpus import KINDS, write_corpus
from foten.export.unity import write_unity
from foten.models.texture_file import Texture, read_texture
from foten.runtime.binding import ABI, NativeActuator
from foten.runtime.native import NativeState, NativeTexture
from foten.runtime.renderer import Renderer
from random_mutants import CMAKE
from test_rendering import with_card

ROOT = Path(__file__).parents[1]
WASM = ROOT / "packages/foten/native" / "wasm"

needs_cmake = pytest.mark.skipif(CMAKE is None or shutil.which("cc") is None, reason="needs CMake and a C compiler")
needs_node = pytest.mark.skipif(shutil.which("node") is None, reason="needs Node")


def ran(*command: str | Path, cwd: Path | None = None, **env: str) -> str:
    """Run a command and return its output; its errors are the assertion's message."""
    done = subprocess.run(
        list(map(str, command)), cwd=cwd, env={**os.environ, **env}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr + done.stdout
    return done.stdout


def built(folder: Path, targets: tuple[str, ...], *options: str) -> Path:
    assert CMAKE is not None
    ran(CMAKE, "-S", ROOT / "packages/foten", "-B", folder, "-DFOTEN_TESTS=ON", *options)
    ran(CMAKE, "--build", folder, "--parallel", "2", "--target", *targets)
    return folder


@pytest.fixture(scope="module")
def build(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("build"), ("foten", "hot_path"))


@pytest.fixture(scope="module")
def sanitized(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("sanitized"), ("contacts", "fuzz_file"), "-DFOTEN_SANITIZE=address,undefined")


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("file") / "t.foten"
    path.write_bytes(exported("foten-plus").to_bytes())
    return path


@pytest.fixture(scope="module")
def corpus(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_corpus(tmp_path_factory.mktemp("corpus"))


def stroke_of(file: Path) -> np.ndarray:
    """What `stroke` renders in every language: 2 s in blocks of 32 samples, faster from one to the next, smoothed."""
    renderer = Renderer(file, smooth=True)
    low, high = renderer.native_texture.info.trained_speed
    n = int(2 * renderer.rate)
    blocks = [
        renderer.render(np.float32(low + (high - low) * first / n), 0.8, min(32, n - first))
        for first in range(0, n, 32)
    ]
    return np.concatenate(blocks)


def accelerations(table: str) -> np.ndarray:
    return np.array([float(row["acceleration_m_s2"]) for row in csv.DictReader(io.StringIO(table))])


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
@pytest.mark.parametrize(
    "source", ["src/kernel.c", "src/innovation_kernel.c", "training/training_kernel.c", "training/encoder_layer.c"]
)
@pytest.mark.parametrize(("kernel", "rows"), [("neon", 8), ("simd128", 5)])
def test_kernels_for_other_processors_compile_without_a_warning(
    tmp_path: Path, kernel: str, rows: int, source: str
) -> None:
    """The vectors are the compiler's own, so that it knows them whatever the processor."""
    ran(
        *(
            "cc",
            "-std=c11",
            "-O3",
            "-Wall",
            "-Wextra",
            "-Wno-psabi",
            "-Werror",
            "-I",
            ROOT / "packages/foten/native" / "include",
        ),
        *(f"-DKERNEL={kernel}", "-DLANES=4", f"-DROWS={rows}", "-I", ROOT / "packages/foten/native" / "src"),
        *("-c", ROOT / "packages/foten/native" / source, "-o", tmp_path / "kernel.o"),
    )


@needs_cmake
def test_kernels_are_those_of_the_processor_that_is_built_for(tmp_path: Path) -> None:
    """On a Mac with Apple silicon a build for x86-64 had the kernel for NEON, and did not link."""
    assert CMAKE is not None
    mac = ("-DCMAKE_SYSTEM_NAME=Linux", "-DCMAKE_SYSTEM_PROCESSOR=arm64", "-DCMAKE_OSX_ARCHITECTURES=x86_64")
    ran(CMAKE, "-S", ROOT / "packages/foten", "-B", tmp_path, *mac)
    targets = ran(CMAKE, "--build", tmp_path, "--target", "help")
    assert "foten_avx2" in targets
    assert "foten_neon" not in targets


@needs_cmake
def test_nothing_is_allocated_while_rendering(build: Path, corpus: list[Path]) -> None:
    """The program fails as well where its counter sees nothing of what loading allocates, where a state asks for another
    number of bytes than foten_model_info gives, and where a file that there is no memory for is said to be anything else.
    """
    # What others predict is not ours to count.
    run_by_kernel = [path for path in corpus if not path.stem.startswith("graph")]
    out = ran(build / "hot_path", *run_by_kernel)
    assert out.strip() == f"nothing allocated while rendering {len(run_by_kernel)} files"


@needs_cmake
@pytest.mark.parametrize("n", [3000, pytest.param(1_000_000, marks=pytest.mark.slow)])
def test_damaged_files_do_no_harm(sanitized: Path, corpus: list[Path], n: int) -> None:
    """Mutants of each kind of file under AddressSanitizer and UndefinedBehaviorSanitizer; both end the program with a report."""
    assert len(corpus) == len(KINDS)
    ran(
        sanitized / "fuzz_file",
        str(n),
        *corpus,
        UBSAN_OPTIONS="halt_on_error=1",
        ASAN_OPTIONS="allocator_may_return_null=1",
    )


@needs_cmake
@pytest.mark.parametrize("isa", ["avx512", "avx2", "neon", "portable"])
def test_the_kernel_is_clean_under_sanitizers(sanitized: Path, file: Path, isa: str) -> None:
    """A step of a whole network in each instruction set."""
    result = ran(sanitized / "contacts", file, "0", "2", "1000", FOTEN_ISA=isa, UBSAN_OPTIONS="halt_on_error=1")
    assert '"n_states": 1' in result
    if f'"isa": "{isa}"' not in result:
        pytest.skip(f"this processor has no {isa}")


@needs_cmake
@pytest.mark.parametrize("rate", [1000.0, 2500.0])
def test_a_c_program_renders_what_python_does(build: Path, texture: Texture, rate: float, tmp_path: Path) -> None:
    """A stroke of two seconds, whatever the texture's rate: it had 2000 samples, 0.2 s of a texture of 10 kHz."""
    program, file = tmp_path / "stroke", tmp_path / "t.foten"
    preprocess_entry = {**texture.card["preprocess"], "rate_hz": rate}
    file.write_bytes(with_card(texture, rate_hz=rate, preprocess=preprocess_entry).to_bytes())
    source = ROOT / "examples" / "c" / "stroke.c"
    (compiled,) = re.findall(r"^ \* +cc stroke\.c (.*) -o stroke$", source.read_text(), re.MULTILINE)
    assert compiled == "$(foten doctor --c-flags)"  # as in the tutorial, where the library that is installed is meant
    ran(
        *("cc", "-std=c11", "-Wall", "-Werror", source, "-o", program),
        *("-I", ROOT / "packages/foten/native" / "include", "-L", build, "-lfoten", "-lm", f"-Wl,-rpath,{build}"),
    )
    table = ran(program, file)
    np.testing.assert_array_equal(accelerations(table), [float(f"{x:g}") for x in stroke_of(file)])
    assert accelerations(table).size == 2 * rate
    assert float(table.splitlines()[-1].split(",")[0]) == pytest.approx(2 - 1 / rate, rel=1e-5)
    done = subprocess.run([program, ROOT / "README.md"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
@pytest.mark.parametrize(
    ("path", "compiler"), [("c/stroke.c", ("cc", "-std=c11")), ("cpp/haptic_callback.cpp", ("c++", "-std=c++17"))]
)
def test_examples_refuse_a_library_of_another_version(
    file: Path, tmp_path: Path, path: str, compiler: tuple[str]
) -> None:
    """Of which they call nothing but `foten_abi`: all else of it ends the program."""
    if shutil.which(compiler[0]) is None:
        pytest.skip(f"needs {compiler[0]}")
    header = (ROOT / "packages/foten/native" / "include" / "foten.h").read_text()
    others = set(re.findall(r"\b(foten_\w+)\(", header)) - {"foten_abi", "foten_predictor"}
    library = tmp_path / "other.c"
    ends = "".join(f"void {name}(void) {{ abort(); }}\n" for name in sorted(others))
    library.write_text(f"#include <stdlib.h>\nint foten_abi(void) {{ return {ABI + 1}; }}\n{ends}")
    ran("cc", "-c", library, "-o", tmp_path / "other.o")
    program = tmp_path / "program"
    ran(
        *(*compiler, "-pthread", ROOT / "examples" / path, tmp_path / "other.o", "-o", program),
        *("-I", ROOT / "packages/foten/native" / "include", "-lm"),
    )
    done = subprocess.run([program, file], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "of another version" in done.stderr
    assert len(done.stderr.splitlines()) == 1


@needs_cmake
@pytest.mark.skipif(shutil.which("c++") is None, reason="needs a C++ compiler")
def test_a_haptic_callback_in_cpp_runs(build: Path, file: Path, tmp_path: Path) -> None:
    program = tmp_path / "haptic_callback"
    ran(
        *("c++", "-std=c++17", "-Wall", "-Werror", "-pthread"),
        *(ROOT / "examples" / "cpp" / "haptic_callback.cpp", "-o", program),
        *("-I", ROOT / "packages/foten/native" / "include", "-L", build, "-lfoten", "-lm", f"-Wl,-rpath,{build}"),
    )
    ticks, rms = (ran(program, file).replace(",", "").replace(";", "").split()[i] for i in (0, 4))
    assert ticks == "2000"
    assert float(rms) > 0


@pytest.mark.skipif(shutil.which("mcs") is None or shutil.which("mono") is None, reason="needs Mono's compiler")
def test_csharp_renders_what_python_does(file: Path, tmp_path: Path) -> None:
    """What `--to unity` writes: `Foten.cs` with a program around it; the component needs Unity and is not tried."""
    (tmp_path / "Try.cs").write_text(
        """
using System;
using System.IO;
using System.Globalization;
public static class Try {
    public static void Main(string[] arguments) {
        using (var texture = new Foten.Texture(File.ReadAllBytes(arguments[0])))
        using (var renderer = new Foten.Renderer(texture, smooth: true)) {
            var block = new float[32];
            int n = (int)(2 * texture.Rate);
            Console.WriteLine("acceleration_m_s2");
            for (int first = 0; first < n; first += block.Length) {
                int rendered = Math.Min(block.Length, n - first);
                double speed = texture.LowestSpeed + (texture.HighestSpeed - texture.LowestSpeed) * first / n;
                renderer.SetCondition((float)speed, 0.8f);
                renderer.Render(block, rendered);
                for (int i = 0; i < rendered; i++) Console.WriteLine(block[i].ToString("R", CultureInfo.InvariantCulture));
            }
            renderer.Dispose();
            Action[] uses = {
                () => renderer.SetCondition(1, 1), () => renderer.Render(block), () => renderer.Reset(0),
                () => Console.Write(renderer.Delay)
            };
            foreach (var use in uses)
                try { use(); Environment.Exit(3); } catch (ObjectDisposedException) { }
        }
    }
}
"""
    )
    name = write_unity(read_texture(file), tmp_path)
    runtime = tmp_path / "Runtime"
    ran("mcs", "-out:try.exe", "Try.cs", runtime / "Foten.cs", cwd=tmp_path)
    texture = runtime / "Resources" / "Foten" / f"{name}.bytes"
    result = accelerations(ran("mono", "try.exe", texture, cwd=tmp_path, LD_LIBRARY_PATH=str(runtime / "Plugins")))
    np.testing.assert_allclose(result, stroke_of(file), rtol=1e-6)


@needs_node
def test_node_renders_what_python_does(file: Path) -> None:
    """Not to the byte: it is another instruction set."""
    result = accelerations(ran("node", ROOT / "examples" / "node" / "stroke.mjs", file))
    expected = stroke_of(file)
    np.testing.assert_allclose(result, expected, atol=1e-4 * np.abs(expected).max())


@needs_node
def test_node_has_the_same_noise_and_refuses_in_one_line(tmp_path: Path) -> None:
    program = tmp_path / "noise.mjs"
    program.write_text(
        f"""
import {{ readFileSync }} from "node:fs";
import {{ Foten }} from "{(WASM / "foten.mjs").as_uri()}";
const foten = await Foten.load(readFileSync("{WASM / "foten.wasm"}"));
for (const [seed, stream, first] of [[0, 0, 0], [7, 3, 1000], [2n ** 63n, 1n, 2n ** 33n]])
  console.log(Array.from(foten.noise(seed, stream, first, 50)).join(" "));
try {{ foten.texture(new Uint8Array(100)); }} catch (error) {{ console.log(error.message); }}
"""
    )
    *noises, refused = ran("node", program).strip().splitlines()
    from foten.dsp.noise import gaussian

    for line, (seed, stream, first) in zip(noises, ((0, 0, 0), (7, 3, 1000), (2**63, 1, 2**33)), strict=True):
        np.testing.assert_array_equal(np.array(line.split(), dtype=float), gaussian(seed, stream, first, 50))
    with pytest.raises(ValueError) as error:  # noqa: PT011, the message is what is compared
        NativeTexture(bytes(100))
    assert refused == str(error.value)


@needs_node
def test_node_knows_names_seeds_and_what_was_freed(file: Path, tmp_path: Path) -> None:
    named = tmp_path / "named.foten"
    named.write_bytes(file.read_bytes().replace(b"untrained", b"untr\xffined", 1))
    program = tmp_path / "freed.mjs"
    program.write_text(
        f"""
import {{ readFileSync }} from "node:fs";
import {{ Foten }} from "{(WASM / "foten.mjs").as_uri()}";
const foten = await Foten.load(readFileSync("{WASM / "foten.wasm"}"));
const texture = foten.texture(readFileSync("{named}"));
console.log(texture.info.texture);
const renderer = texture.renderer({{ seed: 3 }}), stylus = renderer.stylus();
renderer.setCondition(80, 0.8);
const before = renderer.render(new Float32Array(20)).join();
renderer.reset();
console.log(renderer.render(new Float32Array(20)).join() === before);
stylus.free();
const block = new Float32Array(1);
function tried(...uses) {{
  for (const use of uses) try {{ use(); }} catch (error) {{ console.log(error.message); }}
}}
tried(() => stylus.push(0, 0, 1, 0), () => stylus.stats, () => renderer.renderStylus(stylus, block));
renderer.free();
tried(() => renderer.setCondition(80, 0.8), () => renderer.render(block), () => renderer.reset());
tried(() => renderer.delay, () => renderer.condition, () => renderer.stats);
texture.free();
tried(() => texture.renderer(), () => renderer.stylus());
"""
    )
    name, same, *freed = ran("node", program).splitlines()
    assert name == NativeTexture(named.read_bytes()).info.texture == "untr�ined"
    assert same == "true"
    assert freed == [*["this stylus was freed"] * 3, *["this renderer was freed"] * 6, *["this texture was freed"] * 2]


@needs_node
def test_node_drives_actuators_and_counts_as_python_does(texture: Texture, tmp_path: Path) -> None:
    """At 8 kHz with a resonance and a limit, without either, and acceleration again."""
    path, program = tmp_path / "t.foten", tmp_path / "actuator.mjs"
    path.write_bytes(with_card(texture, trained_range={"speed": [0.0026, 220.0], "force": [0.3, 2.5]}).to_bytes())
    program.write_text(
        f"""
import {{ readFileSync }} from "node:fs";
import {{ Foten }} from "{(WASM / "foten.mjs").as_uri()}";
const foten = await Foten.load(readFileSync("{WASM / "foten.wasm"}"));
const texture = foten.texture(readFileSync("{path}")), renderer = texture.renderer({{ rate: 8000 }});
const actuators = [{{ resonanceHz: 70, damping: 0.25, gain: 2, lowestHz: 30, limit: 0.5 }}, {{ gain: -2 }}, null];
for (const [i, actuator] of actuators.entries()) {{
  renderer.setCondition([80, 1, 80][i], 0.8);
  renderer.setActuator(actuator);
  console.log(Array.from(renderer.render(new Float32Array(800))).join(" "));
}}
console.log(renderer.stats.n, renderer.stats.nBelow, renderer.stats.nLimited);
for (const actuator of [{{}}, {{ gain: 0 }}, {{ gain: 1, limit: -1 }}, {{ gain: 1, resonanceHz: 600 }}])
  try {{ renderer.setActuator(actuator); }} catch (error) {{ console.log(error.message); }}
renderer.free();
try {{ renderer.setActuator(null); }} catch (error) {{ console.log(error.message); }}
"""
    )
    *driven, counts, first, second, third, fourth, freed = ran("node", program).splitlines()
    state = NativeState(NativeTexture(path.read_bytes()), 8000.0)
    actuators = (NativeActuator(70.0, 0.25, 2.0, 30.0, 0.5), NativeActuator(0.0, 0.0, -2.0, 0.0, 0.0), None)
    expected = np.empty(800, dtype=np.float32)
    for line, actuator, speed in zip(driven, actuators, (80.0, 1.0, 80.0), strict=True):
        state.set_condition(speed, 0.8)
        state.set_actuator(actuator)
        state.render(expected)
        np.testing.assert_allclose(np.array(line.split(), dtype=float), expected, atol=1e-4 * np.abs(expected).max())
    counted = state.statistics
    assert list(map(int, counts.split())) == [counted.n, counted.n_below, counted.n_limited]
    assert counted.n_below == 100
    assert counted.n_limited > 0
    assert first == second == third == fourth
    with pytest.raises(ValueError, match=re.escape(first)):
        state.set_actuator(NativeActuator(600.0, 0.0, 1.0, 0.0, 0.0))
    assert freed == "this renderer was freed"


def test_the_wasm_has_the_digest_that_is_beside_it() -> None:
    digest = hashlib.sha256((WASM / "foten.wasm").read_bytes()).hexdigest()
    assert (WASM / "foten.wasm.sha256").read_text().split() == [digest, "foten.wasm"]


@pytest.mark.skipif(importlib.util.find_spec("ziglang") is None, reason="needs ziglang, of the extra wasm")
def test_the_wasm_is_what_the_sources_give() -> None:
    ran(sys.executable, WASM / "build.py", "--check")
