"""Piecewise AR: local linear models over speed and force."""
