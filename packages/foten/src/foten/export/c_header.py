"""A texture as a C header: the bytes of the texture file, aligned, for `foten_model_load`."""

import re
from pathlib import Path

from foten.atomic_write import atomic_write
from foten.models.texture_file import Texture
from foten.untrusted import printable

KEEPS = "the header keeps the whole texture, proof included"
_ROW = 20  # bytes of a line


def identifier(name: str) -> str:
    """Name as C has it: `steel-mesh 1` → `steel_mesh_1`."""
    word = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_").lower() or "texture"
    return f"texture_{word}" if word[0].isdigit() else word


def write_c_header(texture: Texture, path: Path) -> str:
    """Write a texture as a header and return the name of its bytes in C."""
    name, data, card = identifier(str(texture.card["texture"]) or path.stem), texture.to_bytes(), texture.card
    body = ",\n".join(", ".join(map(str, data[i : i + _ROW])) for i in range(0, len(data), _ROW))
    trained = texture.trained_range_in_words()
    # Of anyone's file, in a comment, which it must not end.
    made = f" * {printable(texture.evidence).replace('*/', '* /')}\n" if texture.evidence else ""
    credit = made + (f" * Credit: {printable(texture.credit).replace('*/', '* /')}\n" if texture.credit else "")
    text = f"""/* {name}: a texture of foten, {card["model"]} at {texture.rate_hz:g} Hz, for {trained}.
{credit} *
 *     foten_model *model;
 *     char why[256];
 *     if (foten_model_load({name}_foten, {name}_foten_size, &model, why, sizeof why) != FOTEN_OK) ...
 */
#ifndef {name.upper()}_FOTEN_H
#define {name.upper()}_FOTEN_H

#include <stddef.h>

#if defined(__GNUC__)
__attribute__((aligned(64)))
#endif
static const unsigned char {name}_foten[] = {{
{body}
}};
static const size_t {name}_foten_size = sizeof {name}_foten;

#endif
"""
    with atomic_write(path) as part:
        part.write_text(text, encoding="ascii", errors="replace")
    return f"{name}_foten"
