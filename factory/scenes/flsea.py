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
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field
from pydantic.dataclasses import dataclass

from ..errors import FactoryError
from ..frame import Frame, FrameRef, Intrinsics
from ..settings import STRICT
from .base import Discovery, SceneSettings
from .calibration import read_kalibr, scaled
from .images import read_depth, read_rgb
from .rgbd import finished_frame
from .roots import LeftOut, Root, root_folder, visible_files

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
        left_out = LeftOut()
        folders: dict[str, Path] = {}
        frames: list[FrameRef] = []
        skipped: Counter[str] = Counter()
        calibrations: dict[str, Path | None] = {}
        readable: list[str] = []
        for scene in sorted(set(wanted), key=lambda scene: (SCENES[scene], scene)):
            with left_out.unreadable(root):
                if (folder := _scene_folder(root, scene)) is not None:
                    calibration = _calibration_file(folder, SCENES[scene])
                    frames += _scene_frames(folder, scene, calibration, skipped)
                    calibrations.setdefault(SCENES[scene], calibration)
                    folders[scene] = folder
                readable.append(scene)
        if not frames:
            left_out.check()
        if not folders:
            raise FactoryError(
                f"scenes.root={self.settings.root}: no {_asked(self.settings)} here, looked for "
                f"<location>/<scene>/imgs such as canyons/u_canyon/imgs; set scenes.root to "
                f"{_EXPECTED}"
            )
        if not frames:
            raise FactoryError(
                f"scenes.root={self.settings.root}: no frame in {', '.join(folders)} "
                f"({_counts(skipped)}); expected imgs/<timestamp>.tiff and "
                f"depth/<timestamp>{_DEPTH_ENDINGS[0]}"
            )
        notes = [f"FLSea: {len(folders)} of {len(SCENES)} scenes"]
        absent = [scene for scene in SCENES if scene in readable and scene not in folders]
        if absent:
            notes.append(f"FLSea scenes not found here, left out: {', '.join(absent)}")
        notes += [self._calibration_note(*item) for item in calibrations.items()]
        skipped.update(left_out.skipped)
        return Discovery(
            tuple(frames), dict(sorted(skipped.items())), tuple(notes), left_out.warnings
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
        if parent.name == location:
            return min(_kalibr_files(parent / "calibration"), default=None)
    return None


def _kalibr_files(folder: Path) -> Iterator[Path]:
    """Kalibr results in `folder`, at any depth.  Raises OSError when a folder cannot be read."""
    for path, _, names in os.walk(folder, onerror=_unless_missing):
        for name in names:
            if name.endswith("kalibr-results-imucam.txt") and (file := Path(path, name)).is_file():
                yield file


def _unless_missing(error: OSError) -> None:
    if not isinstance(error, FileNotFoundError | NotADirectoryError):
        raise error


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
