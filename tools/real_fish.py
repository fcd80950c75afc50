"""What denoising leaves of real fish: `python -m tools.real_fish [RECORDING...]`.

Denoises recordings of a sonar at rest by `simnfnd denoise`, at its defaults and with `--frames 1`,
and says how much of the contrast of each moving echo is left.  Without a name it takes the three
recordings of examples/ and draws docs/images/real-fish.png; `--reports FOLDER` keeps what was
denoised.

A moving echo is a local maximum of a frame minus the background of its recording (the median of its
registered frames), above 6 standard deviations of the grain, where a person saw a fish; its
contrast is that difference, blurred as wide as the grain.  In the ARIS recording, six frames short,
a faint target crosses that stays below 6: its own limit is 3.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from simnfnd import open_recording
from simnfnd.command import main as simnfnd
from simnfnd.evaluation.filters.windows import shift_px
from simnfnd.factory.common.array_types import Float32s, UInt8s

ROOT = Path(__file__).resolve().parents[1]
IMAGE = ROOT / "docs" / "images" / "real-fish.png"
WAYS = {"single frame": "1", "in time": "7"}

_LOST = 0.3
_APART_PX = 10
_GREY = 255
_NORMAL_OF_MEDIAN = 1.4826  # standard deviation over median absolute deviation of a Gaussian
_LEAST_SPREAD = 1.0  # grey values
_CROP_WIDTH_PX = 132
_GAP_PX = 3
_CAPTION_PX = 20
_LABEL_PX = 96
_FEWEST_COLUMNS = 48  # of an image; fewer are beams
_DARK = 24
_LIGHT = 235
_FONT = cv2.FONT_HERSHEY_SIMPLEX


class Place(NamedTuple):
    """Frames and pixels in which a person saw fish."""

    frames: range
    rows: range
    columns: range

    def holds(self, frame: int, row: int, column: int) -> bool:
        """Whether a pixel of a frame is part of it."""
        return frame in self.frames and row in self.rows and column in self.columns


class Subject(NamedTuple):
    """A recording, its grain and its fish.

    grain_px: standard deviations of the blur along rows and columns.
    limit: of a peak, in standard deviations.
    crops: what the image shows, one frame a column.
    """

    file: Path
    grain_px: tuple[float, float]
    limit: float
    fish: tuple[Place, ...]
    crops: tuple[Place, ...]


class Echo(NamedTuple):
    """A moving echo: where it is, and the part of its contrast that each way leaves."""

    frame: int
    row: int
    column: int
    deviation: float
    kept: dict[str, float]


_DIDSON = ROOT / "examples" / "didson"
_FAN_GRAIN_PX = (1.5, 1.5)
_LAMPREY_2 = (
    Place(range(16, 28), range(555, 640), range(180, 260)),
    Place(range(50, 58), range(560, 600), range(235, 280)),
)
SUBJECTS = (
    Subject(
        _DIDSON / "lamprey1.avi",
        _FAN_GRAIN_PX,
        6.0,
        (Place(range(18, 150), range(25, 225), range(140, 310)),),
        (Place(range(116, 122), range(55, 145), range(150, 240)),),
    ),
    Subject(
        _DIDSON / "lamprey.avi",
        _FAN_GRAIN_PX,
        6.0,
        _LAMPREY_2,
        (Place(range(17, 23), range(580, 640), range(190, 270)),),
    ),
    Subject(
        ROOT / "examples" / "aris" / "sample.aris",
        (3.0, 0.6),
        3.0,
        (
            Place(range(2, 3), range(1324, 1334), range(32, 37)),
            Place(range(3, 4), range(1318, 1328), range(29, 34)),
            Place(range(4, 5), range(1314, 1324), range(26, 31)),
            Place(range(5, 6), range(1311, 1321), range(23, 28)),
        ),
        (Place(range(6), range(1290, 1350), range(18, 42)),),
    ),
)


def subject_of(path: Path) -> Subject:
    """A recording that somebody names: where its fish are known, those, else all that moves."""
    everything = range(10**6)
    known = {"lamprey2.avi": _LAMPREY_2} | {one.file.name: one.fish for one in SUBJECTS}
    fish = known.get(path.name, (Place(everything, everything, everything),))
    return Subject(path, _FAN_GRAIN_PX, 6.0, fish, ())


def grey_frames(path: Path) -> Float32s:
    """(T, H, W) float32 in 0..255: a recording's frames as they are stored."""
    with open_recording(path) as recording:
        frames = np.stack([shot.frame.samples for shot in recording])
    if frames.ndim == 4:
        frames = frames[..., 0]
    return frames.astype(np.float32)


def denoised_frames(path: Path, folder: Path, frame_count: str) -> Float32s:
    """What `simnfnd denoise` makes of a recording; kept in a folder, and taken from there."""
    folder.mkdir(parents=True, exist_ok=True)
    result = folder / path.name
    if not result.is_file():
        words = ["denoise", str(path), "--out", str(folder), "--frames", frame_count]
        if code := simnfnd(words):
            raise SystemExit(code)
    return grey_frames(result)


def registered(frames: Float32s) -> Float32s:
    """Frames laid over the first by whole pixels."""
    shifts = [shift_px(frames[0], frame) for frame in frames]
    return np.stack(
        [
            np.roll(frame, (-down, -right), (0, 1))
            for frame, (right, down) in zip(frames, shifts, strict=True)
        ]
    )


def moving_parts(frames: Float32s, grain_px: tuple[float, float]) -> Float32s:
    """(T, H, W) frames minus their background, blurred as wide as the grain."""
    background = np.median(frames, axis=0)
    along_rows, along_columns = grain_px
    return np.stack(
        [
            cv2.GaussianBlur(frame - background, (0, 0), sigmaX=along_columns, sigmaY=along_rows)
            for frame in frames
        ]
    )


