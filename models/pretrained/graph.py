"""A trained network as one function of arrays, for other programs than this one."""

from __future__ import annotations

from collections.abc import Mapping
from typing import ClassVar, Literal, get_args

import numpy as np
import torch
from torch import Tensor, nn

from ...factory.errors import FactoryError
from ...factory.imaging.contract import ARTEFACTS
from ...factory.sonar.geometry import FanGeometry
from ..networks.network import Network
from ..removal import DEFAULT, vector

Layout = Literal["none", "fan", "polar"]
LAYOUTS: tuple[Layout, ...] = get_args(Layout)
MAPS = ("range_fraction", "azimuth_rad", "sector")

Inputs = dict[str, Tensor]


class Graph(nn.Module):
    """What `simnfnd denoise` computes of a picture that fits one tile, without choices at run time.

    Inputs, in this order: `noisy` (N, 1, H, W) float32 in 0..1; the maps of `MAPS`, each
    (N, 1, H, W), where layout is not `none`; `remove` (1, 6) where the network is told what to
    remove.  Outputs: `denoised` (N, 1, H, W), 0..1; and `weight` (N,), the part of its change that
    a picture was given, of networks that weigh it.
    """

    tolerance: ClassVar[float] = 1e-4
    """Largest difference from torch that is let through, in pictures of 0 to 1."""

    def __init__(self, network: Network, layout: Layout) -> None:
        """Raises FactoryError for a layout that the network has no use for."""
        super().__init__()
        if layout != "none" and not set(MAPS) <= set(network.extras):
            raise FactoryError(
                f"--geometry {layout}: this network does not use the geometry; leave it out"
            )
        self.network, self.layout = network, layout
        maps = MAPS if layout != "none" else ()
        told = ("remove",) if "remove" in network.extras else ()
        self.inputs: tuple[str, ...] = ("noisy", *maps, *told)
        self.outputs: tuple[str, ...] = (
            ("denoised", "weight") if network.has_heads else ("denoised",)
        )
        if hasattr(network, "fan"):
            setattr(network, "fan", layout == "fan")  # noqa: B010  (of sonarnet alone)
        # Without gradients and choices of training, as tracing keeps both.
        self.requires_grad_(False).eval()

    @property
    def axes(self) -> dict[str, dict[int, str]]:
        """Name -> its dimensions of any size."""
        pictures = [name for name in (*self.inputs, "denoised") if name != "remove"]
        sizes = {0: "count", 2: "height", 3: "width"}
        return {**{name: sizes for name in pictures}, "weight": {0: "count"}}

    def forward(self, noisy: Tensor, *told: Tensor) -> tuple[Tensor, ...]:
        """See the class."""
        extras = dict(zip(self.inputs[1:], told, strict=True))
        if "remove" in extras:
            extras["remove"] = extras["remove"].expand(noisy.shape[0], -1)
        if not self.network.has_heads:
            return (self.network(noisy, **extras).clamp(0, 1),)
        found = self.network.with_heads(noisy, **extras)
        change = found.weight[:, None, None, None] * (found.image - noisy)
        return (noisy + change).clamp(0, 1), found.weight

    def shown(self, name: str, values: np.ndarray) -> np.ndarray:
        """An output as it shows in a picture, for comparisons."""
        return 1 / (1 + np.exp(-values)) if name == "shadow_logits" else values

    def example(self, height: int, width: int, count: int = 1, seed: int = 0) -> Inputs:
        """Speckle in a sector of 60 degrees, and the other inputs for it."""
        geometry = _fan(height, width) if self.layout == "fan" else FanGeometry.polar()
        maps = geometry.with_size(height, width).maps(0, 0, height, width)
        rng = np.random.default_rng(seed)
        speckle = np.clip(rng.exponential(0.2, (count, 1, height, width)), 0, 1) * maps["sector"]
        every = {name: np.repeat(values[None, None], count, 0) for name, values in maps.items()}
        every |= {"noisy": speckle.astype(np.float32), "remove": wanted(DEFAULT)}
        return {name: torch.from_numpy(every[name]) for name in self.inputs}


def wanted(removed: tuple[str, ...]) -> np.ndarray:
    """(1, 6) float32, the input `remove`."""
    return vector(removed)[None]


def described(graph: Graph) -> Mapping[str, str]:
    """Name -> one line on an input or output."""
    usual = ", ".join(f"{told:g}" for told in vector(DEFAULT))
    lines = {
        "noisy": "(N, 1, H, W) gray picture, 0 to 1",
        "range_fraction": "(N, 1, H, W) slant range of each pixel over the largest range",
        "azimuth_rad": "(N, 1, H, W) bearing of each pixel in radians, positive to the right",
        "sector": "(N, 1, H, W) 1 where the sonar measured, 0 elsewhere",
        "remove": f"(1, 6) 1 for each to remove of {', '.join(ARTEFACTS)}; usual: {usual}",
        "frames": "(1, 1, H, W) log2 of the number of frames averaged, 0 for one",
        "maps": "(1, 3, H, W) 2 range_fraction - 1, azimuth_rad, 1 - sector; 0, 0, -1 if unknown",
        "beams": "(1, cells) beam of each cell at half the padded size; columns if unknown",
        "arcs": "(1, cells) arc of each cell at half the padded size; rows if unknown",
        "change": "(1, 1, H, W) what to add to the picture",
        "shadow_logits": "(1, 1, H, W) positive where the network sees shadow",
        "denoised": "(N, 1, H, W) the picture denoised, 0 to 1",
        "weight": "(N) the part of its change that the picture was given, 0 to 1",
    }
    return {name: lines[name] for name in (*graph.inputs, *graph.outputs)}


def _fan(height: int, width: int) -> FanGeometry:
    return FanGeometry.fan(
        np.pi / 3,
        apex_x_px=width / 2 - 0.5,
        apex_y_px=height - 0.5,
        near_px=0.1 * height,
        far_px=height,
        x_scale=width / height,
    )
