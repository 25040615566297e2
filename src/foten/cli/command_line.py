"""Command line. Exit status: 0; 1 where a result fails a check; 2 for bad input, one line on stderr; 130 after Ctrl-C.

Results go to stdout, progress to stderr. Heavy imports stay inside the subcommands.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from typing import Annotated, Any

import typer
from typer.exceptions import Abort, TyperException

from foten.atomic_write import reason
from foten.cli.editing import blend, describe, edit
from foten.cli.evaluate import evaluate, info
from foten.cli.experiments import demo, figures, sweep, tables
from foten.cli.export import export
from foten.cli.imagine import imagine
from foten.cli.machine import bench, devices, doctor
from foten.cli.recordings import import_, inspect, simulate
from foten.cli.render import play, render
from foten.cli.serve import serve
from foten.cli.texture_library import app as library
from foten.cli.tool import app as tool
from foten.cli.train import train
from foten.console import say
from foten.study.adapt_command import adapt
from foten.study.commands import app as study


class _Commands(typer.core.TyperGroup):
    """Subcommands that turn Ctrl-C into an `Abort`: Typer would end silently."""

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


_EXTRAS = dict.fromkeys(("scipy", "h5py", "matplotlib", "openpyxl", "nptdms", "pymatreader", "PIL"), "data")
_EXTRAS |= dict.fromkeys(("starlette", "uvicorn", "websockets", "segno", "cryptography"), "serve")
_EXTRAS |= dict.fromkeys(("statsmodels", "pandas"), "study")
_EXTRAS |= {"sentence_transformers": "words", "torch": "train", "ray": "sweep", "onnx": "onnx", "onnxruntime": "onnx"}
"""Which extra installs a package that may be missing."""


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


# In the order in which --help lists them.
_PANELS: dict[str, tuple[Callable[..., None], ...]] = {
    "From a recording to a texture": (simulate, import_, inspect, train, evaluate, info),
    "Stroke, play, take elsewhere": (serve, play, render, export),
    "Change a texture": (describe, edit, blend, imagine, adapt),
    "Compare": (sweep, tables, figures),
    "This machine": (demo, devices, bench, doctor),
}
for _panel, _commands in _PANELS.items():
    for _command in _commands:
        app.command(_command.__name__.rstrip("_"), rich_help_panel=_panel)(_command)
    if _panel == "Change a texture":
        app.add_typer(library, name="library", rich_help_panel=_panel)
        app.add_typer(tool, name="tool", rich_help_panel=_panel)
    if _panel == "Compare":
        app.add_typer(study, name="study", rich_help_panel=_panel)


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
        text = f"this needs {package}, which is not installed: pip install 'foten[{_EXTRAS[package]}]'"
    except OSError as error:
        text = reason(error)
    except ValueError as error:
        text = str(error) or type(error).__name__
    say(f"foten: {' '.join(text.split())}")
    return 2
