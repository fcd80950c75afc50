"""docs/images/real.png: frames of two recordings as recorded, denoised, and the mean of the others.

    python -m tools.real_pictures FOLDER

FOLDER holds didson/lamprey1.avi and aris-sdk/sample.aris, whose terms docs/images/NOTICE.md states.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from simnfnd.evaluation.metrics.measure import Gray
from simnfnd.evaluation.real.groups import judged, search
from simnfnd.evaluation.recorded import open_input
from simnfnd.models.denoise.denoiser import load_denoiser

OUT = Path("docs/images/real.png")
_HEIGHT_PX, _GAP_PX = 620, 32


@dataclass(frozen=True)
class Recording:
    """A file, how many of its frames are searched for a scene at rest, and the contrast shown.

    dark, bright: grey values shown as black and white.
    """

    path: str
    most: int
    dark: float
    bright: float


RECORDINGS = (
    Recording("didson/lamprey1.avi", 32, 0.0, 0.77),
    Recording("aris-sdk/sample.aris", 6, 0.18, 0.65),
)


def main(folder: Path) -> None:
    """Draw the picture."""
    denoise = load_denoiser("simnfnd", "cpu")
    shown = []
    for recording in RECORDINGS:
        (stretch,), _ = open_input(str(folder / recording.path))
        group = search((0, stretch, recording.most)).groups[0]
        frame = next(iter(judged(0, group, [len(group.shots) // 2])))
        assert frame.reference is not None
        for one in (frame.noisy, denoise(frame.noisy, frame.geometry), frame.reference):
            level = (one - recording.dark) / (recording.bright - recording.dark)
            picture = np.clip(level, 0, 1).astype(np.float32) * (frame.noisy > 0)
            shown += [tall(picture), np.zeros((_HEIGHT_PX, _GAP_PX), np.float32)]
    cv2.imwrite(str(OUT), np.rint(np.hstack(shown[:-1]) * 255).astype(np.uint8))


def tall(picture: Gray) -> Gray:
    """As high as all of them."""
    width = round(picture.shape[1] * _HEIGHT_PX / picture.shape[0])
    found = cv2.resize(picture, (width, _HEIGHT_PX), interpolation=cv2.INTER_AREA)
    return np.asarray(found, np.float32)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
