"""Writes, reads, validates and describes the files of a dataset."""

from .pair_dataset import PairDataset

__all__ = ["PairDataset"]
