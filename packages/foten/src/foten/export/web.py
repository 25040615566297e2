"""The studio's page as files for any host: it renders in the browser, and needs no server of ours."""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

KEEPS = "the page keeps the textures whole, and renders them in the browser"


def write_site(
    files: Mapping[str, Path], listed: Mapping[str, Any], textures: Mapping[str, Path], folder: Path
) -> None:
    """Write files of the page and of textures, by name, and the list of textures, into a folder, which is made."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, path in {**files, **textures}.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, folder / name)
    (folder / "textures.json").write_text(json.dumps({**listed, "server": False}, indent=1) + "\n", encoding="utf-8")
