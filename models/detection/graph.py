"""Writes the ONNX graph that `runtime` runs: python -m simnfnd.models.detection.graph."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import onnx
import torch
from torch import Tensor, nn

from ...factory.common.files import write_atomically
from ..exporting.onnx_graph import OPSET, number_values, remove_weights
from .detector import DIVISOR
from .network import DetectorNetwork, Outputs
from .runtime import GRAPH, HEAD_INPUTS, RawOutputs


class _Graph(nn.Module):
    """The network with the weights of its last layer as inputs."""

    def __init__(self) -> None:
        super().__init__()
        self.network = DetectorNetwork(1).eval().requires_grad_(False)

    def forward(self, image: Tensor, head_weight: Tensor, head_bias: Tensor) -> Outputs:
        features = self.network.features(image)
        return self.network.split(nn.functional.conv2d(features, head_weight, head_bias))


def write_graph(path: Path = GRAPH) -> None:
    """Write the graph; the same versions of torch and onnx give the same bytes."""
    graph = _Graph()
    inputs = ("image", *HEAD_INPUTS)
    sizes = {0: "count", 2: "height", 3: "width"}
    axes = dict.fromkeys(("image", *RawOutputs._fields), sizes)
    axes |= {name: {0: "outputs"} for name in HEAD_INPUTS}
    content = io.BytesIO()
    heads = graph.network.heads
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")  # of the tracer, which is what serves here
        torch.onnx.export(
            graph,
            (torch.zeros(2, 3, 3 * DIVISOR, 5 * DIVISOR), heads.weight, heads.bias),
            content,  # type: ignore[arg-type]
            dynamo=False,
            opset_version=OPSET,
            # Otherwise norms become part of convolutions, whose weights no file has.
            training=torch.onnx.TrainingMode.PRESERVE,
            do_constant_folding=False,
            input_names=list(inputs),
            output_names=list(RawOutputs._fields),
            dynamic_axes=axes,
        )
    model = onnx.load_model_from_string(content.getvalue())
    number_values(model.graph)
    remove_weights(model.graph, graph.state_dict().keys())
    model.doc_string = "A detector for forward-looking sonar images, made by SimNFND."
    write_atomically(path, model.SerializeToString(deterministic=True), key="graph")


if __name__ == "__main__":
    write_graph()
