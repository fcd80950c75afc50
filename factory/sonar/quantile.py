"""Quantiles of many numbers without sorting them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt


def quantiles(
    values: npt.NDArray[np.float32], fractions: Sequence[float], *, skip: int = 0
) -> list[float]:
    """The quantiles of (N,) float32 numbers, none of which is negative or NaN; N > skip.

    As numpy's default has it: between the values of the two nearest ranks, linearly.
    skip: so many of the smallest do not count.
    """
    from .. import elementary  # loads numba

    places = [skip + fraction * (len(values) - 1 - skip) for fraction in fractions]
    ranks = np.array([(int(place), min(int(place) + 1, len(values) - 1)) for place in places])
    found = np.empty(ranks.size, np.float32)
    elementary.ranked(np.ascontiguousarray(values), ranks.ravel().astype(np.int64), found)
    low, high = found.reshape(-1, 2).astype(np.float64).T
    return [
        float(one + (other - one) * (place - int(place)))
        for one, other, place in zip(low, high, places, strict=True)
    ]
