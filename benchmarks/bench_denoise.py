"""What denoising costs from Enter to file: one image, a recording by single frames and in time.

The image is one frame of examples/didson/lamprey.avi at 512x512 pixels; a further frame of a
recording is the difference of a long and a short video.
"""

from __future__ import annotations

import tempfile
from pathlib import Path
from statistics import median

import cv2
import numpy as np

from benchmarks.shared import Options, Section, Table, run_command

SIDE_PX = 512
TURNS = 3
LAMPREY = Path(__file__).parents[1] / "examples/didson/lamprey.avi"


def measure(options: Options) -> Section:
    """CPU and wall seconds of one image, and of a further frame of a recording."""
    few = options.amount(10, 2)
    many = options.amount(60, 4)
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        frames = _frames(many)
        cv2.imwrite(str(folder / "frame.png"), frames[0])
        for count in (few, many):
            _write(folder / f"{count}.avi", frames[:count])
        turns = [
            run_command("denoise", f"{folder}/frame.png", "--out", f"{folder}/image-{turn}")
            for turn in range(options.amount(TURNS))
        ]
        cpu, wall = (median(getattr(turn, key) for turn in turns) for key in ("cpu", "wall"))
        rows.append(("one PNG, from Enter to file", cpu, wall))
        for label, words in (("single frames", ("--frames", "1")), ("in time", ())):
            less, more = (
                run_command(
                    "denoise", f"{folder}/{count}.avi", *words, "--out",
                    f"{folder}/{label}-{count}".replace(" ", "-"),
                )
                for count in (few, many)
            )  # fmt: skip
            frame = [
                (getattr(more, key) - getattr(less, key)) / (many - few) for key in ("cpu", "wall")
            ]
            rows.append((f"a further frame, {label}", *frame))
    return Section((Table(("512x512 pixels", "CPU s", "wall s"), rows),))


def _frames(count: int) -> list[np.ndarray]:
    video = cv2.VideoCapture(str(LAMPREY))
    frames: list[np.ndarray] = []
    while len(frames) < count and (read := video.read())[0]:
        frames.append(cv2.resize(read[1], (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA))
    return (frames * (count // len(frames) + 1))[:count]


def _write(path: Path, frames: list[np.ndarray]) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"FFV1"), 10, (SIDE_PX, SIDE_PX))
    for frame in frames:
        writer.write(frame)
    writer.release()
