"""FLSea VI: forward-looking underwater video of the Mediterranean and the Red Sea with depth maps.

    <location>/<scene>/imgs/<timestamp>.tiff                     968x608 RGB
    <location>/<scene>/depth/<timestamp>_SeaErra_abs_depth.tif   968x608 float32 metres, 0 = none
    <location>/calibration/*kalibr-results-imucam.txt            lens calibration

The public archive repeats the scene folder (canyons/flatiron/flatiron/imgs) and older drops name
the depth <timestamp>_abs_depth.tif; both are read.  The set has no camera poses.
"""

from __future__ import annotations

import os
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field
from pydantic.dataclasses import dataclass

from simnfnd.factory.errors import FactoryError
from simnfnd.factory.frame import Frame, FrameRef, Intrinsics
from simnfnd.factory.scenes.base import Discovery, SceneSettings
from simnfnd.factory.scenes.calibration import read_kalibr, scaled
from simnfnd.factory.scenes.images import read_depth, read_rgb
from simnfnd.factory.scenes.rgbd import finished_frame
from simnfnd.factory.scenes.roots import Root, listing, root_folder, visible_files
from simnfnd.factory.settings import STRICT

# Scene -> location, all twelve.
SCENES = {
    "flatiron": "canyons",
    "horse_canyon": "canyons",
    "tiny_canyon": "canyons",
    "u_canyon": "canyons",
    "big_dice_loop": "red_sea",
    "coral_table_loop": "red_sea",
    "cross_pyramid_loop": "red_sea",
    "dice_path": "red_sea",
    "landward_path": "red_sea",
    "northeast_path": "red_sea",
    "pier_path": "red_sea",
    "sub_pier": "red_sea",
}

# What the calibration files of the set hold, for downloads that lack them.  The distortion of the
# Red Sea camera is published in its calibration file alone.
BUILT_IN = {
    "canyons": Intrinsics(
        fx=1175.3913431656817,
        fy=1174.2805075232263,
        cx=466.2595428966926,
        cy=271.2116633091501,
        distortion=(
            -0.13280386913948822,
            0.09799479194607102,
            -0.004731205238184176,
            0.0007132375646502103,
        ),
    ),
    "red_sea": Intrinsics(
        fx=1296.666758476217, fy=1300.831316354508, cx=501.50386149846, cy=276.161712082695
    ),
}
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
        root = root_folder(self.settings.root, _EXPECTED)
        wanted = self.settings.scenes or tuple(SCENES)
        folders = {
            scene: folder
            for scene in sorted(set(wanted), key=lambda scene: (SCENES[scene], scene))
            if (folder := _scene_folder(root, scene)) is not None
        }
        if not folders:
            raise FactoryError(
                f"scenes.root={self.settings.root}: no {_asked(self.settings)} here, looked for "
                f"<location>/<scene>/imgs such as canyons/u_canyon/imgs; set scenes.root to "
                f"{_EXPECTED}"
            )
        frames: list[FrameRef] = []
        skipped: Counter[str] = Counter()
        calibrations: dict[str, Path | None] = {}
        for scene, folder in folders.items():
            calibration = _calibration_file(folder, SCENES[scene])
            calibrations.setdefault(SCENES[scene], calibration)
            frames += _scene_frames(folder, scene, calibration, skipped)
        if not frames:
            raise FactoryError(
                f"scenes.root={self.settings.root}: no frame in {', '.join(folders)} "
                f"({_counts(skipped)}); expected imgs/<timestamp>.tiff and "
                f"depth/<timestamp>{_DEPTH_ENDINGS[0]}"
            )
        notes = [f"FLSea: {len(folders)} of {len(SCENES)} scenes"]
        if absent := [scene for scene in SCENES if scene in wanted and scene not in folders]:
            notes.append(f"FLSea scenes not found here, left out: {', '.join(absent)}")
        notes += [self._calibration_note(*item) for item in calibrations.items()]
        return Discovery(tuple(frames), dict(sorted(skipped.items())), tuple(notes))

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
            with listing(folder):
                if (folder / "imgs").is_dir():
                    return folder
    return None


def _calibration_file(folder: Path, location: str) -> Path | None:
    """The Kalibr result of the location that a scene folder lies in, by name the first of many."""
    for parent in Path(os.path.abspath(folder)).parents[:2]:
        if parent.name == location:
            found = (parent / "calibration").glob("**/*kalibr-results-imucam.txt")
            return min(found, default=None)
    return None


def _scene_frames(
    folder: Path, scene: str, calibration: Path | None, skipped: Counter[str]
) -> list[FrameRef]:
    """The scene's images that have a depth map, by time stamp; the others are counted."""
    depths = set(visible_files(folder / "depth"))
    images: dict[str, str] = {}
    for name in visible_files(folder / "imgs"):
        stem, suffix = os.path.splitext(name)
        if suffix.lower() in _IMAGE_SUFFIXES:
            images.setdefault(stem, name)
    frames = []
    for stem in sorted(images):
        depth = next((stem + end for end in _DEPTH_ENDINGS if stem + end in depths), None)
        if depth is None:
            skipped["image without a depth map"] += 1
            continue
        depths.remove(depth)
        paths = [folder / "imgs" / images[stem], folder / "depth" / depth]
        paths += [calibration] if calibration else []
        frames.append(FrameRef(SCENES[scene], scene, stem, tuple(map(str, paths))))
    if lonely := sum(name.endswith(_DEPTH_ENDINGS) for name in depths):
        skipped["depth map without an image"] += lonely
    return frames


def _asked(settings: FlseaSettings) -> str:
    return f"FLSea scene {' or '.join(settings.scenes)}" if settings.scenes else "FLSea scene"


def _counts(skipped: Counter[str]) -> str:
    return ", ".join(f"{count} x {reason}" for reason, count in sorted(skipped.items())) or "empty"
