"""The command line: one subcommand per stage; parse, call one function, write.

Exit status: 0; 1 for a result that fails a check; 2 for bad input or usage, one line on stderr; 130 after Ctrl-C.
Results go to stdout, progress to stderr. Heavy imports stay inside the subcommands.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.exceptions import Abort, TyperException

app = typer.Typer(
    name="foten",
    help="Haptic textures learned from a recording and given back as vibration.",
    add_completion=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_EXTRAS = {
    "scipy": "data",
    "h5py": "data",
    "matplotlib": "data",
    "openpyxl": "data",
    "nptdms": "data",
    "pymatreader": "data",
    "torch": "train",
}
"""Which extra installs a package that may be missing."""

JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON on stdout.")]


def _say(text: str) -> None:
    """Print progress, on stderr."""
    print(text, file=sys.stderr, flush=True)


def _print_json(document: Any) -> None:
    print(json.dumps(document, indent=1, sort_keys=False, allow_nan=False))


def _print_version(wanted: bool) -> None:
    if wanted:
        from foten import __version__

        print(__version__)
        raise typer.Exit


@app.callback()
def _common(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and stop.")
    ] = False,
) -> None:
    pass


def main() -> None:
    """Run the command line and turn every expected failure into one line and an exit status."""
    sys.exit(_status(sys.argv[1:]))


def _status(arguments: list[str]) -> int:
    if os.environ.get("FOTEN_DEBUG"):  # the whole traceback, for people who mend foten
        return app(arguments, standalone_mode=False) or 0
    if not arguments:
        arguments = ["--help"]
    try:
        return app(arguments, standalone_mode=False) or 0
    except (Abort, KeyboardInterrupt):
        _say("foten: interrupted")
        return 130
    except TyperException as error:
        _say(f"foten: {' '.join(error.format_message().split())}")
    except ModuleNotFoundError as error:
        package = (error.name or "").split(".")[0]
        if package not in _EXTRAS:
            raise
        _say(f"foten: this needs {package}, which is not installed: pip install 'foten[{_EXTRAS[package]}]'")
    except (ValueError, OSError) as error:
        _say(f"foten: {' '.join(str(error).split()) or type(error).__name__}")
    return 2


if __name__ == "__main__":
    main()
