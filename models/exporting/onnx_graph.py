"""Exports networks as ONNX files and compares them with torch before writing them.

The export traces the network.  torch's exporter with symbolic shapes (`dynamo=True`) produces the
same ONNX graph of `sonarnet`, but takes minutes where the trace takes seconds.
"""

from __future__ import annotations

import io
import json
import warnings
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any, ClassVar, Literal, cast

import numpy as np
import torch
from torch import Tensor, nn

from ...factory import __version__
from ...factory.common.errors import FactoryError
from ...factory.common.files import check_writable, sha256_of, write_atomically
from ...factory.dataset.fan_geometry import FanGeometry
from ..denoise.runtime import (
    GeometryInputs,
    give_weights,
    inputs_of,
    structure,
    used_weights,
)
from ..networks import DEFAULT, GEOMETRY, vector
from ..networks.bearing_view import BEARINGS, RANGES
from ..networks.bearings import BearingHead
from ..networks.folded import LineTable, LineTables, geometry_features
from ..networks.line_context import MapLines
from ..networks.network import Network, padded
from ..networks.sonarnet import SonarNet
from ..networks.weights import Trained, load_weights
from ..pretrained.graphs import Form, packed, remember

OPSET = 18  # GridSample and sums by ScatterElements came with 16, LayerNormalization with 17
Layout = Literal["none", "fan", "polar"]
Inputs = dict[str, Tensor]
Run = Callable[[Mapping[str, Tensor]], list[np.ndarray]]

# Sizes of images, (height, width, count).  The traced one is no multiple of a network's stride, so
# that padding becomes part of the trace.
_TRACED_SIZE = (75, 91, 2)
_COMPARED_SIZES = ((64, 64, 1), (50, 83, 2), (128, 70, 1))
# Stored in the files, so they stay as they are.
_DESCRIPTIONS = {
    "noisy": "(N, 1, H, W) gray picture, 0 to 1",
    "range_fraction": "(N, 1, H, W) slant range of each pixel over the largest range",
    "azimuth_rad": "(N, 1, H, W) bearing of each pixel in radians, positive to the right",
    "sector": "(N, 1, H, W) 1 where the sonar measured, 0 elsewhere",
    "denoised": "(N, 1, H, W) the picture denoised, 0 to 1",
    "weight": "(N) the part of its change that the picture was given, 0 to 1",
}


class Graph(nn.Module):
    """What `simnfnd denoise` computes for an image that fits one tile, without run-time branches.

    Inputs, in this order: `noisy` (N, 1, H, W) float32 in 0..1; the maps of range, bearing and
    sector, each (N, 1, H, W), where layout is not `none`.  Outputs: `denoised` (N, 1, H, W), 0..1;
    and, of networks that weigh their change, `weight` (N,) in 0..1, the factor on the network's
    change of each image.
    """

    tolerance: ClassVar[float] = 1e-4
    """Largest accepted difference from torch, in grey values of 0 to 1."""

    def __init__(self, network: Network, layout: Layout) -> None:
        """Raises FactoryError for a layout that the network has no use for."""
        super().__init__()
        if layout != "none" and not set(GEOMETRY) <= set(network.extras):
            raise FactoryError(
                f"--geometry {layout}: this network does not use the geometry; leave it out"
            )
        self.network = network
        self.layout = layout
        self.inputs: tuple[str, ...] = ("noisy", *(GEOMETRY if layout != "none" else ()))
        self.outputs: tuple[str, ...] = ("denoised", "weight")[: 1 + network.has_heads]
        sizes = {0: "count", 2: "height", 3: "width"}
        self.axes = {**dict.fromkeys((*self.inputs, "denoised"), sizes), "weight": {0: "count"}}
        if isinstance(network, SonarNet):
            network.fan = layout == "fan"
        # Without gradients and choices of training, as tracing keeps both.
        self.requires_grad_(False).eval()

    def forward(self, noisy: Tensor, *extras_in_order: Tensor) -> tuple[Tensor, ...]:
        """See the class."""
        extras = dict(zip(self.inputs[1:], extras_in_order, strict=True))
        if not self.network.has_heads:
            return (self.network(noisy, **extras).clamp(0, 1),)
        heads = self.network.with_heads(noisy, **extras)
        change = heads.weight[:, None, None, None] * (heads.image - noisy)
        return (noisy + change).clamp(0, 1), heads.weight

    def expected(self, inputs: Inputs) -> tuple[Tensor, ...]:
        """What the file must compute of inputs as of `example`."""
        outputs: tuple[Tensor, ...] = self(*inputs.values())
        return outputs

    def example(self, height: int, width: int, count: int = 1, seed: int = 0) -> Inputs:
        """Speckle in a sector of 60 degrees, and the other inputs for it."""
        maps = _maps("fan" if self.layout == "fan" else "polar", height, width)
        speckle = np.random.default_rng(seed).exponential(0.2, (count, 1, height, width))
        every = {name: np.repeat(values[None, None], count, 0) for name, values in maps.items()}
        every["noisy"] = (np.clip(speckle, 0, 1) * maps["sector"]).astype(np.float32)
        return {name: torch.from_numpy(every[name]) for name in self.inputs}


