"""foten-plus: a level, a lattice, tones, and an innovation network."""
