"""Mutants that nobody chose: operators on syntax, drawn by a seed over all Python and C; the share that dies, by package.

    python tests/random_mutants.py --seed HASH [--n 25] [--jobs 2] [PACKAGE ...]

Changes are ordered by a hash of the seed and the change, so that a draw stays what it was while other code is written; the
operators take turns. A mutant runs the tests that execute its line (of C: that load the kernel) and pass without it. Results go
to build/mutants/results.csv; one that died there is not tried again. `EQUIVALENT` lists those that no test could see.
"""

from __future__ import annotations

import argparse
import ast
import copy
import csv
import hashlib
import importlib
import itertools
import json
import multiprocessing
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

ROOT = Path(__file__).parents[1]
WORK = ROOT / "build" / "mutants"
PACKAGES = ROOT / "packages"
SOURCES = [PACKAGES / "foten/src/foten", PACKAGES / "foten-study/src/foten_study", PACKAGES / "foten-lab/src/foten_lab"]
CONSTANTS = ROOT / "packages/foten/native" / "src" / "constants.h"
# That of the extra `dev` lies beside this Python, which need not be in the path.
CMAKE = shutil.which("cmake", path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
C, TOP = "native", "foten"  # packages of the kernel, and of the modules that are in none
OPERATORS = ("comparison", "plus or minus", "constant", "off by one", "swapped arguments", "dropped call")
OTHER = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "+": "-", "-": "+", "+=": "-=", "-=": "+="}
OTHER_NODE: dict[type, type] = {
    **{ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq},
    **{ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.Add: ast.Sub, ast.Sub: ast.Add},
}
CHANGED = ast.Compare | ast.BinOp | ast.AugAssign | ast.Constant | ast.Call | ast.Expr
# Calls whose first two arguments may change places.
COMMUTATIVE = re.compile(r"f?(max|min)f?|maximum|minimum|hypot|isclose|allclose|array_equal|gcd|logaddexp|fabs")
LARGEST_INDEX = 10  # above it, a whole number is a constant and no count of places
PRELOADED = "torch scipy.signal scipy.io h5py pandas matplotlib.pyplot openpyxl starlette pytest coverage"


EQUIVALENT: dict[str, str] = {
    "2a83bf48d8": "at 0 either side of the curve begins at 0, which is its strength",
    "94b3833ae3": "of what is put before a window, no more than before is kept",
    "a04def26f8": "0 held between a number and n, and the number held between 0 and n, are the same",
    "55c42be63e": "where two points are left, none within is",
    "f798188bd7": "points that span no area are taken out before",
    "987b9fc32d": "a factor of all levels is in no gain between them",
    "e9f8f3d417": "what is taken away is 0",
    "0711a79630": "the steady level from 1 s on differs from that from 0.5 s on by at most 0.028 dB, less than a line is wide",
    "ffb3353669": "what is zipped was found to have three entries",
}
"""Mutants that change nothing that a test could see, by their key, and why."""


@dataclass(frozen=True)
class Change:
    """One change of a file's text."""

    path: str  # from the root of the repository
    scope: str  # names of classes and functions around it
    line: int
    operator: str
    what: str  # before → after
    number: int  # among the equal ones of its scope
    apply: Callable[[], str]

    @property
    def key(self) -> str:
        """Hash of what stays while other lines are written."""
        text = "\0".join(
            (self.path.removeprefix("packages/foten/"), self.scope, self.operator, self.what, str(self.number))
        )
        return hashlib.sha256(text.encode()).hexdigest()[:10]

    def row(self) -> list[str]:
        return [self.key, self.path, str(self.line), self.scope, self.operator, self.what]

    def rank(self, seed: str) -> str:
        """Place in a seed's order."""
        return hashlib.sha256(f"{seed}{self.key}".encode()).hexdigest()


def package_of(path: Path) -> str:
    """The folder in `foten` that a file is in, or the other package; `native` of C, `foten` of the modules above."""
    if path.suffix in (".c", ".h"):
        return C
    if not path.is_relative_to(SOURCES[0]):
        return path.relative_to(PACKAGES).parts[0]
    parts = path.relative_to(SOURCES[0]).parts
    return parts[0] if len(parts) > 1 else TOP


