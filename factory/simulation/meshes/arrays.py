"""Types of the arrays that meshes and their cameras are made of."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float32]
Points = npt.NDArray[np.float64]
Arrays = npt.NDArray[np.floating[Any]]
"""Any precision."""
Draws = np.random.Generator
Colour = Sequence[float]
"""Red, green, blue."""