class RuntimeGraph(Graph):
    """What `sonarnet` computes of one image, given the inputs of `denoise.runtime.inputs_of`.

    `sonarnet` shares features among the cells (pixels at half resolution) of one beam and of one
    arc, cells of equal range.  The cells of each beam and arc are inputs, so one graph serves fans,
    polar images and images of unknown geometry.  What the first layer makes of the geometry is an
    input, too: the graph `geometry` computes it once for all images that share it.
    Outputs: `change` and `shadow_logits` (1, 1, H, W); `weight` (1,), the factor on the change; of
    the form `geometry`: `features` (cells, C); of `bearings`: `interference`, as of `BearingHead`.
    See `Form`.
    """

    tolerance: ClassVar[float] = 1e-5
    network: SonarNet

    def __init__(self, network: Network, form: Form = "whole") -> None:
        """Set the names and the open sizes of inputs and outputs.

        Raises FactoryError for a network that the runtime has no inputs for.
        """
        super().__init__(network, "none")
        if not isinstance(network, SonarNet):
            raise FactoryError(
                "--to runtime: is for model=sonarnet; use --to onnx for other networks"
            )
        self.form = form
        unused = {"frames"} if form == "single" else set()
        conditions = [
            name for name in ("frames", "remove") if name in network.extras and name not in unused
        ]
        lines = [f"{line}_{part}" for line in ("beam", "arc") for part in LineTable._fields]
        self.inputs = ("noisy", "outside", "features", *lines, *conditions)
        self.outputs = ("change", "shadow_logits", "weight")[: 2 if form == "window" else 3]
        if form == "geometry":
            self.inputs = ("maps",)
            self.outputs = ("features",)
        if form == "bearings":
            self.inputs = ("view", "width_rad")
            self.outputs = ("interference",)
        images = {"noisy", "outside", "maps", "frames", "change", "shadow_logits"}
        self.axes = {
            name: {2: "height", 3: "width"}
            for name in sorted(images & {*self.inputs, *self.outputs})
        }
        self.axes["features"] = {0: "cells"}
        for line in ("beam", "arc"):
            self.axes |= {
                f"{line}_number": {0: "cells"},
                f"{line}_chunks": {0: f"{line}_chunks"},
                f"{line}_lines": {0: f"{line}_chunks"},
                f"{line}_counts": {0: f"{line}s"},
            }
        every = {*self.inputs, *self.outputs}
        self.axes = {name: sizes for name, sizes in self.axes.items() if name in every}

    def forward(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        """Compute the outputs from the inputs in the order of `self.inputs`, as is fastest."""
        named = dict(zip(self.inputs, inputs, strict=True))
        if self.form == "bearings":
            return (cast(BearingHead, self.network.bearings)(named["view"], named["width_rad"]),)
        if self.form == "geometry":
            maps = padded(named["maps"], self.network.core_stride)
            return (geometry_features(self.network.intro, maps),)
        tables = LineTables(_table(named, "beam"), _table(named, "arc"))
        planes = named["noisy"], named["outside"]
        core = self.network.core(
            self._remove(named), named.get("frames"), tables, *planes, geometry=named["features"]
        )
        return tuple(core)[: len(self.outputs)]

    def expected(self, inputs: Inputs) -> tuple[Tensor, ...]:
        """What the layers of training compute."""
        if self.form == "bearings":
            return self.forward(inputs["view"], inputs["width_rad"])
        maps = inputs["maps"]
        if self.form == "geometry":
            return self.forward(maps)
        # The third map is 1 outside the sector and 0 in it, or -1 where no geometry is known.
        inside = padded(1 - maps[:, 2:], self.network.core_stride)
        # Every second pixel: the cells of the features at half resolution.
        is_cell_inside = inside[..., ::2, ::2] > 0
        shape = is_cell_inside.shape[-2], is_cell_inside.shape[-1]
        cell_weights = is_cell_inside.float().flatten(2)
        numbers = inputs["beam_number"][None], inputs["arc_number"][None]
        lines = MapLines(*numbers, cell_weights, shape)
        planes = inputs["noisy"], *torch.split(maps, 1, dim=1)
        frames = inputs.get("frames", torch.zeros_like(inputs["noisy"]))
        has_frames = "frames" in self.network.extras
        core = self.network.core(
            self._remove(inputs), frames if has_frames else None, lines, *planes
        )
        return (*core,)[: len(self.outputs)]

    def _remove(self, inputs: Mapping[str, Tensor]) -> Tensor:
        return inputs.get("remove", torch.from_numpy(vector(DEFAULT))[None])

    def example(self, height: int, width: int, count: int = 1, seed: int = 0) -> Inputs:
        """Speckle in one image, and the other inputs for it; `count` has no effect.

        The image is a fan, polar or of unknown geometry for seeds 0, 1, 2, and so on.
        """
        rng = np.random.default_rng(seed)
        if self.form == "bearings":
            view = rng.gamma(4, 0.05, (1, 2, RANGES, BEARINGS)).astype(np.float32)
            view[:, 1] = rng.random((RANGES, BEARINGS)) < 1 - 0.2 * seed
            width_rad = np.array([[0.3 + 0.5 * seed]], np.float32)
            return {"view": torch.from_numpy(view), "width_rad": torch.from_numpy(width_rad)}
        noisy = np.clip(rng.exponential(0.2, (height, width)), 0, 1).astype(np.float32)
        layouts: tuple[Layout, ...] = ("fan", "polar", "none")
        layout = layouts[seed % len(layouts)]
        maps = {} if layout == "none" else _maps(layout, height, width)
        noisy *= maps.get("sector", np.float32(1))
        if "frames" in self.inputs:
            maps["frames"] = rng.uniform(0, 3, (height, width)).astype(np.float32)

        def features_of(planes: np.ndarray) -> np.ndarray:
            with torch.no_grad():
                maps = padded(torch.from_numpy(planes), self.network.core_stride)
                return geometry_features(self.network.intro, maps).numpy()

        stride = self.network.core_stride
        geometry = GeometryInputs.of(noisy.shape, maps, stride, features_of)
        named = inputs_of(noisy, maps, geometry)
        if "frames" not in self.inputs:
            del named["frames"]
        return {name: torch.from_numpy(values) for name, values in named.items()}


def _table(inputs: Mapping[str, Tensor], line: str) -> LineTable:
    """The inputs of the beams (`beam`) or arcs (`arc`)."""
    return LineTable(*(inputs[f"{line}_{part}"] for part in LineTable._fields))


def write_onnx(weights: Path, out: Path, layout: Layout | None) -> float:
    """Write a network as a `.onnx` file for images of any height and width.

    layout: of the images, of which it denoises any number at a time.  None: the graph that
    `denoise.runtime` computes, without the weights; the same network and versions of torch and onnx
    give the same bytes.
    Returns the largest difference from torch.  Raises FactoryError for a network that cannot be
    exported, when onnxruntime and torch disagree, or when the file cannot be written; writes
    nothing then.
    """
    trained = load_weights(weights)
    if layout is None:
        return _write_runtime(trained, out)
    graph = Graph(trained.network, layout)
    about = {
        "model": json.dumps(dict(trained.model), sort_keys=True),
        "simnfnd": __version__,
        "weights_sha256": sha256_of(weights),
    }
    check_writable(out.parent, "--out")
    content = _content(graph, about, bare=False)
    difference = _difference_in_onnxruntime(graph, content, bare=False)
    write_atomically(out, content, key="--out")
    return difference


def _write_runtime(trained: Trained, out: Path) -> float:
    """Write the graph of `denoise.runtime`, which holds its other forms; see `write_onnx`."""
    network = trained.network
    others: tuple[Form, ...] = ("geometry",)
    if "frames" in network.extras:
        others = ("geometry", "single", "window")
    if "bearings" in network.extras:
        others = (*others, "bearings")
    about = {
        "model": json.dumps(structure(trained.model), sort_keys=True),
        "extras": ",".join(network.extras),
        "stride": str(RuntimeGraph(network).network.core_stride),
    }
    worst = 0.0
    content = b""
    for form in (*others, "whole"):
        graph = RuntimeGraph(network, form)
        content = _content(graph, about, bare=True)
        worst = max(worst, _difference_in_onnxruntime(graph, content, bare=True))
        about[f"form_{form}"] = packed(form, content)
    check_writable(out.parent, "--out")
    write_atomically(out, content, key="--out")
    remember(content)
    return worst


def _difference_in_onnxruntime(graph: Graph, content: bytes, bare: bool) -> float:
    """Largest difference of onnxruntime from torch; see `compared`.

    content: of the `.onnx` file.  bare: whether it lacks the weights.
    """
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    shared_arrays = []
    if bare:
        parameters = {name: values.numpy() for name, values in graph.state_dict().items()}
        shared_arrays = give_weights(options, used_weights(parameters, content))
    session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])

    def run(inputs: Mapping[str, Tensor]) -> list[np.ndarray]:
        # Without those that a network has no use for.
        arrays = {node.name: inputs[node.name].numpy() for node in session.get_inputs()}
        outputs: list[np.ndarray] = session.run(list(graph.outputs), arrays)
        return outputs

    difference = compared(graph, run)
    del shared_arrays  # whose memory the session uses until here
    return difference