def echoes_of(subject: Subject, recorded: Float32s, ways: dict[str, Float32s]) -> list[Echo]:
    """The moving echoes of a recording, in the order of time."""
    moving = moving_parts(recorded, subject.grain_px)
    left = {name: moving_parts(frames, subject.grain_px) for name, frames in ways.items()}
    spread = _NORMAL_OF_MEDIAN * np.median(np.abs(moving), axis=0)
    spread = np.maximum(cv2.GaussianBlur(spread, (0, 0), 4), _LEAST_SPREAD)
    kernel = np.ones((2 * _APART_PX + 1,) * 2, np.uint8)
    echoes = []
    for number, frame in enumerate(moving):
        deviation = frame / spread
        is_peak = (deviation == cv2.dilate(deviation, kernel)) & (deviation > subject.limit)
        for row, column in zip(*np.nonzero(is_peak), strict=True):
            if not any(place.holds(number, int(row), int(column)) for place in subject.fish):
                continue
            kept = {
                name: float(parts[number, row, column] / frame[row, column])
                for name, parts in left.items()
            }
            echoes.append(Echo(number, int(row), int(column), float(deviation[row, column]), kept))
    return echoes


def say(subject: Subject, echoes: Sequence[Echo]) -> None:
    """Print how much of the contrast is left, and where least."""
    if not echoes:
        print(f"{subject.file.name}: no moving echo above {subject.limit:g} deviations")
        return
    print(f"{subject.file.name}: {len(echoes)} moving echoes above {subject.limit:g} deviations")
    for name in WAYS:
        kept = np.array([echo.kept[name] for echo in echoes])
        worst = min(echoes, key=lambda echo: echo.kept[name])
        print(
            f"  {name}: median {np.median(kept):.2f}, below {_LOST:g} "
            f"{np.mean(kept < _LOST):.1%}; least {worst.kept[name]:.2f} in frame {worst.frame}, "
            f"row {worst.row}, column {worst.column}"
        )
        for echo in echoes:
            if echo.kept[name] < _LOST:
                print(
                    f"    frame {echo.frame}, row {echo.row}, column {echo.column}: "
                    f"{echo.kept[name]:.2f} left of {echo.deviation:.1f} deviations"
                )


def crop_row(
    name: str, frames: Float32s, place: Place, brightest: float, echoes: Sequence[Echo]
) -> UInt8s:
    """One way's crops side by side, a mark below each moving echo."""
    rows, columns = (slice(side.start, side.stop) for side in (place.rows, place.columns))
    across = _CROP_WIDTH_PX / len(place.columns)
    height = round(len(place.rows) * across)
    if len(place.columns) < _FEWEST_COLUMNS:
        height = _CROP_WIDTH_PX  # beams and ranges, not pixels
    down = height / len(place.rows)
    line = np.full((height, _LABEL_PX), _DARK, np.uint8)
    cv2.putText(line, name, (4, height // 2), _FONT, 0.4, (_LIGHT,), 1, cv2.LINE_AA)
    for number in place.frames:
        crop = frames[number][rows, columns] / brightest * _GREY
        crop = cv2.resize(crop, (_CROP_WIDTH_PX, height), interpolation=cv2.INTER_CUBIC)
        crop = np.clip(crop, 0, _GREY).astype(np.uint8)
        for echo in echoes:
            if place.holds(number, echo.row, echo.column) and echo.frame == number:
                x = round((echo.column + 0.5 - place.columns.start) * across)
                y = round((echo.row + 0.5 - place.rows.start) * down)
                cv2.line(crop, (x, y + 12), (x, y + 20), (_GREY,), 1)
        gap = np.full((height, _GAP_PX), _DARK, np.uint8)
        line = np.hstack([line, gap, crop])
    return np.vstack([line, np.full((_GAP_PX, line.shape[1]), _DARK, np.uint8)])


def block(
    subject: Subject, place: Place, stacks: dict[str, Float32s], echoes: Sequence[Echo]
) -> UInt8s:
    """A caption, and below it the crops as recorded and of each way."""
    shown = stacks["recorded"][place.frames.start : place.frames.stop]
    shown = shown[:, place.rows.start : place.rows.stop, place.columns.start : place.columns.stop]
    brightest = float(np.quantile(shown, 0.999))
    lines = [crop_row(name, frames, place, brightest, echoes) for name, frames in stacks.items()]
    caption = np.full((_CAPTION_PX, lines[0].shape[1]), _DARK, np.uint8)
    text = f"{subject.file.name}, frames {place.frames.start} to {place.frames.stop - 1}"
    cv2.putText(caption, text, (4, 14), _FONT, 0.4, (_LIGHT,), 1, cv2.LINE_AA)
    return np.vstack([caption, *lines])


def main() -> None:
    """Measure, and draw what ships."""
    parser = argparse.ArgumentParser(prog="python -m tools.real_fish")
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--reports", type=Path, default=ROOT / "outputs" / "real-fish")
    chosen = parser.parse_args()
    subjects = tuple(map(subject_of, chosen.recordings)) or SUBJECTS
    blocks = []
    for subject in subjects:
        recorded = registered(grey_frames(subject.file))
        ways = {
            name: denoised_frames(subject.file, chosen.reports / f"frames-{count}", count)
            for name, count in WAYS.items()
        }
        echoes = echoes_of(subject, recorded, ways)
        say(subject, echoes)
        stacks = {"recorded": recorded, **ways}
        blocks += [block(subject, place, stacks, echoes) for place in subject.crops]
    if blocks:
        cv2.imwrite(str(IMAGE), np.vstack(blocks))


if __name__ == "__main__":
    main()
