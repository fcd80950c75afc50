"""From polar grey values to the pixels that somebody gets to see, as makers' programs do it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from ..sonar.fan import fan_table
from ..sonar.settings import SonarSettings
from ..sonar.window import Window

Floats = npt.NDArray[np.float32]
_LARGEST_PX = 1536


@dataclass(frozen=True)
class Raster:
    """nearest: fan pixels show the nearest sample; else they interpolate.

    enlarged: the picture is made so much larger and then shrunk.  jpeg_quality: of JPEG in between,
    None without.
    """

    nearest: bool = False
    enlarged: float = 1.0
    jpeg_quality: int | None = None

    def picture(self, grey: Floats, window: Window, sonar: SonarSettings, *, noisy: bool) -> Floats:
        """(H, W) float32 in 0..1 of (range_bins, beams) grey values, rounded to 8 bits.

        noisy: whether JPEG leaves its traces; a clean picture has none.
        """
        height, width = sonar.shape()
        if sonar.image.layout == "polar":
            found = grey
        else:
            factor = min(self.enlarged, _LARGEST_PX / max(height, width))
            factor = max(factor, 1.0)
            image = replace(
                sonar.image, height_px=round(height * factor), width_px=round(width * factor)
            )
            table = fan_table(replace(sonar, image=image), window.near_fraction)
            found = table.nearest(grey) if self.nearest else table.bilinear(grey)
            if found.shape != (height, width):
                import cv2  # not in a core installation

                found = np.asarray(
                    cv2.resize(found, (width, height), interpolation=cv2.INTER_AREA), np.float32
                )
        eight = np.rint(np.clip(found, 0, 1) * 255).astype(np.uint8)
        if noisy and self.jpeg_quality is not None:
            import cv2

            done, content = cv2.imencode(
                ".jpg", eight, [cv2.IMWRITE_JPEG_QUALITY, self.jpeg_quality]
            )
            assert done
            eight = np.asarray(cv2.imdecode(content, cv2.IMREAD_GRAYSCALE), np.uint8)
        return np.asarray(eight, np.float32) / np.float32(255)
