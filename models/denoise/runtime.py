"""What computes a network: onnxruntime where its graph ships, torch for any other.

torch is not imported for a network whose graph ships (`models.pretrained`).
What is quick in NumPy stands around the graph: the beam and the arc of each cell, the polar grid,
the sector.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from ...factory.cli.extras import Need, require
from ...factory.errors import FactoryError
from ..networks import DEFAULT, vector
from ..networks.weights import read_weights
from ..pretrained import shipped
from .pictures import Gray

Maps = Mapping[str, Gray]
Positions = Sequence[Gray]
_SMALLEST = np.float32(1e-6)
_PROBE_SHAPE = (96, 128)
_LEAST_RANGE = 1e-4
_MOST = np.float32(80)  # of a logit, so that its exponential is a number


def open_runtime(weights: Path, device: str) -> OnnxNetwork | TorchNetwork:
    """The network of a weights file.

    device: auto, cpu or gpu.  Raises FactoryError for a file that holds no network, a GPU that is
    not there, and packages that are not installed.
    """
    graph = find_graph(weights)
    network = OnnxNetwork(weights, graph, device) if graph else TorchNetwork(weights, device)
    if weights not in shipped().values():
        check_network(weights, network)
    return network


def check_network(weights: Path, network: OnnxNetwork | TorchNetwork) -> None:
    """Raise FactoryError for weights that turn speckle into NaN, or into one grey value."""
    rng = np.random.default_rng(0)
    speckle = np.clip(rng.rayleigh(0.2, _PROBE_SHAPE), 0, 1).astype(np.float32)
    with np.errstate(all="ignore"):
        image, weight = network.run(speckle, {})
        denoised = np.clip(speckle + np.float32(weight) * (image - speckle), 0, 1)
    if not np.isfinite(denoised).all() or np.ptp(denoised) < _LEAST_RANGE:
        raise FactoryError(
            f"weights={weights}: make every image NaN or a single grey value; train again, or take "
            "another file"
        )


def find_graph(weights: Path) -> Path | None:
    """The graph that computes these weights without torch, or None where there is none.

    It lies beside the weights under the same name, as `simnfnd export-weights --to runtime` wrote
    it, or ships.  Raises FactoryError for a file that holds no network.
    """
    model = structure(read_weights(weights)[0]["model"])
    # A graph names the structure that it computes at its end.
    description = json.dumps(model, sort_keys=True).encode()
    for path in (weights, *shipped().values()):
        graph = path.with_suffix(".onnx")
        if graph.is_file() and description in graph.read_bytes():
            return graph
    return None


def _on_gpu(device: str, is_available: bool) -> bool:
    if device == "gpu" and not is_available:
        needed = "onnxruntime-gpu, for weights of your own a torch for GPUs"
        raise FactoryError(f"--device gpu: no usable GPU here ({needed}); use --device cpu")
    return is_available and device != "cpu"


def structure(model: Mapping[str, Any]) -> dict[str, Any]:
    """What of a `model` configuration decides the graph."""
    every = {"told": True, "frames": False, "mirror": False, "channels": 1, **model}
    return {key: value for key, value in every.items() if key not in ("forget", "wide_grain")}


def give_weights(options: Any, weights: Mapping[str, npt.NDArray[Any]]) -> list[Any]:
    """Put weights into the options of a session of a graph without any.

    Returns what must be kept as long as the session: it shares the memory.
    """
    from onnxruntime import OrtValue

    arrays = [np.ascontiguousarray(values) for values in weights.values()]
    ort_values = [OrtValue.ortvalue_from_numpy(values) for values in arrays]
    options.add_external_initializers(list(weights), ort_values)
    return [arrays, ort_values]


def _session_of(
    graph: Path, weights: Mapping[str, npt.NDArray[Any]], providers: list[str]
) -> tuple[Any, list[Any]]:
    """A session of a graph with these weights, and what must be kept as long as it."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # what is wrong comes as an exception
    # Waiting threads would burn as much time as computing ones.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    named = {f"network.{name}": tensor for name, tensor in weights.items()}
    shared_arrays = give_weights(options, named)
    return onnxruntime.InferenceSession(str(graph), options, providers=providers), shared_arrays


