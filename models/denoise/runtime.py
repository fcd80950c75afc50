"""Runs a network: in onnxruntime if its graph ships, otherwise in torch.

torch is not imported for a network whose graph ships (`models.pretrained`).  NumPy computes what
is fast enough there and is not part of the graph: the beam and the arc of each cell, the polar
grid (`polar`), the sector.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Array, Bools, Float32s, Int64s
from ...factory.common.errors import FactoryError
from ...factory.common.extras import Need, require
from ...factory.common.workers.machine import usable_cores
from ..networks import BEARING_INPUTS, DEFAULT, GEOMETRY, vector
from ..networks.weights import read_weights
from ..pretrained import shipped
from ..pretrained.graphs import Form, RunnableGraph, find_runnable, unknown_graph
from .polar import Maps, polar_grid, sampled

_PROBE_SHAPE = (96, 128)
_LEAST_RANGE = 1e-4
_MOST = np.float32(80)  # of a logit, so that its exponential is a number


def open_runtime(weights: Path, device: str) -> OnnxNetwork | TorchNetwork:
    """Open the network of a weights file.

    device: auto, cpu or gpu.  Raises FactoryError for a file that holds no network, a missing GPU
    and packages that are not installed.
    """
    graph = find_graph(weights)
    if graph is not None:
        network: OnnxNetwork | TorchNetwork = OnnxNetwork(weights, graph, device)
    else:
        network = TorchNetwork(weights, device)
    if weights not in shipped().values():
        check_network(weights, network)
    return network


def check_network(weights: Path, network: OnnxNetwork | TorchNetwork) -> None:
    """Raise FactoryError for weights that turn speckle into NaN, or into one grey value."""
    rng = np.random.default_rng(0)
    speckle = np.clip(rng.rayleigh(0.2, _PROBE_SHAPE), 0, 1).astype(np.float32)
    with np.errstate(all="ignore"):
        estimate, weight = network.run(speckle, {})
        denoised = speckle + np.float32(weight or 0) * (estimate - speckle)
    # The estimate itself, for a small weight would hide that it is a single grey value.
    estimated_range = np.ptp(np.clip(estimate, 0, 1))
    if not np.isfinite(denoised).all() or estimated_range < _LEAST_RANGE:
        raise FactoryError(
            f"weights={weights}: make every image NaN or a single grey value; train again, or take "
            "another file"
        )


def find_graph(weights: Path) -> RunnableGraph | None:
    """The graph that computes these weights without torch, or None where none may be run.

    It ships, or lies beside the weights under the same name, as `simnfnd export-weights --to
    runtime` wrote it.  Raises FactoryError for a file that holds no network.
    """
    model = structure(read_weights(weights)[0]["model"])
    return find_runnable(weights, json.dumps(model, sort_keys=True).encode())


def _on_gpu(device: str, is_available: bool) -> bool:
    if device == "gpu" and not is_available:
        needed = "onnxruntime-gpu, for weights of your own a torch for GPUs"
        raise FactoryError(f"--device gpu: no usable GPU here ({needed}); use --device cpu")
    return is_available and device != "cpu"


_NOT_IN_GRAPH = "forget", "wide_grain", "average_cells", "even_level"


def structure(model: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keys of a `model` configuration that determine the graph."""
    every = {"told": True, "frames": False, "mirror": False, "channels": 1, **model}
    if not every.get("bearings"):
        every.pop("bearings", None)  # which graphs of earlier versions do not name
    return {key: value for key, value in every.items() if key not in _NOT_IN_GRAPH}


def give_weights(options: Any, weights: Mapping[str, Array]) -> list[Any]:
    """Put weights into the options of a session whose graph has none.

    Returns the arrays whose memory the session uses: keep them as long as the session.
    """
    from onnxruntime import OrtValue

    arrays = [np.ascontiguousarray(values) for values in weights.values()]
    ort_values = [OrtValue.ortvalue_from_numpy(values) for values in arrays]
    options.add_external_initializers(list(weights), ort_values)
    return [arrays, ort_values]


def used_weights(weights: Mapping[str, Array], content: bytes) -> dict[str, Array]:
    """Those weights that a graph names."""
    return {name: values for name, values in weights.items() if name.encode() in content}


class _Session(NamedTuple):
    """A session of onnxruntime, the names of its inputs and outputs.

    shared_arrays: whose memory it uses: keep them as long as it.
    """

    session: Any
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    shared_arrays: list[Any]


