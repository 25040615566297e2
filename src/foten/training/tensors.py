"""Tensors of a network in PyTorch, by the names in a texture file."""

from torch import nn

from foten.training.texture_builder import Tensors


def tensors_of(module: nn.Module, prefix: str = "") -> Tensors:
    """A module's parameters and buffers by name, copied."""
    return {f"{prefix}{name}": t.detach().cpu().numpy().copy() for name, t in module.state_dict().items()}
