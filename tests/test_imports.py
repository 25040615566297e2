"""The layers: who may import whom, and what must run without PyTorch and without SciPy."""

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import foten
import foten_lab
import foten_study
from foten.models.texture_file import Texture, write_texture
from foten.runtime.renderer import Renderer

ROOTS = {package.__name__: Path(package.__file__).parent for package in (foten, foten_study, foten_lab)}
OTHERS = {"foten_study": "foten-study", "foten_lab": "foten-lab"}
MODULES = sorted(
    ".".join((name, *path.relative_to(root).with_suffix("").parts)).removesuffix(".__init__")
    for name, root in ROOTS.items()
    for path in root.rglob("*.py")
)

DOCUMENT = Path(__file__).parent.parent / "docs" / "architecture.md"


def table() -> dict[str, set[str] | None]:
    """What each package may import, as docs/architecture.md has it; None for everything."""
    _, rows, _ = re.split(r"<!-- /?imports -->\n", DOCUMENT.read_text(encoding="utf-8"))
    cells = [[cell.strip() for cell in row.strip("|").split("|")] for row in rows.splitlines()[2:]]
    return {
        package.strip(" `"): None
        if names.startswith("everything")
        else {name.strip(" `") for name in names.split(",") if name}
        for packages, names in cells
        for package in packages.split(",")
    }


MAY_IMPORT = table()
FOR_ALL = {"atomic_write", "untrusted"}
EVERYTHING = {"", "cli"}  # "": foten itself, lazily
WITH_TORCH = {"training", "foten-lab", "cli"}
TRAINED = re.compile(
    r"foten\.models\.(graph|\w+\.(?!definition$|sizes$|config$|recorded_innovations$|recorded_store$)\w+)"
)  # by PyTorch
SETTINGS = re.compile(r"foten\.models\.(trainable|\w+\.config)")  # of trainings, without PyTorch
SHARED = {f"foten.models.{name}" for name in ("conditions", "excitation", "model_sizes", "texture_file")}
NO_TORCH = {"foten.training", "foten.training.config", "foten_lab", "foten_lab.baselines", "foten_lab.baselines.sizes"}
NO_TORCH |= {f"foten_lab.{name}" for name in ("commands", "from_spectrum", "words", "words_commands")}
HEAVY = re.compile(r"foten\.cli\.(train_capture|simulator_reference|demo)")  # no commands
LISTENER = re.compile(r"foten\.evaluate\.listener(_network)?")  # loads PyTorch when it is asked
WITHOUT_SCIPY = {"atomic_write", "untrusted", "dsp", "recording", "models", "runtime", ""}  # at import
EXTERNAL = {"atomic_write": set(), "untrusted": set(), "dsp": {"numpy", "scipy"}, "models": {"numpy", "safetensors"}}


def may_train(module: str) -> bool:
    """Whether a module is of what may import PyTorch as soon as it is imported."""
    if module in NO_TORCH:
        return False
    trained = TRAINED.fullmatch(module) or LISTENER.fullmatch(module) or HEAVY.fullmatch(module)
    return bool(trained) or package(module) in {"training", "foten-lab"}


def package(module: str) -> str:
    """What the table calls the package that a module is in: a folder of foten, or another distribution."""
    first, *rest = module.split(".")
    return OTHERS.get(first, rest[0] if rest else "")


def source(module: str) -> ast.Module:
    first, *rest = module.split(".")
    path = ROOTS[first].joinpath(*rest)
    path = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    return ast.parse(path.read_text(encoding="utf-8"))


def imported(tree: ast.AST) -> Iterator[str]:
    """Every module that the code under a node names in an import."""
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
    """What a module imports when it is imported: nothing in functions, nothing for type checkers alone."""
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
    return {package(name) for name in modules if name.split(".")[0] in ROOTS and name != "foten"}


def test_no_distribution_imports_another_but_foten() -> None:
    for module in MODULES:
        assert of_project(imported(source(module))) & set(OTHERS.values()) <= {package(module)}, module


