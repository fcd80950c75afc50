"""FLSea VI: forward-looking underwater video of the Mediterranean and the Red Sea with depth maps.

    <location>/<scene>/imgs/<timestamp>.tiff                     968x608 RGB
    <location>/<scene>/depth/<timestamp>_SeaErra_abs_depth.tif   968x608 float32 metres, 0 = none
    <location>/calibration/*kalibr-results-imucam.txt            lens calibration

The public archive repeats the scene folder (canyons/flatiron/flatiron/imgs) and older drops name
the depth <timestamp>_abs_depth.tif; both are read.  The set has no camera poses.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field
from pydantic.dataclasses import dataclass

from ..frame import Frame, FrameRef, Intrinsics
from ..settings import STRICT
from .base import Discovery, Found, Root, SceneSettings, readable, root_folder, visible_files
from .calibration import finished_frame, read_kalibr, scaled
from .images import read_depth, read_rgb

_CANYONS = ("flatiron", "horse_canyon", "tiny_canyon", "u_canyon")
_RED_SEA = ("big_dice_loop", "coral_table_loop", "cross_pyramid_loop", "dice_path", "landward_path",
            "northeast_path", "pier_path", "sub_pier")  # fmt: skip
SCENES = dict.fromkeys(_CANYONS, "canyons") | dict.fromkeys(_RED_SEA, "red_sea")
"""Scene -> location, all twelve, sorted by location and name."""

# What the calibration files of the set hold, for downloads that lack them.  The distortion of the
# Red Sea camera is published in its calibration file alone.
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


def _known(scenes: tuple[str, ...] | None) -> tuple[str, ...] | None:
    for scene in scenes or ():
        if scene not in SCENES:
            raise ValueError(f"unknown scene {scene!r}; the {len(SCENES)} are {', '.join(SCENES)}")
    return scenes


@dataclass(frozen=True, config=STRICT, kw_only=True)
class FlseaSettings(SceneSettings):
    """Keys of `scenes=flsea`.

    root: folder of canyons/ and red_sea/, or one location folder, or one scene folder.
    scenes: which of the twelve scenes to use, by name; None uses every one that is there.
    undistort: take the lens distortion out of colour and depth (same camera matrix).
    """

    kind: Literal["flsea"] = "flsea"
    root: Root
    scenes: Annotated[
        Annotated[tuple[str, ...], Field(min_length=1)] | None, AfterValidator(_known)
    ] = None
    undistort: bool = False


class FlseaReader:
    """Finds the scenes that were downloaded and reads their frames."""

    def __init__(self, settings: FlseaSettings) -> None:
        self.settings = settings

    def discover(self) -> Discovery:
        """See `simnfnd.factory.scenes.base.Reader`."""
        given = f"scenes.root={self.settings.root}"
        root, found = root_folder(self.settings.root, _EXPECTED), Found()
        folders: dict[str, Path] = {}
        absent: list[str] = []
        calibrations: dict[str, Path | None] = {}
        for scene in (one for one in SCENES if one in (self.settings.scenes or SCENES)):
            with readable(root):
                if (folder := _scene_folder(root, scene)) is None:
                    absent.append(scene)
                    continue
                calibration = _calibration_file(folder, SCENES[scene])
                _scan(folder, scene, calibration, found)
            calibrations.setdefault(SCENES[scene], calibration)
            folders[scene] = folder
        notes = [f"FLSea: {len(folders)} of {len(SCENES)} scenes"]
        if absent:
            notes.append(f"FLSea scenes not found here, left out: {', '.join(absent)}")
        notes += [self._calibration_note(*item) for item in calibrations.items()]
        found.notes = notes
        if folders:
            counts = [f"{n} x {reason}" for reason, n in sorted(found.skipped.items()) if n]
            return found.discovery(
                f"{given}: no frame in {', '.join(folders)} ({', '.join(counts) or 'empty'}); "
                f"expected imgs/<timestamp>.tiff and depth/<timestamp>{_DEPTH_ENDINGS[0]}"
            )
        asked = " or ".join(("FLSea scene", *(self.settings.scenes or ()))).replace(" or ", " ", 1)
        return found.discovery(
            f"{given}: no {asked} here, looked for <location>/<scene>/imgs such as "
            f"canyons/u_canyon/imgs; set scenes.root to {_EXPECTED}"
        )

    def load(self, ref: FrameRef) -> Frame:
        """See `simnfnd.factory.scenes.base.Reader`."""
        image, depth, *calibration = map(Path, ref.paths)
        rgb = read_rgb(image)
        depth_m = read_depth(depth, units_per_m=None)
        known = read_kalibr(calibration[0]) if calibration else BUILT_IN[ref.location]
        intrinsics = scaled(known, CALIBRATED_SIZE, (rgb.shape[1], rgb.shape[0]))
        return finished_frame(
            ref, rgb, depth_m, intrinsics, self.settings, undistort=self.settings.undistort
        )

    def _calibration_note(self, location: str, calibration: Path | None) -> str:
        known = read_kalibr(calibration) if calibration else BUILT_IN[location]
        source = calibration.name if calibration else "built in, no Kalibr file found"
        note = f"{location}: intrinsics {source}"
        if self.settings.undistort and not known.distortion:
            note += "; lens distortion unknown, images are not undistorted"
        return note


def _scene_folder(root: Path, scene: str) -> Path | None:
    """The folder that holds the scene's imgs/, wherever `root` starts in the tree."""
    starts = [root / SCENES[scene] / scene, root / scene]
    if Path(os.path.abspath(root)).name == scene:
        starts.append(root)
    for start in starts:
        for folder in (start, start / scene):
            if (folder / "imgs").is_dir():
                return folder
    return None


def _calibration_file(folder: Path, location: str) -> Path | None:
    """The Kalibr result of the location that a scene folder lies in, by name the first of many."""
    for parent in Path(os.path.abspath(folder)).parents[:2]:
        if parent.name == location and (parent / "calibration").is_dir():
            found = (parent / "calibration").rglob("*kalibr-results-imucam.txt")
            return min(filter(Path.is_file, found), default=None)
    return None


def _scan(folder: Path, scene: str, calibration: Path | None, found: Found) -> None:
    """Add the scene's images that have a depth map, by time stamp; the others are counted."""
    depths = set(visible_files(folder / "depth"))
    images: dict[str, str] = {}
    for name in visible_files(folder / "imgs"):
        stem, suffix = os.path.splitext(name)
        if suffix.lower() in _IMAGE_SUFFIXES:
            images.setdefault(stem, name)
    for stem in sorted(images):
        depth = next((stem + end for end in _DEPTH_ENDINGS if stem + end in depths), None)
        if depth is None:
            found.skipped["image without a depth map"] += 1
            continue
        depths.remove(depth)
        paths = [folder / "imgs" / images[stem], folder / "depth" / depth]
        paths += [calibration] if calibration else []
        found.frames.append(FrameRef(SCENES[scene], scene, stem, tuple(map(str, paths))))
    lonely = sum(name.endswith(_DEPTH_ENDINGS) for name in depths)
    found.skipped["depth map without an image"] += lonely
