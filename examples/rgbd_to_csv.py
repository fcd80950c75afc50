"""List a TUM RGB-D recording for `scenes=csv_list`: colour and depth nearest in time are a frame.

    python examples/rgbd_to_csv.py rgbd_dataset_freiburg1_desk

writes frames.csv into the recording and prints the command that makes pairs of it.  Other layouts
need another list, and nothing else: colour, depth and scene a line, paths relative to the list.
"""

from __future__ import annotations

import argparse
import bisect
import csv
from pathlib import Path

# fx, fy, cx, cy of the three colour cameras as the set publishes them; the file's numbers are
# depth times 5000.
CAMERAS = {
    "freiburg1": "517.3,516.5,318.6,255.3",
    "freiburg2": "520.9,521.0,325.1,249.7",
    "freiburg3": "535.4,539.2,320.1,247.6",
}
DEPTH_SCALE = 5000
APART_S = 0.02


def listed(path: Path) -> list[tuple[float, str]]:
    """Time and file of the `time file` lines, by time."""
    lines = [line.split() for line in path.read_text().splitlines()]
    return sorted((float(line[0]), line[1]) for line in lines if line and line[0][0] != "#")


def pairs(
    colours: list[tuple[float, str]], depths: list[tuple[float, str]]
) -> list[tuple[str, str]]:
    """Files of colour and depth; each goes to the one nearest in time, and serves once."""
    times = [time for time, _ in depths]
    near = []
    for time, colour in colours:
        first, last = (bisect.bisect(times, time + way * APART_S) for way in (-1, 1))
        near += [(abs(times[k] - time), colour, depths[k][1]) for k in range(first, last)]
    taken: set[str] = set()
    matches = []
    for _, colour, depth in sorted(near):
        if not taken & {colour, depth}:
            taken |= {colour, depth}
            matches.append((colour, depth))
    return sorted(matches)


def main() -> None:
    """See the module."""
    parser = argparse.ArgumentParser(description=__doc__, usage="%(prog)s RECORDING")
    parser.add_argument("recording", type=Path, help="folder of rgb.txt and depth.txt")
    folder = parser.parse_args().recording
    for name in ("rgb.txt", "depth.txt"):
        if not (folder / name).is_file():
            parser.error(f"{folder}: no {name} in it; give the folder of a TUM RGB-D recording")
    matches = pairs(listed(folder / "rgb.txt"), listed(folder / "depth.txt"))
    target = folder / "frames.csv"
    name = folder.resolve().name
    with target.open("w", newline="") as file:
        csv.writer(file).writerows((*pair, name) for pair in matches)
    camera = next((value for key, value in CAMERAS.items() if key in name), "FX,FY,CX,CY")
    print(f"{len(matches)} frames in {target}; make pairs with")
    print(
        f"simnfnd make scenes=csv_list scenes.file={target} scenes.intrinsics='[{camera}]' "
        f"scenes.depth_scale={DEPTH_SCALE} dataset.dir=outputs/{name}"
    )


if __name__ == "__main__":
    main()
