"""Writes, reads, validates and describes the files of a dataset."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .pair_dataset import PairDataset

__all__ = ["PairDataset"]


def __getattr__(name: str) -> object:
    # Loads h5py, which the geometry of an image does without.
    if name != "PairDataset":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .pair_dataset import PairDataset

    return PairDataset
