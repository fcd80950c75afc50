"""The files of a dataset."""

from .read.pair_dataset import PairDataset

__all__ = ["PairDataset"]
