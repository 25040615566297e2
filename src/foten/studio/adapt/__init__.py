"""A user's thresholds, gains and likings, measured on a page."""