def sources() -> list[Path]:
    """All Python of the packages and all C of the kernel, without the table that a script writes."""
    c = [path for folder in ("src", "training") for path in (ROOT / "packages/foten/native" / folder).glob("*.[ch]")]
    return sorted(
        [
            *(path for source in SOURCES for path in source.rglob("*.py")),
            *(path for path in c if path.name != "resample_table.h"),
        ]
    )


def changes(path: Path, root: Path = ROOT) -> list[Change]:
    """Every change of a file."""
    source, counts, result = path.read_text(), {}, []
    for scope, line, operator, what, apply in (c_changes if path.suffix in (".c", ".h") else python_changes)(source):
        number = counts[scope, operator, what] = counts.get((scope, operator, what), -1) + 1
        result.append(Change(str(path.relative_to(root)), scope, line, operator, what, number, apply))
    return result


def drawn(all_changes: list[Change], seed: str) -> Iterator[Change]:
    """A package's changes in the order of a seed, the operators in turn."""
    ordered = sorted(all_changes, key=lambda change: change.rank(seed))
    by_operator = [[change for change in ordered if change.operator == operator] for operator in OPERATORS]
    for row in itertools.zip_longest(*by_operator):
        yield from filter(None, row)


Found = tuple[str, int, str, str, Callable[[], str]]


def python_changes(source: str) -> Iterator[Found]:
    """Changes of nodes of the syntax tree; annotations, and what runs for a type checker alone, are left out."""
    for index, (scope, node) in enumerate(_nodes(ast.parse(source), "")):
        for operator in OPERATORS if isinstance(node, CHANGED) else ():
            if (changed := _changed(copy.deepcopy(node), operator)) is None:
                continue

            def apply(index: int = index, operator: str = operator) -> str:
                tree = ast.parse(source)
                (node,) = (node for _, node in itertools.islice(_nodes(tree, ""), index, index + 1))
                return ast.unparse(_Swap(node, _changed(copy.copy(node), operator)).visit(tree))

            yield scope, node.lineno, operator, f"{ast.unparse(node)} → {ast.unparse(changed)}", apply


class _Swap(ast.NodeTransformer):
    def __init__(self, node: ast.AST, other: ast.AST) -> None:
        self._node, self._other = node, other

    def visit(self, node: ast.AST) -> Any:
        return self._other if node is self._node else self.generic_visit(node)


def _nodes(node: Any, scope: str) -> Iterator[tuple[str, Any]]:
    """Nodes with the names of the classes and functions around them, in the order of the source."""
    if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "__name__ == '__main__'"):
        return
    yield scope, node
    if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
        scope = f"{scope}.{node.name}" if scope else node.name
    for name, value in ast.iter_fields(node):
        if name in ("annotation", "returns"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.AST):
                yield from _nodes(child, scope)


def _changed(node: Any, operator: str) -> Any:
    """A node, changed in place, or another for it; None where the operator does not fit."""
    match operator, node:
        case "comparison", ast.Compare(ops=[first, *others]) if type(first) in OTHER_NODE:
            node.ops = [OTHER_NODE[type(first)](), *others]
        case "plus or minus", ast.BinOp(left=one, right=other, op=ast.Add() | ast.Sub()) if not _is_text(one, other):
            node.op = OTHER_NODE[type(node.op)]()
        case "plus or minus", ast.AugAssign(value=value, op=ast.Add() | ast.Sub()) if not _is_text(value):
            node.op = OTHER_NODE[type(node.op)]()
        case "constant", ast.Constant(value=bool()):
            node.value = not node.value
        case "constant", ast.Constant(value=int() | float() as value) if value and not _is_count(value):
            node.value = 2 * value
        case "off by one", ast.Constant(value=int() as value) if _is_count(value):
            node.value = value + 1
        case "swapped arguments", ast.Call(args=[first, second, *others]) if not (
            COMMUTATIVE.fullmatch(ast.unparse(node.func).split(".")[-1])
            or isinstance(first, ast.Starred)
            or isinstance(second, ast.Starred)
            or ast.dump(first) == ast.dump(second)
        ):
            node.args = [second, first, *others]
        case "dropped call", ast.Expr(value=ast.Call() | ast.Await(value=ast.Call())):
            return ast.Pass()
        case _:
            return None
    return node


def _is_count(value: Any) -> bool:
    return type(value) is int and value <= LARGEST_INDEX


def _is_text(*nodes: Any) -> bool:
    return any(isinstance(node, ast.JoinedStr) or isinstance(getattr(node, "value", 0), str | bytes) for node in nodes)


