"""foten-plus: a level, a lattice, tones, and a network of innovations."""
