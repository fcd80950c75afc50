"""`simnfnd denoise`: what comes in comes out, denoised, under its own name."""

from __future__ import annotations

import os
from pathlib import Path

import cv2
import h5py
import numpy as np
import pytest

from simnfnd.factory.common.array_types import Array
from simnfnd.factory.common.errors import FactoryError, FrameError
from simnfnd.factory.dataset import reader
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.factory.simulation.sonar.settings import SonarSettings
from simnfnd.models.denoise.denoiser import Denoiser
from simnfnd.models.denoise.images import Denoising
from simnfnd.models.denoise.journal import JOURNAL_NAME
from simnfnd.models.denoise.options import main
from simnfnd.models.denoise.reports import TABLE
from simnfnd.models.denoise.shards import opened_shard
from simnfnd.models.denoise.writers import CAPTION_PX
from simnfnd.models.recordings.inputs import InputFile, find_items
from tests.factory.production.export.export_dataset import write
from tests.models.denoise.untrained import half, results_in, through_network, untrained_sonarnet
from tests.small_dataset import fan_images, write_dataset, write_manifest


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("shape", [(6, 7), (6, 7, 3), (6, 7, 4), (1, 1)])
def test_shape_dtype_and_scale_stay(dtype: str, shape: tuple[int, ...]) -> None:
    full = {"uint8": 255, "uint16": 65535, "float32": 1}[dtype]
    image = np.random.default_rng(0).random(shape) * full
    image = image.astype(dtype) if dtype == "float32" else np.rint(image).astype(dtype)
    result = Denoising(half).denoise_image(image, lambda _: None).image
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
    denoise = Denoiser(untrained_sonarnet(tmp_path), "cpu")
    on_black = denoise(grey, geometry)
    on_page = denoise(page, geometry)
    np.testing.assert_array_equal(on_page[inside], on_black[inside])
    np.testing.assert_array_equal(on_page[~inside], page[~inside])


