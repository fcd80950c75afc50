"""Training losses: functions of (prediction, clean, batch), images (N, C, H, W) in 0..1."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Annotated, Literal

import torch
from pydantic import Field
from pydantic.dataclasses import dataclass
from torch import Tensor
from torch.nn import functional

from ...factory.common.settings import STRICT
from ...factory.dataset.quality import CONTRAST_FLOOR, LUMINANCE_FLOOR, RADIUS_PX, SIGMA_PX
from ..networks.bearings import interference_loss

NotNegative = Annotated[float, Field(ge=0)]
_PSNR_FLOOR = 1e-4  # added to the mean squares in `decibels`: below it, 40 dB, gains count little
_SSIM_WINDOW_PX = 2 * RADIUS_PX + 1
_SSIM_C1 = LUMINANCE_FLOOR**2
_SSIM_C2 = CONTRAST_FLOOR**2
_EQUAL = 1e-10  # mean squared difference of images that count as equal: 100 dB
_NOTHING = 0.3  # factor on a change up to which the change is left out
_WHOLE = 0.8  # factor on a change from which the change is made whole
_CLEAN = 1e-4  # in `blend` the noise of an image has at least this mean square, 40 dB


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
    ssim: of one less the structural similarity (Wang et al. 2004, Gaussian window of 11 pixels),
    where the faint grain that is left in darkness counts as much as that beside bright echoes.
    mask: of the binary cross entropy between the true shadow and `shadow_logits`.
    blend: of the binary cross entropy between `weight`, the part of its change that a network
    gives an image, and the best one there is, each image counting as the mean square of its
    change over that of its noise, at most 1; teaches that weight alone.
    interference: of the difference between the interference along bearings that is there and that
    a network's head states (`networks.bearings`).
    """

    kind: Literal["l1", "newloss"]
    weight: NotNegative = 0.0
    shadow: Literal["literal", "ste"] = "literal"
    threshold: Annotated[float, Field(ge=0, lt=1)] = 0.02
    square: NotNegative = 0.0
    decibels: NotNegative = 0.0
    ssim: NotNegative = 0.0
    mask: NotNegative = 0.05
    blend: NotNegative = 0.02
    interference: NotNegative = 1.0

    def __call__(self, prediction: Tensor, clean: Tensor, batch: Mapping[str, Tensor]) -> Tensor:
        """Scalar, differentiable in `prediction` and in what the heads say.

        batch: `noisy`, `shadow`, and of a network with heads `shadow_logits` and `weight`.
        """
        loss = (prediction - clean).abs().mean()

        if self.weight:
            loss = loss + self.weight * self._shadow_difference(prediction, clean)

        if self.square:
            loss = loss + self.square * (prediction - clean).square().mean()

        if self.decibels:
            squared_error = (prediction - clean).square().mean(dim=(1, 2, 3))
            loss = loss + self.decibels * 10 * torch.log10(squared_error + _PSNR_FLOOR).mean()

        if self.ssim:
            loss = loss + self.ssim * (1 - _structural_similarity(prediction, clean))

        if self.mask and "shadow_logits" in batch:
            logits = batch["shadow_logits"]
            shadow = batch["shadow"]
            loss = loss + self.mask * functional.binary_cross_entropy_with_logits(logits, shadow)

        if self.interference and "interference_nodes" in batch:
            error = interference_loss(batch["interference_nodes"], batch["interference"])
            loss = loss + self.interference * error

        if self.blend and "weight" in batch:
            loss = loss + self.blend * _blend_entropy(prediction, clean, batch)

        return loss

    def _shadow_difference(self, prediction: Tensor, clean: Tensor) -> Tensor:
        """Mean absolute difference of the thresholded images, the second term of `newloss`."""
        is_lit = (clean > self.threshold).to(prediction.dtype)
        predicted = (prediction > self.threshold).to(prediction.dtype)
        if self.shadow == "ste":
            predicted = predicted + (prediction - prediction.detach())
        return (predicted - is_lit).abs().mean()


def _structural_similarity(first: Tensor, second: Tensor) -> Tensor:
    """Mean structural similarity of images (N, C, H, W) in 0..1, of every second window, scalar."""
    products = (first, second, first * first, second * second, first * second)
    means = _gaussian_mean(torch.cat(products)).chunk(len(products))
    first_mean, second_mean, first_square, second_square, product = means
    covariance = product - first_mean * second_mean
    variances = first_square - first_mean.square() + second_square - second_mean.square()
    luminance = (2 * first_mean * second_mean + _SSIM_C1) / (
        first_mean.square() + second_mean.square() + _SSIM_C1
    )
    structure = (2 * covariance + _SSIM_C2) / (variances + _SSIM_C2)
    return (luminance * structure).mean()


def _gaussian_mean(images: Tensor) -> Tensor:
    """Gaussian means of images (N, C, H, W) in every second window along both axes."""
    rows, columns = (
        _gaussian_matrix(size).to(images.device, images.dtype) for size in images.shape[-2:]
    )
    # On a CPU two products of matrices take a tenth of the time of a convolution of one channel.
    return rows @ images @ columns.T


@lru_cache
def _gaussian_matrix(size: int) -> Tensor:
    """(windows, size) float32: row i holds the window that begins at sample 2 i."""
    offsets = torch.arange(-RADIUS_PX, RADIUS_PX + 1)
    gaussian = torch.exp(-0.5 * (offsets / SIGMA_PX).square())
    window = gaussian / gaussian.sum()
    first_samples = range(0, size - _SSIM_WINDOW_PX + 1, 2)
    matrix = torch.zeros(len(first_samples), size)
    for row, first in enumerate(first_samples):
        matrix[row, first : first + _SSIM_WINDOW_PX] = window
    return matrix


def _blend_entropy(prediction: Tensor, clean: Tensor, batch: Mapping[str, Tensor]) -> Tensor:
    """Cross entropy between the network's `weight` and the best weight of each image, scalar.

    The best factor on the change is the least-squares one; the best weight is 1 where that is
    `_WHOLE` or more, and 0 where it is `_NOTHING` or less.  Entropy averages over images: without
    these limits a change that is right gets 0.8 of itself.  Each image counts as the power of its
    change over that of its noise, at most 1.
    """
    # Autocast forbids the cross entropy of probabilities on a GPU.
    with torch.autocast(prediction.device.type, enabled=False):
        noisy = batch["noisy"].detach().float()
        change = prediction.detach().float() - noisy
        noise = clean.float() - noisy
        change_power = change.square().mean(dim=(1, 2, 3))
        noise_power = noise.square().mean(dim=(1, 2, 3))

        overlap = (change * noise).mean(dim=(1, 2, 3))
        best_factor = overlap / (change_power + _EQUAL)
        best_weight = ((best_factor - _NOTHING) / (_WHOLE - _NOTHING)).clamp(0, 1)
        importance = (change_power / (noise_power + _CLEAN)).clamp(max=1)
        return functional.binary_cross_entropy(batch["weight"].float(), best_weight, importance)
