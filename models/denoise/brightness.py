"""Dark pictures as bright as those that networks have learned from.

Samples of 12 bits in files of 16, and amplitudes without a logarithm, fill a small part of the grey
scale.  Networks take what is that dark for shadow, or for another kind of noise.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

Grey = npt.NDArray[np.float32]

_SHARE = 99.5  # percentile of the pixels that are not zero
_DARK, _DARKER, _WANTED = 0.25, 0.125, 0.5
"""Bright pixels below the first make a picture dark; below the second they come to the last."""


def brightened(grey: Grey, denoise: Callable[[Grey, np.float32], Grey]) -> Grey:
    """What `denoise` makes of a picture, (H, W) in 0..1, that it gets bright enough.

    denoise: gets the picture and what it was multiplied by, 1 if it was left as it is.
    """
    gain = gain_of(grey)
    if gain == 1:
        return denoise(grey, gain)
    return np.asarray(denoise(np.minimum(grey * gain, 1), gain) / gain)


def gain_of(grey: Grey) -> np.float32:
    """By what a picture, (H, W) in 0..1, is to be multiplied; 1 where it is bright enough.

    It rises without a step as pictures get darker, and no pixel comes above 1.
    """
    # Most pictures are bright enough, and counting takes a fiftieth of what a percentile does.
    few = np.count_nonzero(grey) * (1 - _SHARE / 100)
    if np.count_nonzero(grey >= _DARK) >= few:
        return np.float32(1)
    lit = grey[grey > 0]
    bright = max(float(np.percentile(lit, _SHARE)), 1e-6)
    gain = _WANTED / bright if bright < _DARKER else (_DARK / bright) ** 2
    return np.float32(max(1.0, min(gain, 1 / float(lit.max()))))
