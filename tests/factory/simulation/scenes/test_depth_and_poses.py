"""Which distances a depth map holds, which axes poses have, and files that hold more than one."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image, TiffImagePlugin

from simnfnd.command import main
from simnfnd.factory.common.errors import FactoryError, FrameError
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.scenes import open_reader
from simnfnd.factory.simulation.scenes.frame_files import read_depth
from tests.factory.production.cli_frames import ground

LENS = [110.0, 110.0, 79.5, 59.5]
FAST = ["render=analytic", "scheduler=serial", "dataset.preview_pairs=0", "noise=none"]


def write_list(folder: Path, depth_m: np.ndarray) -> list[str]:
    """A list of one frame, and the words that read it."""
    height, width = depth_m.shape
    Image.fromarray(np.full((height, width, 3), 128, np.uint8)).save(folder / "a.png")
    np.save(folder / "a.npy", depth_m.astype(np.float32))
    (folder / "list.csv").write_text("a.png,a.npy,s\n")
    return ["scenes=csv_list", f"scenes.file={folder}/list.csv",
            f"scenes.intrinsics={LENS}".replace(" ", "")]  # fmt: skip


def frame_of(words: list[str]) -> Any:
    reader = open_reader(compose_config(words).scenes)
    return reader.load(reader.discover().frames[0])


def test_distances_along_rays_give_the_same_frame(tmp_path: Path) -> None:
    v, u = np.mgrid[:120, :160]
    rays = np.sqrt(1 + ((u - LENS[2]) / LENS[0]) ** 2 + ((v - LENS[3]) / LENS[1]) ** 2)
    words = write_list(tmp_path, 4 * rays)
    frame = frame_of([*words, "scenes.depth_kind=ray"])
    assert frame.depth_m == pytest.approx(np.full((120, 160), 4.0), abs=1e-5)
    assert frame_of(words).depth_m.max() > 5
    identities = [
        identity(compose_config([*words, *more])) for more in ([], ["scenes.depth_kind=ray"])
    ]
    assert [values["scenes"]["depth_kind"] for values in identities] == ["z", "ray"]


@pytest.mark.slow
def test_a_corrected_depth_map_is_noticed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*write_list(tmp_path, ground(120, 160)), *FAST]
    folder = tmp_path / "made"
    assert main(["make", *words, f"dataset.dir={folder}"]) == 0
    (shard,) = folder.glob("t*/*.h5")
    before = shard.read_bytes()
    times = os.stat(tmp_path / "a.npy")
    assert main(["make", *words, f"dataset.dir={folder}"]) == 0
    assert "changed" not in capsys.readouterr().out
    assert shard.read_bytes() == before

    write_list(tmp_path, ground(120, 160) * np.float32(0.8))
    os.utime(tmp_path / "a.npy", ns=(times.st_atime_ns, times.st_mtime_ns))
    assert main(["make", *words, f"dataset.dir={folder}"]) == 0
    assert "files have changed" in "".join(capsys.readouterr())
    assert shard.read_bytes() != before
    assert main(["make", *words, f"dataset.dir={tmp_path}/fresh"]) == 0
    (fresh,) = (tmp_path / "fresh").glob("t*/*.h5")
    assert shard.read_bytes() == fresh.read_bytes()


# One place, looking level along y of the world, 1.5 m above its ground.
POSES = {
    "optical": "0 0 -5 1.5 -0.7071068 0 0 0.7071068",
    "flu": "0 0 -5 1.5 0 0 0.7071068 0.7071068",
    "ned": "0 0 5 -1.5 0 0 -0.7071068 0.7071068",
}


# Longer than the sample table's name of a location.
WORLD = "floor" * 30


def world(folder: Path, line: str) -> list[str]:
    corners = [(-9, -9), (9, -9), (9, 9), (-9, 9)]
    (folder / f"{WORLD}.obj").write_text(
        "\n".join(f"v {x} {y} 0" for x, y in corners) + "\nf 1 2 3 4\n"
        "v -1 4 0\nv 1 4 0\nv 1 4 2\nv -1 4 2\nf 5 6 7 8\n"
    )
    (folder / "poses.txt").write_text(f"{line}\n")
    return ["scenes=mesh", f"scenes.file={folder}/{WORLD}.obj", "scenes.width=96", "scenes.up=z",
            f"scenes.poses={folder}/poses.txt", "scenes.height=64"]  # fmt: skip


@pytest.mark.parametrize("axes", ["flu", "ned"])
def test_poses_in_the_axes_of_a_body_see_the_same(tmp_path: Path, axes: str) -> None:
    expected = frame_of(world(tmp_path, POSES["optical"]))
    other = tmp_path / axes
    other.mkdir()
    frame = frame_of([*world(other, POSES[axes]), f"scenes.poses_frame={axes}"])
    assert frame.depth_m == pytest.approx(expected.depth_m, abs=1e-4)
    assert frame.world_from_camera == pytest.approx(expected.world_from_camera, abs=1e-5)
    assert (frame.depth_m > 0).mean() > 0.3
    assert len(frame.ref.location) <= 96


def test_a_frame_that_sees_nothing_names_the_axes(tmp_path: Path) -> None:
    words = world(tmp_path, POSES["flu"])
    with pytest.raises(FrameError, match=r"poses_frame=optical .*poses_frame=flu or ned"):
        frame_of([*words, "scenes.hfov_deg=60", "scenes.vfov_deg=20"])


def test_axes_without_poses_are_refused(tmp_path: Path) -> None:
    words = world(tmp_path, POSES["flu"])
    with pytest.raises(FactoryError, match="poses_frame"):
        compose_config([*words, "scenes.poses=null", "scenes.poses_frame=ned"])


def write_pages(path: Path, second: np.ndarray, subfile_type: int | None) -> Path:
    tags = TiffImagePlugin.ImageFileDirectory_v2()
    if subfile_type is not None:
        tags[254] = subfile_type
    first = Image.fromarray(np.full((48, 64), 2.5, np.float32))
    with TiffImagePlugin.AppendingTiffWriter(str(path), True) as writer:
        first.save(writer, format="TIFF")
        writer.newFrame()
        Image.fromarray(second).save(writer, format="TIFF", tiffinfo=tags)
    return path


@pytest.mark.parametrize("shape", [(48, 64), (24, 32), (30, 50)])
def test_a_second_depth_map_of_any_size_is_refused(tmp_path: Path, shape: tuple[int, int]) -> None:
    second = np.full(shape, 4, np.float32)
    with pytest.raises(FrameError, match="holds 2 images"):
        read_depth(write_pages(tmp_path / "two.tif", second, None))


def test_a_marked_overview_counts_for_nothing(tmp_path: Path) -> None:
    second = np.full((24, 32), 4, np.float32)
    depth_m = read_depth(write_pages(tmp_path / "overview.tif", second, 1))
    assert depth_m.shape == (48, 64)
    path = tmp_path / "overview-first.tif"
    with tifffile.TiffWriter(path) as writer:
        writer.write(second, subfiletype=1, metadata=None)
        writer.write(np.full((48, 64), 2.5, np.float32), metadata=None)
    assert read_depth(path).shape == (48, 64)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes of POSIX")
def test_a_named_pipe_in_a_list_is_no_frame(tmp_path: Path) -> None:
    words = write_list(tmp_path, ground(120, 160))
    (tmp_path / "a.npy").unlink()
    os.mkfifo(tmp_path / "a.npy")
    with pytest.raises(FrameError):
        frame_of(words)
