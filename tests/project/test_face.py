"""What `from simnfnd import ...` gives, docs/python.md, and how little reading needs."""

from __future__ import annotations

import doctest
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

import simnfnd
from simnfnd.command import main
from tests.models.recordings.recording_files import pings, write_aris
from tests.project_files import ROOT
from tests.small_dataset import write_dataset

# Run by Python before anything else, in this process and in those it starts.
ONLY_NUMPY_AND_H5PY = """
import sys

class Refuse:
    def find_spec(self, name, path=None, target=None):
        top = name.split(".")[0]
        if top in {"numpy", "h5py", "simnfnd"} | sys.stdlib_module_names or top.startswith("_"):
            return None
        raise ModuleNotFoundError(f"{name} is not installed", name=name)

sys.meta_path.insert(0, Refuse())
"""
READ = """
import sys
from simnfnd import FactoryError, PairDataset

with PairDataset(sys.argv[1], "train", layers=("noisy", "clean", "shadow"), scaled=True) as pairs:
    print(len(pairs), pairs[0]["noisy"].shape, pairs[1:3]["clean"].dtype, len(pairs.meta()))
    print(sorted({name.split(".")[0] for name in sys.modules} & {"pydantic", "cv2", "hydra"}))
try:
    PairDataset("nowhere")
except FactoryError as error:
    print(error)
"""


