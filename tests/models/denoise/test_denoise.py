"""`simnfnd denoise`: what comes in comes out, denoised, under its own name."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import numpy.typing as npt
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy import ndimage

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.recordings.video import VideoFile
from simnfnd.factory.sonar.geometry import FanGeometry
from simnfnd.factory.sonar.settings import SonarSettings
from simnfnd.models.denoise.command import main
from simnfnd.models.denoise.compared import CAPTION_PX
from simnfnd.models.denoise.denoiser import load_denoiser
from simnfnd.models.denoise.files import denoise_image
from simnfnd.models.denoise.inputs import Item, find_items
from simnfnd.models.denoise.tile import starts, tiled
from simnfnd.models.denoise.videos import CODECS, FrameFiles
from simnfnd.models.networks import build_network
from simnfnd.models.networks.network import Network
from simnfnd.models.networks.weights import load_weights, save_weights
from tests.small_dataset import fan_images, write_dataset, write_manifest

TINY = {"kind": "nafnet", "width": 4, "encoder": [1], "middle": 0, "decoder": [1]}


def half(gray: npt.NDArray[np.float32], geometry: object = None) -> npt.NDArray[np.float32]:
    """A denoiser whose result is easy to foretell."""
    return gray / 2


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Weights of an untrained network: it changes images, and by how much can be computed."""
    torch.manual_seed(0)
    path = tmp_path_factory.mktemp("weights") / "weights.safetensors"
    save_weights(path, build_network(TINY), TINY, {})
    return path


def untrained_sonarnet(folder: Path) -> Path:
    """Weights of a network that can be told what to remove."""
    config = {
        **{"kind": "sonarnet", "widths": [4, 4], "blocks": [0, 0], "polar": False},
        **{"lines": True, "mask": True, "forget": 0.0},
    }
    torch.manual_seed(0)
    path = folder / "weights.safetensors"
    save_weights(path, build_network(config), config, {})
    return path


