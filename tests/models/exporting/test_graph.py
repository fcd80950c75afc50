"""`simnfnd export-weights --to onnx`: any size, as torch, and as `denoise`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import onnx
import onnxruntime
import pytest
import torch

from simnfnd import open_recording
from simnfnd.command import main as command
from simnfnd.factory.common.errors import FactoryError
from simnfnd.models.denoise import denoiser
from simnfnd.models.exporting.export import main
from simnfnd.models.exporting.onnx_graph import OPSET, Graph, Layout, compared
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import load_weights, save_weights
from simnfnd.models.recordings.fan_tables import write_fans
from tests.models.networks.tiny_networks import TINY
from tests.models.recordings.fan_images import fan, preset
from tests.project.run_example import run


def weights(folder: Path, kind: str) -> Path:
    """A small network of this kind that changes images."""
    model = {"kind": kind, **TINY[kind]}
    torch.manual_seed(1)
    network = build_network(model)
    for parameter in network.parameters():
        parameter.data.add_(torch.randn_like(parameter), alpha=0.1)
    path = folder / f"{kind}.safetensors"
    save_weights(path, network, model, {})
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "layout"),
    [
        *((kind, "none") for kind in TINY if kind != "sonarnet"),
        ("sonarnet", "fan"),
        ("sonarnet", "polar"),
    ],
)
def test_onnxruntime_gets_what_torch_gets_at_any_size(
    kind: str, layout: Layout, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weights_file = weights(tmp_path, kind)
    out = tmp_path / "network.onnx"
    assert main([str(weights_file), "--to", "onnx", "--geometry", layout, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    assert f"ONNX, opset {OPSET}" in said
    graph = Graph(load_weights(weights_file).network, layout)
    session = onnxruntime.InferenceSession(out.read_bytes())
    assert tuple(value.name for value in session.get_inputs()) == graph.inputs
    assert tuple(value.name for value in session.get_outputs()) == graph.outputs
    inputs = {k: v.numpy() for k, v in graph.example(57, 83, 2, seed=9).items()}
    actual = session.run(None, inputs)
    assert actual[0].shape == inputs["noisy"].shape
    assert np.abs(actual[0] - inputs["noisy"]).max() > 0.01
    wished = graph(*map(torch.from_numpy, inputs.values()))
    for values, expected in zip(actual, wished, strict=True):
        np.testing.assert_allclose(values, expected.numpy(), atol=1e-4, rtol=0)


def test_the_file_says_what_it_is(tmp_path: Path) -> None:
    weights_file = weights(tmp_path, "sonarnet")
    out = tmp_path / "network.onnx"
    words = [str(weights_file), "--to", "onnx", "--geometry", "fan", "--out", str(out)]
    assert main(words) == 0
    model = onnx.load(out)
    facts = {entry.key: entry.value for entry in model.metadata_props}
    assert (facts["opset"], facts["geometry"]) == (str(OPSET), "fan")
    assert json.loads(facts["model"])["kind"] == "sonarnet"
    assert [entry.version for entry in model.opset_import] == [OPSET]
    assert all(value.doc_string for value in (*model.graph.input, *model.graph.output))
    sizes = [entry.dim_param for entry in model.graph.input[0].type.tensor_type.shape.dim]
    assert sizes == ["count", "", "height", "width"]
    assert str(Path(__file__).parents[3]).encode() not in out.read_bytes()


@pytest.mark.parametrize("wrong", [1e-3, np.nan])
def test_a_file_that_differs_from_torch_is_refused(tmp_path: Path, wrong: float) -> None:
    graph = Graph(load_weights(weights(tmp_path, "nafnet")).network, "none")

    def different(inputs: Any) -> list[np.ndarray]:
        actual = [values.numpy().copy() for values in graph(*inputs.values())]
        actual[0][0, 0, 5, 5] += wrong
        return actual

    with pytest.raises(FactoryError, match="differs from torch"):
        compared(graph, different)


@pytest.mark.slow
def test_the_example_denoises_as_the_command_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The shipped weights, on a fan found in its image; images may round differently.

    But for the fine detail that the command keeps, which is no part of the network.
    """
    monkeypatch.setattr(denoiser, "corrected_by_detail", lambda _, denoised: denoised)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    cv2.imwrite("image.png", fan(preset("aris_1800_lf", 128, 160), 0.3, holes=False)[0])
    words = ("export-weights", "simnfnd", "--to", "onnx", "--geometry", "fan", "--out", "fan.onnx")
    assert command(words) == 0
    geometry = open_recording("image.png")[0].geometry
    assert geometry is not None
    write_fans("fans.csv", {"image.png": geometry})
    assert command(("denoise", "image.png", "--geometry", "fans.csv", "--out", "out")) == 0
    done = run("onnx_denoise.py", "fan.onnx", "image.png", "a.png", "fans.csv", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    theirs, ours = (cv2.imread(str(path), 0).astype(int) for path in ("a.png", "out/image.png"))
    difference = np.abs(theirs - ours)
    assert difference.max() <= 1
    assert (difference > 0).mean() < 0.01
    assert (np.abs(ours - cv2.imread("image.png", 0).astype(int)) > 5).any()
