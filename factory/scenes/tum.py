"""TUM RGB-D recordings: rgb.txt and depth.txt list time-stamped images of a Kinect.

    <recording>/rgb.txt, depth.txt      `time file` lines, seconds
    <recording>/groundtruth.txt         `time tx ty tz qx qy qz qw`, world from camera, optional

Colour and depth are taken at different times, and associated when close enough.  Depth is
registered to the colour image already.  Lens distortion is left alone: the depth was registered
with the factory's model, so undistorting it again would move it off the colour image.
"""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from ..errors import FactoryError
from ..frame import Frame, FrameRef, Intrinsics
from ..settings import STRICT
from .base import INTEGERS_PER_M, Discovery, SceneSettings
from .calibration import Pinhole, scaled
from .images import read_depth, read_rgb
from .poses import numbered_lines, pose_at
from .rgbd import finished_frame
from .roots import (
    LeftOut,
    Root,
    folder_name,
    is_there,
    recordings,
    root_folder,
)

# Colour cameras of the three Kinects as the set publishes them.
FREIBURG = {
    1: Intrinsics(517.3, 516.5, 318.6, 255.3),
    2: Intrinsics(520.9, 521.0, 325.1, 249.7),
    3: Intrinsics(535.4, 539.2, 320.1, 247.6),
}
CALIBRATED_SIZE = (640, 480)  # width, height

_EXPECTED = "a recording (a folder with rgb.txt and depth.txt) or to a folder of recordings"


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


class TumReader:
    """Associates colour, depth and ground truth by time and reads the frames."""

    def __init__(self, settings: TumSettings) -> None:
        self.settings = settings

    def discover(self) -> Discovery:
        """See `simnfnd.factory.scenes.base.Reader`."""
        root = root_folder(self.settings.root, _EXPECTED)
        frames: list[FrameRef] = []
        skipped: Counter[str] = Counter()
        notes: list[str] = []
        left_out = LeftOut()
        for folder in recordings(root, _is_recording, left_out):
            self._camera(folder_name(folder))  # report an unknown camera now, not at every frame
            with left_out.unreadable(folder):
                found, images, depths = self._associated(folder)
                frames += found
                skipped["image without a depth map close in time"] += images - len(found)
                skipped["depth map without an image close in time"] += depths - len(found)
                if not (folder / "groundtruth.txt").is_file():
                    notes.append(f"{folder_name(folder)}: no groundtruth.txt, frames have no pose")
        if not frames:
            left_out.check()
            raise FactoryError(
                f"scenes.root={self.settings.root}: no frame found; set scenes.root to {_EXPECTED}"
            )
        if not any(is_there(path) for ref in frames for path in ref.paths[:2]):
            raise FactoryError(
                f"scenes.root={self.settings.root}: none of the {len(frames)} frames listed in "
                f"rgb.txt and depth.txt exists, the first is {frames[0].paths[0]}; unpack the "
                "images beside the lists"
            )
        frames.sort(key=lambda ref: (ref.location, ref.scene, ref.frame))
        skipped.update(left_out.skipped)
        counts = {reason: count for reason, count in sorted(skipped.items()) if count}
        return Discovery(tuple(frames), counts, tuple(notes), left_out.warnings)

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

    def _associated(self, folder: Path) -> tuple[list[FrameRef], int, int]:
        """Frames of one recording and how many colour and depth images it lists."""
        images, depths = _listed(folder / "rgb.txt"), _listed(folder / "depth.txt")
        image_times, depth_times = list(images), list(depths)
        pairs = associated(
            [float(time) for time in image_times],
            [float(time) for time in depth_times],
            self.settings.max_time_difference_s,
        )
        trajectory = folder / "groundtruth.txt"
        pose = (str(trajectory),) if trajectory.is_file() else ()
        frames = [
            FrameRef(
                "",
                folder_name(folder),
                image_times[i],
                (
                    str(folder / images[image_times[i]]),
                    str(folder / depths[depth_times[d]]),
                    *pose,
                ),
            )
            for i, d in pairs
        ]
        return frames, len(images), len(depths)


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


def _is_recording(folder: Path) -> bool:
    return (folder / "rgb.txt").is_file() and (folder / "depth.txt").is_file()


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
