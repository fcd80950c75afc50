"""TUM RGB-D recordings: rgb.txt and depth.txt list time-stamped images of a Kinect.

    <recording>/rgb.txt, depth.txt      `time file` lines, seconds
    <recording>/groundtruth.txt         `time tx ty tz qx qy qz qw`, world from camera, optional

Colour and depth are taken at different times, and associated when close enough.  Depth is
registered to the colour image already.  Lens distortion is left alone: the depth was registered
with the factory's model, so undistorting it again would move it off the colour image.
"""

from __future__ import annotations

import math
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field
from pydantic.dataclasses import dataclass

from ..errors import FactoryError
from ..frame import Frame, FrameRef, Intrinsics
from ..settings import STRICT
from .base import (
    INTEGERS_PER_M,
    Discovery,
    FolderReader,
    Found,
    Root,
    SceneSettings,
    check_some_exist,
    folder_name,
    numbered_lines,
)
from .calibration import Pinhole, finished_frame, scaled
from .images import read_depth, read_rgb

Pose = npt.NDArray[np.float64]

# Colour cameras of the three Kinects as the set publishes them.
FREIBURG = {
    1: Intrinsics(517.3, 516.5, 318.6, 255.3),
    2: Intrinsics(520.9, 521.0, 325.1, 249.7),
    3: Intrinsics(535.4, 539.2, 320.1, 247.6),
}
CALIBRATED_SIZE = (640, 480)  # width, height


@dataclass(frozen=True, config=STRICT, kw_only=True)
class TumSettings(SceneSettings):
    """Keys of `scenes=tum`.

    root: one recording or a folder of recordings; each is a scene.
    intrinsics: fx, fy, cx, cy of the images; None takes the Freiburg 1, 2 or 3 camera that the
        folder's name tells (`freiburg1` or `fr1`).
    depth_scale: what the numbers in the depth files are divided by to give metres; None: integers
        by 5000, and floating-point numbers are metres already.
    max_time_difference_s: colour, depth and pose further apart in time do not belong together.
    """

    kind: Literal["tum"] = "tum"
    root: Root
    intrinsics: Pinhole | None = None
    depth_scale: Annotated[float, Field(gt=0)] | None = None
    max_time_difference_s: Annotated[float, Field(ge=0)] = 0.02


class TumReader(FolderReader):
    """Associates colour, depth and ground truth by time and reads the frames."""

    expected = "a recording (a folder with rgb.txt and depth.txt) or to a folder of recordings"

    def __init__(self, settings: TumSettings) -> None:
        self.settings, self.root = settings, settings.root

    def is_recording(self, folder: Path) -> bool:
        """See `FolderReader`."""
        return (folder / "rgb.txt").is_file() and (folder / "depth.txt").is_file()

    def scan(self, folder: Path, found: Found) -> None:
        """See `FolderReader`."""
        name, trajectory = folder_name(folder), folder / "groundtruth.txt"
        self._camera(name)  # report an unknown camera now, not at every frame
        images, depths = _listed(folder / "rgb.txt"), _listed(folder / "depth.txt")
        stamps = [[float(stamp) for stamp in listed] for listed in (images, depths)]
        pairs = associated(stamps[0], stamps[1], self.settings.max_time_difference_s)
        pose = (str(trajectory),) if trajectory.is_file() else ()
        image_items, depth_files = list(images.items()), list(depths.values())
        for i, d in pairs:
            stamp, image = image_items[i]
            paths = (str(folder / image), str(folder / depth_files[d]), *pose)
            found.frames.append(FrameRef("", name, stamp, paths))
        found.skipped["image without a depth map close in time"] += len(images) - len(pairs)
        found.skipped["depth map without an image close in time"] += len(depths) - len(pairs)
        if not pose:
            found.notes.append(f"{name}: no groundtruth.txt, frames have no pose")

    def discover(self) -> Discovery:
        """See `simnfnd.factory.scenes.base.Reader`."""
        discovery = super().discover()
        remedy = "unpack the images beside rgb.txt and depth.txt"
        check_some_exist(discovery.frames, f"scenes.root={self.root}", remedy)
        return discovery

    def load(self, ref: FrameRef) -> Frame:
        """See `simnfnd.factory.scenes.base.Reader`."""
        image, depth, *trajectory = map(Path, ref.paths)
        rgb = read_rgb(image)
        depth_m = read_depth(depth, self.settings.depth_scale, INTEGERS_PER_M["tum"])
        intrinsics = self._camera(ref.scene)
        if self.settings.intrinsics is None:
            intrinsics = scaled(intrinsics, CALIBRATED_SIZE, (rgb.shape[1], rgb.shape[0]))
        pose = None
        if trajectory:
            pose = pose_at(trajectory[0], float(ref.frame), self.settings.max_time_difference_s)
        return finished_frame(ref, rgb, depth_m, intrinsics, self.settings, world_from_camera=pose)

    def _camera(self, recording: str) -> Intrinsics:
        if self.settings.intrinsics is not None:
            return Intrinsics(*self.settings.intrinsics)
        for number, intrinsics in FREIBURG.items():
            if f"freiburg{number}" in recording.lower() or f"fr{number}" in recording.lower():
                return intrinsics
        raise FactoryError(
            f"scenes.root={self.settings.root}: the folder name {recording!r} tells no camera "
            "(freiburg1, 2, 3 or fr1, 2, 3); set scenes.intrinsics=[fx,fy,cx,cy]"
        )


