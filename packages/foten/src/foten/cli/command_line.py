"""Command line. Exit status: 0; 1 where a result fails a check; 2 for bad input, one line on stderr; 130 after Ctrl-C.

Results go to stdout, progress to stderr. A command is imported when it is called, heavy libraries inside it.
"""

import os
import sys
from collections.abc import Iterator, Mapping
from typing import Annotated, Any

import typer
from typer.exceptions import Abort, TyperException
from typer.main import get_command, get_group

from foten.atomic_write import reason
from foten.cli import commands
from foten.console import say


class _Imported(Mapping[str, Any]):
    """Commands by name, each imported when it is asked for."""

    def __iter__(self) -> Iterator[str]:
        return iter(commands.panels())

    def __len__(self) -> int:
        return len(commands.panels())

    def __getitem__(self, name: str) -> Any:
        panel = commands.panels().get(name)
        if " " in name or (panel is None and name not in commands.PACKAGES):
            raise KeyError(name)
        command = commands.load(name)
        if isinstance(command, typer.Typer):
            command = get_group(command)
        else:
            single = typer.Typer(add_completion=False)
            single.command(name)(command)
            command = get_command(single)
        command.name, command.rich_help_panel = name, panel
        return command


class _Commands(typer.core.TyperGroup):
    """Subcommands that turn Ctrl-C into an `Abort`: Typer would end silently."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**settings)
        self.commands = _Imported()  # type: ignore[assignment]

    def invoke(self, ctx: Any) -> Any:
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as interrupted:
            raise Abort from interrupted


app = typer.Typer(
    name="foten",
    cls=_Commands,
    help="Learn haptic textures from recordings and render them as vibration.",
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


_EXTRAS = dict.fromkeys(("scipy", "h5py", "matplotlib", "openpyxl", "nptdms", "pymatreader", "PIL"), "foten[data]")
_EXTRAS |= dict.fromkeys(("starlette", "uvicorn", "websockets", "segno", "cryptography"), "foten[serve]")
_EXTRAS |= dict.fromkeys(("statsmodels", "pandas"), "foten-study[analysis]")
_EXTRAS |= {"torch": "foten[train]", "onnx": "foten[onnx]", "onnxruntime": "foten[onnx]"}
_EXTRAS |= {"ray": "foten-lab[sweep]", "sentence_transformers": "foten-lab[words]"}
"""What installs a package that may be missing."""


def _print_version(requested: bool) -> None:
    if requested:
        from foten import __version__

        print(__version__)
        raise typer.Exit


@app.callback()
def _global_options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line and exit with its status."""
    # Read when NumPy and PyTorch load their libraries: small matrices only lose by more threads.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    sys.exit(_status(sys.argv[1:]))


def _status(arguments: list[str]) -> int:
    """Exit status of one command; an expected failure is printed as one line."""
    if os.environ.get("FOTEN_DEBUG"):  # the whole traceback, for developers
        return app(arguments, standalone_mode=False) or 0
    try:
        return app(arguments or ["--help"], standalone_mode=False) or 0
    except (Abort, KeyboardInterrupt):
        say("foten: interrupted")
        return 130
    except TyperException as error:
        text = error.format_message()
    except ModuleNotFoundError as error:
        package = (error.name or "").split(".")[0]
        if package not in _EXTRAS:
            raise
        text = f"this needs {package}, which is not installed: pip install './packages/{_EXTRAS[package]}'"
    except (OSError, ValueError) as error:
        text = reason(error)
    say(f"foten: {' '.join(text.split())}")
    return 2
