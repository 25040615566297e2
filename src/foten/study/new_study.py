"""A new study file, to edit, from texture files."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from string import Template

from foten.models.texture_file import read_texture
from foten.study.design import INSTRUCTIONS, Rating

TEMPLATE = Path(__file__).with_name("new_study.toml")


def study_text(title: str, textures: Mapping[str, Mapping[str, str]], participants: int, seed: int) -> str:
    """Text of a study file, for textures by name, each with its files by method."""
    lines = []
    for name, files in textures.items():
        key = _key(name)
        lines += ["", f"[textures.{key}]", f"name = {_quoted(name)}"]
        lines += ['real = ""               # which sample the operator lays down', f"[textures.{key}.methods]"]
        lines += [f"{_key(method)} = {_quoted(file)}" for method, file in files.items()]
    values = {"title": _quoted(title), "participants": participants, "seed": seed, "instructions": INSTRUCTIONS}
    values |= {name: _quoted(getattr(Rating, name)) for name in ("question", "lowest", "highest")}
    return Template(TEMPLATE.read_text(encoding="utf-8")).substitute(values) + "\n".join(lines) + "\n"


def files_by_method(paths: Sequence[Path], folder: Path) -> tuple[dict[str, dict[str, str]], list[str]]:
    """Texture files by texture and method, as seen from a folder, and textures that lack a method and are left out.

    The texture is that of a file's card, the method its model; where two files of a texture have one model, the method is what
    their names have beside the texture's: mesh-slow, mesh-quick.

    Raises:
        ValueError: a file is no texture file, or there is one method alone.
    """
    models_of: dict[str, dict[Path, str]] = {}
    for path in paths:
        card = read_texture(path).card
        models_of.setdefault(str(card["texture"]) or path.stem, {})[path] = str(card["model"])
    if any(len(set(models.values())) < len(models) for models in models_of.values()):
        models_of = {
            name: {path: path.stem.removeprefix(name).strip("-_. ") or model for path, model in models.items()}
            for name, models in models_of.items()
        }
    usual = max((frozenset(models.values()) for models in models_of.values()), key=len)
    if len(usual) < 2:
        name = next(iter(models_of))
        raise ValueError(f"{name} has one method, expected two texture files or more of each texture, to compare")
    incomplete = [name for name, models in models_of.items() if frozenset(models.values()) != usual]
    files = {
        name: {
            method: os.path.relpath(path, folder) for path, method in sorted(models.items(), key=lambda item: item[1])
        }
        for name, models in models_of.items()
        if name not in incomplete
    }
    doubts = [f"left out {name}: it does not have each of {', '.join(sorted(usual))}" for name in incomplete]
    return files, doubts


def _key(name: str) -> str:
    return name if name.isascii() and name.replace("-", "").replace("_", "").isalnum() else _quoted(name)


def _quoted(text: str) -> str:
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return '"' + "".join(c if c.isprintable() else f"\\u{ord(c):04x}" for c in escaped) + '"'
