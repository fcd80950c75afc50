"""docs/images/removal.png: what --remove takes from pictures of drawn devices.

    python -m tools.removal_picture

Pictures of `python -m benchmarks removal`: as they are, denoised with `--remove` of one artefact,
and what they would be without it.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np

from benchmarks.denoising.bench_removal import PLACES, Asked, rendered
from simnfnd.models.denoise.in_turn import asked_denoiser

OUT = Path("docs/images/removal.png")
SHOWN = (("spokes", 22), ("spokes", 42), ("haze", 19))
"""Artefact, and number of the picture."""
_HEIGHT_PX, _GAP_PX = 420, 8


def main() -> None:
    """Make the picture."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        config, frames = rendered(Path(folder), PLACES)
        for artefact, number in SHOWN:
            sample = Asked(config, frames, (artefact,)).sample(number % len(frames), number)
            assert sample.clean is not None
            denoised = asked_denoiser(None, "cpu", [artefact])(sample.noisy, sample.geometry)
            rows.append([_shown(one) for one in (sample.noisy, denoised, sample.clean)])
    # The pictures of an artefact stand beside each other, one artefact after the other.
    cv2.imwrite(str(OUT), np.hstack([part for row in rows for part in row])[:, :-_GAP_PX])


def _shown(picture: np.ndarray) -> np.ndarray:
    size = round(picture.shape[1] * _HEIGHT_PX / picture.shape[0]), _HEIGHT_PX
    small = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
    grey = np.rint(np.clip(small, 0, 1) * 255).astype(np.uint8)
    return np.pad(grey, ((0, 0), (0, _GAP_PX)), constant_values=255)


if __name__ == "__main__":
    main()
