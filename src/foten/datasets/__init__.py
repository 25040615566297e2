"""Readers of file formats, and the simulator."""
