"""Any RGBD set, listed in a CSV file of one camera.

    rgb,depth,scene                          a header is optional, and so is the third column
    dive1/0001.png,dive1/0001_depth.tif,dive1

Paths are relative to the CSV file.  Depth is a TIFF, PNG, PFM or .npy: floating-point metres or
integer millimetres where `depth_scale` says nothing else, along the optical axis or the rays of
the pixels (`depth_kind`).  `scene` is what train and test are split by; without it the whole list
is one scene, named as the file.
"""

from __future__ import annotations

import csv
import os
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic.dataclasses import dataclass

from ...common.array_types import Float32s
from ...common.errors import MOST_LISTED, FactoryError, FrameError
from ...common.files import shortened
from ...common.limits import limited
from ...common.settings import STRICT
from ...common.small_files import numbered_lines
from ...dataset.frame_ref import FrameRef
from ..frames.frame import Frame, Intrinsics
from .base import LONGEST_NAME, BadDepth, Discovery, Root, SceneSettings, discovery
from .frame_files import image_size, in_metres, read_frame, read_rgb, refuse_mark, stored_depth

_EXPECTED = "a CSV file of rgb,depth lines"


# Lengths in widths of the image are refused later, with their value in pixels.
_FocalLength = Annotated[float, limited(1e-3, 1e6, "px")]
_ImagePlace = Annotated[float, limited(-1e6, 1e6, "px")]
# Renders mark the sky by distances that no sonar sees.
_Depth = Annotated[float, limited(-1e12, 1e12, "m")]
_DepthScale = Annotated[float, limited(1e-9, 1e9)]


@dataclass(frozen=True, config=STRICT, kw_only=True)
class CsvListSettings(SceneSettings):
    """Keys of `scenes=csv_list`.

    file: the CSV file.
    intrinsics: fx, fy, cx, cy of the images as they are, pixels.
    depth_scale: what the numbers in the depth files are divided by to give metres; None: integers
        by 1000 (millimetres), and floating-point numbers are metres already.
    depth_kind: z: distances along the optical axis; ray: from the camera along each pixel's ray, as
        Hypersim, Kubric and AirSim's DepthPerspective give them.
    invalid_below_m: stored depths at or below this are no measurement; None: only 0 is none.
    invalid_above_m: depths at or above this are, too (a rendered sky, for example); None: a map in
        which many pixels hold the largest number of its type is refused.
    bad_depth: see `BadDepth`.
    """

    kind: Literal["csv_list"] = "csv_list"
    file: Root
    intrinsics: tuple[_FocalLength, _FocalLength, _ImagePlace, _ImagePlace]
    depth_scale: _DepthScale | None = None
    depth_kind: Literal["z", "ray"] = "z"
    invalid_below_m: _Depth | None = 0.0
    invalid_above_m: _Depth | None = None
    bad_depth: BadDepth = "reject"


class CsvListReader:
    """Reads the frames of the list."""

    def __init__(self, settings: CsvListSettings) -> None:
        self.settings = settings
        self._lens = Intrinsics(*settings.intrinsics)

    def discover(self) -> Discovery:
        """See `simnfnd.factory.simulation.scenes.base.Reader`."""
        path = Path(self.settings.file).expanduser()
        key = f"scenes.file={self.settings.file}"
        if not path.is_file():
            fault = "is a folder" if path.is_dir() else "no such file"
            raise FactoryError(f"{key}: {fault}; give {_EXPECTED}")

        rows = _rows(path)
        frames = _named(path.parent, rows)
        # Unlike Path.is_file, os.path.isfile raises nothing.
        if frames and not any(os.path.isfile(file) for ref in frames for file in ref.paths):
            raise FactoryError(
                f"{key}: none of the {len(frames)} frames listed exists, the first is "
                f"{frames[0].paths[0]}; paths are relative to the CSV file"
            )
        self._check_sizes(key, frames)
        skipped = {"listed twice": len(rows) - len(frames)}
        return discovery(frames, f"{key}: no line lists a frame; give {_EXPECTED}", skipped)

    def _check_sizes(self, key: str, frames: list[FrameRef]) -> None:
        """Raise FactoryError unless all images have one size, which the intrinsics can be of.

        Images that cannot be read are left to `load`.
        """
        first_of_size: dict[tuple[int, int], str] = {}
        for ref in frames:
            size = image_size(Path(ref.paths[0]))
            if size is not None:
                first_of_size.setdefault(size, ref.paths[0])
        if len(first_of_size) > 1:
            sizes = [
                f"{width}x{height} ({path})" for (width, height), path in first_of_size.items()
            ]
            raise FactoryError(
                f"{key}: images of {len(sizes)} sizes, {', '.join(sizes[:MOST_LISTED])}; list the "
                "frames of each size apart"
            )
        for size in first_of_size:
            if misfit := self._lens.misfit(*size):
                raise FactoryError(f"scenes.intrinsics: {misfit}")

    def load(self, ref: FrameRef) -> Frame:
        """See `simnfnd.factory.simulation.scenes.base.Reader`."""
        settings = self.settings
        image_path, depth_path = map(Path, ref.paths)
        rgb = read_rgb(image_path)
        stored = stored_depth(depth_path)
        if settings.invalid_above_m is None:
            refuse_mark(depth_path, stored, settings.depth_scale)
        depth_m = in_metres(stored, settings.depth_scale)

        negative_count = np.count_nonzero(depth_m < 0)
        if negative_count and not (depth_m > 0).any():
            raise FrameError(
                f"{depth_path}: {negative_count} depths are negative and none is positive; store "
                "distances as positive numbers"
            )
        low = -np.inf if settings.invalid_below_m is None else settings.invalid_below_m
        high = np.inf if settings.invalid_above_m is None else settings.invalid_above_m
        # NaN and infinities stay to be refused.
        is_invalid = np.isfinite(depth_m) & ((depth_m <= low) | (depth_m >= high))
        depth_m = np.where(is_invalid, np.float32(0), depth_m)
        if settings.depth_kind == "ray":
            depth_m = along_axis(depth_m, self._lens)
        return read_frame(ref, rgb, depth_m, self._lens, settings.bad_depth)


