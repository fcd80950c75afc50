"""Types of the arrays that meshes and their cameras are made of."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

Draws = np.random.Generator
Colour = Sequence[float]
"""Red, green, blue."""
