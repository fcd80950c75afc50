"""Runs a detector's network in onnxruntime, without torch.

The graph ships and holds no weights: it computes any detector of this program, for the weights of
its last layer, whose number depends on the classes, are inputs.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Float32s
from ...factory.common.errors import FactoryError
from ...factory.common.workers.machine import usable_cores
from .weights import read_detector

GRAPH = Path(__file__).parent / "simnfnd-detector.onnx"
HEAD_INPUTS = ("heads.weight", "heads.bias")
"""Inputs of the graph beside `image`, by their names in the weights."""


class RawOutputs(NamedTuple):
    """Outputs of the network for N images of h x w cells, float32.

    centre: (N, 1, h, w) logits.  sides: (N, 4, h, w) cells to left, top, right and bottom.
    classes: (N, K, h, w) logits.
    """

    centre: Float32s
    sides: Float32s
    classes: Float32s


class DetectorRuntime:
    """A detector that is ready to run.

    facts: its classes, and what its file says of its boxes and scores.
    """

    def __init__(self, path: Path) -> None:
        """Raises FactoryError for a file that holds no detector."""
        import onnxruntime

        self.facts, tensors = read_detector(path)
        self._head = {name: tensors.pop(name) for name in HEAD_INPUTS}
        options = onnxruntime.SessionOptions()
        options.log_severity_level = 4  # errors arrive as exceptions
        options.intra_op_num_threads = usable_cores()
        # Waiting threads would use as much time as computing ones.
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        names = [f"network.{name}" for name in tensors]
        # onnxruntime uses the memory of these arrays.
        self._weights = [onnxruntime.OrtValue.ortvalue_from_numpy(v) for v in tensors.values()]
        options.add_external_initializers(names, self._weights)
        try:
            self._session = onnxruntime.InferenceSession(
                GRAPH.read_bytes(), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:
            # onnxruntime has an exception type of its own for each of its states.
            raise FactoryError(
                f"detector={path}: its weights do not fit this version; train it again"
            ) from error

    def __call__(self, inputs: Float32s) -> RawOutputs:
        """Compute images as `images.network_input` makes them, (N, 3, H, W)."""
        outputs = self._session.run(list(RawOutputs._fields), {"image": inputs, **self._head})
        return RawOutputs(*(np.asarray(output, np.float32) for output in outputs))