def compared(graph: Graph, run: Run) -> float:
    """Largest difference of `run` from the graph in torch, over images of several sizes.

    Raises FactoryError when it is above the graph's tolerance.
    """
    worst = 0.0
    for seed, size in enumerate(_COMPARED_SIZES):
        inputs = graph.example(*size, seed=seed)
        expected = [values.numpy() for values in graph.expected(inputs)]
        for name, values, torch_values in zip(graph.outputs, run(inputs), expected, strict=True):
            if name == "shadow_logits":  # compared as the shadow that an image shows
                difference = np.abs(_sigmoid(values) - _sigmoid(torch_values)).max()
            else:
                difference = np.abs(values - torch_values).max()
            # Written so that NaN does not pass.
            if not difference <= worst:
                worst = float(difference)
    if not worst <= graph.tolerance:
        raise FactoryError(
            f"onnxruntime differs from torch by {worst:.1e}, more than {graph.tolerance:.0e}; "
            "nothing was written; please report this with the versions of both"
        )
    return worst


def _sigmoid(values: np.ndarray) -> np.ndarray:
    return np.asarray(1 / (1 + np.exp(-values)))


def _content(graph: Graph, about: Mapping[str, object], bare: bool) -> bytes:
    """Return the file, with descriptions of itself and its inputs.

    about: facts that the file states.  bare: whether to leave out the weights.
    """
    import onnx

    model = onnx.load_model_from_string(_export_trace(graph, fold=not bare))
    for value in (*model.graph.input, *model.graph.output):
        value.doc_string = _DESCRIPTIONS.get(value.name, "")
    number_values(model.graph)
    model.doc_string = "A denoiser for forward-looking sonar pictures, made by SimNFND."
    facts = {"geometry": graph.layout, "opset": OPSET, **about}
    onnx.helper.set_model_props(model, {key: str(value) for key, value in sorted(facts.items())})
    onnx.checker.check_model(model, full_check=True)
    if bare:
        remove_weights(model.graph, graph.state_dict().keys())
    written: bytes = model.SerializeToString(deterministic=True)
    return written


