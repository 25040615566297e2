"""Textures with a known truth, and recordings and captures of them."""