TOKEN = re.compile(
    r"""(?P<skip>//[^\n]*|/\*.*?\*/|^[ \t]*\#(?:\\\n|[^\n])*|\s+)|(?P<text>"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*')"""
    r"""|(?P<number>(?:\d[\w.]*|\.\d+)(?:(?<=[eE])[+-]\d+\w*)?)|(?P<name>\w+)"""
    r"""|(?P<sign><<=|>>=|->|\+\+|--|<<|>>|[-+*/%<>=!&|^]=|&&|\|\||.)""",
    re.DOTALL | re.MULTILINE | re.VERBOSE,
)
KEYWORDS = {"if", "for", "while", "switch", "return", "sizeof", "do", "else", "case", "static_assert", "_Static_assert"}


def c_changes(source: str) -> Iterator[Found]:
    """Changes of tokens inside of functions."""
    tokens = [match for match in TOKEN.finditer(source) if match.lastgroup != "skip"]
    texts = [match[0] for match in tokens]
    scope, depth = "", 0
    for i, (token, text) in enumerate(zip(tokens, texts, strict=True)):
        if depth == 0 and token.lastgroup == "name" and texts[i + 1 : i + 2] == ["("]:
            scope = text
        depth += {"{": 1, "}": -1}.get(text, 0)
        if depth == 0:
            continue
        for operator, start, end, after in _token_changes(tokens, texts, i):
            before = " ".join(source[start:end].split())
            line = source.count("\n", 0, start) + 1

            def apply(start: int = start, end: int = end, after: str = after) -> str:
                return source[:start] + after + source[end:]

            yield scope, line, operator, f"{before} → {after} after {''.join(texts[max(i - 3, 0) : i])}", apply


def _token_changes(tokens: list[re.Match[str]], texts: list[str], i: int) -> Iterator[tuple[str, int, int, str]]:
    """Operators that fit a token, each with the start and end of what it replaces, and by what."""
    token, text = tokens[i], texts[i]
    operand = (
        i > 0
        and (tokens[i - 1].lastgroup in ("name", "number") or texts[i - 1] in ")]")
        and texts[i - 1] not in KEYWORDS
    )
    if text in OTHER and operand:
        yield ("comparison" if text[0] in "<>=!" else "plus or minus"), token.start(), token.end(), OTHER[text]
    if token.lastgroup == "number" and text.isdigit() and int(text) <= LARGEST_INDEX:
        yield "off by one", token.start(), token.end(), str(int(text) + 1)
    elif token.lastgroup == "number" and re.fullmatch(r"[\d.]+(e[+-]?\d+)?", text) and float(text) != 0:
        yield "constant", token.start(), token.end(), str(2 * int(text)) if text.isdigit() else f"{2 * float(text)!r}"
    if token.lastgroup == "name" and text not in KEYWORDS and texts[i + 1 : i + 2] == ["("]:
        ends = _argument_ends(texts, i + 1)
        if len(ends) > 1 and not COMMUTATIVE.fullmatch(text):
            first, second = tokens[i + 2].start(), tokens[ends[0] + 1].start()
            source = token.string
            one, other = source[first : tokens[ends[0] - 1].end()], source[second : tokens[ends[1] - 1].end()]
            if one != other:
                yield "swapped arguments", first, tokens[ends[1] - 1].end(), f"{other}, {one}"
        if ends and _begins_statement(texts, i) and texts[ends[-1] + 1 : ends[-1] + 2] == [";"]:
            yield "dropped call", token.start(), tokens[ends[-1]].end(), "(void)0"


def _begins_statement(texts: list[str], i: int) -> bool:
    """Whether a statement begins at a token: after another, a brace, `else`, or the condition of `if`, `for` or `while`."""
    depth = 0
    for k in range(i - 1, -1, -1) if texts[i - 1] == ")" else ():
        depth += (texts[k] == ")") - (texts[k] == "(")
        if depth == 0:
            return texts[k - 1] in ("if", "for", "while")
    return texts[i - 1] in (";", "{", "}", "else")


def _argument_ends(texts: list[str], opening: int) -> list[int]:
    """Places of the commas between a call's arguments, and of the bracket that closes it."""
    depth, ends = 0, []
    for i in range(opening, len(texts)):
        depth += (texts[i] in "([{") - (texts[i] in ")]}")
        if (texts[i] == "," and depth == 1) or depth == 0:
            ends.append(i)
        if depth == 0:
            return ends if i > opening + 1 else []
    return []


