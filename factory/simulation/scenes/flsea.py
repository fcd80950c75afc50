"""FLSea VI: forward-looking underwater video of the Mediterranean and the Red Sea with depth maps.

    <location>/<scene>/imgs/<timestamp>.tiff                     968x608 RGB
    <location>/<scene>/depth/<timestamp>_SeaErra_abs_depth.tif   968x608 float32 metres, 0 = none

The public archive repeats the scene folder (canyons/flatiron/flatiron/imgs) and older drops name
the depth <timestamp>_abs_depth.tif; both are read.  The set has no camera poses.
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field
from pydantic.dataclasses import dataclass

from ...common.errors import FactoryError
from ...common.settings import STRICT
from ...dataset.frame_ref import FrameRef
from ..frames.frame import Frame, Intrinsics
from .base import BadDepth, Discovery, Root, SceneSettings, discovery
from .frame_files import read_depth, read_frame, read_rgb

_CANYONS = ("flatiron", "horse_canyon", "tiny_canyon", "u_canyon")
_RED_SEA = ("big_dice_loop", "coral_table_loop", "cross_pyramid_loop", "dice_path", "landward_path",
            "northeast_path", "pier_path", "sub_pier")  # fmt: skip
SCENES = dict.fromkeys(_CANYONS, "canyons") | dict.fromkeys(_RED_SEA, "red_sea")
"""Scene -> location, all twelve, sorted by location and name."""

# What the calibration files of the set hold.
BUILT_IN = {
    "canyons": Intrinsics(
        1175.3913431656817, 1174.2805075232263, 466.2595428966926, 271.2116633091501,
        (-0.13280386913948822, 0.09799479194607102, -0.004731205238184176, 0.0007132375646502103),
    ),
    "red_sea": Intrinsics(
        1296.666758476217, 1300.831316354508, 501.50386149846, 276.161712082695
    ),
}  # fmt: skip
CALIBRATED_SIZE = (968, 608)  # width, height

_IMAGE_SUFFIXES = (".tiff", ".tif", ".png", ".jpg")
_DEPTH_ENDINGS = ("_SeaErra_abs_depth.tif", "_abs_depth.tif")
_EXPECTED = "the folder that holds canyons/ and red_sea/, or to one location or scene in it"


@dataclass(frozen=True, config=STRICT, kw_only=True)
class FlseaSettings(SceneSettings):
    """Keys of `scenes=flsea`.

    root: folder of canyons/ and red_sea/, or one location folder, or one scene folder.
    scenes: which of the twelve scenes to use, by name; None uses every one that is there.
    bad_depth: see `BadDepth`.
    """

    kind: Literal["flsea"] = "flsea"
    root: Root
    scenes: Annotated[tuple[str, ...], Field(min_length=1)] | None = None
    bad_depth: BadDepth = "reject"


class FlseaReader:
    """Finds the scenes that were downloaded and reads their frames."""

    def __init__(self, settings: FlseaSettings) -> None:
        self.settings = settings

    def discover(self) -> Discovery:
        """See `simnfnd.factory.simulation.scenes.base.Reader`."""
        root_setting = f"scenes.root={self.settings.root}"
        requested_scenes = self.settings.scenes or tuple(SCENES)
        root = os.path.abspath(Path(self.settings.root).expanduser())
        if not os.path.isdir(root):
            raise FactoryError(f"{root_setting}: no such folder; set scenes.root to {_EXPECTED}")
        folder_of_scene = _scene_folders(Path(root))
        skipped = Counter[str]()
        folders = {
            scene: folder_of_scene[scene]
            for scene in SCENES
            if scene in requested_scenes and scene in folder_of_scene
        }
        frames = [ref for item in folders.items() for ref in _frames(*item, skipped)]
        notes = [f"FLSea: {len(folders)} of {len(SCENES)} scenes"]
        if absent := [scene for scene in requested_scenes if scene not in folder_of_scene]:
            notes.append(f"FLSea scenes not found here, left out: {', '.join(absent)}")
        named = f" {' or '.join(requested_scenes)}" if len(requested_scenes) < len(SCENES) else ""
        nothing = (
            f"no FLSea scene{named} here with imgs/<timestamp>.tiff and depth/<timestamp>"
            f"{_DEPTH_ENDINGS[0]}; set scenes.root to {_EXPECTED}"
        )
        return discovery(frames, f"{root_setting}: {nothing}", skipped, notes)

    def load(self, ref: FrameRef) -> Frame:
        """See `simnfnd.factory.simulation.scenes.base.Reader`."""
        image, depth = map(Path, ref.paths)
        rgb = read_rgb(image)
        depth_m = read_depth(depth)
        lens = _scaled(BUILT_IN[ref.location], rgb.shape[1], rgb.shape[0])
        return read_frame(ref, rgb, depth_m, lens, self.settings.bad_depth)


def _scaled(lens: Intrinsics, width: int, height: int) -> Intrinsics:
    """The lens for images of another size: pixel centres are at whole numbers."""
    x = width / CALIBRATED_SIZE[0]
    y = height / CALIBRATED_SIZE[1]
    if (x, y) == (1.0, 1.0):
        return lens
    centre = (lens.cx + 0.5) * x - 0.5, (lens.cy + 0.5) * y - 0.5
    return Intrinsics(lens.fx * x, lens.fy * y, *centre, lens.distortion)


def _scene_folders(root: Path) -> dict[str, Path]:
    """Scene -> the folder that holds its imgs/, wherever `root` starts in the tree."""
    folder_of_scene: dict[str, Path] = {}
    for levels in range(4):
        for images in sorted(root.glob("*/" * levels + "imgs")):
            if images.parent.name in SCENES:
                folder_of_scene.setdefault(images.parent.name, images.parent)
    return folder_of_scene


def _frames(scene: str, folder: Path, skipped: Counter[str]) -> list[FrameRef]:
    """The scene's images that have a depth map, by time stamp; the others are counted."""
    depths = set(_visible_files(folder / "depth"))
    images = dict[str, str]()
    frames = []
    for name in _visible_files(folder / "imgs"):
        stem, suffix = os.path.splitext(name)
        if suffix.lower() in _IMAGE_SUFFIXES:
            images.setdefault(stem, name)
    for stem in sorted(images):
        depth = next((stem + end for end in _DEPTH_ENDINGS if stem + end in depths), None)
        if depth is None:
            skipped["image without a depth map"] += 1
            continue
        depths.remove(depth)
        paths = str(folder / "imgs" / images[stem]), str(folder / "depth" / depth)
        frames.append(FrameRef(SCENES[scene], scene, stem, paths))
    lonely = sum(name.endswith(_DEPTH_ENDINGS) for name in depths)
    skipped["depth map without an image"] += lonely
    return frames


def _visible_files(folder: Path) -> list[str]:
    """Names of the files of a folder, sorted; nothing when the folder is not there.

    Without those that start with a dot: archives made on a Mac carry a `._x.tiff` beside `x.tiff`.
    """
    if not folder.is_dir():
        return []
    with os.scandir(folder) as entries:
        return sorted(entry.name for entry in entries if entry.name[0] != "." and entry.is_file())
