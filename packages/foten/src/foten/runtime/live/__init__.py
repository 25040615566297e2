"""A texture live: rings, sinks, devices, players."""
