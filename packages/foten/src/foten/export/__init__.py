"""A texture, or a stroke of it, in the formats of other worlds: one writer a file."""
