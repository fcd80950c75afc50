"""PSNR, SSIM and shadow IoU of batches on the training device, defined as in evaluation."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

_SIGMA, _RADIUS = 1.5, 5


def psnr_db(image: Tensor, clean: Tensor) -> Tensor:
    """(N,) peak signal-to-noise ratio in dB of (N, 1, H, W) images in 0..1, at most 100 dB."""
    error = (image - clean).square().mean(dim=(1, 2, 3))
    return -10 * torch.log10(error.clamp_min(1e-10))


def ssim(image: Tensor, clean: Tensor) -> Tensor:
    """(N,) mean structural similarity of (N, 1, H, W) images in 0..1, at least 11x11.

    Gaussian window of sigma 1.5, population covariance, border of 5 pixels left out (Wang et al.
    2004); float64, because the variances are small differences of large numbers.
    """
    a, b = image.double(), clean.double()
    offset = torch.arange(-_RADIUS, _RADIUS + 1, dtype=a.dtype, device=a.device)
    window = torch.exp(-offset.square() / (2 * _SIGMA**2))
    window = window / window.sum()

    def mean(x: Tensor) -> Tensor:
        rows = functional.conv2d(x, window.view(1, 1, -1, 1))
        return functional.conv2d(rows, window.view(1, 1, 1, -1))

    mu_a, mu_b = mean(a), mean(b)
    var_a = mean(a * a) - mu_a.square()
    var_b = mean(b * b) - mu_b.square()
    covariance = mean(a * b) - mu_a * mu_b
    c1, c2 = 0.01**2, 0.03**2
    similarity = (2 * mu_a * mu_b + c1) * (2 * covariance + c2)
    similarity = similarity / ((mu_a.square() + mu_b.square() + c1) * (var_a + var_b + c2))
    return similarity.mean(dim=(1, 2, 3))


def shadow_iou(image: Tensor, batch: dict[str, Tensor], threshold: float = 0.02) -> Tensor:
    """(N,) overlap of the true shadow with what is at or below `threshold`, inside the sector.

    1 where there is no shadow at all.  batch: `noisy`, `clean` and `shadow`, (N, 1, H, W).
    """
    truth = batch["shadow"] > 0.5
    sector = truth | (batch["clean"] > 0) | (batch["noisy"] > 0)
    dark = (image <= threshold) & sector
    both = (truth & dark).sum(dim=(1, 2, 3)).float()
    either = (truth | dark).sum(dim=(1, 2, 3)).float()
    return torch.where(either > 0, both / either.clamp_min(1), torch.ones_like(both))
