"""From a texture file, a speed and a force to acceleration: the kernel in C, bound with ctypes, and what plays it live."""
