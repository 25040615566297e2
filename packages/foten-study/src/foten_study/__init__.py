"""People are asked: the perceptual study (Sec. VII), from its file to its report, and `foten adapt`."""