class LineRecorder:
    """Plugin of pytest: which test executes which line, how long each takes, and which fail."""

    def __init__(self, folder: Path) -> None:
        self._coverage = importlib.import_module("coverage").Coverage(
            data_file=None, include=[f"{folder}/packages/*/src/*"], config_file=False
        )
        self._folder = folder
        self.result: dict[str, Any] = {"seconds": {}, "failed": [], "lines": {}}

    def pytest_configure(self) -> None:
        self._coverage.start()

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        self._coverage.switch_context(nodeid)

    def pytest_runtest_logreport(self, report: Any) -> None:
        seconds = self.result["seconds"]
        seconds[report.nodeid] = seconds.get(report.nodeid, 0.0) + report.duration
        if report.failed or report.skipped:
            self.result["failed"].append(report.nodeid)

    def pytest_unconfigure(self) -> None:
        self._coverage.stop()
        data = self._coverage.get_data()
        for path in data.measured_files():
            lines = {str(line): tests for line, tests in data.contexts_by_lineno(path).items() if any(tests)}
            self.result["lines"][str(Path(path).relative_to(self._folder))] = lines


class Deadline:
    """Plugin of pytest: a test that takes over 100 s, four times what any takes of Python, ends the process."""

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        signal.alarm(100)


def run_pytest(folder: Path, arguments: list[str], limit_s: float, recorder: LineRecorder | None = None) -> str:
    """Run a copy's tests in a fork of this process: `passed`, `failed`, or `late`. A recorder writes its `record.json`."""
    child = multiprocessing.get_context("fork").Process(target=_pytest, args=(folder, arguments, recorder))
    child.start()
    child.join(limit_s)
    outcome = {None: "late", 0: "passed", 5: "passed"}.get(child.exitcode, "failed")  # 5: nothing was selected
    if outcome == "late" and recorder and child.pid:
        os.kill(child.pid, signal.SIGINT)  # which writes what was recorded
        child.join(60)
    with suppress(ProcessLookupError):
        os.killpg(child.pid or 0, signal.SIGKILL)  # a group that is theirs alone
    child.join()
    return outcome


def _pytest(folder: Path, arguments: list[str], recorder: LineRecorder | None) -> None:
    os.setsid()
    os.chdir(folder)
    resource.setrlimit(resource.RLIMIT_DATA, (8 << 30, 8 << 30))
    log = os.open(folder / "log.txt", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(log, 1)
    os.dup2(log, 2)
    sys.meta_path[:] = [finder for finder in sys.meta_path if "ScikitBuild" not in type(finder).__name__]
    sys.path[:0] = [*import_paths(folder), str(folder / "tests")]
    os.environ["PYTHONPATH"] = python_path(folder)
    import pytest

    options = ["-q", "-p", "no:xdist", "-p", "no:cacheprovider", *([] if recorder else ["-x"])]
    status = pytest.main([*options, *arguments], [recorder or Deadline()])
    if recorder:
        (folder / "record.json").write_text(json.dumps(recorder.result))
    sys.stdout.flush()
    os._exit(int(status))


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
    (folder / "shadow").mkdir(exist_ok=True)
    (folder / "shadow" / "_editable_skbc_foten.py").touch()  # in place of the finder of the installed package
    assert CMAKE is not None
    subprocess.run(
        [CMAKE, "-S", folder / "packages/foten", "-B", folder / "build", "-D", "FOTEN_TRAINING=ON"],
        check=True,
        capture_output=True,
    )


def import_paths(folder: Path) -> list[str]:
    """Folders that a copy's packages are imported from."""
    return [str(folder / source.parent.relative_to(ROOT)) for source in SOURCES]


def python_path(folder: Path) -> str:
    """`PYTHONPATH` of a process, and of all that it starts, that is to import a copy's package and no installed one."""
    return os.pathsep.join([*import_paths(folder), str(folder / "shadow")])


def build(folder: Path) -> None:
    """Build a copy's kernel beside its package."""
    assert CMAKE is not None
    subprocess.run([CMAKE, "--build", folder / "build", "--parallel", "2"], check=True, capture_output=True)
    kernel = folder / "packages/foten/src/foten/runtime/kernel"
    kernel.mkdir(exist_ok=True)
    for name in ("libfoten", "libfoten_training"):
        shutil.copy(next((folder / "build").glob(f"{name}.*")).resolve(), kernel / f"{name}.so")
    for path in ("include/foten.h", "wasm/foten.mjs", "wasm/foten.wasm"):
        shutil.copy(folder / "packages/foten/native" / path, kernel)


def fresh_copy(number: int) -> Path:
    """A copy of the sources and tests in `build/mutants`, its kernel built."""
    folder = WORK / f"copy-{number}"
    for name in ("packages", "tests", "docs"):
        shutil.rmtree(folder / name, ignore_errors=True)
    copy_tree(folder)
    build(folder)
    return folder


def record(folder: Path, test: str) -> dict[str, Any]:
    """What a file of tests executes, recorded once for its text, with the digests of the sources at that time."""
    stored = WORK / "lines" / f"{Path(test).stem}-{_digest((ROOT / test).read_bytes())}.json"
    if not stored.exists():
        selected = ["-m", "not slow and not gpu and not browser", test]
        paths = [path.relative_to(ROOT) for path in sources()]
        digests = {str(path): _digest((folder / path).read_bytes()) for path in paths}
        run_pytest(folder, selected, 600, LineRecorder(folder))
        result = json.loads((folder / "record.json").read_text())
        (folder / "record.json").unlink()
        stored.parent.mkdir(parents=True, exist_ok=True)
        stored.write_text(json.dumps(result | {"sources": digests}))
    result = json.loads(stored.read_text())
    return cast(dict[str, Any], result)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:12]


