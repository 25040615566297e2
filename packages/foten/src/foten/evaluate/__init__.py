"""Judging: metrics, references, one-step and free-run scores, the report."""