def test_the_modules_of_the_study_import_one_another_in_one_direction() -> None:
    """Also those that are imported for type checkers alone, or in functions."""
    waiting = {m: {n for n in imported(source(m)) if n in MODULES} for m in MODULES if package(m) == "foten-study"}
    waiting["foten_study"] = waiting["foten_study.tasks"] = set()
    while free := [module for module, needed in waiting.items() if not needed & waiting.keys()]:
        for module in free:
            del waiting[module]
    assert not waiting


def test_every_package_has_its_row() -> None:
    assert {package(module) for module in MODULES} == MAY_IMPORT.keys() | FOR_ALL | {""}


@pytest.mark.parametrize("module", MODULES)
def test_a_module_imports_what_its_layer_may(module: str) -> None:
    layer = package(module)
    if layer in EVERYTHING | FOR_ALL:
        return
    allowed = (
        (MAY_IMPORT[layer] or MAY_IMPORT.keys() - OTHERS.values())
        | FOR_ALL
        | {layer}
        | ({"training", "datasets", "runtime"} if may_train(module) else set())
        | ({"training"} if SETTINGS.fullmatch(module) else set())
    )
    beyond = of_project(imported(source(module))) - allowed
    assert not beyond, f"{module} imports {', '.join(sorted(beyond))}"


@pytest.mark.parametrize("module", [m for m in MODULES if package(m) == "training"])
def test_training_knows_no_model(module: str) -> None:
    of_models = {name for name in imported(source(module)) if name.startswith("foten.models")}
    assert of_models <= SHARED


@pytest.mark.parametrize("module", [m for m in MODULES if package(m) in EXTERNAL and not may_train(m)])
def test_a_module_needs_no_more_than_its_layer_may(module: str) -> None:
    names = {name.split(".")[0] for name in imported(source(module))}
    beyond = names - set(sys.stdlib_module_names) - EXTERNAL[package(module)] - {"foten"}
    assert not beyond, f"{module} imports {', '.join(sorted(beyond))}"


@pytest.mark.parametrize("module", MODULES)
def test_pytorch_stays_where_networks_are_trained(module: str) -> None:
    uses_torch = any(name.split(".")[0] == "torch" for name in imported(source(module)))
    assert not uses_torch or package(module) in WITH_TORCH or may_train(module)
    if not may_train(module):
        at_once = list(imported_at_once(module))
        assert not any(name.split(".")[0] == "torch" or may_train(name) for name in at_once)


@pytest.mark.parametrize("module", [m for m in MODULES if package(m) in WITHOUT_SCIPY and not may_train(m)])
def test_importing_the_runtime_loads_no_scipy(module: str) -> None:
    assert "scipy" not in {name.split(".")[0] for name in imported_at_once(module)}


def test_records_are_frozen() -> None:
    """All dataclasses but those that count or collect while something runs."""
    classes = [node for module in MODULES for node in ast.walk(source(module)) if isinstance(node, ast.ClassDef)]
    decorators = {node.name: " ".join(map(ast.unparse, node.decorator_list)) for node in classes}
    changing = {name for name, text in decorators.items() if "dataclass" in text and "frozen=True" not in text}
    counting = {"Allowance", "LiveStatistics", "Progress", "Timing", "TrialLog", "WindowStream"}
    assert changing == counting | {"Library", "_Stroked"}


def defaults(tree: ast.AST) -> Iterator[tuple[str, ast.Call | ast.expr]]:
    """Names of parameters and fields that have a default, and that."""
    for node in ast.walk(tree):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value:
            yield node.target.id, node.value
        elif isinstance(node, ast.FunctionDef) and node.args.defaults:
            names = [argument.arg for argument in node.args.args]
            yield from zip(names[-len(node.args.defaults) :], node.args.defaults, strict=True)


def test_switches_of_commands_are_off_and_seeds_begin_at_0() -> None:
    commands = [
        module
        for module in MODULES
        if package(module) == "cli" or (module.startswith("foten_study.") and "command" in module)
    ]
    options = [(name, ast.unparse(value)) for module in commands for name, value in defaults(source(module))]
    on = {name for name, text in options if text == "True" or text.startswith("Option(True")}
    assert on == {"feel", "open_page", "tiles"}
    seeds = [text for name, text in options if name == "seed"]
    assert all(re.match(r"Option\(([01], min=0|None), (max=2 \*\* (32 - 1|64 - 1|31), )?help", text) for text in seeds)