def through_network(weights: Path, image: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    network = load_weights(weights).network
    with torch.inference_mode():
        result = network(torch.from_numpy(image.astype(np.float32))[None, None])
    return np.asarray(np.clip(result[0, 0].numpy(), 0, 1), dtype=np.float64)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("shape", [(6, 7), (6, 7, 3), (6, 7, 4), (1, 1)])
def test_shape_dtype_and_scale_stay(dtype: str, shape: tuple[int, ...]) -> None:
    full = {"uint8": 255, "uint16": 65535, "float32": 1}[dtype]
    image = np.random.default_rng(0).random(shape) * full
    image = image.astype(dtype) if dtype == "float32" else np.rint(image).astype(dtype)
    result = denoise_image(image, half)
    assert result.shape == shape
    assert result.dtype == image.dtype
    tolerance = 1e-6 if dtype == "float32" else 0.5
    colours = np.s_[..., :3]
    assert np.abs(result[colours] - image[colours] / 2.0).max() <= tolerance
    if shape[-1] == 4:
        assert np.array_equal(result[..., 3], image[..., 3]), "alpha is no echo"


def test_weights_do_not_see_a_bright_page_around_a_fan(tmp_path: Path) -> None:
    sonar = SonarSettings()
    geometry = FanGeometry.from_sonar(sonar, 1.0, 6.0)
    inside = geometry.maps(0, 0, *sonar.shape())["sector"] > 0
    rng = np.random.default_rng(0)
    grey = np.where(inside, rng.rayleigh(0.2, inside.shape).clip(0, 1), 0).astype(np.float32)
    page = np.where(inside, grey, np.float32(0.9))
    denoise = load_denoiser(untrained_sonarnet(tmp_path), "cpu")
    on_black, on_page = denoise(grey, geometry), denoise(page, geometry)
    np.testing.assert_array_equal(on_page[inside], on_black[inside])
    np.testing.assert_array_equal(on_page[~inside], page[~inside])


def test_unusable_pixels_are_refused() -> None:
    for image, words in (
        (np.full((4, 4), np.nan, np.float32), r"0\.\.1"),
        (np.full((4, 4), 3, np.float32), r"0\.\.1"),
        (np.zeros((4, 4), np.int32), "int32"),
        (np.zeros((0, 4), np.uint8), "shape"),
    ):
        with pytest.raises(ValueError, match=words):
            denoise_image(image, half)


def test_images_keep_name_size_and_dtype(
    weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    noisy, _, _ = fan_images(40, np.random.default_rng(0))
    noisy = noisy[:31]
    images: dict[str, npt.NDArray[Any]] = {
        "a.png": (noisy * 255).astype(np.uint8),
        "deep/b.png": (noisy * 65535).astype(np.uint16),
        "deep/c.tif": noisy,
        "d.PNG": np.repeat((noisy * 255).astype(np.uint8)[..., None], 3, axis=2),
    }
    for name, image in images.items():
        path = tmp_path / "in" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        assert cv2.imwrite(str(path), image)
    out = tmp_path / "out"
    arguments = [str(tmp_path / "in"), "--out", str(out), "--weights", str(weights), "--compare"]
    assert main(arguments) == 0
    assert "denoised: 4 file(s)" in capsys.readouterr().out
    for name, image in images.items():
        result = cv2.imread(str(out / name), cv2.IMREAD_UNCHANGED)
        assert result is not None
        assert (result.shape, result.dtype) == (image.shape, image.dtype)
        full = {"uint8": 255, "uint16": 65535, "float32": 1}[str(image.dtype)]
        gray = image[..., 0] if image.ndim == 3 else image
        shown = result[..., 0] if result.ndim == 3 else result
        expected = through_network(weights, gray / full)
        assert np.abs(shown / full - expected).max() <= 0.51 / full + 1e-6
        assert not np.array_equal(result, image)
        sheet = cv2.imread(str((out / "compare" / name).with_suffix(".png")), cv2.IMREAD_UNCHANGED)
        assert sheet is not None
        assert sheet.shape[:2] == (CAPTION_PX + 31, 2 * 40 + 4)
        names = sheet[:CAPTION_PX, :, :3] if sheet.ndim == 3 else sheet[:CAPTION_PX]
        assert names[:, :40].max() > 60 < names[:, 44:].max(), "each picture is named"
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert main(arguments) == 0
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_strength_is_the_part_of_the_change(tmp_path: Path) -> None:
    weights = untrained_sonarnet(tmp_path)
    gray = fan_images(40, np.random.default_rng(0))[0].astype(np.float32)
    whole, half, none = (
        load_denoiser(weights, "cpu", strength=part)(gray) for part in (1.0, 0.5, 0.0)
    )
    np.testing.assert_array_equal(none, gray)
    assert np.abs(whole - gray).max() > 0.01
    inside = (whole > 0) & (whole < 1)
    np.testing.assert_allclose(half[inside], ((gray + whole) / 2)[inside], atol=1e-6)


def test_precision_changes_pictures_by_less_than_a_grey_level_on_average(tmp_path: Path) -> None:
    weights = untrained_sonarnet(tmp_path)
    gray = fan_images(40, np.random.default_rng(0))[0].astype(np.float32)
    exact, half, auto = (
        load_denoiser(weights, "cpu", precision=name)(gray)
        for name in ("32-true", "bf16-mixed", "auto")
    )
    assert np.abs(exact - gray).max() > 0.01
    assert not np.array_equal(half, exact)
    assert np.abs(half - exact).mean() < 1 / 255
    assert any(np.array_equal(auto, one) for one in (exact, half))
    with pytest.raises(FactoryError, match=r"--precision double: is none of auto, 32-true"):
        load_denoiser(weights, "cpu", precision="double")


def test_what_cannot_be_removed_is_said(
    tmp_path: Path, weights: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cv2.imwrite(str(tmp_path / "a.png"), np.zeros((16, 16), np.uint8))
    arguments = [str(tmp_path / "a.png"), "--out", str(tmp_path / "out"), "--weights"]
    for own, words, said in (
        (untrained_sonarnet(tmp_path), ["--remove", "hiss"], "'hiss' is none of speckle, haze"),
        (untrained_sonarnet(tmp_path), ["--strength", "2"], "must lie between 0 and 1"),
        (weights, ["--remove", "haze"], "these weights always remove the same"),
    ):
        with pytest.raises(FactoryError, match=said):
            main([*arguments, str(own), *words])
    assert not (tmp_path / "out" / "a.png").exists()


def test_all_tiles_of_a_picture_get_the_same_part_of_their_change(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    denoise = load_denoiser(untrained_sonarnet(tmp_path), "cpu", tile=32, overlap=0)
    gray = np.full((32, 64), 0.5, np.float32)
    gray[:, 32:] = 0.75
    monkeypatch.setattr(
        denoise,
        "_denoise_tile",
        lambda part, maps: (part / 2, 1.0 if part[0, 0] > 0.6 else 0.5),
    )
    np.testing.assert_allclose(denoise(gray), gray * (1 - 0.5 * 0.75), rtol=1e-6)


def test_shards_become_denoised_shards(weights: Path, tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=4, test=2, size=32)
    write_manifest(dataset, "train/shard-00000.h5", "test/shard-00000.h5")
    (dataset / "preview.png").write_bytes(b"no sonar image")
    out = tmp_path / "out"
    arguments = [str(dataset), "--out", str(out), "--weights", str(weights), "--compare"]
    assert main(arguments) == 0
    names = sorted(p.relative_to(out).as_posix() for p in out.rglob("*") if p.is_file())
    assert names == [
        "compare/test/shard-00000.png",
        "compare/train/shard-00000.png",
        "test/shard-00000.h5",
        "train/shard-00000.h5",
    ]
    source = dataset / "train" / "shard-00000.h5"
    with h5py.File(source) as noisy, h5py.File(out / "train" / "shard-00000.h5") as done:
        assert done["denoised"].shape == noisy["noisy"].shape
        assert done["denoised"].dtype == np.uint8
        assert np.array_equal(done["meta"][()], noisy["meta"][()])
        assert np.array_equal(done["axes/range"][()], noisy["axes/range"][()])
        for row in range(4):
            expected = through_network(weights, noisy["noisy"][row] / 255) * 255
            assert np.abs(done["denoised"][row] - expected).max() <= 0.51
    sheet = cv2.imread(str(out / "compare/train/shard-00000.png"))
    assert sheet is not None
    assert sheet.shape[:2] == (CAPTION_PX + 4 * 32, 3 * 32 + 2 * 4)


def test_a_bad_file_among_good_ones_is_skipped(
    weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    cv2.imwrite(str(folder / "good.png"), np.zeros((9, 9), np.uint8))
    (folder / "broken.png").write_bytes(b"\x89PNG not")
    (folder / "empty.png").write_bytes(b"")
    (folder / "other.h5").write_bytes(b"no HDF5")
    out = tmp_path / "out"
    assert main([str(folder), "--out", str(out), "--weights", str(weights)]) == 1
    said = capsys.readouterr()
    assert "denoised: 1 file(s)" in said.out
    for name in ("broken.png: not a readable picture", "empty.png", "other.h5: not a readable"):
        assert name in said.err
    assert [path.name for path in out.iterdir()] == ["good.png"]
    (folder / "good.png").unlink()
    with pytest.raises(FactoryError, match=r"broken\.png.*and 2 more"):
        main([str(folder), "--out", str(out), "--weights", str(weights)])


def test_no_result_replaces_another_file(tmp_path: Path) -> None:
    for name in ("a/x.png", "b/x.png"):
        path = tmp_path / name
        path.parent.mkdir()
        cv2.imwrite(str(path), np.zeros((9, 9), np.uint8))
    first, second = tmp_path / "a" / "x.png", tmp_path / "b" / "x.png"
    with pytest.raises(FactoryError, match=r"both become x\.png"):
        find_items([first, second], tmp_path / "out")
    with pytest.raises(FactoryError, match="would overwrite the input"):
        find_items([first], tmp_path / "a")
    # Results of an earlier run below the input folder are no input.
    out = tmp_path / "a" / "out"
    out.mkdir()
    (out / "x.png").write_bytes(first.read_bytes())
    assert find_items([tmp_path / "a"], out) == [Item(first, Path("x.png"))]


def test_nothing_to_denoise(tmp_path: Path) -> None:
    with pytest.raises(FactoryError, match="no such file or folder"):
        find_items([tmp_path / "nowhere"], tmp_path / "out")
    with pytest.raises(FactoryError, match="holds no image"):
        find_items([tmp_path], tmp_path / "out")
    (tmp_path / "notes.txt").write_text("words", encoding="utf-8")
    with pytest.raises(FactoryError, match="neither an image nor a shard"):
        find_items([tmp_path / "notes.txt"], tmp_path / "out")


@pytest.mark.parametrize("name", ["dive.avi", "dive.mp4", "dive.webm"])
def test_videos_become_videos_or_folders(weights: Path, tmp_path: Path, name: str) -> None:
    noisy, _, _ = fan_images(48, np.random.default_rng(1))
    grey = (noisy * 255).astype(np.uint8)
    path = tmp_path / "dive.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 12.5, (48, 48))
    for shift in range(3):
        writer.write(cv2.cvtColor(np.roll(grey, shift, axis=1), cv2.COLOR_GRAY2BGR))
    writer.release()
    path = path.rename(tmp_path / name)
    with VideoFile(path) as recording:
        originals = [frame.samples for frame in recording]
    out = tmp_path / "out"
    assert main([str(path), "--out", str(out), "--weights", str(weights), "--compare"]) == 0
    if name != "dive.webm":
        with VideoFile(out / name) as recording:
            assert recording.rate_hz == pytest.approx(12.5)
            results = [frame.samples for frame in recording]
    else:
        frames = sorted((out / name).iterdir())
        assert [frame.name for frame in frames] == ["000000.png", "000001.png", "000002.png"]
        results = [np.asarray(cv2.imread(str(frame), cv2.IMREAD_UNCHANGED)) for frame in frames]
    assert len(results) == len(originals) == 3
    for original, result in zip(originals, results, strict=True):
        assert result.shape == original.shape
        assert np.abs(result - through_network(weights, original / 255.0) * 255).max() <= 0.51
    assert (out / "compare" / "dive.png").is_file()
    assert sorted(entry.name for entry in out.iterdir()) == sorted(["compare", name])


@pytest.mark.parametrize("name", [f"a{suffix}" for suffix in CODECS])
@pytest.mark.parametrize("colours", [(), (3,)])
def test_frames_survive_in_every_container(
    tmp_path: Path, name: str, colours: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    frames = np.random.default_rng(3).integers(0, 256, (4, 30, 46, *colours), dtype=np.uint8)
    with FrameFiles(tmp_path / name, 7.5) as files:
        for frame in frames:
            files.add(frame)
    with VideoFile(tmp_path / name) as recording:
        assert recording.rate_hz == pytest.approx(7.5)
        np.testing.assert_array_equal([frame.samples for frame in recording], frames)
    assert [entry.name for entry in tmp_path.iterdir()] == [name]
    assert not capfd.readouterr().err, "what OpenCV says of codecs is of no use to anybody"


@pytest.mark.parametrize(("shape", "rate_hz"), [((31, 46), 7.5), ((30, 47), 7.5), ((30, 46), None)])
def test_frames_that_fit_no_container_are_pictures(
    tmp_path: Path, shape: tuple[int, int], rate_hz: float | None
) -> None:
    frame = np.random.default_rng(3).integers(0, 256, shape, dtype=np.uint8)
    with FrameFiles(tmp_path / "a.avi", rate_hz) as files:
        files.add(frame)
        files.add(frame)
    assert sorted(path.name for path in (tmp_path / "a.avi").iterdir()) == [
        "000000.png",
        "000001.png",
    ]
    np.testing.assert_array_equal(cv2.imread(str(tmp_path / "a.avi/000001.png"), -1), frame)
    (tmp_path / "b.avi").write_bytes(b"mine")
    with (
        pytest.raises(FrameError, match=r"b\.avi: is there already"),
        FrameFiles(tmp_path / "b.avi", None) as files,
    ):
        files.add(frame)


def test_a_video_that_broke_off_leaves_nothing(tmp_path: Path) -> None:
    def fails() -> None:
        with FrameFiles(tmp_path / "a.avi", 10.0) as files:
            files.add(np.zeros((30, 46), np.uint8))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fails()
    assert list(tmp_path.iterdir()) == []


def test_a_video_that_is_none_leaves_nothing(weights: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    (tmp_path / "broken.mp4").write_bytes(b"no video")
    with pytest.raises(FactoryError, match=r"broken\.mp4: not a readable video"):
        main([str(tmp_path / "broken.mp4"), "--out", str(out), "--weights", str(weights)])


@given(st.integers(1, 400), st.integers(8, 64), st.data())
def test_tiles_cover_every_pixel_and_share_enough(
    size: int, tile: int, data: st.DataObject
) -> None:
    overlap = data.draw(st.integers(0, tile // 2))
    found = starts(size, tile, overlap)
    assert found[0] == 0
    assert found[-1] + tile >= size
    assert size <= tile or found[-1] + tile == size
    for first, second in pairwise(found):
        assert overlap <= first + tile - second < tile


def test_tiles_leave_no_seam() -> None:
    rng = np.random.default_rng(0)
    image = rng.random((90, 130)).astype(np.float32)
    scale = {"scale": np.linspace(0, 1, 90 * 130, dtype=np.float32).reshape(90, 130)}

    def local(part: npt.NDArray[np.float32], maps: Any) -> npt.NDArray[np.float32]:
        # What a network with a small field of view does: pixels and their neighbours.
        return np.asarray(ndimage.uniform_filter(part, 5, mode="nearest") * maps["scale"])

    whole, parts = local(image, scale), tiled(local, image, scale, 48, 20)
    np.testing.assert_allclose(parts[3:-3, 3:-3], whole[3:-3, 3:-3], atol=0.02)
    middle = np.abs(parts - whole)[3:-3, 3:-3]
    assert np.median(middle) < 1e-6

    def brightening(part: npt.NDArray[np.float32], maps: Any) -> npt.NDArray[np.float32]:
        # Each tile comes out brighter than the one before: the worst seam that there could be.
        brightening.calls += 1  # type: ignore[attr-defined]
        return np.full(part.shape, brightening.calls, np.float32)  # type: ignore[attr-defined]

    brightening.calls = 0  # type: ignore[attr-defined]
    blended = tiled(brightening, np.zeros((40, 200), np.float32), {}, 60, 20)
    assert np.abs(np.diff(blended, axis=1)).max() <= 1.01 / 20
    with pytest.raises(ValueError, match="half of the tile"):
        tiled(local, image, scale, 32, 20)


def test_large_pictures_are_denoised_in_tiles(weights: Path) -> None:
    noisy, _, _ = fan_images(96, np.random.default_rng(2))
    whole = load_denoiser(weights, "cpu")(noisy)
    parts = load_denoiser(weights, "cpu", tile=64, overlap=24)(noisy)
    # NAFNet's attention is a mean over the tile, so a little differs.
    assert np.abs(whole - parts).max() < 0.05
    assert parts.dtype == np.float32
    with pytest.raises(FactoryError, match="--overlap 40: must be at most half"):
        main(["x.png", "--out", "o", "--tile", "64", "--overlap", "40"])


def test_geometry_reaches_the_network(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    received: list[tuple[str, ...]] = []

    class Recorder(Network):
        extras = ("range_fraction", "sector")

        def __init__(self) -> None:
            super().__init__(channels=1, stride=1)
            self.scale = torch.nn.Parameter(torch.ones(()))

        def restore(self, noisy: torch.Tensor, **extras: torch.Tensor) -> torch.Tensor:
            received.append(tuple(extras))
            return noisy * self.scale

    monkeypatch.setattr("simnfnd.models.networks.weights.build_network", lambda model: Recorder())
    path = tmp_path / "weights.safetensors"
    save_weights(path, Recorder(), {"kind": "recorder"}, {})
    denoise = load_denoiser(path, "cpu")
    gray = np.zeros((20, 20), np.float32)
    denoise(gray)
    denoise(gray, FanGeometry.polar().with_size(20, 20))
    denoise(gray, layout="polar")
    assert received == [(), ("range_fraction", "sector"), ("range_fraction", "sector")]
