"""Made-up sonar pictures for the tests of the realism report."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt
from PIL import Image
from scipy import ndimage

Gray = npt.NDArray[np.float32]


def speckle(
    rng: np.random.Generator,
    shape: tuple[int, int] = (192, 96),
    grain: tuple[float, float] = (0.0, 0.0),
) -> npt.NDArray[np.float64]:
    """Rayleigh amplitude of mean power 1; grain: Gaussian standard deviations in cells."""
    field = rng.standard_normal((2, *shape))
    if any(grain):
        field = np.stack([ndimage.gaussian_filter(part, grain, mode="wrap") for part in field])
    power = (field**2).sum(axis=0)
    return np.asarray(np.sqrt(power / power.mean()))


def sonar_picture(rng: np.random.Generator, level: float = 0.3, looks: int = 3) -> Gray:
    """(192, 96) polar picture in 0..1: log-compressed speckle on a sloping bottom, one object."""
    power = np.mean([speckle(rng, grain=(0.6, 0.6)) ** 2 for _ in range(looks)], axis=0)
    rows, columns = np.mgrid[0:192, 0:96]
    bottom_db = -6 * rows / 192 + 4 * np.sin(columns / 30 + rng.uniform(0, 6))
    bottom_db[60:70, 20:34] += 20
    bottom_db[70:100, 20:34] -= 15
    grey = level + (10 * np.log10(power) + bottom_db) / 80
    return np.asarray(np.clip(grey, 0, 1), np.float32)


def polar_folder(root: Path, seed: int, count: int = 16, **changes: float) -> Path:
    """A folder of polar pictures with geometry.csv."""
    root.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    for number in range(count):
        picture = np.rint(255 * sonar_picture(rng, **changes)).astype(np.uint8)  # type: ignore[arg-type]
        Image.fromarray(picture).save(root / f"{number:03d}.png")
    (root / "geometry.csv").write_text(
        "file,layout,hfov_deg,range_min_m,range_max_m\n*,polar,30,1,5\n"
    )
    return root
