"""What computes a network: onnxruntime gets what torch gets, and `denoise` needs no torch."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.models.denoise.denoiser import Denoiser
from simnfnd.models.denoise.runtime import open_runtime
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import save_weights
from simnfnd.models.pretrained import find_runnable, find_weights, shipped
from simnfnd.models.pretrained.export import main as export
from tests.models.recordings.fan_pictures import fan, preset

MODEL = {
    "kind": "sonarnet", "widths": [4, 8], "blocks": [1, 1], "polar": False, "lines": True,
    "mask": True, "forget": 0.1, "frames": True, "wide_grain": 0.6,
}  # fmt: skip


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Weights of a small network that changes pictures, and its ONNX file."""
    folder = tmp_path_factory.mktemp("runtime")
    torch.manual_seed(1)
    network = build_network(MODEL)
    for parameter in network.parameters():
        parameter.data.add_(torch.randn_like(parameter), alpha=0.1)
    weights, onnx = folder / "own.safetensors", folder / "own.onnx"
    save_weights(weights, network, MODEL, {}, half=True)
    assert export([str(weights), "--to", "runtime", "--out", str(onnx)]) == 0
    return weights, onnx


@pytest.mark.parametrize("frames", [None, 3.0, "map"])
@pytest.mark.parametrize("where", ["fan", "polar", "unknown"])
def test_onnxruntime_gets_what_torch_gets(
    both: tuple[Path, Path], where: str, frames: float | str | None
) -> None:
    drawn, geometry = fan(preset("aris_explorer_3000", 150, 211), 0.3, holes=False)
    picture = drawn.astype(np.float32) / 255
    polar = FanGeometry.polar().with_size(*picture.shape)
    known = {"fan": geometry, "polar": polar, "unknown": None}[where]
    told: float | np.ndarray | None = None if isinstance(frames, str) else frames
    if frames == "map":
        told = np.random.default_rng(0).uniform(1, 7, picture.shape).astype(np.float32)
    of_torch, of_onnx = (Denoiser(path, "cpu", 256, 32) for path in both)
    wished = of_torch(picture, known, frames=told)
    assert of_onnx.knows_frames
    assert np.abs(wished - picture).max() > 0.01
    np.testing.assert_allclose(of_onnx(picture, known, frames=told), wished, atol=1e-5)
    if frames is not None:
        assert np.abs(of_torch(picture, known) - wished).max() > 1e-4


def test_one_frame_is_what_nothing_told_is(both: tuple[Path, Path]) -> None:
    gray = np.random.default_rng(0).random((40, 56)).astype(np.float32)
    denoise = Denoiser(both[1], "cpu", 256, 32)
    assert np.array_equal(denoise(gray), denoise(gray, frames=1.0))


def test_the_command_that_made_a_shipped_file_makes_it_again(tmp_path: Path) -> None:
    runnable = {name: find_runnable(name) for name in shipped()}
    for name, path in runnable.items():
        if path.suffix != ".onnx":
            continue
        again = tmp_path / f"{name}.onnx"
        assert export([name, "--to", "runtime", "--out", str(again)]) == 0
        gray = np.random.default_rng(1).random((70, 90)).astype(np.float32)
        wished, made = (Denoiser(one, "cpu", 256, 32)(gray) for one in (find_weights(name), path))
        np.testing.assert_allclose(made, wished, atol=1e-5)
        np.testing.assert_allclose(Denoiser(again, "cpu", 256, 32)(gray), wished, atol=1e-5)


def test_a_picture_is_denoised_without_torch(both: tuple[Path, Path], tmp_path: Path) -> None:
    drawn, _ = fan(preset("aris_explorer_3000", 150, 211), 0.3, holes=False)
    cv2.imwrite(str(tmp_path / "picture.png"), drawn)
    script = (
        "import sys; from simnfnd.command import main; code = main(sys.argv[1:]); "
        "print(*(name for name in ('torch', 'lightning', 'onnx') if name in sys.modules)); "
        "sys.exit(code)"
    )
    words = ["denoise", str(tmp_path / "picture.png"), "--out", str(tmp_path / "out")]
    done = subprocess.run(
        [sys.executable, "-c", script, *words, "--weights", str(both[1])],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1] == ""
    assert (tmp_path / "out" / "picture.png").is_file()


def test_what_it_cannot_run_is_refused_in_a_line(both: tuple[Path, Path], tmp_path: Path) -> None:
    damaged = tmp_path / "damaged.onnx"
    damaged.write_bytes(both[1].read_bytes()[:-500])
    with pytest.raises(FactoryError, match="not an ONNX file of"):
        open_runtime(damaged, "cpu")
    with pytest.raises(FactoryError, match="compute in 32 bits"):
        open_runtime(both[1], "cpu", "bf16-mixed")
    with pytest.raises(FactoryError, match="no usable GPU"):
        open_runtime(both[1], "gpu")


def test_a_network_without_such_inputs_is_refused(tmp_path: Path) -> None:
    model = {"kind": "unet", "widths": [4, 8], "blocks": 1, "channels": 1}
    weights = tmp_path / "unet.safetensors"
    save_weights(weights, build_network(model), model, {})
    with pytest.raises(FactoryError, match="--to runtime: is for model=sonarnet"):
        export([str(weights), "--to", "runtime", "--out", str(tmp_path / "unet.onnx")])
