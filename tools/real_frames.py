"""Draw docs/images/real.png anew: `python -m tools.real_frames`.

A frame of a DIDSON and one of an ARIS, both of examples/: as recorded, denoised alone, and the mean
of the other frames of the recording, which the network does not see.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from simnfnd import denoise, open_recording
from simnfnd.factory.common.array_types import Float32s, UInt8s
from simnfnd.models.recordings.views import frame_image

ROOT = Path(__file__).resolve().parents[1]
IMAGE = ROOT / "docs" / "images" / "real.png"
FRAMES = {"didson/lamprey.avi": 18, "aris/sample.aris": 1}
"""Recording in examples/ -> the frame that is shown."""

_HEIGHT_PX = 600
_CAPTION_PX = 24
_GAP_PX = 6
_BACKGROUND = 24
_LIGHT = 235
_WHITE_PERCENTILE = 99.8


def views(path: Path, number: int) -> dict[str, Float32s]:
    """Caption -> (H, W) float32 in 0..1, cut to what is insonified."""
    with open_recording(path) as recording:
        frame_count = len(recording)
    frames_with_geometry = [frame_image(path, index) for index in range(frame_count)]
    frames = [frame for frame, _ in frames_with_geometry]
    geometry = frames_with_geometry[number][1]
    others = [frame for index, frame in enumerate(frames) if index != number]
    images = {
        "as recorded": frames[number],
        "one frame, denoised": np.asarray(denoise(frames[number], geometry=geometry)),
        "mean of the others": np.mean(others, axis=0),
    }
    is_insonified = np.max(frames, axis=0) > 0
    rows = np.flatnonzero(is_insonified.any(axis=1))
    columns = np.flatnonzero(is_insonified.any(axis=0))
    shown = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
    white = np.percentile(frames[number][is_insonified], _WHITE_PERCENTILE)
    return {caption: np.clip(image[shown] / white, 0, 1) for caption, image in images.items()}


def captioned(image: Float32s, caption: str) -> UInt8s:
    """An image at the sheet's height, below its caption."""
    height, width = image.shape
    size = round(width * _HEIGHT_PX / height), _HEIGHT_PX
    pixels = cv2.resize((255 * image).astype(np.float32), size, interpolation=cv2.INTER_AREA)
    panel = np.full((_CAPTION_PX + _HEIGHT_PX, size[0]), _BACKGROUND, np.uint8)
    panel[_CAPTION_PX:] = pixels
    place = (4, 17)
    cv2.putText(panel, caption, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, (_LIGHT,), 1, cv2.LINE_AA)
    return panel


def main() -> None:
    """Draw the sheet."""
    panels = []
    for name, number in FRAMES.items():
        for caption, image in views(ROOT / "examples" / name, number).items():
            panels.append(captioned(image, caption))
            panels.append(np.full((_CAPTION_PX + _HEIGHT_PX, _GAP_PX), _BACKGROUND, np.uint8))
    cv2.imwrite(str(IMAGE), np.hstack(panels[:-1]))
    print(IMAGE.relative_to(ROOT))


if __name__ == "__main__":
    main()
