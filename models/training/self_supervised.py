"""Training without clean images (`data=self_supervised`), for a sonar that no simulation fits.

- neighbor2neighbor (Huang et al., Neighbor2Neighbor: Self-Supervised Denoising from Single Noisy
  Images, CVPR 2021): of every 2x2 block two different pixels make two half-size images of the same
  scene with independent noise; the network learns to predict the second from the first.
- blind_spot (after Krull et al., Noise2Void, CVPR 2019, with the wider mask of Broaddus et al.,
  Structured Noise2Void, ISBI 2020): some pixels are predicted from what lies further away than the
  grain of the speckle, which is correlated from pixel to pixel in every sonar.
- blind_network (Lee et al., AP-BSN, CVPR 2022): the network itself never sees the pixel that it
  predicts (`is_blind`), and is compared with all of them, by the absolute difference.
- variance (Pillai et al. 2026): see `simnfnd.models.training.residual_statistics`.

All but the last compare log(1 + log_gain * grey): multiplicative speckle is additive there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional
from torch.optim.swa_utils import AveragedModel

from ...factory.seeds import stream
from ..data.pairs import Batch
from ..losses.base import Loss
from ..networks.network import Network
from ..settings import SelfSupervisedData, TrainSettings
from .blind_spots import log_scale, mask_blind_spots
from .module import DenoisingModule
from .residual_statistics import residual_loss

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
        return self._loss(self.network, batch["noisy"], rng, done)

    def validation_step(self, batch: Batch, index: int) -> None:
        """The loss, of fixed choices, on a whole image."""
        rng = stream(self.seed, "self", _VALIDATION, index)
        value = self._loss(self.average, batch["noisy"], rng, 1.0)
        self.log_means({"validation_loss": value[None]}, 1)

    def _loss(
        self, network: torch.nn.Module, noisy: Tensor, rng: np.random.Generator, done: float
    ) -> Tensor:
        """Of one batch.  done: part of the training, which decides how much some terms weigh."""
        if self.data.method == "blind_network":
            plain = network.module if isinstance(network, AveragedModel) else network
            assert isinstance(plain, Network)
            return (self._log(plain.predict_blind(noisy)) - self._log(noisy)).abs().mean()
        if self.data.method == "variance":
            return residual_loss(network(noisy), noisy, self.data.variance, done)
        if self.data.method == "blind_spot":
            hidden, chosen = mask_blind_spots(noisy, rng, self.data.masked, self.data.radius)
            difference = self._log(network(hidden)) - self._log(noisy)
            return (difference.square() * chosen).sum() / chosen.sum()
        first, second = neighbour_pairs(noisy.shape, rng)
        half = select_pixels(noisy, first)
        denoised = self._log(network(half))
        target = self._log(select_pixels(noisy, second))
        loss = (denoised - target).square().mean()
        gamma = self.data.gamma * done
        if gamma:
            with torch.no_grad():
                full = self._log(network(noisy))
            shift = select_pixels(full, first) - select_pixels(full, second)
            loss = loss + gamma * (denoised - target - shift).square().mean()
        return loss

    def _log(self, grey: Tensor) -> Tensor:
        return log_scale(grey, self.data.log_gain)


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
