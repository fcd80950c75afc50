"""Mean absolute difference."""

from __future__ import annotations

from typing import Literal

from pydantic.dataclasses import dataclass
from torch import Tensor

from ...factory.settings import STRICT
from .base import BatchTensors, Loss


@dataclass(frozen=True, config=STRICT, kw_only=True)
class L1(Loss):
    """Mean absolute difference."""

    kind: Literal["l1"]

    def image(self, prediction: Tensor, clean: Tensor, batch: BatchTensors) -> Tensor:
        """Scalar tensor."""
        return (prediction - clean).abs().mean()
