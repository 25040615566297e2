"""Textures as values: described, edited, blended, and made from less than a recording."""
