"""The files of a dataset."""

from simnfnd.factory.dataset.read.pair_dataset import PairDataset

__all__ = ["PairDataset"]
