"""Several pictures of one scene, the one that is meant in the middle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeVar

T = TypeVar("T")


def centred(pictures: Sequence[T], own: int, count: int) -> list[T]:
    """`count` (odd) of them around number `own`, in order; an end is repeated beyond it."""
    first, last = own - count // 2, len(pictures) - 1
    return [pictures[min(max(place, 0), last)] for place in range(first, first + count)]


def amid(own: T, others: Sequence[T], count: int) -> list[T]:
    """`count` (odd): the first of the others, half of them before `own` and half after it."""
    some = others[: count - 1]
    half = len(some) // 2
    return centred([*some[:half], own, *some[half:]], half, count)
