"""Training losses: functions of (prediction, clean, batch), images (N, C, H, W) in 0..1.

A loss is a settings class whose `image` compares the images, in a file of its own, and one line in
`LOSSES`.  `simnfnd.models.losses.base.Loss` adds what every loss can have.
"""

from __future__ import annotations

from collections.abc import Mapping

from ...factory.errors import FactoryError
from ...factory.settings import build
from .base import Loss
from .charbonnier import Charbonnier
from .l1 import L1
from .newloss import NewLoss

LOSSES: dict[str, type[Loss]] = {"l1": L1, "charbonnier": Charbonnier, "newloss": NewLoss}


def build_loss(config: Mapping[str, object]) -> Loss:
    """The loss that the `loss` group describes; FactoryError for an unknown kind or key."""
    kind = str(config.get("kind"))
    if kind not in LOSSES:
        raise FactoryError(f"loss.kind: {kind!r} is none of {', '.join(sorted(LOSSES))}")
    return build(LOSSES[kind], config, "loss")
