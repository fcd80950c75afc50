"""The segmentation network, and its training."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor, nn
from torch.nn import functional

from ...factory.seeds import stream
from ...models.networks.unet import residual_blocks

_WIDTHS = (16, 32, 64)
_STRIDE = 8
_RATE = 2e-3


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


def trained(
    inputs: npt.NDArray[np.float32],
    targets: npt.NDArray[np.int64],
    *,
    classes: int,
    steps: int,
    batch: int,
    seed: int,
    device: str,
) -> SegmentNet:
    """A network that learned (N, H, W) pictures with class indices of the same shape.

    Cross entropy whose classes weigh as one over the root of how often they are; Adam with a
    cosine to 0; each picture as often as any other, mirrored left to right half of the time.
    `seed` decides the start, the order and the mirroring, the same for every method.
    device: auto, cpu or gpu.
    """
    random = stream(seed, "downstream", "training")
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(random.integers(2**31)))
        network = SegmentNet(classes)
    where = _device(device)
    network.to(where).train()
    counts = np.bincount(targets.ravel(), minlength=classes)
    weights = torch.from_numpy(
        np.where(counts > 0, 1 / np.sqrt(np.maximum(counts, 1)), 0).astype(np.float32)
    ).to(where)
    x, y = _padded(torch.from_numpy(inputs)), torch.from_numpy(targets)
    optimizer = torch.optim.Adam(network.parameters(), lr=_RATE)
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
    height, width = targets.shape[1:]
    queue = np.empty(0, np.int64)
    for _ in range(steps):
        while len(queue) < batch:
            queue = np.concatenate([queue, random.permutation(len(inputs))])
        chosen, queue = torch.from_numpy(queue[:batch]), queue[batch:]
        images, labels = x[chosen], y[chosen]
        mirrored = torch.from_numpy(random.random(batch) < 0.5)
        flipped = _padded(images[..., :height, :width].flip(-1))
        images = torch.where(mirrored[:, None, None, None], flipped, images)
        labels = torch.where(mirrored[:, None, None], labels.flip(-1), labels)
        logits = network(images.to(where))[..., :height, :width]
        optimizer.zero_grad()
        loss = functional.cross_entropy(logits, labels.to(where), weights)
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
    return network


def probabilities(network: SegmentNet, image: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """(H, W) -> (classes, H, W), of each class in each pixel."""
    network.eval()
    height, width = image.shape
    where = next(network.parameters()).device
    with torch.inference_mode():
        logits = network(_padded(torch.from_numpy(image[None])).to(where))[0, :, :height, :width]
        return np.asarray(logits.softmax(0).cpu().numpy())


def _padded(images: Tensor) -> Tensor:
    """(N, H, W) or (N, 1, H, W) -> (N, 1, H', W') that divide by the stride; -1 is black."""
    images = images if images.ndim == 4 else images[:, None]
    height, width = images.shape[-2:]
    return functional.pad(images, (0, -width % _STRIDE, 0, -height % _STRIDE), value=-1.0)


def _device(name: str) -> str:
    has_gpu = torch.cuda.is_available()
    return "cuda" if has_gpu and name != "cpu" else "cpu"
