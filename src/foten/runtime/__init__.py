"""From a texture file, a speed and a force to acceleration: the kernel in C, and its reference in NumPy."""