def test_reading_needs_numpy_and_h5py_alone(tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=4, test=2, size=32)
    (tmp_path / "sitecustomize.py").write_text(ONLY_NUMPY_AND_H5PY)
    path = os.pathsep.join([str(tmp_path), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", READ, str(dataset)],
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    first, loaded, error = done.stdout.splitlines()
    assert first == "4 (32, 32) float32 4"
    assert loaded == "[]"
    assert error.startswith("dataset=nowhere: no such folder")


def test_every_name_is_there_and_documented() -> None:
    assert dir(simnfnd) == sorted(simnfnd.__all__)
    for name in simnfnd.__all__:
        assert getattr(simnfnd, name).__doc__
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        simnfnd.nothing  # noqa: B018


# --- make_pair ----------------------------------------------------------------------------------


def frame() -> tuple[np.ndarray, np.ndarray]:
    """Sloping ground with a few pixels that were not measured."""
    v = np.arange(96)[:, None] / 96
    depth_m = np.broadcast_to(1.5 / (0.15 + 0.5 * v), (96, 152)).astype(np.float32).copy()
    depth_m[:4, :4] = np.nan
    rgb = np.random.default_rng(0).integers(60, 200, (96, 152, 3), dtype=np.uint8)
    return rgb, depth_m


PLACE: dict[str, Any] = {"fx": 120.0, "fy": 120.0, "cx": 76.0, "cy": 48.0}


def test_a_pair_of_a_frame_in_memory() -> None:
    rgb, depth_m = frame()
    pair = simnfnd.make_pair(rgb, depth_m, **PLACE)
    assert isinstance(pair, simnfnd.Pair)
    assert pair.noisy.shape == pair.clean.shape == pair.shadow.shape == (256, 256)
    assert pair.noisy.dtype == pair.clean.dtype == np.uint8
    assert pair.clean.max() > 100
    assert (pair.noisy != pair.clean).any()
    assert float(pair.record["noise.background.density"]) > 0
    again = simnfnd.make_pair(rgb, depth_m, **PLACE)
    np.testing.assert_array_equal(again.noisy, pair.noisy)
    others: list[dict[str, Any]] = [{"variant": 1}, {"seed": 7}, {"name": "another"}]
    others.append({"config": ("experiment=physical", "sonar=didson_hf")})
    for options in others:
        actual = simnfnd.make_pair(rgb, depth_m, **PLACE, **options)
        assert not np.array_equal(actual.noisy, pair.noisy)


def test_a_pair_is_that_of_a_dataset_of_the_same_frame(tmp_path: Path, monkeypatch) -> None:
    """A recording of one frame, made by `simnfnd make`, holds the very same images."""
    rgb, depth_m = frame()
    depth_m[:4, :4] = 0
    millimetres = np.rint(depth_m * 1000).astype(np.uint16)
    cv2.imwrite(str(tmp_path / "a.png"), np.ascontiguousarray(rgb[..., ::-1]))
    cv2.imwrite(str(tmp_path / "a_d.png"), millimetres)
    (tmp_path / "frame.csv").write_text("a.png,a_d.png\n")
    words = ("render=analytic", "seed=3", "dataset.dtype=float32", "sonar.projection=top_view")
    monkeypatch.setattr(sys, "argv", ["simnfnd"])
    command_words = [
        *("make", *words, "scenes=csv_list", f"scenes.file={tmp_path / 'frame.csv'}"),
        *("scenes.intrinsics=[120,120,76,48]", "scheduler=serial", "dataset.preview_pairs=0"),
        *(f"dataset.dir={tmp_path / 'out'}", f"cache.dir={tmp_path / 'cache'}"),
    ]
    assert main(command_words) == 0
    with simnfnd.PairDataset(tmp_path / "out", "all", trusted=True) as pairs:
        stored = pairs[0]
        meta = pairs.meta()[0]
    name = "/".join(meta[key].decode() for key in ("location", "scene", "frame") if meta[key])
    pair = simnfnd.make_pair(
        rgb, millimetres / np.float32(1000), **PLACE, config=words, name=name.split("/")[-1],
        scene=name.rsplit("/", 1)[0],
    )  # fmt: skip
    np.testing.assert_array_equal(pair.clean, stored["clean"])
    np.testing.assert_array_equal(pair.noisy, stored["noisy"])


def test_frames_and_words_that_will_not_do(monkeypatch) -> None:
    rgb, depth_m = frame()
    with pytest.raises(ValueError, match=r"depth_m .*76x96 .*rgb .*152x96"):
        simnfnd.make_pair(rgb, depth_m[:, ::2], **PLACE)
    with pytest.raises(simnfnd.FactoryError, match="nois"):
        simnfnd.make_pair(rgb, depth_m, **PLACE, config=("nois=none",))
    monkeypatch.setitem(sys.modules, "bpy", None)
    with pytest.raises(simnfnd.FactoryError, match=r"simnfnd\[blender\]"):
        simnfnd.make_pair(rgb, depth_m, **PLACE, config=("render=cycles",))


@pytest.mark.slow
def test_the_examples_of_the_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    rgb, depth_m = frame()
    cv2.imwrite("frame.png", np.ascontiguousarray(rgb[..., ::-1]))
    cv2.imwrite(
        "frame_depth.png", np.rint(np.nan_to_num(depth_m, posinf=0) * 1000).astype(np.uint16)
    )
    Path("frames.csv").write_text("frame.png,frame_depth.png\n")
    write_aris(tmp_path / "dive.aris", pings(2, 40, 48))
    write_dataset(tmp_path / "dataset", train=4, test=2, size=32)
    page = ROOT / "docs/python.md"
    parsed = doctest.DocTestParser().get_doctest(
        page.read_text(encoding="utf-8"), {}, page.name, str(page), 0
    )
    said: list[str] = []
    runner = doctest.DocTestRunner(optionflags=doctest.IGNORE_EXCEPTION_DETAIL)
    result = runner.run(parsed, out=said.append)
    assert result.failed == 0, "".join(said)
    assert result.attempted > 10


# --- denoise ------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
@pytest.mark.parametrize("shape", [(40, 48), (2, 40, 48)])
def test_an_image_comes_back_in_its_own_form(dtype: type, shape: tuple[int, ...]) -> None:
    full = 1 if np.dtype(dtype).kind == "f" else np.iinfo(dtype).max
    image: np.ndarray = (np.random.default_rng(0).random(shape) * full).astype(dtype)
    before = image.copy()
    result = simnfnd.denoise(image)
    assert result.shape == shape
    assert result.dtype == dtype
    assert (result != image).any()
    np.testing.assert_array_equal(image, before)


@pytest.mark.parametrize("order", [1, -1])
def test_colours_of_a_map_are_denoised_as_levels(order: int) -> None:
    """Whether red comes first or blue, and with an alpha channel; not taken for a stack."""
    ramp = np.linspace(20, 230, 48, dtype=np.float32)
    image = np.clip(ramp + np.random.default_rng(0).normal(0, 12, (40, 48)), 0, 255)
    levels = image.astype(np.uint8)
    jet = cv2.applyColorMap(levels, cv2.COLORMAP_JET)[..., ::order]
    wanted = cv2.applyColorMap(simnfnd.denoise(levels), cv2.COLORMAP_JET)[..., ::order]
    actual = simnfnd.denoise(jet)
    assert np.abs(actual.astype(int) - wanted).mean() < 1
    alpha = np.full((40, 48, 1), 7, np.uint8)
    np.testing.assert_array_equal(simnfnd.denoise(np.dstack([jet, alpha]))[..., 3:], alpha)
    np.testing.assert_allclose(simnfnd.denoise(jet / 255) * 255, actual, atol=1)


def test_a_stack_is_its_images_one_by_one() -> None:
    stack = np.random.default_rng(0).integers(0, 255, (2, 40, 48), dtype=np.uint8)
    both = simnfnd.denoise(stack, strength=0.9, geometry="polar", opening_deg=30)
    for image, denoised in zip(stack, both, strict=True):
        alone = simnfnd.denoise(image, strength=0.9, geometry="polar", opening_deg=30)
        np.testing.assert_array_equal(alone, denoised)
    assert (simnfnd.denoise(stack[0], strength=0.9) != both[0]).any(), "geometry made no difference"


def test_images_and_weights_that_will_not_do(monkeypatch) -> None:
    images: list[tuple[np.ndarray, str]] = [
        (np.zeros(5), "expected"),
        (np.zeros((4, 4), np.int64), "int64"),
        (np.full((4, 4), 2.0), "0 to 1"),
        (np.full((5, 5, 3), [0, 1, np.nan]), "NaN"),
    ]
    for image, said in images:
        with pytest.raises(ValueError, match=said):
            simnfnd.denoise(image)
    with pytest.raises(simnfnd.FactoryError, match="nowhere"):
        simnfnd.denoise(np.zeros((8, 8)), weights="nowhere")
    with pytest.raises(ValueError, match="'fan': expected 'find', 'polar'"):
        simnfnd.denoise(np.zeros((8, 8)), geometry="fan")  # type: ignore[call-overload]
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(simnfnd.FactoryError, match=r"onnxruntime.*\[denoise\]"):
        simnfnd.denoise(np.zeros((8, 8)))


def test_a_checkout_is_a_repository_of_torch_hub(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its module denoises as the command does, where that needs the network alone."""
    import torch

    from simnfnd.models.denoise import denoiser as denoiser_module

    monkeypatch.setattr(denoiser_module, "corrected_by_detail", lambda _, denoised: denoised)

    load: Any = torch.hub.load
    denoiser = load(str(ROOT), "denoiser", source="local")
    speckle = np.random.default_rng(0).rayleigh(0.2, (2, 64, 48)).clip(0, 1).astype(np.float32)
    noisy = torch.from_numpy(speckle)[:, None]
    denoised = denoiser(noisy)
    expected = simnfnd.denoise(speckle, frames=1, geometry=None)
    np.testing.assert_allclose(denoised[:, 0].detach().numpy(), expected, atol=1e-4)
    denoised.sum().backward()
    assert all(parameter.requires_grad for parameter in denoiser.parameters())
    with pytest.raises(ValueError, match=r"expected \(N, 1, H, W\)"):
        denoiser(noisy[0])
