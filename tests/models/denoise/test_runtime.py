"""What computes a network: onnxruntime gets what torch gets, and `denoise` needs no torch."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from safetensors.numpy import save_file

from simnfnd.evaluation.commands import _runtime_of
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.models.denoise.denoiser import Denoiser
from simnfnd.models.denoise.runtime import (
    OnnxNetwork,
    TorchNetwork,
    check_network,
    find_graph,
    open_runtime,
)
from simnfnd.models.exporting.export import main as export
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import KEY, Arrays, read_weights, save_weights
from simnfnd.models.pretrained import find_weights, shipped
from simnfnd.models.pretrained.graphs import RunnableGraph
from tests.models.recordings.fan_images import fan, preset

Change = Callable[[Arrays], Arrays]
MODELS = {
    "plane": {
        "kind": "sonarnet", "widths": [4, 8], "blocks": [1, 1], "polar": False, "lines": True,
        "mask": True, "forget": 0.1, "frames": True, "wide_grain": 0.6,
    },
    "bearings": {
        "kind": "sonarnet", "widths": [4, 4, 8], "blocks": [0, 0, 1], "polar": False, "lines": True,
        "mask": True, "forget": 0.1, "told": False, "bearings": True,
    },
    "grid": {
        "kind": "sonarnet", "widths": [4, 8], "blocks": [1, 1], "polar": True, "lines": True,
        "mask": True, "forget": 0.1, "told": False,
    },
}  # fmt: skip


@pytest.fixture(scope="module", params=list(MODELS))
def both(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, Path]:
    """Weights of a small network that changes images, and its graph."""
    return exported(MODELS[request.param], tmp_path_factory.mktemp("runtime"))


def exported(model: dict[str, Any], folder: Path) -> tuple[Path, Path]:
    folder.mkdir(exist_ok=True)
    torch.manual_seed(1)
    network = build_network(model)
    for name, parameter in network.named_parameters():
        alpha = 0.01 if name.startswith("bearings.") else 0.1
        parameter.data.add_(torch.randn_like(parameter), alpha=alpha)
    weights = folder / "own.safetensors"
    graph = folder / "own.onnx"
    save_weights(weights, network, model, {}, half=True)
    assert export([str(weights), "--to", "runtime", "--out", str(graph)]) == 0
    return weights, graph


def in_onnx(both: tuple[Path, Path]) -> Denoiser:
    """A denoiser in onnxruntime, which finds the graph beside the weights."""
    denoise = Denoiser(both[0], "cpu")
    assert isinstance(denoise.runtime, OnnxNetwork)
    return denoise


def in_torch(both: tuple[Path, Path]) -> Denoiser:
    denoise = Denoiser(both[0], "cpu")
    denoise.runtime = TorchNetwork(both[0], "cpu")
    return denoise


@pytest.mark.slow
def test_a_graph_of_another_network_is_no_graph_of_these_weights(tmp_path: Path) -> None:
    weights, _ = exported(MODELS["grid"], tmp_path / "grid")
    _, other_weights = exported(MODELS["plane"], tmp_path / "plane")
    weights.with_suffix(".onnx").write_bytes(other_weights.read_bytes())
    assert find_graph(weights) is None
    assert _runtime_of(str(weights)) == "torch"
    exported(MODELS["grid"], tmp_path / "grid")
    assert _runtime_of(str(weights)) == "onnxruntime"


def within(denoise: Denoiser) -> float:
    """Positions on a polar grid, in 32 bits, are summed up in another order."""
    runtime = denoise.runtime
    return 5e-5 if isinstance(runtime, OnnxNetwork) and runtime.is_polar else 1e-5


@pytest.mark.parametrize("frames", [None, 3.0, "map"])
@pytest.mark.parametrize("kind", ["fan", "polar", "unknown"])
def test_onnxruntime_gets_what_torch_gets(
    both: tuple[Path, Path], kind: str, frames: float | str | None
) -> None:
    drawn, geometry = fan(preset("aris_explorer_3000", 90, 127), 0.3, holes=False)
    image = drawn.astype(np.float32) / 255
    polar = FanGeometry.polar().with_size(*image.shape)
    known = {"fan": geometry, "polar": polar, "unknown": None}[kind]
    message: float | np.ndarray | None = None if isinstance(frames, str) else frames
    if frames == "map":
        message = np.random.default_rng(0).uniform(1, 7, image.shape).astype(np.float32)
    of_torch = in_torch(both)
    of_onnx = in_onnx(both)
    wished = of_torch(image, known, frames=message)
    assert np.abs(wished - image).max() > 0.01
    np.testing.assert_allclose(of_onnx(image, known, frames=message), wished, atol=within(of_onnx))
    if frames is not None and of_onnx.knows_frames:
        assert np.abs(of_torch(image, known) - wished).max() > 1e-4


def test_a_graph_of_another_version_costs_a_line() -> None:
    weights = find_weights("simnfnd")
    content = weights.with_suffix(".onnx").read_bytes()
    other = content.replace(b"(simnfnd graph geometry", b"(another graph geometry")
    assert other != content
    with pytest.raises(FactoryError, match=r"simnfnd\.onnx: .*export-weights --to runtime"):
        OnnxNetwork(weights, RunnableGraph(weights.with_suffix(".onnx"), other), "cpu")


@pytest.mark.parametrize("name", sorted(shipped()))
def test_weights_that_ship_run_in_onnxruntime_as_in_torch(name: str, tmp_path: Path) -> None:
    """And the graph that ships is the one that the command makes."""
    denoise = Denoiser(name, "cpu")
    of_torch = Denoiser(name, "cpu")
    assert isinstance(denoise.runtime, OnnxNetwork)
    again = tmp_path / "again.onnx"
    assert export([name, "--to", "runtime", "--out", str(again)]) == 0
    assert again.read_bytes() == find_weights(name).with_suffix(".onnx").read_bytes()
    drawn, geometry = fan(preset("aris_explorer_3000", 150, 211), 0.3, holes=False)
    image = drawn.astype(np.float32) / 255
    of_torch.runtime = TorchNetwork(find_weights(name), "cpu")
    wished = of_torch(image, geometry)
    np.testing.assert_allclose(denoise(image, geometry), wished, atol=within(denoise))


def widest(arrays: Arrays) -> str:
    return max(arrays, key=lambda name: arrays[name].size)


def with_tensor(change: Callable[[np.ndarray], np.ndarray]) -> Change:
    """Another tensor in place of the largest."""
    return lambda arrays: {**arrays, widest(arrays): change(arrays[widest(arrays)])}


UNFIT: dict[str, Change] = {
    "missing": lambda arrays: {k: v for k, v in arrays.items() if k != widest(arrays)},
    "extra": lambda arrays: {**arrays, "more.weight": np.zeros(3, np.float32)},
    "none": lambda arrays: {},
    "flat": with_tensor(np.ravel),
    "transposed": with_tensor(lambda tensor: np.ascontiguousarray(tensor.swapaxes(0, 1)[:, :1])),
    "empty": with_tensor(lambda tensor: tensor[:0]),
    "integers": with_tensor(lambda tensor: tensor.astype(np.int32)),
    "truths": with_tensor(lambda tensor: tensor > 0),
    "infinite": with_tensor(lambda tensor: tensor * np.float32(np.inf)),
    "too many": lambda arrays: {**arrays, **{f"x{n}": np.zeros(1) for n in range(20_000)}},
    "huge": lambda arrays: {name: tensor * np.float32(1e15) for name, tensor in arrays.items()},
    "black": lambda arrays: {**arrays, "outro.bias": arrays["outro.bias"] - np.float32(1e6)},
}


def open_in_torch(path: Path, device: str) -> None:
    check_network(path, TorchNetwork(path, device))


@pytest.mark.parametrize("runtime", ["onnx", "torch"])
@pytest.mark.parametrize("name", UNFIT)
def test_weights_that_do_not_fit_cost_a_line(name: str, runtime: str, tmp_path: Path) -> None:
    header, arrays = read_weights(find_weights("simnfnd"))
    path = write_arrays(tmp_path / "own.safetensors", header, UNFIT[name](arrays))
    opened = open_runtime if runtime == "onnx" else open_in_torch
    with pytest.raises(FactoryError, match=r"weights=.*own\.safetensors") as caught:
        opened(path, "cpu")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


@pytest.mark.parametrize("value", ["x", None, [1], math.nan, -3])
@pytest.mark.parametrize("key", ["wide_grain", "polar", "widths", "kind"])
def test_metadata_of_a_wrong_type_cost_a_line(key: str, value: object, tmp_path: Path) -> None:
    header, arrays = read_weights(find_weights("simnfnd"))
    changed = {**header, "model": {**header["model"], key: value}}
    path = write_arrays(tmp_path / "own.safetensors", changed, arrays)
    with pytest.raises(FactoryError, match=r"weights=.*own\.safetensors: "):
        open_runtime(path, "cpu")


def test_weights_that_always_forgot_the_geometry_get_none(tmp_path: Path) -> None:
    header, arrays = read_weights(find_weights("simnfnd"))
    changed = {**header, "model": {**header["model"], "forget": 1.0}}
    path = write_arrays(tmp_path / "own.safetensors", changed, arrays)
    assert open_runtime(path, "cpu").extras == ("frames",)
    assert TorchNetwork(path, "cpu").extras == ("frames",)


def write_arrays(path: Path, header: Any, arrays: Arrays) -> Path:
    contiguous = {name: np.ascontiguousarray(tensor) for name, tensor in arrays.items()}
    save_file(contiguous, path, {KEY: json.dumps(header)})
    return path


@pytest.mark.slow
def test_an_image_is_denoised_without_torch(tmp_path: Path) -> None:
    drawn, _ = fan(preset("aris_explorer_3000", 150, 211), 0.3, holes=False)
    cv2.imwrite(str(tmp_path / "image.png"), drawn)
    script = (
        "import sys; from simnfnd.command import main; code = main(sys.argv[1:]); "
        "print(*(name for name in ('torch', 'onnx') if name in sys.modules)); "
        "sys.exit(code)"
    )
    words = ["denoise", str(tmp_path / "image.png"), "--out", str(tmp_path / "out")]
    done = subprocess.run(
        [sys.executable, "-c", script, *words], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == ""
    assert (tmp_path / "out" / "image.png").is_file()
