"""Readers and importers of file formats, and our own recording file."""