Judges = list[tuple[list[str], float]]
"""Arguments of pytest in the order in which they are tried, and the seconds that each took without a mutant."""


def judges(change: Change, records: dict[str, dict[str, Any]]) -> Judges:
    """Tests that execute a change's line and pass without it, first those that import its module; then files with processes.

    Where no test executes it, those that execute the module, and all files that import it. Of C: those that call the kernel.
    """
    path, in_c = change.path, change.path.endswith((".c", ".h"))
    if in_c:
        path = f"packages/foten/src/foten/{'training/training_kernel' if '/training/' in path else 'runtime/native'}.py"
    # Any command is run by the package's `main`.
    module = "foten.cli" if "/cli/" in path else path[path.index("/src/") + 5 : -3].replace("/", ".")
    imported = re.compile(rf"\b{re.escape(module)}\b")
    on_line: dict[str, float] = {}
    in_module: dict[str, float] = {}
    files: list[tuple[float, list[str], bool]] = []
    naming: set[str] = set()
    for test, result in records.items():
        passed = {name: s for name, s in result["seconds"].items() if name not in result["failed"]}
        lines, text = result["lines"].get(path, {}), (ROOT / test).read_text()
        text += CONSTANTS.read_text() if CONSTANTS.name in text else ""  # it names constants of Python
        in_module |= {name: passed[name] for names in lines.values() for name in names if name in passed}
        if result["sources"].get(path) == _digest((ROOT / path).read_bytes()):  # else lines have moved
            on_line |= {name: passed[name] for name in lines.get(str(change.line), []) if name in passed}
        named = Path(change.path).stem in test if in_c else imported.search(text)
        naming |= {test} if named else set()
        if named or ("test_kernel_build" if in_c else "test_imports") in test:  # of the latter one reads every module
            without = [option for name in result["failed"] for option in ("--deselect", name)]
            files.append((sum(passed.values()), [test, *without], "subprocess" in text))
    executing = in_module if in_c or not on_line else on_line
    by_relevance = sorted(executing, key=lambda name: (name.partition("::")[0] not in naming, executing[name]))
    quick = (by_relevance, sum(executing.values()))
    # Lines that a process of a test executes are not recorded.
    whole = [(names, seconds) for seconds, names, starts in sorted(files) if starts or in_c or not on_line]
    return [*whole[:1], quick, *whole[1:]] if in_c else [quick, *whole]


def fate(folder: Path, change: Change, tests: Judges, limit_s: float) -> str:
    """`dies`, `survives` or `does not compile`, after a change was made in a copy and tested."""
    path = folder / change.path
    original, stat = path.read_text(), path.stat()
    in_c = change.path.endswith((".c", ".h"))
    try:
        path.write_text(change.apply())
        if not in_c:
            os.utime(path, (time.time(), next(MOMENTS)))  # so that no compiled file of another mutant counts as its own
        elif not _builds(folder):
            return "does not compile"
        end = time.monotonic() + limit_s
        for group, expected_s in tests:
            this_s = min(60 + 5 * expected_s, end - time.monotonic())
            outcome = run_pytest(folder, group, this_s) if group and this_s > 0 else "passed"
            if outcome == "failed" or (outcome == "late" and time.monotonic() < end):  # or without an end
                return "dies"
        return "survives"
    finally:
        path.write_text(original)
        if in_c:
            build(folder)
        else:
            os.utime(path, (stat.st_atime, stat.st_mtime))


