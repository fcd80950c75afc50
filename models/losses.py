"""Training losses: functions of (prediction, clean, batch), images (N, C, H, W) in 0..1."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor
from torch.nn import functional

from ..factory.settings import STRICT

NotNegative = Annotated[float, Field(ge=0)]
_PSNR_FLOOR = 1e-4  # added to the mean squares in `decibels`: below it, 40 dB, gains count little
_EQUAL = 1e-10  # mean squared difference of pictures that count as equal: 100 dB
_CLEAN = 1e-4  # in `blend` the noise of a picture has at least this mean square, 40 dB


@dataclass(frozen=True, config=STRICT, kw_only=True)
class Loss:
    """The mean absolute difference (`l1`) and the sum of terms, each with its weight.

    weight: of the shadow term of `newloss` (SimNFND paper, section 4.3): L1 of Shadow(prediction,
    t) and Shadow(clean, t), where Shadow is 1 above the grey value t (`threshold`, which the paper
    does not give) and 0 elsewhere.  shadow: `literal`, as printed; a threshold has no slope, so
    this trains exactly as L1 does; or `ste`, the same number, whose gradient passes the threshold
    as if it were not there (straight-through estimator, Bengio et al. 2013).
    square: of the mean squared difference, which PSNR measures.
    decibels: of 10 log10 of the mean squared difference of each image (after the PSNR loss of Chen
    et al., ECCV 2022, with a floor at 40 dB); nearly clean images count as much as noisy ones.
    mask: of the binary cross entropy between the true shadow and `shadow_logits`.
    blend: of the binary cross entropy between `weight`, the part of its change that a network
    gives a picture, and the best one there is, each picture counting as the mean square of its
    change over that of its noise, at most 1; teaches that weight alone.
    """

    kind: Literal["l1", "newloss"]
    weight: NotNegative = 0.0
    shadow: Literal["literal", "ste"] = "literal"
    threshold: Annotated[float, Field(ge=0, lt=1)] = 0.02
    square: NotNegative = 0.0
    decibels: NotNegative = 0.0
    mask: NotNegative = 0.05
    blend: NotNegative = 0.02

    def __call__(self, prediction: Tensor, clean: Tensor, batch: Mapping[str, Tensor]) -> Tensor:
        """Scalar, differentiable in `prediction` and in what the heads say.

        batch: `noisy`, `shadow`, and of a network with heads `shadow_logits` and `weight`.
        """
        loss = (prediction - clean).abs().mean()
        if self.weight:
            lit = (clean > self.threshold).to(prediction.dtype)
            shown = (prediction > self.threshold).to(prediction.dtype)
            if self.shadow == "ste":
                shown = shown + (prediction - prediction.detach())
            loss = loss + self.weight * (shown - lit).abs().mean()
        if self.square:
            loss = loss + self.square * (prediction - clean).square().mean()
        if self.decibels:
            each = (prediction - clean).square().mean(dim=(1, 2, 3))
            loss = loss + self.decibels * 10 * torch.log10(each + _PSNR_FLOOR).mean()
        if self.mask and "shadow_logits" in batch:
            logits, shadow = batch["shadow_logits"], batch["shadow"]
            loss = loss + self.mask * functional.binary_cross_entropy_with_logits(logits, shadow)
        if self.blend and "weight" in batch:
            change = (prediction.detach() - batch["noisy"]).float()
            noise = (clean - batch["noisy"]).float()
            power = change.square().mean(dim=(1, 2, 3))
            best = ((change * noise).mean(dim=(1, 2, 3)) / (power + _EQUAL)).clamp(0, 1)
            counts = power / (noise.square().mean(dim=(1, 2, 3)) + _CLEAN)
            given = batch["weight"].float()
            off = functional.binary_cross_entropy(given, best, counts.clamp(max=1))
            loss = loss + self.blend * off
        return loss
