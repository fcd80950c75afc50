"""`simnfnd preview DIR`: contact sheet of a dataset, or of a recording."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...factory.cli import Parser
from ...factory.dataset.describe.preview import Shown, draw, preview
from ...factory.errors import FactoryError
from ...factory.files import write_atomically
from ...models.recordings import is_recording, open_recording
from ...models.recordings.base import Frame
from ...models.recordings.fan.pings import fan_of, grey_of


def main(words: list[str]) -> None:
    """Draw the contact sheet that `words` ask for."""
    parser = Parser(prog="simnfnd preview")
    parser.add_argument("dir", type=Path, help="folder of a dataset, or a recording")
    parser.add_argument(
        "--out", type=Path, help="picture to write (default: DIR/preview.png; a recording needs it)"
    )
    parser.add_argument("--pairs", type=int, default=8, help="pairs or frames to show")
    given = parser.parse_args(words)
    if is_recording(given.dir):
        path = _of_recording(given.dir, given.out, given.pairs)
    else:
        path = preview(given.dir, out=given.out, pairs=given.pairs)
    print(f"preview: {path}")


def _of_recording(source: Path, out: Path | None, frames: int) -> Path:
    """Draw frames, evenly spread, pings as fans; returns the path."""
    if out is None:
        raise FactoryError(f"{source}: a recording has no folder of its own; give --out FILE.png")
    if frames < 1:
        raise FactoryError(f"--pairs must be at least 1, got {frames}")
    with open_recording(source) as recording:
        count = len(recording)
        numbers = sorted({k * count // min(frames, count) for k in range(min(frames, count))})
        shown = [_shown(recording[number], number) for number in numbers]
    write_atomically(out, draw(shown, source.name, f"{count} frames"), key="--out")
    return out


def _shown(frame: Frame, number: int) -> Shown:
    grey = grey_of(frame)
    if frame.beams is not None:
        grey, _ = fan_of(grey, frame.beams)
    elif grey.ndim == 3:
        grey = np.asarray(grey[..., :3].mean(axis=-1), np.float32)
    height, width = grey.shape
    extent = (0.0, float(width), float(height), 0.0)
    return Shown(f"frame {number}", {"picture": grey}, 1.0, ("row", "column"), extent)
