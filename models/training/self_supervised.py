"""Training without clean images (`data=self_supervised`), for a sonar that no simulation fits.

- neighbor2neighbor (Huang et al., Neighbor2Neighbor: Self-Supervised Denoising from Single Noisy
  Images, CVPR 2021): of every 2x2 block two different pixels make two half-size images of the same
  scene with independent noise; the network learns to predict the second from the first.
- blind_spot (after Krull et al., Noise2Void, CVPR 2019, with the wider mask of Broaddus et al.,
  Structured Noise2Void, ISBI 2020): some pixels are predicted from what lies further away than the
  grain of the speckle, which is correlated from pixel to pixel in every sonar.

Both compare log(1 + log_gain * grey): multiplicative speckle is additive there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from simnfnd.factory.seeds import stream
from simnfnd.models.data.pairs import Batch
from simnfnd.models.losses.base import Loss
from simnfnd.models.networks.network import Network
from simnfnd.models.training.module import DenoisingModule
from simnfnd.models.training.settings import SelfSupervisedData, TrainSettings

_VALIDATION = -1
_NEIGHBOURS = ((0, 1), (0, 2), (1, 3), (2, 3))
"""Pairs of the pixels of a 2x2 block (numbered along its rows) that touch."""


class SelfSupervisedModule(DenoisingModule):
    """A network learns from noisy images alone; validation is the same loss on held-out images."""

    figures: ClassVar[tuple[str, ...]] = ("validation_loss",)

    def __init__(
        self,
        network: Network,
        loss: Loss,
        settings: TrainSettings,
        seed: int,
        data: SelfSupervisedData,
    ) -> None:
        super().__init__(network, loss, settings, seed)
        self.data = data

    @staticmethod
    def score(row: Mapping[str, float | int]) -> float:
        """See `DenoisingModule`."""
        return -row["validation_loss"]

    def compute_loss(self, batch: Batch, index: int) -> Tensor:
        """See `DenoisingModule`; the random choices belong to the step and the device."""
        # The weight of the regulariser grows linearly, as its authors propose.
        done = (self.step + index) / self.settings.steps
        rng = stream(self.seed, "self", self.step + index, self.global_rank)
        return self._loss(self.network, batch["noisy"], rng, self.data.gamma * done)

    def validation_step(self, batch: Batch, index: int) -> None:
        """The loss, of fixed choices, on a whole image."""
        rng = stream(self.seed, "self", _VALIDATION, index)
        value = self._loss(self.average, batch["noisy"], rng, self.data.gamma)
        self.log_means({"validation_loss": value[None]}, 1)

    def _loss(
        self, network: torch.nn.Module, noisy: Tensor, rng: np.random.Generator, gamma: float
    ) -> Tensor:
        if self.data.method == "blind_spot":
            hidden, chosen = mask_blind_spots(noisy, rng, self.data.masked, self.data.radius)
            difference = self._log(network(hidden)) - self._log(noisy)
            return (difference.square() * chosen).sum() / chosen.sum()
        first, second = neighbour_pairs(noisy.shape, rng)
        half = select_pixels(noisy, first)
        denoised = self._log(network(half))
        target = self._log(select_pixels(noisy, second))
        loss = (denoised - target).square().mean()
        if gamma:
            with torch.no_grad():
                full = self._log(network(noisy))
            shift = select_pixels(full, first) - select_pixels(full, second)
            loss = loss + gamma * (denoised - target - shift).square().mean()
        return loss

    def _log(self, grey: Tensor) -> Tensor:
        """Grey values in 0..1 -> the logarithmic scale, also 0..1, on which they are compared."""
        gain = self.data.log_gain
        if not gain:
            return grey
        # Linear below black: a network may predict slightly negative values.
        compressed = torch.log1p(gain * grey.clamp_min(0)) + gain * grey.clamp_max(0)
        return compressed / math.log1p(gain)


def neighbour_pairs(shape: torch.Size, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Two numbers (N, 1, H // 2, W // 2) in 0..3 a block: two different pixels that touch."""
    size = (shape[0], 1, shape[2] // 2, shape[3] // 2)
    pair = np.asarray(_NEIGHBOURS)[rng.integers(len(_NEIGHBOURS), size=size)]
    swapped = rng.random(size) < 0.5
    first = np.where(swapped, pair[..., 1], pair[..., 0])
    second = np.where(swapped, pair[..., 0], pair[..., 1])
    return torch.from_numpy(first), torch.from_numpy(second)


def select_pixels(image: Tensor, number: Tensor) -> Tensor:
    """(N, 1, H // 2, W // 2): of each 2x2 block the pixel with that number."""
    height, width = (2 * (side // 2) for side in image.shape[-2:])
    blocks = functional.pixel_unshuffle(image[..., :height, :width], 2)
    return blocks.gather(1, number.to(image.device))


def mask_blind_spots(
    noisy: Tensor, rng: np.random.Generator, share: float, radius: int
) -> tuple[Tensor, Tensor]:
    """The images with the surroundings of some pixels hidden, and which pixels (1, else 0).

    Everything within `radius` of a chosen pixel is replaced by pixels of the image drawn from
    between that and four more pixels away, so nothing of its own grain is left.
    """
    count, _, height, width = noisy.shape
    # Fewer where surroundings are wide: they would hide the whole image.
    chosen = rng.random((count, 1, height, width)) < min(share, 0.25 / (2 * radius + 1) ** 2)
    chosen[:, :, height // 2, width // 2] |= ~chosen.any(axis=(1, 2, 3))[:, None]
    mask = torch.from_numpy(chosen.astype(np.float32)).to(noisy.device)
    near = functional.max_pool2d(mask, 2 * radius + 1, stride=1, padding=radius) > 0
    length = rng.integers(radius + 1, radius + 5, size=(2, *chosen.shape))
    step = length * rng.choice([-1, 1], size=length.shape)
    rows = _reflected(np.arange(height)[:, None] + step[0], height)
    columns = _reflected(np.arange(width)[None, :] + step[1], width)
    index = torch.from_numpy(rows * width + columns).to(noisy.device)
    elsewhere = noisy.flatten(2).gather(2, index.flatten(2)).view_as(noisy)
    return torch.where(near, elsewhere, noisy), mask


def _reflected(index: np.ndarray, size: int) -> np.ndarray:
    """Indices mirrored at the borders."""
    index = np.abs(index)
    return np.clip(np.where(index >= size, 2 * (size - 1) - index, index), 0, size - 1)
