"""docs/images/real.png, real-crops.png, colours.png, screen.png, figure.png: recordings, denoised.

    python -m tools.real_pictures FOLDER

FOLDER: with didson/lamprey1.avi, aris-sdk/sample.aris and oculus/three_pings_8bit.raw, whose terms
docs/images/NOTICE.md states.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from simnfnd.evaluation.filters.base import Gray
from simnfnd.evaluation.filters.bm3d import bm3d
from simnfnd.evaluation.real.groups import Judged, judged, search
from simnfnd.evaluation.real.shots import Mask, open_input
from simnfnd.models.denoise.denoiser import Denoiser, load_denoiser
from simnfnd.models.denoise.pictures import denoise_image
from simnfnd.models.recordings import open_recording
from simnfnd.models.recordings.fan.finder import find_fan
from simnfnd.models.recordings.fan.pings import frame_picture
from simnfnd.models.recordings.palettes import find_painted

OUT = Path("docs/images")
_HEIGHT_PX, _CROP_PX, _ZOOM, _GAP_PX = 620, 130, 3, 8
_COLOURS_HEIGHT_PX = 420
_WHITE = (255, 255, 255)
_SIGMAS = (0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1)


@dataclass(frozen=True)
class Recording:
    """What is shown of a file.

    most: frames looked at for a scene at rest; None: a single frame, which has no mean to be seen
    beside.  dark, bright: grey values shown as black and white.  corners: rows and columns where
    crops begin.
    """

    path: str
    most: int | None
    dark: float
    bright: float
    corners: tuple[tuple[int, int], ...]

    def shown(self, picture: Gray) -> Gray:
        """In its contrast."""
        return np.clip((picture - self.dark) / (self.bright - self.dark), 0, 1).astype(np.float32)


RECORDINGS = (
    Recording("didson/lamprey1.avi", 32, 0.0, 0.77, ((330, 120), (560, 150))),
    Recording("aris-sdk/sample.aris", 6, 0.18, 0.65, ((300, 60), (640, 100))),
    Recording("oculus/three_pings_8bit.raw", None, 0.0, 0.5, ((120, 280),)),
)


def main(folder: Path) -> None:
    """Make the pictures."""
    denoise = load_denoiser("simnfnd", "cpu")
    in_colours(folder / RECORDINGS[0].path, denoise)
    on_a_screen(folder / RECORDINGS[0].path, denoise)
    in_a_figure(folder / RECORDINGS[1].path, denoise)
    whole: list[Gray] = []
    rows: list[Gray] = []
    for recording in RECORDINGS:
        resting = None if recording.most is None else at_rest(folder, recording)
        if resting is None:
            noisy, geometry = frame_picture(folder / recording.path, 1)
            mean, filtered = np.zeros_like(noisy), bm3d(noisy, 0.06)
        else:
            assert resting.reference is not None
            noisy, geometry, mean = resting.noisy, resting.geometry, resting.reference
            filtered = best_bm3d(resting.noisy, mean, resting.where)
        made = [recording.shown(one) for one in (noisy, filtered, denoise(noisy, geometry), mean)]
        if resting is not None:
            whole += [tall(made[number] * (noisy > 0)) for number in (0, 2, 3)]
        for row, column in recording.corners:
            window = np.s_[row : row + _CROP_PX, column : column + _CROP_PX]
            rows.append(side_by_side([np.kron(one[window], np.ones((_ZOOM,) * 2)) for one in made]))
    write(OUT / "real.png", side_by_side(whole, 4 * _GAP_PX))
    write(OUT / "real-crops.png", np.vstack([np.pad(row, ((0, _GAP_PX), (0, 0))) for row in rows]))


def at_rest(folder: Path, recording: Recording) -> Judged:
    """The middle frame of the first group that stands still, with the mean of the others."""
    (stretch,), _ = open_input(str(folder / recording.path), 400)
    group = search((0, stretch, recording.most)).groups[0]
    return next(iter(judged(0, group, [len(group.shots) // 2], 0)))


def best_bm3d(noisy: Gray, mean: Gray, where: Mask) -> Gray:
    """By the strength that is nearest to the mean of the others: better than anyone could know."""

    def error(picture: Gray) -> float:
        return float(np.square(picture - mean)[where].mean())

    return min((bm3d(noisy, sigma) for sigma in _SIGMAS), key=error)


def in_colours(path: Path, denoise: Denoiser) -> None:
    """A frame in two colour maps: as recorded, channels denoised one by one, and its levels."""
    grey, _ = frame_picture(path, 0)
    found = find_fan(grey)
    geometry = None if found is None else found.geometry
    columns = []
    for name in (cv2.COLORMAP_JET, cv2.COLORMAP_HOT):
        picture = cv2.applyColorMap(np.rint(grey * 255).astype(np.uint8), name)
        painted = find_painted(picture)
        assert painted is not None
        columns += [
            picture,
            denoise_image(picture, denoise, geometry),
            painted.repainted(denoise_image(painted.levels, denoise, geometry)),
        ]
    height, width = grey.shape
    size = (round(width * _COLOURS_HEIGHT_PX / height), _COLOURS_HEIGHT_PX)
    small = [cv2.resize(one, size, interpolation=cv2.INTER_AREA) for one in columns]
    cv2.imwrite(str(OUT / "colours.png"), side_by_side(small, gap=255))


def on_a_screen(path: Path, denoise: Denoiser) -> None:
    """A frame as sonar software may show it, on its side amid text and rings: before and after."""
    grey, _ = frame_picture(path, 0)
    levels = np.ascontiguousarray(np.rot90(np.rint(grey * 255).astype(np.uint8)))
    fan = find_fan(levels)
    assert fan is not None
    height, width = levels.shape
    inside = fan.geometry.sector_mask(height, width)
    top, left = 90, 60
    screen = np.full((height + 2 * top, width + 2 * left, 3), (52, 44, 40), np.uint8)
    painted = cv2.applyColorMap(levels, cv2.COLORMAP_HOT)
    screen[top : top + height, left : left + width][inside] = painted[inside]
    range_m = np.linspace(0.25, 1, 4)
    for part in range_m:
        bearings = np.linspace(fan.geometry.azimuth_min_rad, fan.geometry.azimuth_max_rad, 90)
        row, column = fan.geometry.pixels(np.full_like(bearings, part), bearings)
        points = np.rint(np.stack([column + left, row + top], axis=1)).astype(np.int32)
        cv2.polylines(screen, [points], False, (0, 220, 0), 1)
        place = int(points[0, 0]) - 30, int(points[:, 1].max()) + 24
        cv2.putText(screen, f"{part:.2f}", place, cv2.FONT_HERSHEY_SIMPLEX, 0.6, _WHITE, 1)
    cv2.putText(screen, "heading 214  gain 20 dB", (20, 40), cv2.FONT_HERSHEY_SIMPLEX, 0.8, _WHITE)
    found, seen = find_fan(screen), find_painted(screen)
    assert found is not None
    assert seen is not None
    result = seen.repainted(denoise(seen.levels, found.geometry))
    cv2.imwrite(str(OUT / "screen.png"), np.vstack([screen, result]))


def in_a_figure(path: Path, denoise: Denoiser) -> None:
    """A ping as a fan and as it is stored, in axes: as drawn, and denoised."""
    with open_recording(path) as recording:
        frame = recording[2]
    assert frame.beams is not None
    bearings = np.array(frame.beams.azimuths_rad)
    range_m = np.linspace(frame.beams.range_min_m, frame.beams.range_max_m, len(frame.samples))
    across_m, along_m = range_m[:, None] * np.sin(bearings), range_m[:, None] * np.cos(bearings)
    drawn = Figure(figsize=(7, 7), dpi=100, layout="constrained")
    canvas = FigureCanvasAgg(drawn)
    left, right = drawn.subplots(1, 2, width_ratios=(1, 2))
    left.set_aspect("equal")
    left.pcolormesh(across_m, along_m, frame.samples, cmap="gray", shading="nearest")
    left.set(title="fan", xlabel="x [m]", ylabel="y [m]")
    drawn.colorbar(right.imshow(frame.samples, cmap="gray", aspect="auto"))
    right.set(title="samples", xlabel="beam", ylabel="range bin")
    canvas.draw()  # type: ignore[no-untyped-call]
    picture = np.ascontiguousarray(np.asarray(canvas.buffer_rgba())[..., 0])  # type: ignore[no-untyped-call]
    fan = find_fan(picture)
    result = denoise_image(picture, denoise, None if fan is None else fan.geometry)
    cv2.imwrite(str(OUT / "figure.png"), side_by_side([picture, result], gap=255))


def tall(picture: Gray, height_px: int = _HEIGHT_PX) -> Gray:
    """As high as all of them."""
    width = round(picture.shape[1] * height_px / picture.shape[0])
    found = cv2.resize(picture, (width, height_px), interpolation=cv2.INTER_AREA)
    return np.asarray(found, np.float32)


def side_by_side(
    pictures: Sequence[npt.NDArray[Any]], gap_px: int = _GAP_PX, gap: float = 0
) -> npt.NDArray[Any]:
    """(H, W) or (H, W, colours) with the level `gap` between them."""
    parts = []
    for one in pictures:
        around = [(0, 0), (0, gap_px)] + [(0, 0)] * (one.ndim - 2)
        parts.append(np.pad(one, around, constant_values=gap))
    return np.hstack(parts)[:, :-gap_px]


def write(path: Path, picture: Gray) -> None:
    """As PNG of 8 bits."""
    cv2.imwrite(str(path), np.rint(picture * 255).astype(np.uint8))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
