"""From a trace to a texture file, in PyTorch."""
