"""Several pictures of one scene, the one that is meant in the middle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
import numpy.typing as npt

Image = npt.NDArray[np.float32]
T = TypeVar("T")

_VISITS = 2**32
"""More than a frame is visited in any training."""


def centred(pictures: Sequence[T], own: int, count: int) -> list[T]:
    """`count` (odd) of them around number `own`, in order; an end is repeated beyond it."""
    first, last = own - count // 2, len(pictures) - 1
    return [pictures[min(max(place, 0), last)] for place in range(first, first + count)]


def amid(own: T, others: Sequence[T], count: int) -> list[T]:
    """`count` (odd): the first of the others, half of them before `own` and half after it."""
    some = others[: count - 1]
    half = len(some) // 2
    return centred([*some[:half], own, *some[half:]], half, count)


def stacked(own: Image, others: Sequence[Image]) -> Image | None:
    """(H, W) pictures as (T, H, W), `own` in the middle; None without others."""
    return np.stack(amid(own, others, len(others) + 1)) if others else None


def variants_of(visit: int, count: int) -> tuple[int, ...]:
    """The noise variants of a visit's pictures, its own first; no other visit has any of them."""
    return tuple(visit + number * _VISITS for number in range(count))
