"""Any RGBD set, listed in a CSV file of one camera.

    rgb,depth,scene                          a header is optional, and so is the third column
    dive1/0001.png,dive1/0001_depth.tif,dive1

Paths are relative to the CSV file.  Depth is a TIFF, PNG or .npy: floating-point metres or integer
millimetres where `depth_scale` says nothing else.  `scene` is what train and test are split by;
without it the whole list is one scene, named as the file.
"""

from __future__ import annotations

import csv
import os
from collections import Counter
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from ..errors import FactoryError
from ..frame import Frame, FrameRef, Intrinsics
from ..settings import STRICT
from .base import BadDepth, Discovery, Root, SceneSettings, discovery, numbered_lines
from .frame_files import read_depth, read_frame, read_rgb

_EXPECTED = "a CSV file of rgb,depth lines"


_Positive = Annotated[float, Field(gt=0)]


@dataclass(frozen=True, config=STRICT, kw_only=True)
class CsvListSettings(SceneSettings):
    """Keys of `scenes=csv_list`.

    file: the CSV file.
    intrinsics: fx, fy, cx, cy of the images as they are, pixels.
    depth_scale: what the numbers in the depth files are divided by to give metres; None: integers
        by 1000 (millimetres), and floating-point numbers are metres already.
    invalid_below_m: depths at or below this are pixels without a measurement; None: only 0 is.
    invalid_above_m: depths at or above this are, too (a rendered sky, for example).
    bad_depth: see `BadDepth`.
    """

    kind: Literal["csv_list"] = "csv_list"
    file: Root
    intrinsics: tuple[_Positive, _Positive, float, float]
    depth_scale: _Positive | None = None
    invalid_below_m: float | None = 0.0
    invalid_above_m: _Positive | None = None
    bad_depth: BadDepth = "reject"


class CsvListReader:
    """Reads the frames of the list."""

    def __init__(self, settings: CsvListSettings) -> None:
        self.settings = settings

    def discover(self) -> Discovery:
        """See `simnfnd.factory.scenes.base.Reader`."""
        path, given = Path(self.settings.file).expanduser(), f"scenes.file={self.settings.file}"
        if not path.is_file():
            fault = "is a folder" if path.is_dir() else "no such file"
            raise FactoryError(f"{given}: {fault}; give {_EXPECTED}")
        rows = _rows(path)
        frames = _named(path.parent, rows)
        # Unlike Path.is_file, os.path.isfile raises nothing.
        if frames and not any(os.path.isfile(one) for ref in frames for one in ref.paths):
            raise FactoryError(
                f"{given}: none of the {len(frames)} frames listed exists, the first is "
                f"{frames[0].paths[0]}; paths are relative to the CSV file"
            )
        skipped = {"listed twice": len(rows) - len(frames)}
        return discovery(frames, f"{given}: no line lists a frame; give {_EXPECTED}", skipped)

    def load(self, ref: FrameRef) -> Frame:
        """See `simnfnd.factory.scenes.base.Reader`."""
        settings, (image, depth) = self.settings, map(Path, ref.paths)
        rgb, depth_m = read_rgb(image), read_depth(depth, settings.depth_scale)
        # NaN and infinities stay to be refused.
        low, high = settings.invalid_below_m, settings.invalid_above_m
        invalid = np.isfinite(depth_m) & (
            (depth_m <= (-np.inf if low is None else low))
            | (depth_m >= (np.inf if high is None else high))
        )
        depth_m = np.where(invalid, np.float32(0), depth_m)
        return read_frame(ref, rgb, depth_m, Intrinsics(*settings.intrinsics), settings.bad_depth)


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
        rows.append((rgb, depth, scene or path.stem))
    return rows


def _named(folder: Path, rows: list[tuple[str, str, str]]) -> list[FrameRef]:
    """A frame a row, named by the image's stem, or by its whole path where a stem comes again."""
    stems = Counter((scene, Path(rgb).stem) for rgb, _, scene in rows)
    frames: dict[tuple[str, str], FrameRef] = {}
    for rgb, depth, scene in rows:
        name = Path(rgb).stem
        if stems[scene, name] > 1:
            parts = Path(rgb).with_suffix("").parts
            name = "-".join(part for part in parts if part not in (Path(rgb).anchor, "..", "."))
        paths = (str(folder / rgb), str(folder / depth))
        frames.setdefault((scene, name), FrameRef("", scene, name, paths))
    return list(frames.values())