def test_the_reader_of_imports_sees_what_it_should() -> None:
    code = "import a.b\nfrom foten import runtime\ndef f():\n    from c import d\nif x:\n    import e\n"
    assert set(imported(ast.parse(code))) == {"a.b", "foten.runtime", "c", "e"}
    assert of_project(imported(ast.parse("from foten.training.window_fit import fit\nimport foten"))) == {"training"}


def run(code: str, *arguments: str) -> str:
    """What a fresh interpreter prints, every warning an error."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code, *arguments], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_all_but_training_imports_without_pytorch() -> None:
    free = [module for module in MODULES if not may_train(module)]
    code = """
import importlib, sys
sys.modules["torch"] = None
for name in sys.argv[1:]:
    importlib.import_module(name)
"""
    run(code, *free)


def test_adapt_needs_nothing_of_the_statistics_of_a_study() -> None:
    code = """
import sys
for name in ("pandas", "statsmodels", "scipy.stats"):
    sys.modules[name] = None
import foten_study.adapt_command, foten_study.adapt_server
"""
    run(code)


def test_a_page_for_any_host_needs_no_server(tmp_path: Path) -> None:
    """`foten export --to web` asked for starlette."""
    program = "import sys; sys.modules['starlette'] = None; from foten.cli import main; main()"
    arguments = ["export", "--to", "web", "-o", str(tmp_path / "site")]
    done = subprocess.run([sys.executable, "-c", program, *arguments], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "site" / "index.html").exists()


def test_a_command_loads_itself_alone_and_help_no_heavy_library() -> None:
    code = "import sys; from foten.cli.command_line import _status; _status(sys.argv[1:]); print(*sys.modules)"
    assert not {"foten_study.commands", "foten.cli.train", "foten.editing.blend"} & set(
        run(code, "devices", "-h").split()
    )
    loaded = set(run(code, "--help").split())
    assert {"foten_study.commands", "foten.cli.train", "foten.editing.blend"} <= loaded
    assert not {"torch", "scipy", "h5py", "matplotlib", "starlette", "onnxruntime"} & loaded


def test_training_says_what_it_lacks_without_pytorch() -> None:
    """The other side of the test above: the block works."""
    code = "import sys; sys.modules['torch'] = None\ntry:\n    import foten.training.loop\nexcept ImportError as e: print(e.name)"
    assert run(code).strip() == "torch"


def test_a_texture_renders_with_numpy_alone(texture: Texture, tmp_path: Path) -> None:
    path = tmp_path / "mesh.foten"
    write_texture(texture, path)
    code = """
import sys
for name in ("torch", "scipy", "h5py", "matplotlib"):
    sys.modules[name] = None
import foten
import foten_lab
import foten_study
import importlib, pkgutil, foten.runtime
for module in pkgutil.walk_packages(foten.runtime.__path__, "foten.runtime."):
    importlib.import_module(module.name)
import numpy as np
out = foten.Renderer(sys.argv[1], seed=4).render(np.linspace(0, 150, 100), np.full(100, 0.8))
print(*(value.hex() for value in out.tolist()))
"""
    rendered = [float.fromhex(value) for value in run(code, str(path)).split()]
    expected = Renderer(texture, seed=4).render(np.linspace(0, 150, 100), np.full(100, 0.8))
    np.testing.assert_array_equal(rendered, expected)


def test_importing_foten_loads_nothing_of_it() -> None:
    code = "import sys, foten\nprint(*(m for m in sys.modules if m.startswith(('foten.', 'numpy', 'safetensors'))))"
    assert run(code).split() == []


def test_the_public_names_are_there() -> None:
    for name in foten.__all__:
        assert getattr(foten, name) is not None
    assert set(foten.__all__) <= set(dir(foten))
    with pytest.raises(AttributeError, match="no attribute 'Texturizer'"):
        foten.Texturizer  # noqa: B018
