"""Does denoising help whoever works with the pictures?  A small segmentation network tells.

One network for each method, trained from the same start on what that method gives and tested on
what it gives of other pictures, so that no method is tested by a network that grew up with another.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from simnfnd.evaluation.baselines.base import Gray
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.seeds import stream
from simnfnd.models.networks.unet import residual_blocks

Labels = npt.NDArray[np.int64]

_SHRINK = 2  # pictures are halved: minutes instead of a quarter of an hour
_WIDTHS = (16, 32, 64)
_BATCH, _RATE = 4, 2e-3


@dataclass(frozen=True)
class Segmented:
    """iou: class index -> intersection over union on the test pictures, of classes that are there.

    mean: over these classes, the background among them.
    """

    iou: dict[int, float]

    @property
    def mean(self) -> float:
        """MIoU."""
        return float(np.mean(list(self.iou.values())))


class SegmentNet(nn.Module):
    """A U-Net of residual blocks: (N, 1, H, W) -> (N, classes, H, W) logits; H, W divide by 8.

    Its finest level has half of the picture's resolution.
    """

    def __init__(self, classes: int) -> None:
        super().__init__()
        fine, middle, coarse = _WIDTHS
        self.intro = nn.Conv2d(1, fine, 6, stride=2, padding=2)
        self.fine, self.middle, self.coarse = (residual_blocks(width, 1) for width in _WIDTHS)
        self.down = nn.ModuleList(
            [nn.Conv2d(fine, middle, 2, stride=2), nn.Conv2d(middle, coarse, 2, stride=2)]
        )
        self.up = nn.ModuleList(
            [nn.ConvTranspose2d(coarse, middle, 2, 2), nn.ConvTranspose2d(middle, fine, 2, 2)]
        )
        self.last = nn.ModuleList([residual_blocks(middle, 1), residual_blocks(fine, 1)])
        self.outro = nn.Conv2d(fine, classes, 1)

    def forward(self, x: Tensor) -> Tensor:
        """The logits."""
        first: Tensor = self.fine(functional.relu(self.intro(x)))
        second: Tensor = self.middle(functional.relu(self.down[0](first)))
        third: Tensor = self.coarse(functional.relu(self.down[1](second)))
        second = self.last[0](self.up[0](third) + second)
        first = self.last[1](self.up[1](second) + first)
        logits: Tensor = self.outro(first)
        return functional.interpolate(logits, scale_factor=2, mode="bilinear")


def split_of(count: int, test_share: float, seed: int) -> tuple[list[int], list[int]]:
    """Numbers of the pictures to train on and to test on; the same for all methods.

    Raises FactoryError when either part would be empty.
    """
    tested = round(count * test_share)
    if not 0 < tested < count:
        raise FactoryError(f"downstream: {count} pictures cannot be split; give more of them")
    order = stream(seed, "downstream", "split").permutation(count)
    return sorted(order[tested:].tolist()), sorted(order[:tested].tolist())


def segmented(
    images: Sequence[Gray],
    labels: Sequence[npt.NDArray[np.uint8]],
    *,
    epochs: int,
    test_share: float,
    seed: int,
    progress: Callable[[], object] = lambda: None,
) -> Segmented:
    """Train on a part of the pictures, test on the others.

    images: (H, W) in 0..1 each.  labels: their class indices.  progress: called after each epoch.
    Cross entropy whose classes weigh as one over the root of how often they are; Adam with a
    cosine to 0; mirrored left to right half of the time.
    """
    train, test = split_of(len(images), test_share, seed)
    inputs = [torch.from_numpy(_small(image, cv2.INTER_AREA)) for image in images]
    targets = [torch.from_numpy(_small(one, cv2.INTER_NEAREST).astype(np.int64)) for one in labels]
    classes = int(max(target.max() for target in targets)) + 1
    counts = sum(torch.bincount(targets[n].ravel(), minlength=classes) for n in train)
    assert isinstance(counts, Tensor)
    weights = torch.where(counts > 0, counts.double().clamp(min=1).rsqrt(), 0).float()
    random = stream(seed, "downstream", "training")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(random.integers(2**31)))
        network = SegmentNet(classes)
    optimizer = torch.optim.Adam(network.parameters(), lr=_RATE)
    steps = epochs * -(-len(train) // _BATCH)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    network.train()
    for _ in range(epochs):
        order = random.permutation(train)
        for first in range(0, len(order), _BATCH):
            optimizer.zero_grad()
            chosen = order[first : first + _BATCH]
            for number in chosen:  # one by one: pictures may differ in size
                x, y = _padded(inputs[number]), targets[number]
                if random.random() < 0.5:
                    x, y = x.flip(-1), y.flip(-1)
                    logits = network(x[None, None])[0, :, : y.shape[0], -y.shape[1] :]
                else:
                    logits = network(x[None, None])[0, :, : y.shape[0], : y.shape[1]]
                loss = functional.cross_entropy(logits[None], y[None], weights)
                (loss / len(chosen)).backward()  # type: ignore[no-untyped-call]
            optimizer.step()
            schedule.step()
        progress()
    return _tested(network, [inputs[n] for n in test], [targets[n] for n in test], classes)


def _tested(
    network: nn.Module, inputs: Sequence[Tensor], targets: Sequence[Tensor], classes: int
) -> Segmented:
    network.eval()
    table = torch.zeros(classes * classes, dtype=torch.int64)
    with torch.no_grad():
        for x, y in zip(inputs, targets, strict=True):
            logits = network(_padded(x)[None, None])[0, :, : y.shape[0], : y.shape[1]]
            both = y * classes + logits.argmax(0)
            table += torch.bincount(both.ravel(), minlength=classes * classes)
    square = table.reshape(classes, classes).numpy()
    hit = square.diagonal()
    union = square.sum(axis=0) + square.sum(axis=1) - hit
    there = square.sum(axis=1) > 0
    return Segmented({int(n): float(hit[n] / union[n]) for n in np.flatnonzero(there)})


def _small(picture: Gray | npt.NDArray[np.uint8], how: int) -> npt.NDArray[Any]:
    height, width = (max(size // _SHRINK, 1) for size in picture.shape)
    return np.asarray(cv2.resize(picture, (width, height), interpolation=how))


def _padded(x: Tensor) -> Tensor:
    height, width = x.shape
    return functional.pad(x, (0, -width % 8, 0, -height % 8))