class OnnxNetwork:
    """A network in onnxruntime, in 32 bits, ready to denoise.

    extras: names of its optional inputs (see `models.networks`).
    wide_grain: see `denoiser.by_scales`.  on_gpu: whether it runs on a GPU.
    """

    def __init__(self, path: Path, graph: Path, device: str) -> None:
        """See `open_runtime`.  graph: as `simnfnd export-weights --to runtime` wrote it."""
        require([Need("simnfnd denoise", "onnxruntime")])
        import onnxruntime

        cuda = "CUDAExecutionProvider"
        self.on_gpu = _on_gpu(device, cuda in onnxruntime.get_available_providers())
        providers = [*[cuda] * self.on_gpu, "CPUExecutionProvider"]
        header, weights = read_weights(path)
        try:
            session, shared_arrays = _session_of(graph, weights, providers)
        except Exception as error:  # onnxruntime has a class of its own for each reason
            reason = " ".join(str(error).split())[:160]
            raise FactoryError(f"weights={path}: do not fit their network: {reason}") from error
        self._session = session
        self._shared_arrays = shared_arrays
        facts = session.get_modelmeta().custom_metadata_map
        if not {"extras", "stride"} <= facts.keys() or not facts["stride"].isdigit():
            raise FactoryError(
                f"{graph}: was not made by `simnfnd export-weights --to runtime`; make it again"
            )
        model = header["model"]
        self.extras = tuple(facts["extras"].split(","))
        self._stride = max(int(facts["stride"]), 1)
        self.wide_grain = float(model.get("wide_grain", 1.0))
        self.is_polar = bool(model["polar"])
        self._mask = bool(model["mask"])
        self._inputs = tuple(node.name for node in session.get_inputs())

    def run(self, gray: Gray, maps: Maps) -> tuple[Gray, float]:
        """The picture (H, W) with its whole change, and the part of that it should get, 0 to 1.

        gray: (H, W) in 0..1.  maps: (H, W) planes by the names of `extras`.
        """
        grid = polar_grid(maps) if self.is_polar and "azimuth_rad" in maps else None
        if grid is None:
            inputs = inputs_of(gray, maps, self._stride)
        else:
            in_fan, in_grid, cells = grid
            sector = _sampled(maps.get("sector", np.ones_like(gray)), in_fan)
            cells = {**cells, "sector": sector}
            inputs = inputs_of(_sampled(gray, in_fan), cells, self._stride, is_grid=True)
        change, logits, weight = self._session.run(
            ["change", "shadow_logits", "weight"], {name: inputs[name] for name in self._inputs}
        )
        change = change[0, 0]
        logits = logits[0, 0]
        if grid is not None:
            change = _sampled(change, in_grid)
            logits = _sampled(logits, in_grid)
        image = gray + change
        if self._mask:
            image = image / (1 + np.exp(np.minimum(logits, _MOST)))
        if "sector" in maps:
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
    rows, columns = (-(-side // stride) * stride // 2 for side in gray.shape)
    # Columns count as beams and rows as arcs where nothing else is known.
    arcs, beams = np.indices((rows, columns))
    nothing = np.zeros_like(gray)
    planes = nothing, nothing, nothing - 1  # which occurs in no known geometry
    if "azimuth_rad" in maps:
        sector = maps.get("sector", np.ones_like(gray))
        radius = maps["range_fraction"]
        azimuth = maps["azimuth_rad"]
        planes = 2 * radius - 1, azimuth, 1 - sector
        if not is_grid:
            inside = _cells(sector, stride) > 0
            beams = _numbers(_cells(azimuth, stride), inside, columns)
            arcs = _numbers(_cells(radius, stride), inside, rows)
    return {
        "noisy": np.ascontiguousarray(gray, np.float32)[None, None],
        "maps": np.stack(planes)[None].astype(np.float32),
        "beams": beams.reshape(1, -1),
        "arcs": arcs.reshape(1, -1),
        "frames": np.ascontiguousarray(maps.get("frames", nothing), np.float32)[None, None],
        "remove": vector(DEFAULT)[None],
    }


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
        self.on_gpu = _on_gpu(device, torch.cuda.is_available())
        self._device = "cuda" if self.on_gpu else "cpu"
        self._network = network.to(self._device)
        self.extras = network.extras
        self.wide_grain = network.wide_grain

    def run(self, gray: Gray, maps: Maps) -> tuple[Gray, float]:
        """See `OnnxNetwork`."""
        import torch

        planes = {"noisy": gray, **{name: maps[name] for name in self.extras if name in maps}}
        known = {
            name: torch.from_numpy(np.ascontiguousarray(plane))[None, None].to(self._device)
            for name, plane in planes.items()
        }
        noisy = known.pop("noisy")
        weight = 1.0
        with torch.inference_mode():
            if self._network.has_heads:
                output = self._network.with_heads(noisy, **known)
                image = output.image
                weight = float(output.weight[0])
            else:
                image = self._network(noisy, **known)
        return np.asarray(image[0, 0].float().cpu().numpy(), np.float32), weight


def polar_grid(maps: Maps) -> tuple[Positions, Positions, Maps] | None:
    """From a fan to range by bearing and back, in NumPy, as `models.networks.sonarnet` does it.

    Returns rows and columns (H, W), in pixels, of the grid's cells in the fan, and of the fan's
    pixels in the grid; and range and bearing of the cells, near range first.
    None for pictures that are polar already, or too small to tell.
    """
    radius = maps["range_fraction"]
    azimuth = maps["azimuth_rad"]
    height, width = radius.shape
    if min(height, width) < 2 or (radius == radius[:, :1]).all():
        return None
    inside = maps["sector"] > 0 if "sector" in maps else np.ones(radius.shape, bool)
    if not inside.any():
        inside = np.ones_like(inside)
    right = radius * np.sin(azimuth)
    ahead = radius * np.cos(azimuth)
    first_right = right[:, 0].mean()
    first_ahead = ahead[0].mean()
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
    in_fan = [(2 * row + 1) / np.float32(height) - 1, (2 * column + 1) / np.float32(width) - 1]
    in_grid = [
        2 * (radius - near) / (far - near) - 1,
        2 * (azimuth - left) / (right_end - left) - 1,
    ]
    # Rounded as torch's `grid_sample` does, which has positions of -1 to 1 over a side.
    fan, grid = (
        [
            ((at + 1) * np.float32(side) - 1) / 2
            for at, side in zip(positions, radius.shape, strict=True)
        ]
        for positions in (in_fan, in_grid)
    )
    return fan, grid, {"range_fraction": cell_range, "azimuth_rad": cell_azimuth}


def _extent(values: Gray) -> tuple[np.float32, np.float32]:
    least = values.min()
    return least, max(values.max(), least + _SMALLEST)


def _sampled(picture: Gray, at: Positions) -> Gray:
    """A picture between its pixels, bilinear; repeated outside."""
    height, width = picture.shape
    row, column = (
        np.clip(place, 0, side - 1) for place, side in zip(at, picture.shape, strict=True)
    )
    top = row.astype(np.int64)
    first = column.astype(np.int64)
    lower = row - top
    right = column - first
    bottom = np.minimum(top + 1, height - 1)
    last = np.minimum(first + 1, width - 1)
    above = picture[top, first] * (1 - right) + picture[top, last] * right
    below = picture[bottom, first] * (1 - right) + picture[bottom, last] * right
    return np.asarray(above * (1 - lower) + below * lower, np.float32)