def _export_trace(graph: Graph, fold: bool) -> bytes:
    """Trace the graph on an example and export it.  fold: whether constants are folded."""
    content = io.BytesIO()
    if isinstance(graph.network, SonarNet):
        # What onnxruntime computes is compared with the layers of training.
        graph.network.folds = True
    example = graph.example(*_TRACED_SIZE)
    inputs = tuple(example[name] for name in graph.inputs)
    with warnings.catch_warnings(), torch.no_grad():
        # It warns of every branch that it fixes; `compared` shows whether one was wrong.
        warnings.simplefilter("ignore")
        traced: Any = torch.jit.trace(  # type: ignore[no-untyped-call]
            graph, inputs, check_trace=False, _store_inputs=False
        )
        torch.onnx.export(
            traced,
            inputs,
            content,  # type: ignore[arg-type]
            dynamo=False,
            opset_version=OPSET,
            do_constant_folding=fold,
            input_names=list(graph.inputs),
            output_names=list(graph.outputs),
            dynamic_axes=graph.axes,
        )
    if isinstance(graph.network, SonarNet):
        graph.network.folds = False
    return content.getvalue()


def number_values(onnx_graph: Any) -> None:
    """Number the values inside the graph in order.

    Their names depend on what this process has traced before.
    """
    outer_tensors = (*onnx_graph.input, *onnx_graph.output, *onnx_graph.initializer)
    new_names = {name: name for name in ("", *{tensor.name for tensor in outer_tensors})}
    for node in onnx_graph.node:
        node.name = ""
        node.doc_string = ""
        for names in (node.input, node.output):
            names[:] = [new_names.setdefault(name, f"v{len(new_names)}") for name in names]
    del onnx_graph.value_info[:]


def remove_weights(onnx_graph: Any, names: Collection[str]) -> None:
    """Declare the weights external; whoever opens the file supplies them by their names."""
    import onnx

    for tensor in onnx_graph.initializer:
        if tensor.name in names:
            tensor.ClearField("raw_data")
            tensor.data_location = onnx.TensorProto.EXTERNAL
            tensor.external_data.add(key="location", value="weights")


def _maps(layout: Layout, height: int, width: int) -> dict[str, np.ndarray]:
    """Range, bearing and sector of a fan of 60 degrees, or of a polar image; (H, W) each."""
    geometry = FanGeometry.polar()
    if layout == "fan":
        geometry = FanGeometry.fan(
            np.pi / 3,
            apex_x_px=width / 2 - 0.5,
            apex_y_px=height - 0.5,
            near_px=0.1 * height,
            far_px=height,
            x_scale=width / height,
        )
    return dict(geometry.with_size(height, width).maps(0, 0, height, width))
