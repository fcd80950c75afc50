"""The graph of a `sonarnet` that `simnfnd denoise` runs in onnxruntime (`models.denoise.runtime`).

Beams and arcs of the cells are inputs, so one graph serves fans, polar pictures and pictures of
unknown geometry.  It holds no weights: they stay in the safetensors, which they are taken from.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ..denoise.runtime import inputs_of, structure
from ..networks.lines import MapLines
from ..networks.network import Network, padded
from ..networks.sonarnet import SonarNet
from ..networks.weights import load_weights
from ..removal import DEFAULT, vector
from .graph import Graph, Inputs
from .traced import write_onnx

TOLERANCE = 1e-5
"""Largest difference from torch in 32 bits."""


class RuntimeGraph(Graph):
    """What the network computes of one picture, given the inputs of `denoise.runtime.inputs_of`.

    Outputs: `change` and `shadow_logits` (1, 1, H, W); `weight` (1,), the part of it to apply.
    """

    tolerance: ClassVar[float] = TOLERANCE

    def __init__(self, network: Network) -> None:
        """Raises FactoryError for a network that the runtime has no inputs for."""
        super().__init__(network, "none")
        if not isinstance(network, SonarNet) or network.settings.mirror:
            raise FactoryError(
                "--to runtime: is for model=sonarnet with mirror=false; use --to onnx for other "
                "networks"
            )
        told = [name for name in ("frames", "remove") if name in network.extras]
        self.inputs = ("noisy", "maps", "beams", "arcs", *told)
        self.outputs = ("change", "shadow_logits", "weight")

    @property
    def axes(self) -> dict[str, dict[int, str]]:
        """Name -> its dimensions of any size."""
        size, cells = {2: "height", 3: "width"}, {1: "cells"}
        found = dict.fromkeys(("noisy", "maps", "frames", "change", "shadow_logits"), size)
        found |= {"beams": cells, "arcs": cells}
        return {name: found[name] for name in (*self.inputs, *self.outputs) if name in found}

    def forward(self, noisy: Tensor, *told: Tensor) -> tuple[Tensor, ...]:
        """See the class."""
        network = self.network
        assert isinstance(network, SonarNet)
        given = dict(zip(self.inputs[1:], told, strict=True))
        maps = given["maps"]
        # Every second pixel: the cells of the features at half resolution.
        inside = padded(1 - maps[:, 2:], network.core_stride)[..., ::2, ::2] > 0
        shape = inside.shape[-2], inside.shape[-1]
        weight = inside.to(noisy.dtype).flatten(2)
        lines = MapLines(given["beams"], given["arcs"], weight, shape)
        remove = given.get("remove")
        if remove is None:
            remove = torch.from_numpy(vector(DEFAULT))[None]
        planes = torch.split(maps, 1, dim=1)
        return network.core(remove, given.get("frames"), lines, noisy, *planes)

    def example(self, height: int, width: int, count: int = 1, seed: int = 0) -> Inputs:
        """Speckle in a fan, a polar picture or one of unknown geometry, in turn by `seed`."""
        rng = np.random.default_rng(seed)
        noisy = np.clip(rng.exponential(0.2, (height, width)), 0, 1).astype(np.float32)
        maps: dict[str, np.ndarray] = {}
        if seed % 3 < 2:
            fan = FanGeometry.fan(
                np.pi / 3,
                apex_x_px=width / 2 - 0.5,
                apex_y_px=height - 0.5,
                near_px=0.1 * height,
                far_px=height,
                x_scale=width / height,
            )
            geometry = FanGeometry.polar() if seed % 3 else fan
            maps = dict(geometry.with_size(height, width).maps(0, 0, height, width))
            noisy *= maps["sector"]
        if "frames" in self.inputs:
            maps["frames"] = rng.uniform(0, 3, (height, width)).astype(np.float32)
        told = vector(DEFAULT) if "remove" in self.inputs else None
        found = inputs_of(noisy, maps, told, self.core_stride)
        return {name: torch.from_numpy(found[name]) for name in self.inputs}

    @property
    def core_stride(self) -> int:
        """What sizes are padded to."""
        assert isinstance(self.network, SonarNet)
        stride: int = self.network.core_stride
        return stride


def write_runtime(weights: Path, out: Path) -> float:
    """Write the graph of a weights file; how far onnxruntime is from torch with both.

    The same network and versions of torch and onnx give the same bytes, whatever its weights.
    Raises FactoryError for another network, and where the difference is above TOLERANCE; nothing is
    written then.
    """
    trained = load_weights(weights)
    graph = RuntimeGraph(trained.network)
    about = {
        "model": json.dumps(structure(trained.model), sort_keys=True),
        "extras": ",".join(trained.network.extras),
        "stride": graph.core_stride,
    }
    return write_onnx(graph, out, about, bare=True)
