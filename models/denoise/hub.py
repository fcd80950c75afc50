"""What `torch.hub` gives: the denoiser as a module, for pipelines and trainings in torch."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from ...factory.dataset.fan_geometry import FanGeometry
from ..networks.weights import load_weights
from ..pretrained import find_weights


class HubDenoiser(nn.Module):
    """Denoises a batch of images, each alone, on the device that the module is on.

    It can be differentiated and trained further.  What surrounds the network in `simnfnd denoise`
    (tiles of large images, wide grain at half its size, dark images, left detail, time) is left
    out.
    """

    def __init__(self, weights: str | Path | None = None) -> None:
        """weights: as `find_weights` takes them.  Raises FactoryError for those that do not fit."""
        super().__init__()
        self.network = load_weights(find_weights(weights)).network

    def forward(self, noisy: Tensor, geometry: FanGeometry | None = None) -> Tensor:
        """(N, 1, H, W) float in 0..1 -> the same, denoised.

        geometry: where range and bearing are in all of the images, if that is known.
        Raises ValueError for another shape.
        """
        if noisy.ndim != 4 or noisy.shape[1] != 1 or 0 in noisy.shape:
            raise ValueError(f"noisy has shape {tuple(noisy.shape)}; expected (N, 1, H, W)")
        extras: dict[str, Tensor] = {}
        if geometry is not None:
            maps = geometry.maps(0, 0, *noisy.shape[2:])
            for name in maps.keys() & set(self.network.extras):
                plane = torch.from_numpy(np.ascontiguousarray(maps[name], np.float32))
                extras[name] = plane.to(noisy).expand(len(noisy), 1, -1, -1)
        denoised: Tensor = self.network(noisy, **extras)
        return denoised.clamp(0, 1)
