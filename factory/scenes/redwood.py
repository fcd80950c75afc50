"""Redwood RGBD recordings.

    <recording>/color/00000.jpg      also rgb/ or image/
    <recording>/depth/00000.png      uint16 millimetres, 0 = no measurement
    <recording>/trajectory.log       world-from-camera poses by frame number, optional

Colour and depth belong together when the number their names start with is the same.
"""

from __future__ import annotations

import re
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
    FolderReader,
    Found,
    Root,
    SceneSettings,
    folder_name,
    numbered_lines,
    visible_files,
)
from .calibration import Pinhole, finished_frame
from .images import read_depth, read_rgb

Pose = npt.NDArray[np.float64]


@dataclass(frozen=True, config=STRICT, kw_only=True)
class RedwoodSettings(SceneSettings):
    """Keys of `scenes=redwood`.

    root: one recording or a folder of recordings; each is a scene.
    intrinsics: fx, fy, cx, cy of the images as they are; the default is the PrimeSense camera at
        640x480 that the Redwood sets use.
    depth_scale: what the numbers in the depth files are divided by to give metres; None: integers
        by 1000 (millimetres), and floating-point numbers are metres already.
    """

    kind: Literal["redwood"] = "redwood"
    root: Root
    intrinsics: Pinhole = (525.0, 525.0, 319.5, 239.5)
    depth_scale: Annotated[float, Field(gt=0)] | None = None


class RedwoodReader(FolderReader):
    """Pairs colour and depth by frame number and reads the frames."""

    expected = "a recording (a folder with color/ and depth/) or to a folder of recordings"

    def __init__(self, settings: RedwoodSettings) -> None:
        self.settings, self.root = settings, settings.root

    def is_recording(self, folder: Path) -> bool:
        """See `FolderReader`."""
        return (folder / "depth").is_dir() and any(map(Path.is_dir, _colour_folders(folder)))

    def scan(self, folder: Path, found: Found) -> None:
        """See `FolderReader`."""
        name, trajectory = folder_name(folder), folder / "trajectory.log"
        colour = next(filter(Path.is_dir, _colour_folders(folder)))
        images = _by_number(colour, (".jpg", ".jpeg", ".png"))
        depths = _by_number(folder / "depth", (".png",))
        pose = (str(trajectory),) if trajectory.is_file() else ()
        if pose:
            redwood_poses(trajectory)  # report a damaged file now, not at every frame
        else:
            found.notes.append(f"{name}: no trajectory.log, frames have no pose")
        for number in sorted(images.keys() & depths.keys()):
            paths = (str(colour / images[number]), str(folder / "depth" / depths[number]), *pose)
            found.frames.append(FrameRef("", name, Path(images[number]).stem, paths))
        found.skipped["image without a depth map"] += len(images.keys() - depths.keys())
        found.skipped["depth map without an image"] += len(depths.keys() - images.keys())

    def load(self, ref: FrameRef) -> Frame:
        """See `simnfnd.factory.scenes.base.Reader`."""
        image, depth, *trajectory = map(Path, ref.paths)
        pose = redwood_poses(trajectory[0]).get(_number(ref.frame)) if trajectory else None
        return finished_frame(
            ref,
            read_rgb(image),
            read_depth(depth, self.settings.depth_scale),
            Intrinsics(*self.settings.intrinsics),
            self.settings,
            world_from_camera=pose,
        )


def _colour_folders(folder: Path) -> list[Path]:
    return [folder / name for name in ("color", "rgb", "image")]


def _by_number(folder: Path, suffixes: tuple[str, ...]) -> dict[int, str]:
    """Frame number -> file name (the first by name when several carry the number)."""
    files: dict[int, str] = {}
    for name in visible_files(folder):
        if name.lower().endswith(suffixes) and name[0].isdecimal():
            files.setdefault(_number(name), name)
    return files


def _number(name: str) -> int:
    """The whole number that a file name starts with."""
    digits = re.match(r"\d+", name)
    return int(digits.group()) if digits else -1


@lru_cache(maxsize=4)
def redwood_poses(path: Path) -> dict[int, Pose]:
    """Frame number -> (4, 4) world-from-camera pose.

    A record is five lines: three whole numbers, the first of which is the frame's, and the four
    rows of the matrix.
    """
    lines = list(numbered_lines(path))
    poses: dict[int, Pose] = {}
    for start in range(0, len(lines), 5):
        record = [line.split() for _, line in lines[start : start + 5]]
        try:
            pose = np.array(record[1:], dtype=np.float64).reshape(4, 4)
            if not np.isfinite(pose).all():
                raise ValueError
            poses[int(record[0][0])] = pose
        except (ValueError, IndexError) as error:
            raise FactoryError(
                f"{path}:{lines[start][0]}: expected a frame number line and four rows of a 4x4 "
                "pose; repair the file, or remove it to go without poses"
            ) from error
    return poses
