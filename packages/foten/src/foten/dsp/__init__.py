"""Array maths that knows nothing of textures: filters, resampling, kinematics, spectra, AR, noise."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
