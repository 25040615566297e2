"""Array maths that knows nothing of textures: filters, resampling, kinematics, spectra, AR, noise."""
