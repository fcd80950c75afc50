"""Pixel2Pixel, after the paper: a small network learns each image from its own similar pixels.

Ma et al., "Pixel2Pixel: A Pixelwise Approach for Zero-Shot Single Image Denoising", IEEE TPAMI 47
(2025).  For each pixel, the pixels around it whose patches are most alike form a bank.  Two random
draws from the bank are two images of the same scene under other noise, and the network learns one
from the other, as Noise2Noise does.  Spatial correlation of the noise is broken by the draws.

The paper trains six layers of 64 channels on whole images for 3000 steps, hours on a CPU.  Here
fewer channels see random crops, which costs seconds; `steps` and `channels` are parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import cv2
import numpy as np

from ....factory.common.array_types import Float32s
from ...metrics.measure import Grey

if TYPE_CHECKING:
    from torch import nn

_PATCH_PX = 7
_REACH_PX = 10  # of the window in which similar pixels are searched
_BANK = 8  # similar pixels of each pixel
_STRIP_ROWS = 64
_CROP_PX = 96
_LEARNING_RATE = 0.001
_FALLS_AT = (0.5, 0.67, 0.83)  # of the steps, from which on the learning rate is halved
_SLOPE = 0.2  # of the activations below 0


def pixel2pixel(image: Grey, steps: int, channels: int, seed: int = 0) -> Grey:
    """(H, W) in 0..1 denoised by a network that learned from this image alone."""
    if np.ptp(image) == 0:
        return image
    return denoise_with(train_on([image], steps, channels, seed), image)


def train_on(images: Sequence[Grey], steps: int, channels: int, seed: int = 0) -> nn.Module:
    """A network that learned from noisy images, (H, W) in 0..1 each."""
    import torch
    from torch.nn import functional

    banks = [similar_pixels(np.asarray(image, np.float32)) for image in images]
    rng = np.random.default_rng(seed)
    torch.manual_seed(seed)
    # The memory layout that is fastest on a CPU.
    network: nn.Module = _network(channels).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.Adam(network.parameters(), lr=_LEARNING_RATE)
    milestones = [round(share * steps) for share in _FALLS_AT]
    schedule = torch.optim.lr_scheduler.MultiStepLR(optimizer, milestones, gamma=0.5)
    for _ in range(steps):
        bank = banks[int(rng.integers(len(banks)))]
        source, target = (torch.from_numpy(part)[None, None] for part in _drawn_pair(bank, rng))
        loss = functional.l1_loss(network(source), target)
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
        schedule.step()
    return network.eval()


def denoise_with(network: nn.Module, image: Grey) -> Grey:
    """(H, W) in 0..1 denoised by a network of `train_on`."""
    import torch

    with torch.inference_mode():
        denoised = network(torch.from_numpy(np.asarray(image, np.float32))[None, None])
    return np.asarray(np.clip(denoised[0, 0].numpy(), 0, 1), np.float32)


def similar_pixels(image: Float32s) -> Float32s:
    """(_BANK, H, W): of each pixel those around it with the most similar patches, itself first."""
    height, width = image.shape
    padded = np.pad(image, _REACH_PX, mode="reflect")
    offsets = [
        (down, right)
        for down in range(-_REACH_PX, _REACH_PX + 1)
        for right in range(-_REACH_PX, _REACH_PX + 1)
    ]
    bank = np.empty((_BANK, height, width), np.float32)
    for top in range(0, height, _STRIP_ROWS):
        rows = min(_STRIP_ROWS, height - top)
        distances = np.empty((len(offsets), rows, width), np.float32)
        candidates = np.empty_like(distances)
        centre = image[top : top + rows]
        for number, (down, right) in enumerate(offsets):
            first_row = top + _REACH_PX + down
            first_column = _REACH_PX + right
            moved = padded[first_row : first_row + rows, first_column : first_column + width]
            candidates[number] = moved
            distances[number] = cv2.blur(np.square(moved - centre), (_PATCH_PX, _PATCH_PX))
        nearest = np.argpartition(distances, _BANK, axis=0)[:_BANK]
        bank[:, top : top + rows] = np.take_along_axis(candidates, nearest, axis=0)
    return bank


def _drawn_pair(bank: Float32s, rng: np.random.Generator) -> list[Float32s]:
    """Two crops of one place, each pixel drawn from its bank, never twice the same."""
    depth, height, width = bank.shape
    rows, columns = min(_CROP_PX, height), min(_CROP_PX, width)
    top = int(rng.integers(height - rows + 1))
    left = int(rng.integers(width - columns + 1))
    part = bank[:, top : top + rows, left : left + columns]
    first = rng.integers(depth, size=(1, rows, columns))
    second = (first + rng.integers(1, depth, size=first.shape)) % depth
    return [np.take_along_axis(part, index, axis=0)[0] for index in (first, second)]


def _network(channels: int) -> nn.Module:
    """Five convolutions of 3x3 and one of 1x1, as the paper has them."""
    from torch import nn

    layers: list[nn.Module] = [nn.Conv2d(1, channels, 3, padding=1), nn.LeakyReLU(_SLOPE)]
    for _ in range(4):
        layers += [nn.Conv2d(channels, channels, 3, padding=1), nn.LeakyReLU(_SLOPE)]
    return nn.Sequential(*layers, nn.Conv2d(channels, 1, 1))
