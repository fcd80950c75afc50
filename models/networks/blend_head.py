"""The head that weighs the change of a whole image."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional

from .blocks import zeroed
from .folded import unshuffled_part_conv
from .network import padded

_FIRST_WEIGHT = 3.0  # logit of the weight before anything is learned: 95 % of the change
_DARK = 1 / 512  # a cell below this holds no echo: half a grey value of 8 bits
_CENTRE = 1.5  # centres the logarithms of grey values between _DARK and 1
_LEAST = 1e-7  # added to mean squares of grey values (70 dB), so that 0 has a logarithm
_STATISTICS = 5


class BlendHead(nn.Module):
    """Weighs the change of a whole image, 0 to 1, from the image, the change and its features.

    features: channels of the last features.  width: channels of the head itself.
    A network that has learned to remove strong noise harms an image with hardly any; the weight
    falls smoothly to zero there.  The head gets the logarithm of the image, in which a blur looks
    the same in bright and in dim places, and pools with a weight for every place (gated attention,
    Ilse et al., ICML 2018), because shadow carries no information, and maxima, because a single
    defect matters.  Statistics give at once what many layers would have to find out.

    No gradient goes back into the network, so the head cannot harm the images.
    """

    def __init__(self, features: int, width: int = 32) -> None:
        super().__init__()
        self.near = nn.Conv2d(features + 4 * 3, width, 3, stride=2, padding=1)
        self.far = nn.Conv2d(width, width, 3, padding=1)
        self.weight = nn.Conv2d(width, width, 1)
        self.mixed = nn.Linear(3 * width + _STATISTICS, width)
        self.logit = zeroed(nn.Linear(width, 1))
        nn.init.constant_(self.logit.bias, _FIRST_WEIGHT)

    def forward(
        self,
        features: Tensor,
        noisy: Tensor,
        change: Tensor,
        sector: Tensor,
        *,
        folds: bool = False,
    ) -> Tensor:
        """(N, F, h, w) at half resolution, three times (N, 1, H, W) -> (N,) weight, 0 to 1.

        h and w may be half the size of the images after padding.
        sector: 1 where insonified, else 0.  folds: see `SonarNet.folds`.
        """
        features = features.detach()
        noisy = noisy.detach()
        change = change.detach()
        height, width = (2 * size for size in features.shape[-2:])
        padding = (0, width - noisy.shape[-1], 0, height - noisy.shape[-2])
        logarithm = torch.log10(noisy.clamp_min(0) + _DARK) + _CENTRE
        planes = functional.pad(torch.cat([noisy, change, logarithm], dim=1), padding)
        if folds:
            x = functional.relu(unshuffled_part_conv(self.near, features, planes))
        else:
            planes = functional.pixel_unshuffle(planes, 2)
            x = functional.relu(self.near(torch.cat([features, planes], dim=1)))
        x = functional.relu(self.far(x))
        inside = functional.avg_pool2d(padded(functional.pad(sector, padding), 4), 4)
        weight = torch.sigmoid(self.weight(x)).float() * inside
        x = x.float() * inside
        pooled = [
            (weight * x).sum(dim=(2, 3)) / weight.sum(dim=(2, 3)).clamp_min(1e-3),
            x.sum(dim=(2, 3)) / inside.sum(dim=(2, 3)).clamp_min(1),
            x.amax(dim=(2, 3)),
            _statistics(noisy, change, sector),
        ]
        logit: Tensor = self.logit(functional.relu(self.mixed(torch.cat(pooled, dim=1))))
        return torch.sigmoid(logit[:, 0].float())


def _statistics(noisy: Tensor, change: Tensor, sector: Tensor) -> Tensor:
    """(N, 1, H, W) each -> (N, 5): four decimal logarithms and the dark fraction."""
    noisy = noisy.float()
    change = change.float()
    area = sector.sum(dim=(1, 2, 3)).clamp_min(1)

    def mean(x: Tensor) -> Tensor:
        return (x * sector).sum(dim=(1, 2, 3)) / area

    power = mean(noisy.square()) + _LEAST
    changed = mean(change.square()) + _LEAST
    range_step = _step(noisy, sector, 2) / area + _LEAST
    bearing_step = _step(noisy, sector, 3) / area + _LEAST
    return torch.stack(
        [
            torch.log10(changed),
            torch.log10(changed / power),
            torch.log10(range_step / power),
            torch.log10(range_step / bearing_step),
            mean((noisy < _DARK).float()),
        ],
        dim=1,
    )


def _step(x: Tensor, sector: Tensor, dim: int) -> Tensor:
    """(N,) sum of the squared differences to the next pixel where both are insonified.

    Of slices, which a trace follows at any size.
    """
    size = x.shape[dim] - 1
    pixels = x.narrow(dim, 0, size)
    neighbours = x.narrow(dim, 1, size)
    both = (sector.narrow(dim, 0, size) > 0) & (sector.narrow(dim, 1, size) > 0)
    return ((neighbours - pixels).square() * both).sum(dim=(1, 2, 3))
