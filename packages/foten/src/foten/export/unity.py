"""A Unity package with a texture inside: the C# binding, a component, the kernel of this system."""

import json
import shutil
from pathlib import Path

from foten.atomic_write import atomic_write
from foten.export.c_header import identifier
from foten.models.registry import GraphSizes
from foten.models.texture_file import Texture
from foten.runtime.binding import LIBRARIES, kernel_file

KEEPS = "the package keeps the whole texture, and the kernel of this system"
PACKAGE = Path(__file__).with_name("unity_package")
SOURCES = ("package.json", "README.md", "Runtime/Foten.cs", "Runtime/FotenSource.cs", "Runtime/foten.asmdef")
_WORD = "TEXTURE"  # in the sources, where the texture's name stands


def write_unity(texture: Texture, folder: Path) -> str:
    """Write the package into a folder, which is made, and return the texture's name; ValueError for one of ONNX Runtime."""
    if isinstance(texture.sizes, GraphSizes):
        runs = "the network of this texture is run by ONNX Runtime, which the package does not hold"
        raise ValueError(f"{runs}: export a texture of foten-plus, foten or ar")
    name = identifier(str(texture.card["texture"]))
    for source in SOURCES:
        (folder / source).parent.mkdir(parents=True, exist_ok=True)
        text = (PACKAGE / source).read_text(encoding="utf-8").replace(_WORD, name)
        if source == "package.json":
            text = json.dumps({**json.loads(text), "name": f"org.foten.{name.replace('_', '-')}"}, indent=2) + "\n"
        with atomic_write(folder / source) as part:
            part.write_text(text, encoding="utf-8")
    resources, plugins = folder / "Runtime" / "Resources" / "Foten", folder / "Runtime" / "Plugins"
    for place in (resources, plugins):
        place.mkdir(parents=True, exist_ok=True)
    with atomic_write(resources / f"{name}.bytes") as part:
        part.write_bytes(texture.to_bytes())
    library = kernel_file(*LIBRARIES)
    with atomic_write(plugins / (library.name if library.suffix != ".dll" else "foten.dll")) as part:
        shutil.copyfile(library, part)
    return name
