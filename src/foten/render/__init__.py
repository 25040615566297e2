"""From a texture file, a speed and a force to acceleration. NumPy only."""
