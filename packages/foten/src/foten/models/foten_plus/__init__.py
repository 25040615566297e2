"""foten-plus: a level, a lattice, tones, a random part, and a network for one-step predictions."""