def test_images_keep_name_size_and_dtype(
    weights: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    noisy, _, _ = fan_images(40, np.random.default_rng(0))
    noisy = noisy[:31]
    images: dict[str, Array] = {
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
        grey = image[..., 0] if image.ndim == 3 else image
        shown = result[..., 0] if result.ndim == 3 else result
        expected = through_network(weights, grey / full)
        assert np.abs(shown / full - expected).max() <= 0.51 / full + 1e-6
        assert not np.array_equal(result, image)
        is_png = name.lower().endswith(".png")
        sheet = cv2.imread(str(out / "compare" / (name if is_png else f"{name}.png")))
        assert sheet is not None
        assert sheet.shape[:2] == (CAPTION_PX + 31, 3 * 40 + 2 * 4)
        names = sheet[:CAPTION_PX]
        assert min(names[:, left : left + 40].max() for left in (0, 44, 88)) > 60, (
            "panels are named"
        )
    before = {path: path.read_bytes() for path in out.rglob("*") if path.is_file()}
    assert main(arguments) == 0
    assert {path: path.read_bytes() for path in out.rglob("*") if path.is_file()} == before


def test_names_may_hold_any_bytes(
    tmp_path: Path, weights: Path, capfdbinary: pytest.CaptureFixture[bytes]
) -> None:
    """As Latin-1 writes them on a disk of UTF-8."""
    folder = os.fsencode(tmp_path / "in")
    os.mkdir(folder)
    content = cv2.imencode(".png", np.full((40, 40), 90, np.uint8))[1].tobytes()
    names = [b"plong\xe9e_0000.png", b"plong\xe9e_0001.png", b"good.png"]
    for name in names:
        Path(os.fsdecode(os.path.join(folder, name))).write_bytes(content)
    words = [str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--weights", str(weights)]
    assert main(words) == 0
    assert set(names) < set(os.listdir(os.fsencode(tmp_path / "out")))
    assert b"plong\xe9e_0000.png," in (tmp_path / "out" / "denoised.csv").read_bytes()
    assert main(words) == 0  # its journal is read
    # Reports of tests hold text alone, and no such name.
    assert b"plong" in b"".join(capfdbinary.readouterr())


def test_strength_is_the_part_of_the_change(tmp_path: Path) -> None:
    weights = untrained_sonarnet(tmp_path)
    grey = fan_images(40, np.random.default_rng(0))[0].astype(np.float32)
    network = Denoiser(weights, "cpu")
    whole, half, none = (
        Denoising(network, strength=part).denoise_image(grey, lambda _: None).image
        for part in (1.0, 0.5, 0.0)
    )
    np.testing.assert_array_equal(none, grey)
    assert np.abs(whole - grey).max() > 0.01
    inside = (whole > 0) & (whole < 1)
    np.testing.assert_allclose(half[inside], ((grey + whole) / 2)[inside], atol=1e-6)


def test_shards_become_denoised_shards(weights: Path, tmp_path: Path) -> None:
    dataset = write_dataset(tmp_path / "data", train=4, test=2, size=32)
    write_manifest(dataset, "train/shard-00000.h5", "test/shard-00000.h5")
    (dataset / "preview.png").write_bytes(b"no sonar image")
    out = tmp_path / "out"
    arguments = [str(dataset), "--out", str(out), "--weights", str(weights), "--compare"]
    assert main(arguments) == 0
    names = sorted(p.relative_to(out).as_posix() for p in out.rglob("*.*") if p.is_file())
    assert [name for name in names if name not in (JOURNAL_NAME, TABLE)] == [
        "compare/test/shard-00000.h5.png",
        "compare/train/shard-00000.h5.png",
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
    sheet = cv2.imread(str(out / "compare/train/shard-00000.h5.png"))
    assert sheet is not None
    assert sheet.shape[:2] == (CAPTION_PX + 4 * 32, 4 * 32 + 3 * 4)


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
    for name in ("broken.png: not a readable image", "empty.png", "other.h5: not a readable"):
        assert name in said.err
    assert results_in(out) == ["good.png"]
    (folder / "good.png").unlink()
    with pytest.raises(FactoryError, match=r"broken\.png.*and 2 more"):
        main([str(folder), "--out", str(out), "--weights", str(weights)])


def test_no_result_replaces_another_file(tmp_path: Path) -> None:
    for name in ("a/x.png", "b/x.png"):
        path = tmp_path / name
        path.parent.mkdir()
        cv2.imwrite(str(path), np.zeros((9, 9), np.uint8))
    first = tmp_path / "a" / "x.png"
    second = tmp_path / "b" / "x.png"
    with pytest.raises(FactoryError, match=r"both become x\.png"):
        find_items([first, second], tmp_path / "out")
    with pytest.raises(FactoryError, match="overwrite"):
        find_items([first], tmp_path / "a")
    # Results of an earlier run below the input folder are no input.
    out = tmp_path / "a" / "out"
    out.mkdir()
    (out / "x.png").write_bytes(first.read_bytes())
    assert find_items([tmp_path / "a"], out) == [InputFile(first, Path("x.png"))]


def test_the_weights_that_were_used_are_named_and_unsuited_ones_warned_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = write_dataset(tmp_path / "data", train=0, test=2)
    shard = str(next(data.glob("test/*.h5")))
    assert main([shard, "--out", str(tmp_path / "known")]) == 0
    said = capsys.readouterr()
    assert "weights: simnfnd-paper (1 file(s))" in said.out
    assert "warning" not in said.err
    assert main([shard, "--weights", "simnfnd", "--out", str(tmp_path / "other")]) == 0
    said = capsys.readouterr()
    assert "weights: simnfnd (1 file(s))" in said.out
    assert "simnfnd is made for real sonars; simnfnd-paper suits this file" in said.err


def test_shards_are_looked_at_in_another_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that crashes the library is skipped."""
    write(tmp_path / "data")
    (item, *_) = find_items([tmp_path / "data"], tmp_path / "out")
    looked: list[Path] = []
    monkeypatch.setattr(reader, "check_in_isolation", looked.extend)
    opened_shard(item.source).close()
    assert looked == [item.source]
    crash = FactoryError(f"{item.source}: crashes the HDF5 library; it is damaged")

    def look(paths: list[Path]) -> None:
        raise crash

    monkeypatch.setattr(reader, "check_in_isolation", look)
    with pytest.raises(FrameError, match="HDF5"):
        opened_shard(item.source)