def along_axis(distance_m: Float32s, lens: Intrinsics) -> Float32s:
    """(H, W) distances along the optical axis of distances along the rays: r / |K^-1 (u, v, 1)|."""
    x, y = lens.directions(*distance_m.shape)
    lengths = np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
    return np.asarray(distance_m / lengths, np.float32)


def _rows(path: Path) -> list[tuple[str, str, str]]:
    """(rgb, depth, scene) of every line; a header, empty lines and `#` comments are left out."""
    rows = []
    for index, (number, line) in enumerate(numbered_lines(path)):
        cells = [cell.strip() for cell in next(csv.reader([line]), [])]
        if index == 0 and [cell.lower() for cell in cells[:2]] == ["rgb", "depth"]:
            continue
        rgb, depth, scene = (*cells, "")[:3] if len(cells) in (2, 3) else ("", "", "")
        if not rgb or not depth:
            raise FactoryError(
                f"{path}:{number}: expected `rgb,depth` or `rgb,depth,scene`, got {line[:80]!r}; "
                "repair the line"
            )
        if "/" in scene or "\\" in scene:
            raise FactoryError(f"{path}:{number}: a scene name must not hold a slash: {scene!r}")
        rows.append((rgb, depth, shortened(scene or path.stem, LONGEST_NAME)))
    return rows


def _named(folder: Path, rows: list[tuple[str, str, str]]) -> list[FrameRef]:
    """A frame for each pair of files and scene, the first time that it is listed.

    It is named by the image's stem; where that comes again in the scene, by the image's path
    without suffix; where that does, too, by both paths and a number.
    """
    distinct: dict[tuple[str, str, str], tuple[str, str]] = {}
    for rgb, depth, scene in rows:
        image_file = os.path.normpath(folder / rgb)
        depth_file = os.path.normpath(folder / depth)
        distinct.setdefault((image_file, depth_file, scene), (rgb, depth))

    stem_counts = Counter((scene, Path(rgb).stem) for rgb, _, scene in rows)
    path_counts = Counter((scene, _dashed(rgb)) for (*_, scene), (rgb, _) in distinct.items())
    frames: dict[tuple[str, str], FrameRef] = {}
    for (*_, scene), (rgb, depth) in distinct.items():
        name = Path(rgb).stem
        if stem_counts[scene, name] > 1:
            name = _dashed(rgb)
            if path_counts[scene, name] > 1:
                name = f"{_dashed(rgb, keep_suffix=True)}-{_dashed(depth)}"
        name = shortened(name, LONGEST_NAME)
        unique = name
        number = 2
        while (scene, unique) in frames:
            unique = f"{name}-{number}"
            number += 1
        files = (str(folder / rgb), str(folder / depth))
        frames[scene, unique] = FrameRef("", scene, unique, files)
    return list(frames.values())


def _dashed(file: str, keep_suffix: bool = False) -> str:
    """A relative path as one word, its folders joined by dashes."""
    path = Path(file) if keep_suffix else Path(file).with_suffix("")
    return "-".join(part for part in path.parts if part not in (path.anchor, "..", "."))
