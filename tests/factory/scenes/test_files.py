"""Images, depth maps, calibration and trajectories as files: golden values and damage."""

from __future__ import annotations

import functools
import io
import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.frame import Intrinsics
from simnfnd.factory.scenes.frame_files import (
    read_depth,
    read_rgb,
    undistorted,
    z_from_range,
)
from simnfnd.factory.scenes.mesh import trajectory

Array = npt.NDArray[Any]


def encoded(array: Array, kind: str, **options: object) -> bytes:
    buffer = io.BytesIO()
    Image.fromarray(array).save(buffer, kind, **options)
    return buffer.getvalue()


@functools.cache
def samples() -> dict[str, tuple[bytes, Array]]:
    rng = np.random.default_rng(7)
    depth = rng.uniform(0.5, 9, (24, 30)).astype(np.float32)
    rgb = rng.integers(0, 256, (24, 30, 3), dtype=np.uint8)
    millimetres = np.round(depth * 1000).astype(np.uint16)
    return {
        "depth-lzw.tif": (encoded(depth, "TIFF", compression="tiff_lzw"), depth),
        "depth-raw.tif": (encoded(depth, "TIFF"), depth),
        "depth-16.png": (encoded(millimetres, "PNG"), millimetres / np.float32(1000)),
        "rgb-lzw.tiff": (encoded(rgb, "TIFF", compression="tiff_lzw"), rgb),
        "rgb.png": (encoded(rgb, "PNG"), rgb),
    }


def read(path: Path) -> Array:
    return read_depth(path, None) if path.name.startswith("depth") else read_rgb(path)


def attempt(path: Path) -> tuple[Array | None, str]:
    """What the file holds, or the text of the FrameError; any other exception passes."""
    try:
        return read(path), ""
    except FrameError as error:
        return None, str(error)


@pytest.mark.parametrize("name", sorted(samples()))
def test_what_was_written_is_read(name: str, tmp_path: Path) -> None:
    data, expected = samples()[name]
    (tmp_path / name).write_bytes(data)
    found = read(tmp_path / name)
    assert found.dtype == (np.float32 if name.startswith("depth") else np.uint8)
    np.testing.assert_allclose(found, expected, rtol=1e-7)


@settings(max_examples=30)
@given(st.sampled_from(sorted(samples())), st.floats(0, 1, exclude_max=True))
def test_a_truncated_file_is_refused_and_never_half_read(
    tmp_path_factory: pytest.TempPathFactory, name: str, fraction: float
) -> None:
    data, expected = samples()[name]
    path = tmp_path_factory.mktemp("cut") / name
    path.write_bytes(data[: int(len(data) * fraction)])
    found, fault = attempt(path)
    if found is None:
        assert fault.startswith(str(path))
        assert "\n" not in fault
    else:  # only bytes after the last pixel were missing
        np.testing.assert_allclose(found, expected, rtol=1e-7)


