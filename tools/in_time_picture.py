"""docs/images/in-time.png: what fusing makes of a recording, beside one frame and a plain mean.

    python -m tools.in_time_picture lamprey1.avi

The recording stands still and may be shown, such as the DIDSON recordings (Apache-2.0).
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from simnfnd.evaluation.real.in_time import Gray, kinds_of, rows_of
from simnfnd.models.denoise.denoiser import load_denoiser
from simnfnd.models.recordings import open_recording

OUT = Path("docs/images/in-time.png")
FRAMES, NUMBER = 24, 12
SIDE, GAP, CAPTION_PX = 180, 4, 26
BRIGHTER = 2.5  # the dim ground is shown so much brighter
COLUMNS = ("as recorded", "one frame", "fused", "fused and denoised", "mean of 7")


def main(path: Path) -> None:
    """Draw it."""
    with open_recording(path) as recording:
        samples = [np.asarray(recording[number].samples) for number in range(FRAMES)]
    planes = [one if one.ndim == 2 else one[..., 0] for one in samples]
    frames = np.stack(planes).astype(np.float32) / np.float32(255)
    network = load_denoiser(None, "cpu")
    lines = []
    for kind in kinds_of(frames):
        rows = rows_of(kind, network, 0.01)
        found = [kind.frames[NUMBER], *(rows[name](NUMBER) for name in COLUMNS[1:])]
        shown = np.ones_like(kind.frames[NUMBER]) if kind.name == "ghost" else found[0]
        places = [_liveliest(shown, kind.masks[NUMBER])]
        names = [kind.name]
        if kind.name == "static":
            places.append(_dimmest(kind.references[NUMBER]))
            names.append("dim ground")
        for (top, left), name in zip(places, names, strict=True):
            gain = BRIGHTER if name == "dim ground" else 1.0
            parts = [one[top : top + SIDE, left : left + SIDE] * gain for one in found]
            lines.append(_line(name, parts))
    cv2.imwrite(str(OUT), np.concatenate([_names(), *lines]))


def _liveliest(frame: Gray, mask: npt.NDArray[np.bool_]) -> tuple[int, int]:
    """The window with most of what is judged and bright."""
    return _highest(cv2.boxFilter(frame * mask, -1, (SIDE, SIDE), anchor=(0, 0)))


def _dimmest(reference: Gray) -> tuple[int, int]:
    """The darkest window that is lit everywhere."""
    lit = cv2.boxFilter((reference > 0.04).astype(np.float32), -1, (SIDE, SIDE), anchor=(0, 0))
    level = cv2.boxFilter(reference, -1, (SIDE, SIDE), anchor=(0, 0))
    return _highest(np.where(lit > 0.97 * lit[:-SIDE, :-SIDE].max(), 1 - level, -1))


def _highest(score: npt.NDArray[Any]) -> tuple[int, int]:
    inner = score[: -SIDE - 1, : -SIDE - 1]
    top, left = np.unravel_index(int(np.argmax(inner)), inner.shape)
    return int(top), int(left)


def _line(name: str, parts: list[Gray]) -> npt.NDArray[np.uint8]:
    shown = []
    for part in parts:
        grey = np.rint(np.clip(part, 0, 1) * 255).astype(np.uint8)
        shown.append(cv2.copyMakeBorder(grey, 0, GAP, 0, GAP, cv2.BORDER_CONSTANT, value=[24]))
    line: npt.NDArray[np.uint8] = np.concatenate(shown, axis=1)
    _write(line, name, 6, 20)
    return line


def _names() -> npt.NDArray[np.uint8]:
    band = np.full((CAPTION_PX, len(COLUMNS) * (SIDE + GAP)), 24, np.uint8)
    for number, name in enumerate(COLUMNS):
        _write(band, name, number * (SIDE + GAP) + 6, CAPTION_PX - 8)
    return band


def _write(picture: npt.NDArray[np.uint8], text: str, x: int, y: int) -> None:
    cv2.putText(picture, text, (x, y), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (235,), 1, cv2.LINE_AA)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
