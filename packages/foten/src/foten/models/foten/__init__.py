"""FoTEN and TEN, the paper's networks."""
