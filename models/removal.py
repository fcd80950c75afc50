"""What networks are told beside the picture: what to remove, and how many frames were averaged.

What to remove is one number for each of `imaging.contract.ARTEFACTS`, 1 to remove it, 0 to keep it.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import numpy.typing as npt

from ..factory.imaging.effect import ARTEFACTS

DEFAULT: tuple[str, ...] = ("speckle", "spokes", "ghosts", "blur")
"""What most want gone of an unknown picture: its ground and its brightness stay as they are."""


def vector(removed: Collection[str]) -> npt.NDArray[np.float32]:
    """(6,) float32, what a network is told."""
    return np.array([name in removed for name in ARTEFACTS], np.float32)


_MOST_FRAMES = 16.0
"""More frames are too few to tell from this many by the noise that is left."""
_INDEPENDENT = 0.36
"""Power of the number of frames that says how many of independent noise they are worth: the noise
of frames that follow each other is correlated.  Seven frames of two DIDSON recordings and of five
of the MDD groups came out best as two independent ones."""


def averaged(frames: npt.ArrayLike) -> npt.NDArray[np.float32]:
    """log2 of how many independent frames are worth so many that were averaged, 1 or more."""
    counted = np.clip(np.asarray(frames, np.float32), 1, _MOST_FRAMES)
    return np.asarray(_INDEPENDENT * np.log2(counted), np.float32)
