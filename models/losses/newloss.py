"""The SimNFND paper's loss: L1 and a term about shadow, in the forms that can be trained."""

from __future__ import annotations

from typing import Annotated, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor
from torch.nn import functional

from ...factory.settings import STRICT
from .base import BatchTensors, Loss, NotNegative, Positive

Shadow = Literal["literal", "ste", "sigmoid", "bce", "dice", "zone"]


@dataclass(frozen=True, config=STRICT, kw_only=True)
class NewLoss(Loss):
    """L1 of the images plus `weight` times a term about shadow (SimNFND paper, section 4.3).

    The paper's term is L1 of Shadow(prediction, t) and Shadow(clean, t), where Shadow is 1 above
    the threshold t and 0 elsewhere; the paper does not give t.

    shadow: which term.
      literal  as printed.  A threshold has no slope, so this trains exactly as L1 does.
      ste      the same number; the gradient passes the threshold as if it were not there
               (straight-through estimator, Bengio et al. 2013).
      sigmoid  L1 of sigmoid((prediction - t) / width) and Shadow(clean, t).
      bce      binary cross entropy of the same two.
      dice     soft Dice loss of the shadows of the same two (Milletari et al. 2016), by image.
      zone     L1 of the images inside the true shadow alone (`shadow` of the batch; clean <= t
               where the batch has none).
    threshold: t, a grey value.  width: how soft the threshold is, in grey values.
    width_start: what `width` is at the beginning of training; it shrinks by the same factor every
    step, down to `width` (only where the batch holds `progress`).
    """

    kind: Literal["newloss"]
    shadow: Shadow
    weight: NotNegative
    threshold: Annotated[float, Field(ge=0, lt=1)]
    width: Positive
    width_start: Positive

    def image(self, prediction: Tensor, clean: Tensor, batch: BatchTensors) -> Tensor:
        """Scalar tensor."""
        both = (prediction - clean).abs().mean()
        return both + self.weight * self.term(prediction, clean, batch)

    def term(self, prediction: Tensor, clean: Tensor, batch: BatchTensors) -> Tensor:
        """The term about shadow alone, without its weight."""
        dark = clean <= self.threshold
        if self.shadow == "zone":
            zone = batch["shadow"].expand_as(clean) if "shadow" in batch else dark.to(clean.dtype)
            total = ((prediction - clean).abs() * zone).sum()
            return total / zone.sum().clamp_min(1)
        lit = (~dark).to(prediction.dtype)
        if self.shadow in ("literal", "ste"):
            shown = (prediction > self.threshold).to(prediction.dtype)
            if self.shadow == "ste":
                shown = shown + (prediction - prediction.detach())
            return (shown - lit).abs().mean()
        logits = (prediction - self.threshold) / self._width(batch)
        if self.shadow == "bce":
            return functional.binary_cross_entropy_with_logits(logits, lit)
        if self.shadow == "sigmoid":
            return (torch.sigmoid(logits) - lit).abs().mean()
        dark_shown, dark_true = torch.sigmoid(-logits), 1 - lit
        axes = (1, 2, 3)
        # One more pixel in both avoids 0 / 0 in an image without any shadow.
        common = 2 * (dark_shown * dark_true).sum(axes) + 1
        return (1 - common / (dark_shown.sum(axes) + dark_true.sum(axes) + 1)).mean()

    def _width(self, batch: BatchTensors) -> float:
        progress = float(batch["progress"]) if "progress" in batch else 1.0
        return float(self.width_start * (self.width / self.width_start) ** progress)
