"""What computes a network: onnxruntime where its graph ships, torch for any other.

torch is not imported for a network whose graph ships (`models.pretrained`).
What is quick in NumPy stands around the graph: the beam and the arc of each cell, the polar grid,
the sector.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.cli.extras import Need, require
from ...factory.errors import FactoryError
from ..networks import DEFAULT, vector
from ..networks.weights import read_weights
from ..pretrained import graphs

Gray = npt.NDArray[np.float32]
Maps = Mapping[str, Gray]
Positions = tuple[Gray, Gray]
_SMALLEST = np.float32(1e-6)

_MOST = np.float32(80)
"""Of a logit, so that its exponential is a number."""


def open_runtime(weights: Path, device: str) -> OnnxNetwork | TorchNetwork:
    """The network of a weights file.

    device: auto, cpu or gpu.  Raises FactoryError for a file that holds no network, a GPU that is
    not there, and packages that are not installed.
    """
    wished = json.dumps(structure(read_weights(weights)[0]["model"]), sort_keys=True).encode()
    for graph in graphs():
        # The words are at the end of the file, and few.
        if wished in graph.read_bytes():
            return OnnxNetwork(weights, graph, device)
    return TorchNetwork(weights, device)


def structure(model: Mapping[str, Any]) -> dict[str, Any]:
    """What of a `model` configuration decides the graph."""
    every = {"told": True, "frames": False, "mirror": False, "channels": 1, **model}
    return {key: value for key, value in every.items() if key not in ("forget", "wide_grain")}


def give_weights(options: Any, weights: Mapping[str, npt.NDArray[Any]]) -> list[Any]:
    """Put weights into the options of a session of a graph without any.

    Returns what must be kept as long as the session: it shares the memory.
    """
    from onnxruntime import OrtValue

    arrays = [np.ascontiguousarray(one) for one in weights.values()]
    values = [OrtValue.ortvalue_from_numpy(one) for one in arrays]
    options.add_external_initializers(list(weights), values)
    return [arrays, values]


class OnnxNetwork:
    """A network in onnxruntime, in 32 bits, ready to denoise.

    extras: names of its optional inputs (see `models.networks`).
    wide_grain: see `denoiser.by_scales`.  on_gpu: whether it runs on a GPU.
    """

    def __init__(self, path: Path, graph: Path, device: str) -> None:
        """See `open_runtime`.  graph: as `simnfnd export-weights --to runtime` wrote it."""
        require([Need("simnfnd denoise", "onnxruntime")])
        import onnxruntime

        has_gpu = "CUDAExecutionProvider" in onnxruntime.get_available_providers()
        if device == "gpu" and not has_gpu:
            raise FactoryError(
                "--device gpu: onnxruntime finds no usable GPU here; install onnxruntime-gpu, or "
                "use --device cpu"
            )
        self.on_gpu = has_gpu and device != "cpu"
        providers = ["CUDAExecutionProvider"] if self.on_gpu else []
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 3
        # Waiting threads would burn as much time as computing ones.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        header, weights = read_weights(path)
        self._kept = give_weights(
            options, {f"network.{name}": one for name, one in weights.items()}
        )
        try:
            self._session = onnxruntime.InferenceSession(
                graph.read_bytes(), options, providers=[*providers, "CPUExecutionProvider"]
            )
        except Exception as error:
            # onnxruntime reports weights of other sizes with a dozen exception types.
            reason = " ".join(str(error).split())[:160]
            raise FactoryError(f"weights={path}: do not fit their network: {reason}") from error
        facts = self._session.get_modelmeta().custom_metadata_map
        model = json.loads(facts["model"])
        self.extras = tuple(facts["extras"].split(","))
        self.wide_grain = float(header["model"].get("wide_grain", 1.0))
        self._stride, self.is_polar = int(facts["stride"]), bool(model["polar"])
        self._mask = bool(model["mask"])
        self._inputs = tuple(one.name for one in self._session.get_inputs())

    def run(self, gray: Gray, maps: Maps) -> tuple[Gray, float]:
        """The picture (H, W) with its whole change, and the part of that it should get, 0 to 1.

        gray: (H, W) in 0..1.  maps: (H, W) planes by the names of `extras`.
        """
        grid = PolarGrid.of(maps) if self.is_polar and _known(maps) else None
        if grid is None:
            found = inputs_of(gray, maps, self._stride)
        else:
            sector = maps.get("sector", np.ones_like(gray))
            shown = {
                "range_fraction": grid.range_fraction,
                "azimuth_rad": grid.azimuth_rad,
                "sector": grid.polar(sector),
            }
            found = inputs_of(grid.polar(gray), shown, self._stride, is_grid=True)
        change, logits, weight = self._session.run(
            ["change", "shadow_logits", "weight"], {name: found[name] for name in self._inputs}
        )
        change, logits = change[0, 0], logits[0, 0]
        if grid is not None:
            change, logits = grid.fan(change), grid.fan(logits)
        image = gray + change
        if self._mask:
            image = image / (1 + np.exp(np.minimum(logits, _MOST)))
        if _known(maps) and "sector" in maps:
            image = np.where(maps["sector"] > 0, image, gray)
        return np.asarray(image, np.float32), float(weight[0])


def inputs_of(gray: Gray, maps: Maps, stride: int, *, is_grid: bool = False) -> dict[str, Any]:
    """What a graph of `--to runtime` computes a picture from, (H, W) in 0..1.

    maps: `range_fraction` and `azimuth_rad` where the geometry is known, `sector` where it is not
    all of the picture, `frames` (log2 of how many were averaged) where these are several.
    is_grid: whether columns are beams and rows ranges, evenly.
    Returns `noisy` and `frames` (1, 1, H, W), `maps` (1, 3, H, W), `beams` and `arcs` (1, cells)
    int64, the line of each cell at half resolution, and `remove` (1, 6).
    """
    height, width = gray.shape
    rows, columns = (-(-side // stride) * stride // 2 for side in gray.shape)
    if _known(maps):
        sector = maps.get("sector", np.ones_like(gray))
        radius, azimuth = maps["range_fraction"], maps["azimuth_rad"]
        planes = 2 * radius - 1, azimuth, 1 - sector
    else:
        # -1 occurs in no known geometry.
        nothing = np.zeros_like(gray)
        planes = nothing, nothing, nothing - 1
    if _known(maps) and not is_grid:
        inside = _cells(sector, stride) > 0
        beams = _numbers(_cells(azimuth, stride), inside, columns)
        arcs = _numbers(_cells(radius, stride), inside, rows)
    else:
        # Columns count as beams and rows as arcs.
        beams = np.broadcast_to(np.arange(columns), (rows, columns))
        arcs = np.broadcast_to(np.arange(rows)[:, None], (rows, columns))
    frames = maps.get("frames")
    return {
        "noisy": np.ascontiguousarray(gray, np.float32)[None, None],
        "maps": np.stack(planes)[None].astype(np.float32),
        "beams": np.ascontiguousarray(beams, np.int64).reshape(1, -1),
        "arcs": np.ascontiguousarray(arcs, np.int64).reshape(1, -1),
        "frames": np.zeros((1, 1, height, width), np.float32)
        if frames is None
        else np.ascontiguousarray(frames, np.float32)[None, None],
        "remove": vector(DEFAULT)[None],
    }


def _known(maps: Maps) -> bool:
    return "range_fraction" in maps and "azimuth_rad" in maps


def _cells(plane: Gray, stride: int) -> Gray:
    """Every second pixel of a plane that is lengthened to a multiple of the stride."""
    height, width = plane.shape
    padded = np.pad(plane, ((0, -height % stride), (0, -width % stride)), mode="edge")
    return padded[::2, ::2]


def _numbers(values: Gray, inside: npt.NDArray[np.bool_], count: int) -> npt.NDArray[np.int64]:
    """Which of `count` even steps between the extremes inside a value lies in."""
    least, most = (values[inside].min(), values[inside].max()) if inside.any() else (0, 1)
    extent = max(np.float32(most) - np.float32(least), np.float32(1e-6))
    step = (values - np.float32(least)) / extent
    return np.clip(step * np.float32(count), 0, count - 1).astype(np.int64)


class TorchNetwork:
    """A network in torch; used as an `OnnxNetwork`."""

    def __init__(self, path: Path, device: str) -> None:
        """See `open_runtime`."""
        require(Need(f"weights={path.name}", module) for module in ("torch", "safetensors"))
        import torch

        from ..networks.weights import load_weights

        network = load_weights(path).network
        has_gpu = torch.cuda.is_available()
        if device == "gpu" and not has_gpu:
            raise FactoryError("--device gpu: no usable GPU here; use --device cpu")
        self.on_gpu = has_gpu and device != "cpu"
        self._device = "cuda" if self.on_gpu else "cpu"
        self._network = network.to(self._device)
        self.extras = network.extras
        self.wide_grain = network.wide_grain

    def run(self, gray: Gray, maps: Maps) -> tuple[Gray, float]:
        """See `OnnxNetwork`."""
        import torch

        known = {
            name: torch.from_numpy(np.ascontiguousarray(plane))[None, None]
            for name, plane in maps.items()
            if name in self.extras
        }
        known = {name: plane.to(self._device) for name, plane in known.items()}
        noisy, weight = torch.from_numpy(np.ascontiguousarray(gray))[None, None], 1.0
        noisy = noisy.to(self._device)
        with torch.inference_mode():
            if self._network.has_heads:
                output = self._network.with_heads(noisy, **known)
                image, weight = output.image, float(output.weight[0])
            else:
                image = self._network(noisy, **known)
        return np.asarray(image[0, 0].float().cpu().numpy(), np.float32), weight


@dataclass(frozen=True, eq=False)
class PolarGrid:
    """Fan pictures to range by bearing and back, in NumPy, as `models.networks.polar` does it.

    in_fan, in_grid: rows and columns, in pixels, of the cells in the fan and of the pixels in the
    grid.  range_fraction, azimuth_rad: (H, W) of the cells, near range first.
    """

    in_fan: Positions
    in_grid: Positions
    range_fraction: Gray
    azimuth_rad: Gray

    @classmethod
    def of(cls, maps: Mapping[str, Gray]) -> PolarGrid | None:
        """The grid for a fan; None for pictures that are polar already, or too small to tell."""
        radius, azimuth = maps["range_fraction"], maps["azimuth_rad"]
        height, width = radius.shape
        if min(height, width) < 2 or (radius == radius[:, :1]).all():
            return None
        inside = maps["sector"] > 0 if "sector" in maps else np.ones(radius.shape, bool)
        if not inside.any():
            inside = np.ones_like(inside)
        right, ahead = radius * np.sin(azimuth), radius * np.cos(azimuth)
        first_right, first_ahead = right[:, 0].mean(), ahead[0].mean()
        right_step = (right[:, -1].mean() - first_right) / np.float32(width - 1)
        ahead_step = (ahead[-1].mean() - first_ahead) / np.float32(height - 1)
        near, far = _extent(radius[inside])
        left, right_end = _extent(azimuth[inside])
        down = (np.arange(height, dtype=np.float32) + np.float32(0.5)) / np.float32(height)
        across = (np.arange(width, dtype=np.float32) + np.float32(0.5)) / np.float32(width)
        cell_range = np.broadcast_to((near + (far - near) * down)[:, None], radius.shape)
        cell_azimuth = np.broadcast_to(left + (right_end - left) * across, radius.shape)
        row = (cell_range * np.cos(cell_azimuth) - first_ahead) / ahead_step
        column = (cell_range * np.sin(cell_azimuth) - first_right) / right_step
        in_fan = [
            _rounded((2 * place + 1) / np.float32(side) - 1, side)
            for place, side in ((row, height), (column, width))
        ]
        in_grid = [
            _rounded(2 * (values - least) / (most - least) - 1, side)
            for values, least, most, side in (
                (radius, near, far, height),
                (azimuth, left, right_end, width),
            )
        ]
        return cls((in_fan[0], in_fan[1]), (in_grid[0], in_grid[1]), cell_range, cell_azimuth)

    def polar(self, picture: Gray) -> Gray:
        """A fan picture (H, W) on the grid, bilinear."""
        return _sampled(picture, self.in_fan)

    def fan(self, cells: Gray) -> Gray:
        """What is on the grid as a fan picture, bilinear; repeated outside the grid."""
        return _sampled(cells, self.in_grid)


def _extent(values: Gray) -> tuple[np.float32, np.float32]:
    least = values.min()
    return least, max(values.max(), least + _SMALLEST)


def _rounded(position: Gray, side: int) -> Gray:
    """Pixels from a position of -1 to 1 over a side, rounded as torch's `grid_sample` does."""
    return ((position + 1) * np.float32(side) - 1) / 2


def _sampled(picture: Gray, at: Positions) -> Gray:
    height, width = picture.shape
    row, column = (
        np.clip(place, 0, side - 1) for place, side in zip(at, picture.shape, strict=True)
    )
    top, first = row.astype(np.int64), column.astype(np.int64)
    lower, right = row - top, column - first
    bottom, last = np.minimum(top + 1, height - 1), np.minimum(first + 1, width - 1)
    above = picture[top, first] * (1 - right) + picture[top, last] * right
    below = picture[bottom, first] * (1 - right) + picture[bottom, last] * right
    return np.asarray(above * (1 - lower) + below * lower, np.float32)