def associated(
    first_s: list[float], second_s: list[float], max_difference_s: float
) -> list[tuple[int, int]]:
    """Pairs of indices whose times are closest, each index once, ordered by the first index.

    Greedy: of all pairs within `max_difference_s` the closest is taken first; equal differences
    go to the earlier times.
    """
    order = np.argsort(second_s, kind="stable")
    sorted_s = np.asarray(second_s, dtype=np.float64)[order]
    candidates: list[tuple[float, float, float, int, int]] = []
    for i, time in enumerate(first_s):
        start = np.searchsorted(sorted_s, time - max_difference_s, side="left")
        stop = np.searchsorted(sorted_s, time + max_difference_s, side="right")
        for j in order[start:stop]:
            candidates.append((abs(time - second_s[j]), time, second_s[j], i, int(j)))
    taken_first: set[int] = set()
    taken_second: set[int] = set()
    pairs = []
    for *_, i, j in sorted(candidates):
        if i not in taken_first and j not in taken_second:
            taken_first.add(i)
            taken_second.add(j)
            pairs.append((i, j))
    return sorted(pairs)


def _listed(path: Path) -> dict[str, str]:
    """Time stamp as written -> file name, of a `time file` list."""
    files: dict[str, str] = {}
    for number, line in numbered_lines(path):
        words = line.split(maxsplit=1)
        if len(words) != 2 or not _is_time(words[0]):
            raise FactoryError(
                f"{path}:{number}: expected `time file`, got {line[:60]!r}; repair the line"
            )
        files.setdefault(words[0], words[1])
    return files


def _is_time(word: str) -> bool:
    try:
        return math.isfinite(float(word))
    except ValueError:
        return False


def pose_at(path: Path, time_s: float, max_time_difference_s: float) -> Pose | None:
    """(4, 4) world-from-camera pose nearest in time in a TUM trajectory, None when none is near."""
    times, poses = trajectory(path)
    if times.size == 0:
        return None
    nearest = int(np.argmin(np.abs(times - time_s)))
    if abs(times[nearest] - time_s) > max_time_difference_s:
        return None
    return np.asarray(poses[nearest])


@lru_cache(maxsize=4)
def trajectory(path: Path) -> tuple[Pose, Pose]:
    """Times (N,) in seconds and poses (N, 4, 4) from `time tx ty tz qx qy qz qw` lines."""
    rows = []
    for number, line in numbered_lines(path):
        try:
            row = [float(word) for word in line.replace(",", " ").split()]
        except ValueError:
            row = []
        if len(row) != 8 or not np.isfinite(row).all() or not any(row[4:]):
            raise FactoryError(
                f"{path}:{number}: expected `time tx ty tz qx qy qz qw`, got {line[:60]!r}; "
                "repair the line, or remove the file to go without poses"
            )
        rows.append(row)
    table = np.array(rows, dtype=np.float64).reshape(-1, 8)
    poses = np.tile(np.eye(4), (len(table), 1, 1))
    poses[:, :3, :3] = _rotations(table[:, 4:])
    poses[:, :3, 3] = table[:, 1:4]
    return table[:, 0], poses


def _rotations(quaternions_xyzw: Pose) -> Pose:
    """(N, 4) quaternions of any length but 0 -> (N, 3, 3) rotation matrices."""
    length = np.linalg.norm(quaternions_xyzw, axis=1, keepdims=True)
    axis, w = np.split(quaternions_xyzw / length, [3], axis=1)
    # R = (w^2 - a.a) I + 2 a a^T + 2 w [a]x  (Rodrigues' formula for the unit quaternion (a, w))
    outer = axis[:, :, None] * axis[:, None, :]
    cross = np.cross(axis[:, None, :], np.eye(3)[None], axisa=2, axisb=2)
    square = (w**2 - np.sum(axis**2, axis=1, keepdims=True))[:, :, None]
    return np.asarray(square * np.eye(3) + 2 * outer - 2 * w[:, :, None] * cross)
