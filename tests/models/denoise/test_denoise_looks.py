"""`simnfnd denoise` with weights that see several frames: which ones they get."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from simnfnd.factory.errors import FactoryError
from simnfnd.models.denoise.command import main
from simnfnd.models.denoise.denoiser import load_denoiser
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import save_weights
from simnfnd.models.recordings import open_recording
from tests.models.recordings.recording_files import write_aris

CONFIG: dict[str, Any] = {"kind": "kdlae", "frames": 5, "widths": [4, 4], "blocks": 1}


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    torch.manual_seed(2)
    torch.set_num_threads(1)
    network = build_network(CONFIG)
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.2)
    path = tmp_path_factory.mktemp("weights") / "kdlae.safetensors"
    save_weights(path, network, CONFIG, {})
    return path


def pictures(folder: Path, count: int) -> list[np.ndarray]:
    rng = np.random.default_rng(4)
    folder.mkdir()
    found = [rng.integers(0, 255, (40, 48), dtype=np.uint8) for _ in range(count)]
    for number, picture in enumerate(found):
        cv2.imwrite(str(folder / f"ping{number}.png"), picture)
    return found


def in_8_bits(picture: np.ndarray) -> np.ndarray:
    return np.asarray(np.rint(picture.astype(np.float64) * 255), np.uint8)


def test_pictures_of_a_folder_see_those_before_and_after_them(
    weights: Path, tmp_path: Path
) -> None:
    found = pictures(tmp_path / "in", 5)
    cv2.imwrite(str(tmp_path / "in" / "other.png"), found[2])
    words = ["--out", str(tmp_path / "out"), "--weights", str(weights), "--geometry", "none"]
    assert main([str(tmp_path / "in"), *words]) == 0
    denoise = load_denoiser(weights, "cpu")
    greys = [picture.astype(np.float32) / np.float32(255) for picture in found]
    for own in (0, 2, 4):
        looks = [greys[min(max(place, 0), 4)] for place in range(own - 2, own + 3)]
        result = cv2.imread(str(tmp_path / "out" / f"ping{own}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(result, in_8_bits(denoise(greys[own], looks=looks)))
    alone = cv2.imread(str(tmp_path / "out" / "other.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(alone, in_8_bits(denoise(greys[2])))
    beside = cv2.imread(str(tmp_path / "out" / "ping2.png"), cv2.IMREAD_UNCHANGED)
    assert not np.array_equal(alone, beside)


def test_a_picture_of_another_size_is_no_neighbour(weights: Path, tmp_path: Path) -> None:
    found = pictures(tmp_path / "in", 3)
    cv2.imwrite(str(tmp_path / "in" / "ping2.png"), found[2][:30])
    words = ["--out", str(tmp_path / "out"), "--weights", str(weights), "--geometry", "none"]
    assert main([str(tmp_path / "in"), *words]) == 0
    first, own = (picture.astype(np.float32) / np.float32(255) for picture in found[:2])
    expected = load_denoiser(weights, "cpu")(own, looks=[first, first, own, own, own])
    result = cv2.imread(str(tmp_path / "out" / "ping1.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(result, in_8_bits(expected))


def test_frames_of_a_recording_see_each_other(weights: Path, tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    path = write_aris(tmp_path / "pings.aris", rng.integers(0, 255, (4, 30, 48), dtype=np.uint8))
    assert main([str(path), "--out", str(tmp_path / "out"), "--weights", str(weights)]) == 0
    denoise = load_denoiser(weights, "cpu")
    with open_recording(path) as before, open_recording(tmp_path / "out" / path.name) as after:
        greys = [one.samples.astype(np.float32) / np.float32(255) for one in before]
        results = [one.samples for one in after]
    looks = [greys[place] for place in (0, 0, 1, 2, 3)]
    np.testing.assert_array_equal(results[1], in_8_bits(denoise(greys[1], looks=looks)))
    assert not np.array_equal(results[1], in_8_bits(denoise(greys[1])))


def test_tiles_cut_all_frames_alike(weights: Path) -> None:
    looks = list(np.random.default_rng(6).random((5, 64, 96), np.float32))
    whole = load_denoiser(weights, "cpu")(looks[2], looks=looks)
    parts = load_denoiser(weights, "cpu", tile=48, overlap=24)(looks[2], looks=looks)
    assert np.abs(parts - whole).max() < 0.05
    half = load_denoiser(weights, "cpu", strength=0.5)(looks[2], looks=looks)
    inside = (whole > 0) & (whole < 1)
    np.testing.assert_allclose(half[inside], ((looks[2] + whole) / 2)[inside], atol=1e-6)


def test_what_such_weights_cannot_do_is_one_line(weights: Path, tmp_path: Path) -> None:
    pictures(tmp_path / "in", 2)
    words = [str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--weights", str(weights)]
    with pytest.raises(FactoryError, match=r"^--frames 3: these weights see 5 frames themselves"):
        main([*words, "--frames", "3"])
    with pytest.raises(FactoryError, match=r"^--remove: these weights always remove the same"):
        main([*words, "--remove", "haze"])
