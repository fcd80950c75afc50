"""What training makes small: functions of (prediction, clean, batch), images (N, C, H, W) in 0..1.

A loss is one settings class whose `image` compares the images, and one line in `LOSSES`.  To any
the squared difference and PSNR can be added, and all teach the heads of a network that has some.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor
from torch.nn import functional

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.settings import STRICT, build

NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
Shadow = Literal["literal", "ste", "sigmoid", "bce", "dice", "zone"]
Known = Mapping[str, Tensor]
"""What else a batch holds (see `models`); of it `noisy`, `shadow`, `shadow_logits`, `gain_db`
and `progress` count."""
_FLOOR = 1e-4
"""Mean squared difference below which less counts little: 40 dB."""
_EQUAL = 1e-10
"""Mean squared difference of what counts as equal: 100 dB."""
_GAINS_DB = -4.0, 10.0


@dataclass(frozen=True, config=STRICT, kw_only=True)
class Loss:
    """Base of the losses.

    square: weight of the mean squared difference, which is added; it is what PSNR measures.
    decibels: weight of 10 log10 of the mean squared difference of every image, the mean of which
    is added (after the PSNR loss of Chen et al., ECCV 2022, with a floor at 40 dB); images that are
    nearly clean count as much as noisy ones.
    mask: weight of the binary cross entropy between the true shadow and the logits of the mask
    head; without effect on a network that has none, and where the true shadow is not known.
    gain: weight of the smooth L1 difference that teaches a network with heads how many dB it
    brings, counted from -4 to 10: what is worse or better than that is so beyond doubt.
    """

    square: NotNegative = 0.0
    decibels: NotNegative = 0.0
    mask: NotNegative = 0.05
    gain: NotNegative = 0.02

    def image(self, prediction: Tensor, clean: Tensor, batch: Known) -> Tensor:
        """Scalar tensor: how far the images are apart."""
        raise NotImplementedError

    def __call__(self, prediction: Tensor, clean: Tensor, batch: Known | None = None) -> Tensor:
        """Scalar tensor, differentiable in `prediction` and in the logits of the batch."""
        batch = {} if batch is None else batch
        loss = self.image(prediction, clean, batch)
        if self.square:
            loss = loss + self.square * (prediction - clean).square().mean()
        if self.decibels:
            each = (prediction - clean).square().mean(dim=(1, 2, 3))
            loss = loss + self.decibels * 10 * torch.log10(each + _FLOOR).mean()
        if self.mask and "shadow_logits" in batch and "shadow" in batch:
            logits, shadow = batch["shadow_logits"], batch["shadow"]
            loss = loss + self.mask * functional.binary_cross_entropy_with_logits(logits, shadow)
        if self.gain and "gain_db" in batch and "noisy" in batch:
            after = (prediction.detach() - clean).square().mean(dim=(1, 2, 3))
            before = (batch["noisy"] - clean).square().mean(dim=(1, 2, 3))
            gain_db = 10 * torch.log10((before + _EQUAL) / (after + _EQUAL))
            expected = batch["gain_db"]
            told = functional.smooth_l1_loss(expected, gain_db.clamp(*_GAINS_DB).to(expected.dtype))
            loss = loss + self.gain * told
        return loss


@dataclass(frozen=True, config=STRICT, kw_only=True)
class L1(Loss):
    """Mean absolute difference."""

    kind: Literal["l1"]

    def image(self, prediction: Tensor, clean: Tensor, batch: Known) -> Tensor:
        """Scalar tensor."""
        return (prediction - clean).abs().mean()


@dataclass(frozen=True, config=STRICT, kw_only=True)
class Charbonnier(Loss):
    """Mean of sqrt(difference^2 + epsilon^2) (Charbonnier et al. 1994)."""

    kind: Literal["charbonnier"]
    epsilon: Positive

    def image(self, prediction: Tensor, clean: Tensor, batch: Known) -> Tensor:
        """Scalar tensor."""
        return ((prediction - clean).square() + self.epsilon**2).sqrt().mean()


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
    step, down to `width` (only where the batch tells `progress`).
    """

    kind: Literal["newloss"]
    shadow: Shadow
    weight: NotNegative
    threshold: Annotated[float, Field(ge=0, lt=1)]
    width: Positive
    width_start: Positive

    def image(self, prediction: Tensor, clean: Tensor, batch: Known) -> Tensor:
        """Scalar tensor."""
        both = (prediction - clean).abs().mean()
        return both + self.weight * self.term(prediction, clean, batch)

    def term(self, prediction: Tensor, clean: Tensor, batch: Known) -> Tensor:
        """The term about shadow alone, without its weight."""
        dark = clean <= self.threshold
        if self.shadow == "zone":
            zone = batch["shadow"].expand_as(clean) if "shadow" in batch else dark.to(clean.dtype)
            total = ((prediction - clean).abs() * zone).sum()
            return total / zone.sum().clamp_min(1)
        lit = (~dark).to(prediction.dtype)
        if self.shadow in ("literal", "ste"):
            seen = (prediction > self.threshold).to(prediction.dtype)
            if self.shadow == "ste":
                seen = seen + (prediction - prediction.detach())
            return (seen - lit).abs().mean()
        logits = (prediction - self.threshold) / self._width(batch)
        if self.shadow == "bce":
            return functional.binary_cross_entropy_with_logits(logits, lit)
        if self.shadow == "sigmoid":
            return (torch.sigmoid(logits) - lit).abs().mean()
        shown, true = torch.sigmoid(-logits), 1 - lit
        every = (1, 2, 3)
        # One pixel more in both keeps an image without any shadow in order.
        common = 2 * (shown * true).sum(every) + 1
        return (1 - common / (shown.sum(every) + true.sum(every) + 1)).mean()

    def _width(self, batch: Known) -> float:
        progress = float(batch["progress"]) if "progress" in batch else 1.0
        return float(self.width_start * (self.width / self.width_start) ** progress)


LOSSES: dict[str, type[Loss]] = {"l1": L1, "charbonnier": Charbonnier, "newloss": NewLoss}


def build_loss(config: Mapping[str, object]) -> Loss:
    """The loss that the `loss` group describes; FactoryError for an unknown kind or key."""
    kind = str(config.get("kind"))
    if kind not in LOSSES:
        raise FactoryError(f"loss.kind: {kind!r} is none of {', '.join(sorted(LOSSES))}")
    return build(LOSSES[kind], config, "loss")
