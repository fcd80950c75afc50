"""Networks as ONNX files for other programs, compared with torch before they are written.

They come of a trace.  torch's exporter by symbolic shapes (`dynamo=True`) gives the same ONNX
graph of `sonarnet` after minutes where the trace takes seconds.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Callable, Collection, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ...factory import __version__
from ...factory.errors import FactoryError
from ...factory.files import check_writable, write_atomically
from ..denoise.runtime import give_weights
from .graph import Graph, described, wanted

OPSET = 18
"""ONNX operators: GridSample and sums by ScatterElements came with 16, LayerNormalization with 17.

Newer runtimes read older opsets.
"""
# Pictures of the trace and of the comparison: (height, width, how many).  The first divides by
# nothing, so that padding is part of the trace.
_TRACED = (75, 91, 2)
_COMPARED = ((64, 64, 1), (50, 83, 2), (128, 70, 1))

Run = Callable[[Mapping[str, Tensor]], list[np.ndarray]]


def write_onnx(
    graph: Graph, path: Path, about: Mapping[str, object], *, bare: bool = False
) -> float:
    """Write a `.onnx` file of any height, width and number of pictures; how far it is from torch.

    about: what the file says of itself.  bare: without the network's weights.
    Raises FactoryError when onnxruntime does not get what
    torch does, or the file cannot be written.
    """
    import onnxruntime

    check_writable(path.parent, "--out")
    content = _with_words(graph, _exported(graph, folded=not bare), about, bare)
    options = onnxruntime.SessionOptions()
    options.log_severity_level = 3
    if bare:
        weights = {name: values.numpy() for name, values in graph.state_dict().items()}
        kept = give_weights(options, weights)  # noqa: F841  (the session shares their memory)
    session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])

    def run(inputs: Mapping[str, Tensor]) -> list[np.ndarray]:
        found: list[np.ndarray] = session.run(
            list(graph.outputs), {name: values.numpy() for name, values in inputs.items()}
        )
        return found

    difference = compared(graph, run, "onnxruntime")
    write_atomically(path, content, key="--out")
    return difference


def compared(graph: Graph, run: Run, who: str) -> float:
    """Largest difference of `run` from the graph in torch, over pictures of several sizes.

    Raises FactoryError when it is above the graph's tolerance.
    """
    worst = 0.0
    for seed, size in enumerate(_COMPARED):
        inputs = graph.example(*size, seed=seed)
        if seed and "remove" in inputs:
            inputs["remove"] = torch.from_numpy(wanted(("haze", "gains")))
        expected = [values.numpy() for values in graph(*inputs.values())]
        for name, values, wished in zip(graph.outputs, run(inputs), expected, strict=True):
            # NaN must not pass.
            distance = float(np.abs(graph.shown(name, values) - graph.shown(name, wished)).max())
            worst = distance if not distance <= worst else worst
    if not worst <= graph.tolerance:
        raise FactoryError(
            f"{who} differs from torch by {worst:.1e}, more than {graph.tolerance:.0e}; "
            "nothing was written; please report this with the versions of both"
        )
    return worst


def _traced(graph: Graph) -> torch.jit.ScriptModule:
    inputs = tuple(graph.example(*_TRACED).values())
    with warnings.catch_warnings(), torch.no_grad():
        # It warns of every choice that it keeps; `compared` sees whether one was wrong.
        warnings.simplefilter("ignore")
        traced: torch.jit.ScriptModule = torch.jit.trace(  # type: ignore[no-untyped-call]
            graph, inputs, check_trace=False, _store_inputs=False
        )
        return traced


def _exported(graph: Graph, folded: bool = True) -> bytes:
    """folded: with what follows from weights alone computed."""
    content = io.BytesIO()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            _traced(graph),
            tuple(graph.example(*_TRACED).values()),
            content,  # type: ignore[arg-type]
            dynamo=False,
            opset_version=OPSET,
            do_constant_folding=folded,
            input_names=list(graph.inputs),
            output_names=list(graph.outputs),
            dynamic_axes=graph.axes,
        )
    return content.getvalue()


def _with_words(
    graph: Graph, content: bytes, about: Mapping[str, object], bare: bool = False
) -> bytes:
    """The same file with its inputs and itself explained; bare: without weights."""
    import onnx

    model = onnx.load_model_from_string(content)
    lines = described(graph)
    for value in (*model.graph.input, *model.graph.output):
        value.doc_string = lines[value.name]
    for node in model.graph.node:
        node.doc_string = ""
    model.doc_string = (
        f"A denoiser for forward-looking sonar pictures, made by SimNFND {__version__}."
    )
    onnx.helper.set_model_props(
        model, {key: str(value) for key, value in sorted(_facts(graph, about).items())}
    )
    onnx.checker.check_model(model, full_check=True)
    if bare:
        _without_weights(model, graph.state_dict().keys())
    written: bytes = model.SerializeToString(deterministic=True)
    return written


def _without_weights(model: Any, names: Collection[str]) -> None:
    """Leave these weights out of the file: whoever opens it gives them by their names."""
    import onnx

    for one in model.graph.initializer:
        if one.name in names:
            one.ClearField("raw_data")
            one.data_location = onnx.TensorProto.EXTERNAL
            one.external_data.add(key="location", value="weights")


def _facts(graph: Graph, about: Mapping[str, object]) -> dict[str, object]:
    return {"simnfnd": __version__, "geometry": graph.layout, "opset": OPSET, **about}
