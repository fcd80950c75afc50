"""Redwood RGBD recordings.

    <recording>/color/00000.jpg      also rgb/ or image/
    <recording>/depth/00000.png      uint16 millimetres, 0 = no measurement
    <recording>/trajectory.log       world-from-camera poses by frame number, optional

Colour and depth belong together when the number their names start with is the same.
"""

from __future__ import annotations

import re
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from ..errors import FactoryError
from ..frame import Frame, FrameRef, Intrinsics
from ..settings import STRICT
from .base import Discovery, SceneSettings
from .calibration import Pinhole
from .images import read_depth, read_rgb
from .poses import redwood_poses
from .rgbd import finished_frame
from .roots import (
    LeftOut,
    Root,
    folder_name,
    recordings,
    root_folder,
    visible_files,
)

_COLOUR_FOLDERS = ("color", "rgb", "image")
_COLOUR_SUFFIXES = (".jpg", ".jpeg", ".png")
_EXPECTED = "a recording (a folder with color/ and depth/) or to a folder of recordings"


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


class RedwoodReader:
    """Pairs colour and depth by frame number and reads the frames."""

    def __init__(self, settings: RedwoodSettings) -> None:
        self.settings = settings

    def discover(self) -> Discovery:
        """See `simnfnd.factory.scenes.base.Reader`."""
        root = root_folder(self.settings.root, _EXPECTED)
        frames: list[FrameRef] = []
        skipped: Counter[str] = Counter()
        notes: list[str] = []
        left_out = LeftOut()
        for folder in recordings(root, lambda one: _colour_folder(one) is not None, left_out):
            with left_out.unreadable(folder):
                trajectory = folder / "trajectory.log"
                if has_poses := trajectory.is_file():
                    redwood_poses(trajectory)  # report a damaged file now, not at every frame
                frames += _recording_frames(folder, skipped)
                if not has_poses:
                    notes.append(f"{folder_name(folder)}: no trajectory.log, frames have no pose")
        if not frames:
            left_out.check()
            raise FactoryError(
                f"scenes.root={self.settings.root}: no frame found; set scenes.root to {_EXPECTED}"
            )
        frames.sort(key=lambda ref: (ref.location, ref.scene, ref.frame))
        skipped.update(left_out.skipped)
        return Discovery(
            tuple(frames), dict(sorted(skipped.items())), tuple(notes), left_out.warnings
        )

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


def _colour_folder(folder: Path) -> Path | None:
    if not (folder / "depth").is_dir():
        return None
    return next((folder / name for name in _COLOUR_FOLDERS if (folder / name).is_dir()), None)


def _recording_frames(folder: Path, skipped: Counter[str]) -> list[FrameRef]:
    colour = _colour_folder(folder)
    assert colour is not None
    images = _by_number(colour, _COLOUR_SUFFIXES)
    depths = _by_number(folder / "depth", (".png",))
    trajectory = folder / "trajectory.log"
    pose = (str(trajectory),) if trajectory.is_file() else ()
    if alone := len(images.keys() - depths.keys()):
        skipped["image without a depth map"] += alone
    if alone := len(depths.keys() - images.keys()):
        skipped["depth map without an image"] += alone
    return [
        FrameRef(
            "",
            folder_name(folder),
            Path(images[number]).stem,
            (str(colour / images[number]), str(folder / "depth" / depths[number]), *pose),
        )
        for number in sorted(images.keys() & depths.keys())
    ]


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