def test_a_damaged_tiff_writes_nothing_to_stderr(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(samples()["depth-lzw.tif"][0])
    data[200:260] = b"\xff" * 60
    (tmp_path / "depth.tif").write_bytes(data)
    with pytest.raises(FrameError, match="truncated or damaged"):
        read_depth(tmp_path / "depth.tif", 1000.0)
    assert capfd.readouterr().err == ""
    os.write(2, b"still here\n")
    assert capfd.readouterr().err == "still here\n"


@pytest.mark.parametrize(
    ("array", "message"),
    [
        (np.zeros((4, 5, 3), np.float32), "one channel"),
        (np.zeros((4, 5), np.uint8), "holds no distances"),
        (np.zeros((4, 5), bool), "holds no distances"),
        (np.zeros((4, 5), np.complex64), "holds no distances"),
        (np.array([[None]]), "damaged"),
    ],
)
def test_arrays_that_are_no_depth(tmp_path: Path, array: Array, message: str) -> None:
    np.save(tmp_path / "depth.npy", array)
    with pytest.raises(FrameError, match=message):
        read_depth(tmp_path / "depth.npy", 1000.0)


def test_depth_units_follow_the_type(tmp_path: Path) -> None:
    np.save(tmp_path / "whole.npy", np.array([[2500, 0]], np.int32))
    np.save(tmp_path / "double.npy", np.array([[2.5, 1e300]]))
    np.testing.assert_array_equal(read_depth(tmp_path / "whole.npy", None), [[2.5, 0]])
    np.testing.assert_array_equal(read_depth(tmp_path / "double.npy", None), [[2.5, np.inf]])
    np.testing.assert_array_equal(read_depth(tmp_path / "double.npy", 5.0), [[0.5, np.inf]])


def test_colour_is_rgb_whatever_the_file(tmp_path: Path) -> None:
    grey = np.arange(20, dtype=np.uint8).reshape(4, 5)
    Image.fromarray(grey).save(tmp_path / "grey.png")
    np.testing.assert_array_equal(read_rgb(tmp_path / "grey.png"), np.dstack([grey] * 3))
    Image.fromarray(grey.astype(np.uint16) * 256).save(tmp_path / "deep.png")
    with pytest.raises(FrameError, match="8-bit"):
        read_rgb(tmp_path / "deep.png")
    with pytest.raises(FrameError, match="no such file"):
        read_rgb(tmp_path / "absent.png")


def test_range_of_a_sphere_becomes_points_at_its_radius() -> None:
    camera = Intrinsics(60.0, 55.0, 30.2, 18.9)
    z = z_from_range(np.full((40, 64), 4.0, np.float32), camera)
    v, u = np.mgrid[:40, :64]
    points = np.stack([(u - 30.2) / 60 * z, (v - 18.9) / 55 * z, z], axis=-1)
    np.testing.assert_allclose(np.linalg.norm(points, axis=-1), 4.0, rtol=1e-6)
    assert z[19, 30] == pytest.approx(4.0, rel=1e-4)  # straight ahead
    assert z.dtype == np.float32
    assert (z_from_range(np.zeros((3, 3), np.float32), camera) == 0).all()


def test_undistortion_puts_a_plane_where_a_pinhole_sees_it() -> None:
    camera = Intrinsics(120.0, 125.0, 78.0, 61.0, (-0.3, 0.12, 0.004, -0.006))
    normal, distance = np.array([0.5, -0.3, 0.8]), 3.0

    def plane_depth(x: Array, y: Array) -> Array:
        return np.asarray(distance / (normal[0] * x + normal[1] * y + normal[2]), np.float32)

    v, u = np.mgrid[:120, :160].astype(np.float64)
    matrix = np.array([[camera.fx, 0, camera.cx], [0, camera.fy, camera.cy], [0, 0, 1]])
    seen = cv2.undistortPoints(
        np.stack([u, v], axis=-1).reshape(-1, 1, 2), matrix, np.array(camera.distortion)
    ).reshape(120, 160, 2)
    raw = plane_depth(seen[..., 0], seen[..., 1])
    ideal = plane_depth((u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy)
    ramp = np.rint(raw * 20).astype(np.uint8)

    rgb, depth_m = undistorted(np.dstack([ramp] * 3), raw, camera)
    inside = depth_m > 0
    assert inside.mean() > 0.8
    # The nearest of the raw pixels is at most half a pixel away in u and in v, and a raw pixel of
    # this lens covers at most 1.5 ideal ones.
    slope_v, slope_u = map(np.abs, np.gradient(ideal))
    error = np.abs(depth_m - ideal)
    assert (error <= 0.75 * (slope_u + slope_v))[inside].all()
    assert not (np.abs(raw - ideal) <= 0.75 * (slope_u + slope_v)).all()  # the lens did matter
    assert np.isin(depth_m, np.append(raw, 0)).all()  # nearest: no depth was made up
    np.testing.assert_allclose(rgb[20:-20, 20:-20, 0], ideal[20:-20, 20:-20] * 20, atol=1.5)


def test_tum_poses_against_scipy(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    quaternions = rng.normal(size=(5, 4))
    lines = ["# time tx ty tz qx qy qz qw"]
    lines += [
        f"{i / 10} {i} 2 3 {' '.join(map(repr, q.tolist()))}" for i, q in enumerate(quaternions)
    ]
    path = tmp_path / "groundtruth.txt"
    path.write_text("\n".join(lines))
    times, poses = trajectory(path)
    np.testing.assert_allclose(times, np.arange(5) / 10)
    for i, (quaternion, pose) in enumerate(zip(quaternions, poses, strict=True)):
        np.testing.assert_allclose(
            pose[:3, :3], Rotation.from_quat(quaternion).as_matrix(), atol=1e-12
        )
        np.testing.assert_array_equal(pose[:, 3], [i, 2, 3, 1])


@pytest.mark.parametrize(
    "line", ["1 2 3", "1 2 3 4 0 0 0 0", "1 2 3 4 0 0 0 x", "nan 2 3 4 0 0 0 1"]
)
def test_a_damaged_trajectory_names_file_and_line(tmp_path: Path, line: str) -> None:
    path = tmp_path / "groundtruth.txt"
    path.write_text(f"0 0 0 0 0 0 0 1\n{line}\n")
    with pytest.raises(FactoryError, match=r"groundtruth\.txt:2: expected"):
        trajectory(path)
