"""The files of a dataset."""

from factory.shards.pair_dataset import PairDataset

__all__ = ["PairDataset"]
