"""Readers of file formats, each returning a Recording, and the simulator."""
