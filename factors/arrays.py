"""Type aliases of float arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
"""Of 64-bit floats; its shape, unit and frame are said where it stands."""
