"""A texture's one-step network as an ONNX graph, its card in the metadata."""

import json
from pathlib import Path

from foten.atomic_write import atomic_write
from foten.models.texture_file import Texture

KEEPS = "ONNX keeps the one-step network, not the closed loop, the excitation or the fade"


def write_onnx(texture: Texture, graph: bytes, path: Path) -> None:
    """Write a graph with the texture's card under the key `foten`."""
    import onnx

    model = onnx.load_from_string(graph)
    onnx.helper.set_model_props(model, {"foten": json.dumps(dict(texture.card))})
    with atomic_write(path) as part:
        part.write_bytes(model.SerializeToString())
