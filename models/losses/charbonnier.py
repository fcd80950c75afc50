"""L1 with a smooth minimum."""

from __future__ import annotations

from typing import Literal

from pydantic.dataclasses import dataclass
from torch import Tensor

from ...factory.settings import STRICT
from .base import BatchTensors, Loss, Positive


@dataclass(frozen=True, config=STRICT, kw_only=True)
class Charbonnier(Loss):
    """Mean of sqrt(difference^2 + epsilon^2) (Charbonnier et al. 1994)."""

    kind: Literal["charbonnier"]
    epsilon: Positive

    def image(self, prediction: Tensor, clean: Tensor, batch: BatchTensors) -> Tensor:
        """Scalar tensor."""
        return ((prediction - clean).square() + self.epsilon**2).sqrt().mean()