def _session_of(content: bytes, weights: Mapping[str, Array], providers: list[str]) -> _Session:
    """Open a session of a graph with these weights."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 4  # errors arrive as exceptions
    # As many threads as cores that this process may use, not as the machine has.
    options.intra_op_num_threads = usable_cores()
    # Waiting threads would use as much time as computing ones.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    shared_arrays = give_weights(options, weights)
    session = onnxruntime.InferenceSession(content, options, providers=providers)
    inputs = tuple(node.name for node in session.get_inputs())
    outputs = tuple(node.name for node in session.get_outputs())
    return _Session(session, inputs, outputs, shared_arrays)


class OnnxNetwork:
    """A network in onnxruntime, in 32 bits, ready to denoise.

    extras: names of its optional inputs (see `models.networks`).
    wide_grain: see `denoiser.by_scales`.  average_cells: see `wide_cells`.
    on_gpu: whether it runs on a GPU.
    """

    def __init__(self, path: Path, graph: RunnableGraph, device: str) -> None:
        """See `open_runtime`.  graph: one that may be run; see `pretrained.graphs`."""
        require([Need("simnfnd denoise", "onnxruntime")])
        import onnxruntime

        cuda = "CUDAExecutionProvider"
        self.on_gpu = _on_gpu(device, cuda in onnxruntime.get_available_providers())
        self._providers = [*[cuda] * self.on_gpu, "CPUExecutionProvider"]
        header, weights = read_weights(path)
        self._weights = {f"network.{name}": values for name, values in weights.items()}
        self._path = path
        self._forms = graph.forms()
        self._sessions: dict[Form, _Session] = {}
        # Weights that ship fit; others are tried with all layers.
        is_own = path not in shipped().values()
        opened = self._opened("single" if "single" in self._forms and not is_own else "whole")
        facts = opened.session.get_modelmeta().custom_metadata_map
        is_complete = {"extras", "stride"} <= facts.keys() and facts["stride"].isdigit()
        if not is_complete or "geometry" not in self._forms:
            raise FactoryError(
                f"{graph.path}: was not made by `simnfnd export-weights --to runtime` of this "
                "version; make it again"
            )
        model = header["model"]
        # Graphs serve all that share their layers, also those that always forgot the geometry.
        unknown = (*GEOMETRY, *BEARING_INPUTS) if model.get("forget", 0) == 1 else ()
        self.extras = tuple(name for name in facts["extras"].split(",") if name not in unknown)
        self._stride = max(int(facts["stride"]), 1)
        self.wide_grain = float(model.get("wide_grain", 1.0))
        self.average_cells = bool(model.get("average_cells", False))
        self.is_polar = bool(model["polar"])
        self._mask = bool(model["mask"])
        self._last_geometry: GeometryInputs | None = None

    def run(
        self, grey: Float32s, maps: Maps, *, weighs: bool = True
    ) -> tuple[Float32s, float | None]:
        """Return the image (H, W) with its whole change, and the part of it to apply, 0 to 1.

        grey: (H, W) in 0..1.  maps: (H, W) planes by the names of `extras`.
        weighs: whether that part is needed; None may come back otherwise.
        """
        grid = polar_grid(maps) if self.is_polar and "azimuth_rad" in maps else None
        if grid is None:
            geometry = self._geometry_of(grey.shape, maps)
            inputs = inputs_of(grey, maps, geometry)
        else:
            sector = sampled(maps.get("sector", np.ones_like(grey)), grid.cells_in_fan)
            cells = {**grid.cells, "sector": sector}
            cell_values = sampled(grey, grid.cells_in_fan)
            geometry = self._prepared(cell_values.shape, cells, is_grid=True)
            inputs = inputs_of(cell_values, cells, geometry)

        opened = self._opened(self._form_of(inputs["frames"], weighs))
        outputs = opened.session.run(opened.outputs, {name: inputs[name] for name in opened.inputs})
        change = outputs[0][0, 0]
        logits = outputs[1][0, 0]
        if grid is not None:
            change = sampled(change, grid.pixels_in_grid)
            logits = sampled(logits, grid.pixels_in_grid)

        image = grey + change
        if self._mask:
            odds = np.minimum(logits, _MOST)
            np.exp(odds, out=odds)
            odds += 1
            image /= odds
        if "sector" in maps:
            image = np.where(maps["sector"] > 0, image, grey)
        weight = float(outputs[2][0]) if len(outputs) == 3 else None
        return np.asarray(image, np.float32), weight

    def interference(self, view: Float32s, width_rad: float) -> Float32s:
        """(NODES, BEARINGS) of a `bearing_view` of a sector; see `networks.bearings`."""
        inputs = {"view": view[None], "width_rad": np.array([[width_rad]], np.float32)}
        (nodes,) = self._opened("bearings").session.run(["interference"], inputs)
        return np.asarray(nodes[0], np.float32)

    def _form_of(self, frames: Float32s, weighs: bool) -> Form:
        """The graph that computes no more than is needed."""
        if "single" in self._forms and not frames.any():
            return "single"
        return "whole" if weighs or "window" not in self._forms else "window"

    def _opened(self, form: Form) -> _Session:
        """The session of a form of the graph.  Raises FactoryError for weights that do not fit."""
        if form not in self._sessions:
            content = self._forms[form]
            used = used_weights(self._weights, content)
            if form == "whole":
                # All that are not of a graph of their own: weights that do not fit show.
                used = {
                    name: values
                    for name, values in self._weights.items()
                    if not name.startswith("network.bearings.")
                }
            try:
                self._sessions[form] = _session_of(content, used, self._providers)
            except Exception as error:  # onnxruntime has a class of its own for each reason
                reason = " ".join(str(error).split())[:160]
                raise FactoryError(
                    f"weights={self._path}: do not fit their network: {reason}"
                ) from error
        return self._sessions[form]

    def _geometry_of(self, shape: tuple[int, ...], maps: Maps) -> GeometryInputs:
        """The inputs of the geometry; those of the last image where it has the same maps."""
        last = self._last_geometry
        if last is None or not last.is_of(shape, maps):
            last = self._prepared(shape, maps)
            self._last_geometry = last
        return last

    def _prepared(
        self, shape: tuple[int, ...], maps: Maps, *, is_grid: bool = False
    ) -> GeometryInputs:
        return GeometryInputs.of(shape, maps, self._stride, self._features, is_grid=is_grid)

    def _features(self, maps: Float32s) -> Float32s:
        """What the first layer makes of the maps, (1, 3, H, W) -> (cells, C)."""
        (features,) = self._opened("geometry").session.run(["features"], {"maps": maps})
        return np.asarray(features, np.float32)


class GeometryInputs(NamedTuple):
    """What a graph gets of the geometry of an image; see `inputs_of`.

    shape: (H, W) of the image.  sources: the maps that the inputs were made from.
    named: the inputs by their names.
    """

    shape: tuple[int, ...]
    sources: tuple[Float32s | None, ...]
    named: dict[str, Array]

    def is_of(self, shape: tuple[int, ...], maps: Maps) -> bool:
        """Whether they belong to these very arrays."""
        is_same = [
            maps.get(name) is plane for name, plane in zip(GEOMETRY, self.sources, strict=True)
        ]
        return self.shape == shape and all(is_same)

    @classmethod
    def of(
        cls,
        shape: tuple[int, ...],
        maps: Maps,
        stride: int,
        features_of: Callable[[Float32s], Float32s],
        *,
        is_grid: bool = False,
    ) -> GeometryInputs:
        """features_of: what the graph `geometry` computes of the maps, (1, 3, H, W) -> (cells, C).

        is_grid: whether columns are beams and rows ranges, evenly.
        """
        rows, columns = (-(-side // stride) * stride // 2 for side in shape)
        # Columns count as beams and rows as arcs where nothing else is known.
        arcs, beams = np.indices((rows, columns))
        nothing = np.zeros(shape, np.float32)
        planes = nothing, nothing, nothing - 1  # values that no known geometry has
        sector = np.ones(shape, np.float32)
        if "azimuth_rad" in maps:
            sector = maps.get("sector", sector)
            radius = maps["range_fraction"]
            azimuth = maps["azimuth_rad"]
            planes = 2 * radius - 1, azimuth, 1 - sector
            if not is_grid:
                inside = _cells(sector, stride) > 0
                beams = _line_numbers(_cells(azimuth, stride), inside, columns)
                arcs = _line_numbers(_cells(radius, stride), inside, rows)
        stacked = np.stack(planes)[None].astype(np.float32)
        named: dict[str, Array] = {
            "maps": stacked,
            "outside": np.ascontiguousarray(stacked[:, 2:]),
            "features": features_of(stacked),
        }
        is_inside = (_cells(sector, stride) > 0).ravel()
        named |= _line_inputs("beam", beams.ravel(), is_inside, columns)
        named |= _line_inputs("arc", arcs.ravel(), is_inside, rows)
        return cls(shape, tuple(maps.get(name) for name in GEOMETRY), named)


def inputs_of(grey: Float32s, maps: Maps, geometry: GeometryInputs) -> dict[str, Array]:
    """Return the inputs of the graphs of `--to runtime` for an image, (H, W) in 0..1.

    maps: `range_fraction` and `azimuth_rad` where the geometry is known, `sector` where it is not
    all of the image, `frames` (log2 of how many were averaged) where these are several.
    Returns `noisy`, `frames` and `outside` (1, 1, H, W), `maps` (1, 3, H, W), `features` (cells, C)
    and for beams and arcs the parts of `networks.folded.LineTable`, such as `beam_chunks`, of cells
    at half resolution; `remove` (1, 6).
    """
    frames = maps["frames"] if "frames" in maps else np.zeros_like(grey)
    return {
        **geometry.named,
        "noisy": np.ascontiguousarray(grey, np.float32)[None, None],
        "frames": np.ascontiguousarray(frames, np.float32)[None, None],
        "remove": vector(DEFAULT)[None],
    }


_CHUNK = 32  # cells of a line that are summed first


def _line_inputs(line: str, numbers: Int64s, is_inside: Bools, count: int) -> dict[str, Array]:
    """The parts of `networks.folded.LineTable` by their names.

    line: `beam` or `arc`.  numbers: (cells,) line of each cell, below `count`.  is_inside: (cells,)
    where the sonar measured.
    """
    inside = np.flatnonzero(is_inside)
    order = np.argsort(numbers[inside], kind="stable")
    cells = inside[order]
    line_of_cell = numbers[cells]
    counts = np.bincount(line_of_cell, minlength=count)
    rank = np.arange(len(cells)) - np.repeat(np.cumsum(counts) - counts, counts)
    chunk_counts = -(-counts // _CHUNK)
    first_chunks = np.cumsum(chunk_counts) - chunk_counts
    # At least one, so that no graph gets an empty array.
    chunks = np.full((max(int(chunk_counts.sum()), 1), _CHUNK), len(numbers), np.int64)
    chunks[first_chunks[line_of_cell] + rank // _CHUNK, rank % _CHUNK] = cells
    lines = np.zeros(len(chunks), np.int64)
    lines[: int(chunk_counts.sum())] = np.repeat(np.arange(count), chunk_counts)
    return {
        f"{line}_number": np.ascontiguousarray(numbers, np.int64),
        f"{line}_chunks": chunks,
        f"{line}_lines": lines,
        f"{line}_counts": counts.astype(np.float32),
    }


def _cells(plane: Float32s, stride: int) -> Float32s:
    """Every second pixel of a plane, padded to a multiple of the stride."""
    height, width = plane.shape
    padded = np.pad(plane, ((0, -height % stride), (0, -width % stride)), mode="edge")
    return padded[::2, ::2]


def _line_numbers(values: Float32s, inside: Bools, count: int) -> Int64s:
    """The index of each value among `count` even steps between the extremes inside."""
    least, most = (values[inside].min(), values[inside].max()) if inside.any() else (0, 1)
    extent = max(np.float32(most) - np.float32(least), np.float32(1e-6))
    step = (values - np.float32(least)) / extent
    return np.clip(step * np.float32(count), 0, count - 1).astype(np.int64)


class TorchNetwork:
    """A network in torch; used as an `OnnxNetwork`."""

    def __init__(self, path: Path, device: str) -> None:
        """See `open_runtime`."""
        remark = unknown_graph(path) if find_spec("torch") is None else ""
        if remark:
            raise FactoryError(
                f"weights={path}: need torch: pip install 'simnfnd[train]'; {remark}"
            )
        require(Need(f"weights={path.name}", module) for module in ("torch", "safetensors"))
        import torch

        from ..networks.weights import load_weights

        network = load_weights(path).network
        self.on_gpu = _on_gpu(device, torch.cuda.is_available())
        self._device = "cuda" if self.on_gpu else "cpu"
        self._network = network.to(self._device)
        self.extras = network.extras
        self.wide_grain = network.wide_grain
        self.average_cells = network.average_cells

    def run(
        self, grey: Float32s, maps: Maps, *, weighs: bool = True
    ) -> tuple[Float32s, float | None]:
        """See `OnnxNetwork`."""
        import torch

        planes = {"noisy": grey, **{name: maps[name] for name in self.extras if name in maps}}
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

    def interference(self, view: Float32s, width_rad: float) -> Float32s:
        """See `OnnxNetwork`."""
        import torch

        with torch.inference_mode():
            head: Any = self._network.bearings
            nodes = head(
                torch.from_numpy(view)[None].to(self._device),
                torch.tensor([[width_rad]], device=self._device),
            )
        return np.asarray(nodes[0].float().cpu().numpy(), np.float32)
