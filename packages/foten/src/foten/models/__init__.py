"""Models, one folder each: sizes, definition in NumPy, network in PyTorch, fit; the texture file beside them."""