def _builds(folder: Path) -> bool:
    try:
        build(folder)
    except subprocess.CalledProcessError:
        return False
    return True


MOMENTS = itertools.count(int(time.time()) - 10**8)


def _start(numbers: Any) -> None:
    """Import what tests import, once, and take a copy for this process alone."""
    global folder
    for name in PRELOADED.split():
        importlib.import_module(name)
    folder = fresh_copy(numbers.get())


def _record(test: str) -> tuple[str, dict[str, Any]]:
    return test, record(folder, test)


def _fate(key: str, path: str, tests: Judges, limit_s: float) -> str:
    (change,) = (change for change in changes(folder / path, folder) if change.key == key)
    return fate(folder, change, tests, limit_s)


def read_results() -> dict[str, list[str]]:
    """Rows of the results by the key of their mutant."""
    path = WORK / "results.csv"
    return {row[1]: row for row in csv.reader(path.open())} if path.exists() else {}


def write_results(rows: dict[str, list[str]]) -> None:
    """Write the results anew under a name of their own, and rename."""
    partial = WORK / "results.part"
    with partial.open("w", newline="") as file:
        csv.writer(file).writerows(rows.values())
    partial.replace(WORK / "results.csv")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", required=True, help="any text; a commit's hash, say")
    parser.add_argument("--n", type=int, default=25, help="mutants of each package (default: 25)")
    parser.add_argument("--jobs", type=int, default=2, help="copies that are tested at once (default: 2)")
    parser.add_argument("--limit", type=float, default=240, help="s of its tests that a mutant survives (default: 240)")
    parser.add_argument(
        "packages", nargs="*", help="folders of foten, foten-study, foten-lab, or native (default: all)"
    )
    options = parser.parse_args()
    by_package: dict[str, list[Change]] = {}
    for path in sources():
        by_package.setdefault(package_of(path), []).extend(changes(path))
    draws = {name: list(drawn(by_package[name], options.seed)) for name in options.packages or sorted(by_package)}
    WORK.mkdir(parents=True, exist_ok=True)
    rows, tried, numbers = read_results(), set[str](), multiprocessing.Queue()
    for number in range(options.jobs):
        numbers.put(number)
    with ProcessPoolExecutor(options.jobs, initializer=_start, initargs=(numbers,)) as pool:
        names = sorted(path.name for path in (ROOT / "tests").glob("test_*.py") if path.stem != "test_mutants")
        records = dict(pool.map(_record, [f"tests/{name}" for name in names]))
        for test, result in records.items():
            if result["failed"]:
                print(f"{test}: {len(result['failed'])} of {len(result['seconds'])} tests do not pass", file=sys.stderr)
        while futures := {
            pool.submit(_fate, change.key, change.path, judges(change, records), options.limit): (name, change)
            for name, draw in draws.items()
            for change in counted(draw, rows, options.n)
            if change.key not in rows or (rows[change.key][-1] == "survives" and change.key not in tried)
        }:
            for done in as_completed(futures):
                name, change = futures[done]
                tried.add(change.key)
                rows[change.key] = [name, *change.row(), done.result()]
                write_results(rows)
                print(*rows[change.key], sep="  ", file=sys.stderr)
    for name, draw in draws.items():
        n_equivalent = sum(change.key in EQUIVALENT for change in draw[: options.n])
        fates = [rows[change.key][-1] for change in counted(draw, rows, options.n)]
        died = fates.count("dies")
        print(f"{name}: {died} of {len(fates)} die ({died / len(fates):.0%}); {n_equivalent} are equivalent")


def counted(draw: list[Change], rows: dict[str, list[str]], n: int) -> list[Change]:
    """The first n that compile, without those that are equivalent."""
    compiled = [change for change in draw if rows.get(change.key, [""])[-1] != "does not compile"]
    return [change for change in compiled[:n] if change.key not in EQUIVALENT]


if __name__ == "__main__":
    main()
