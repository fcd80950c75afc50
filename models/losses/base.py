"""What all losses share: further terms on the images and the terms that teach the heads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor
from torch.nn import functional

from simnfnd.factory.settings import STRICT

NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]
BatchTensors = Mapping[str, Tensor]
"""What else a batch holds (see `models`); losses read `noisy`, `shadow`, `shadow_logits`, `gain_db`
and `progress`."""
_PSNR_FLOOR = 1e-4
"""Added to the mean squared difference in `decibels`: below it, at 40 dB, gains count little."""
_EQUAL = 1e-10
"""Mean squared difference of images that count as equal: 100 dB."""
_GAIN_LIMITS_DB = -4.0, 10.0


@dataclass(frozen=True, config=STRICT, kw_only=True)
class Loss:
    """Base of the losses.

    square: weight of the mean squared difference, which PSNR measures.
    decibels: weight of 10 log10 of the mean squared difference of each image, averaged over the
    images (after the PSNR loss of Chen et al., ECCV 2022, with a floor at 40 dB); nearly clean
    images count as much as noisy ones.
    mask: weight of the binary cross entropy between the true shadow and the logits of the mask
    head; no effect without such a head or without a known shadow.
    gain: weight of the smooth L1 difference between the gain of PSNR that a network with heads
    expects and the true one, clamped to -4..10 dB, beyond which there is nothing to decide.
    """

    square: NotNegative = 0.0
    decibels: NotNegative = 0.0
    mask: NotNegative = 0.05
    gain: NotNegative = 0.02

    def image(self, prediction: Tensor, clean: Tensor, batch: BatchTensors) -> Tensor:
        """Scalar tensor: how far the images are apart."""
        raise NotImplementedError

    def __call__(
        self, prediction: Tensor, clean: Tensor, batch: BatchTensors | None = None
    ) -> Tensor:
        """Scalar tensor, differentiable in `prediction` and in the logits of the batch."""
        batch = {} if batch is None else batch
        loss = self.image(prediction, clean, batch)
        if self.square:
            loss = loss + self.square * (prediction - clean).square().mean()
        if self.decibels:
            each = (prediction - clean).square().mean(dim=(1, 2, 3))
            loss = loss + self.decibels * 10 * torch.log10(each + _PSNR_FLOOR).mean()
        if self.mask and "shadow_logits" in batch and "shadow" in batch:
            logits, shadow = batch["shadow_logits"], batch["shadow"]
            loss = loss + self.mask * functional.binary_cross_entropy_with_logits(logits, shadow)
        if self.gain and "gain_db" in batch and "noisy" in batch:
            after = (prediction.detach() - clean).square().mean(dim=(1, 2, 3))
            before = (batch["noisy"] - clean).square().mean(dim=(1, 2, 3))
            gain_db = 10 * torch.log10((before + _EQUAL) / (after + _EQUAL))
            expected = batch["gain_db"]
            target = gain_db.clamp(*_GAIN_LIMITS_DB).to(expected.dtype)
            loss = loss + self.gain * functional.smooth_l1_loss(expected, target)
        return loss
