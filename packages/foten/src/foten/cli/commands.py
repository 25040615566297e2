"""The commands by name: foten's own in one table, those of other packages by their entry points."""

from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any

GROUP = "foten.commands"  # of entry points
COMMANDS = {
    "simulate": "foten.cli.recordings:simulate",
    "import": "foten.cli.recordings:import_",
    "inspect": "foten.cli.recordings:inspect",
    "train": "foten.cli.train:train",
    "evaluate": "foten.cli.evaluate:evaluate",
    "info": "foten.cli.evaluate:info",
    "serve": "foten.cli.serve:serve",
    "play": "foten.cli.play:play",
    "render": "foten.cli.render:render",
    "export": "foten.cli.export:export",
    "describe": "foten.cli.editing:describe",
    "edit": "foten.cli.editing:edit",
    "blend": "foten.cli.editing:blend",
    "imagine": "foten.cli.imagine:imagine",
    "library": "foten.cli.texture_library:app",
    "tool": "foten.cli.editing:tool",
    "demo": "foten.cli.machine:demo",
    "devices": "foten.cli.machine:devices",
    "bench": "foten.cli.machine:bench",
    "doctor": "foten.cli.machine:doctor",
}
"""Function or Typer app of each command; a name of two words is a part that a command of foten hands over."""

PANELS = {
    "From a recording to a texture": "simulate import inspect train evaluate info",
    "Stroke, play, take elsewhere": "serve play render export",
    "Change a texture": "describe edit blend imagine adapt library tool",
    "Compare": "sweep tables figures study",
    "This machine": "demo devices bench doctor",
}
"""The order of --help."""

PACKAGES = {"study": "foten-study", "adapt": "foten-study"}
PACKAGES |= dict.fromkeys(("sweep", "tables", "figures", "imagine words", "library search"), "foten-lab")
"""Package of each command that an installation may lack."""


@cache
def others() -> dict[str, EntryPoint]:
    """Commands of other packages."""
    return {entry.name: entry for entry in entry_points(group=GROUP)}


def panels() -> dict[str, str]:
    """Panel of --help of each command that is installed, in order."""
    known = {name: panel for panel, names in PANELS.items() for name in names.split()}
    known |= {name: "Other packages" for name in others() if " " not in name and name not in known}
    return {name: panel for name, panel in known.items() if name in COMMANDS or name in others()}


def load(name: str) -> Any:
    """Function or Typer app of a command, imported; ValueError names the package to install where it is missing."""
    if name in COMMANDS:
        module, attribute = COMMANDS[name].split(":")
        return getattr(import_module(module), attribute)
    if name in others():
        return others()[name].load()
    package = PACKAGES[name]
    raise ValueError(f"{name} is in the package {package}: pip install './packages/foten' './packages/{package}'")
