"""`simnfnd geometry PICTURES`: where range and bearing lie in fan pictures, found in themselves.

Prints a table (CSV) that `simnfnd denoise --geometry` and `data.geometry` of a training take.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

from ...models.recordings import SEQUENCES, kind_of, open_recording
from ...models.recordings.base import FULL_SCALE, Samples
from ...models.recordings.fan.finder import FoundFan, find_fan
from ..cli import Parser
from ..errors import FactoryError, FrameError
from ..files import check_writable, write_atomically
from ..sonar.geometry import FanGeometry

COLUMNS = (
    "file", "apex_x", "apex_y", "edge_slope", "top_row", "bottom_row", "squeeze",
    "sector_deg", "near_fraction", "confidence",
    "quarter_turns",
)  # fmt: skip
_GREEN = (0, 255, 0)


def main(words: list[str]) -> int:
    """Print the table, and draw what was found; 1 when no picture has a fan."""
    parser = Parser(prog="simnfnd geometry")
    parser.add_argument(
        "pictures",
        nargs="+",
        type=Path,
        help="pictures, folders of them, or videos, stacks and arrays (first frame)",
    )
    parser.add_argument("--out", type=Path, help="folder for the pictures with the fan drawn in")
    given = parser.parse_args(words)
    if given.out is not None:
        check_writable(given.out, "--out")
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(COLUMNS)
    count = found_in = 0
    for path in given.pictures:
        for name, picture in _pictures(path):
            count += 1
            found = find_fan(picture)
            if found is None:
                print(f"{name}: no fan found", file=sys.stderr)
                continue
            found_in += 1
            table.writerow(_row(name, found))
            if given.out is not None:
                done, content = cv2.imencode(".png", draw(picture, found.geometry))
                assert done
                write_atomically(given.out / f"{Path(name).stem}.png", content.tobytes())
    print(f"geometry: fan found in {found_in} of {count} pictures", file=sys.stderr)
    return 0 if found_in else 1


def _pictures(path: Path) -> Iterator[tuple[str, Samples]]:
    """(file name, pixels) of a picture, of each in a folder, or of a video's first frame."""
    kind = kind_of(path)
    if kind not in ("pictures", *SEQUENCES):
        raise FactoryError(f"{path}: neither a picture nor a folder nor a video")
    with open_recording(path) as recording:
        if kind != "pictures":
            yield path.name, recording[0].samples
            return
        files = getattr(recording, "files", [path])
        for number, file in enumerate(files):
            try:
                yield file.name, recording[number].samples
            except FrameError as error:
                print(f"skipped: {error}", file=sys.stderr)


def _row(name: str, found: FoundFan) -> tuple[str | float, ...]:
    fan = found.geometry
    slope = (math.tan(fan.azimuth_max_rad) - math.tan(fan.azimuth_min_rad)) / 2 * fan.x_scale
    half = math.atan(slope / fan.x_scale)
    # The last row of a fan that begins at the sonar lies a trifle ahead of it.
    bottom = fan.apex_y_px - max(fan.near_px, 0.01) * math.cos(half)
    return (
        name,
        round(fan.apex_x_px, 2),
        round(fan.apex_y_px, 2),
        round(slope, 5),
        round(fan.apex_y_px - fan.far_px, 2),
        round(bottom, 2),
        round(fan.x_scale, 4),
        round(math.degrees(fan.azimuth_max_rad - fan.azimuth_min_rad), 2),
        round(fan.near_fraction, 4),
        round(found.confidence, 2),
        fan.quarter_turns,
    )


def draw(picture: Samples, fan: FanGeometry) -> Samples:
    """(H, W, 3) uint8: the picture with the outline of its fan."""
    full = FULL_SCALE[str(picture.dtype)]
    grey = np.rint(np.clip(picture / full, 0, 1) * 255).astype(np.uint8)
    canvas = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR) if grey.ndim == 2 else grey[..., :3].copy()
    bearings = np.linspace(fan.azimuth_min_rad, fan.azimuth_max_rad, 200)
    near = np.full_like(bearings, fan.near_fraction)
    ranges = np.concatenate([near, np.ones_like(bearings), [fan.near_fraction]])
    around = np.concatenate([bearings, bearings[::-1], bearings[:1]])
    row, column = fan.pixels(ranges, around)
    # OpenCV counts in sixteenths of a pixel here.
    points = np.rint(np.stack([column, row], axis=1) * 16).astype(np.int32)
    cv2.polylines(canvas, [points], False, _GREEN, 1, cv2.LINE_AA, shift=4)
    return np.asarray(canvas)
