"""A page to stroke textures on, and the server that it comes from."""
