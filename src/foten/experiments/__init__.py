"""What needs several layers at once: truth of a simulation, experiments with their tables and figures, the demo."""
