"""What the subcommands share: arguments, results on stdout, progress on stderr, checks of output paths."""

import json
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from inspect import Signature, signature
from pathlib import Path
from threading import Thread
from typing import Annotated, Any, TypeVar, get_type_hints

from typer import Argument, Option

from foten.untrusted import shown

JsonOption = Annotated[bool, Option("--json", help="Print the result as JSON on stdout.")]
TextureFile = Annotated[Path, Argument(metavar="T.foten", help="Texture file (.foten).")]
RecordingFile = Annotated[Path, Argument(metavar="REC.h5", help="Recording (.h5), as 'foten import' writes it.")]
Options = TypeVar("Options")


def options_from(kind: type[Options]) -> Callable[[Callable[[Options], None]], Callable[..., None]]:
    """Make a command of a function of one frozen dataclass: its fields are the arguments and options, `Option` a default."""
    hints = get_type_hints(kind, include_extras=True)

    def command_of(function: Callable[[Options], None]) -> Callable[..., None]:
        def command(**values: Any) -> None:
            function(kind(**values))

        parameters = [of.replace(annotation=hints[name]) for name, of in signature(kind).parameters.items()]
        command.__signature__ = Signature(parameters)  # type: ignore[attr-defined]
        command.__annotations__ = hints
        command.__name__, command.__doc__ = function.__name__, function.__doc__
        return command

    return command_of


def refuse(why: str, **options: Any) -> None:
    """Refuse the first of some options that is set, since it would have no effect."""
    for name, value in options.items():
        if value is not None and value is not False and value not in ("", []):
            raise ValueError(f"--{name.replace('_', '-')} {why}: leave it out")


def preload(modules: Sequence[str], files: Sequence[Path]) -> None:
    """Import libraries that take a second each beside the reading of files, where these exist.

    One that is missing is said by who needs it.
    """

    def import_all() -> None:
        for module in modules:
            with suppress(ImportError):
                import_module(module)

    if all(file.exists() for file in files):
        Thread(target=import_all).start()


def folder_option(help_text: str) -> Any:
    """Option `-o` of a command that writes a folder."""
    return Option("-o", "--output", metavar="DIR", help=help_text)


def say(text: str) -> None:
    """Print progress, on stderr."""
    print(_shown_lines(text), file=sys.stderr, flush=True)


def open_in_browser(link: str) -> None:
    """Open a page on this machine, or say that it has to be opened by hand."""
    import webbrowser

    if not webbrowser.open(link):
        say("no browser could be opened here: open the link above")


def say_code(link: str) -> None:
    """Print a link as a code that a tablet scans."""
    import segno

    segno.make(link, error="l").terminal(out=sys.stderr, compact=True)


def _shown_lines(text: str) -> str:
    """Text for a terminal; names in it may come from a file of anyone's."""
    return "\n".join(shown(line) for line in text.split("\n"))


def print_result(document: Any, text: str, as_json: bool) -> None:
    """Print a result, on stdout: as JSON, or as text."""
    print(json.dumps(document, indent=1, allow_nan=False) if as_json else _shown_lines(text))


def check_files(paths: list[Path]) -> None:
    """Refuse an output whose folder does not exist, before any work is done."""
    for path in paths:
        if not path.parent.is_dir():
            raise ValueError(f"cannot write {path}: there is no folder {path.parent}")
        if path.is_dir() and path.suffix:
            raise ValueError(f"cannot write {path}: it is a folder")


def check_output(path: Path, what: str, *suffixes: str) -> None:
    """Refuse an output, such as "a texture", whose name ends otherwise, or whose folder does not exist."""
    if path.suffix not in suffixes:
        raise ValueError(f"{what} is written as {suffixes[0]}, got -o {path.name}")
    check_files([path])


def check_folder(path: Path | None, option: str = "-o") -> None:
    """Refuse an output folder that is a file, before any work is done."""
    if path is not None and path.exists() and not path.is_dir():
        raise ValueError(f"{option} {path} is a file, expected a folder")
