"""What training makes small: functions of (denoised, clean), both (N, 1, H, W) in 0..1."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Annotated, Any, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor

from factory.errors import FactoryError
from factory.settings import STRICT, build

Loss = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True, config=STRICT)
class L1:
    """Mean absolute difference."""

    kind: Literal["l1"]

    def __call__(self, denoised: Tensor, clean: Tensor) -> Tensor:
        """Scalar tensor."""
        return (denoised - clean).abs().mean()


@dataclass(frozen=True, config=STRICT)
class Charbonnier:
    """Mean of sqrt(difference^2 + epsilon^2) (Charbonnier et al. 1994)."""

    kind: Literal["charbonnier"]
    epsilon: Annotated[float, Field(gt=0)]

    def __call__(self, denoised: Tensor, clean: Tensor) -> Tensor:
        """Scalar tensor."""
        return ((denoised - clean).square() + self.epsilon**2).sqrt().mean()


LOSSES = {"l1": L1, "charbonnier": Charbonnier}


def build_loss(config: Mapping[str, Any]) -> Loss:
    """The loss that the `loss` group describes; FactoryError for an unknown kind or key."""
    kind = config.get("kind")
    if kind not in LOSSES:
        raise FactoryError(f"loss.kind: {kind!r} is none of {', '.join(sorted(LOSSES))}")
    loss: Loss = build(LOSSES[kind], config, "loss")
    return loss
