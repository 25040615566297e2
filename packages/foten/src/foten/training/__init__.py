"""Parts that every fit shares: loop, optimiser, blocks, calibration, texture builder, jobs; in PyTorch."""
