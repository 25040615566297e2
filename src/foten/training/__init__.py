"""What every fit uses: one loop, optimiser, blocks, calibration, texture builder, jobs; in PyTorch."""
