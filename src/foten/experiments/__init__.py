"""What needs several layers at once: the truth of a simulation for the judge, tables, the demo."""
