"""What a denoiser is asked to remove: the vector that networks are told.

One number for each of `formation.contract.ARTEFACTS`, 1 to remove it and 0 to keep it.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from ..factory.imaging.contract import ARTEFACTS

DEFAULT: tuple[str, ...] = ("speckle", "spokes", "ghosts", "blur")
"""What most want gone of an unknown picture: its ground and its brightness stay as they are."""


def vector(removed: Collection[str]) -> npt.NDArray[np.float32]:
    """(6,) float32, what a network is told.  Raises ValueError for a name that there is not."""
    for name in removed:
        if name not in ARTEFACTS:
            raise ValueError(f"{name!r} is none of {', '.join(ARTEFACTS)}")
    return np.array([name in removed for name in ARTEFACTS], np.float32)
