"""The layers: who may import whom, and what must run without PyTorch and without SciPy."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import foten
from foten.families.texture_file import Texture, write_texture
from foten.runtime.renderer import Renderer

ROOT = Path(foten.__file__).parent
MODULES = sorted(
    ".".join(("foten", *path.relative_to(ROOT).with_suffix("").parts)).removesuffix(".__init__")
    for path in ROOT.rglob("*.py")
)

# `Who may import whom` of the architecture. Every package may import itself and the version.
MAY_IMPORT: dict[str, set[str]] = {
    "dsp": set(),
    "architecture": set(),
    "recording": {"dsp"},
    "datasets": {"dsp", "recording"},
    "texture_file": {"architecture", "recording"},
    "render": {"dsp", "architecture", "recording", "texture_file"},
    "models": {"dsp", "architecture"},
    "train": {"models", "recording", "texture_file", "render"},
    "evaluate": {"dsp", "recording", "texture_file", "render"},
    "export": {"dsp", "texture_file", "render"},
    "study": set(),
    "studio": {"recording", "texture_file", "render", "study"},
}
MAY_IMPORT["train"] |= MAY_IMPORT["models"]  # it stands above the models and reads what they read
MAY_IMPORT["train"].add("datasets")  # models that others have fitted are exported too
for may in MAY_IMPORT.values():
    may |= {"atomic_write", "untrusted"}  # they import nothing themselves
MAY_IMPORT |= {"atomic_write": set(), "untrusted": set()}
EVERYTHING = {"experiments", "cli", ""}  # the last is the package itself, whose names are looked up lazily
WITH_TORCH = {"models", "train", "experiments", "cli"}
WITHOUT_SCIPY = {
    "atomic_write",
    "dsp",
    "architecture",
    "recording",
    "texture_file",
    "render",
    "",
}  # at import


def package(module: str) -> str:
    """Return the part of a module's name that the table speaks of."""
    return module.split(".")[1] if "." in module else ""


def source(module: str) -> ast.Module:
    path = ROOT.joinpath(*module.split(".")[1:])
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return ast.parse(path.read_text(encoding="utf-8"))


def imported(tree: ast.AST) -> Iterator[str]:
    """Return every module that the code under a node names in an import."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            assert node.module is not None
            if node.module == "foten":
                yield from (f"foten.{alias.name}" for alias in node.names if alias.name != "__version__")
            else:
                yield node.module


def imported_at_once(module: str) -> Iterator[str]:
    """Return what a module imports when it is imported: nothing in functions, nothing for type checkers alone."""
    waiting: list[ast.AST] = list(source(module).body)
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            continue
        if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING"):
            waiting += node.orelse
        elif isinstance(node, ast.Import | ast.ImportFrom):
            yield from imported(node)
        else:
            waiting += ast.iter_child_nodes(node)


def of_project(modules: Iterator[str]) -> set[str]:
    return {package(name) for name in modules if name.startswith("foten.")}


def test_every_package_has_its_row() -> None:
    found = {package(module) for module in MODULES}
    assert found <= MAY_IMPORT.keys() | EVERYTHING


@pytest.mark.parametrize("module", MODULES)
def test_a_module_imports_what_its_layer_may(module: str) -> None:
    layer = package(module)
    if layer in EVERYTHING:
        return
    beyond = of_project(imported(source(module))) - MAY_IMPORT[layer] - {layer}
    assert not beyond, f"{module} imports {', '.join(sorted(beyond))}"


@pytest.mark.parametrize("module", MODULES)
def test_pytorch_stays_where_networks_are_trained(module: str) -> None:
    uses_torch = any(name.split(".")[0] == "torch" for name in imported(source(module)))
    assert not uses_torch or package(module) in WITH_TORCH
    if package(module) == "cli":
        assert not any(name.split(".")[0] == "torch" for name in imported_at_once(module))


@pytest.mark.parametrize("module", [m for m in MODULES if package(m) in WITHOUT_SCIPY])
def test_importing_the_runtime_loads_no_scipy(module: str) -> None:
    assert "scipy" not in {name.split(".")[0] for name in imported_at_once(module)}


def test_the_reader_of_imports_sees_what_it_should() -> None:
    code = "import a.b\nfrom foten import render\ndef f():\n    from c import d\nif x:\n    import e\n"
    assert set(imported(ast.parse(code))) == {"a.b", "foten.runtime", "c", "e"}
    assert of_project(imported(ast.parse("from foten.train.fit import fit\nimport foten"))) == {"train"}


def run(code: str, *arguments: str) -> str:
    """Return what a fresh interpreter prints, every warning an error."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *arguments], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_all_but_training_imports_without_pytorch() -> None:
    free = [module for module in MODULES if package(module) not in {"models", "train", "experiments"}]
    code = """
import importlib, sys
sys.modules["torch"] = None
for name in sys.argv[1:]:
    importlib.import_module(name)
"""
    run(code, *free)


def test_training_says_what_it_lacks_without_pytorch() -> None:
    """The other side of the test above: the block works."""
    code = "import sys; sys.modules['torch'] = None\ntry:\n    import foten.networks\nexcept ImportError as e: print(e.name)"
    assert run(code).strip() == "torch"


def test_a_texture_renders_with_numpy_alone(texture: Texture, tmp_path: Path) -> None:
    path = tmp_path / "mesh.foten"
    write_texture(texture, path)
    code = """
import sys
for name in ("torch", "scipy", "h5py", "matplotlib"):
    sys.modules[name] = None
import foten
import importlib, pkgutil, foten.runtime
for module in pkgutil.walk_packages(foten.runtime.__path__, "foten.runtime."):
    importlib.import_module(module.name)
import numpy as np
out = foten.Renderer(sys.argv[1], seed=4).render(np.linspace(0, 150, 100), np.full(100, 0.8))
print(*(value.hex() for value in out.tolist()))
"""
    found = [float.fromhex(value) for value in run(code, str(path)).split()]
    expected = Renderer(texture, seed=4).render(np.linspace(0, 150, 100), np.full(100, 0.8))
    np.testing.assert_array_equal(found, expected)


def test_importing_foten_loads_nothing_of_it() -> None:
    code = "import sys, foten\nprint(*(m for m in sys.modules if m.startswith(('foten.', 'numpy', 'safetensors'))))"
    assert run(code).split() == []


def test_the_public_names_are_there() -> None:
    for name in foten.__all__:
        assert getattr(foten, name) is not None
    assert set(foten.__all__) <= set(dir(foten))
    with pytest.raises(AttributeError, match="no attribute 'Texturizer'"):
        foten.Texturizer  # noqa: B018
