"""docs/images/removal.png: what --remove takes from pictures of drawn devices.

    python -m tools.removal_picture

Pictures of `python -m benchmarks removal`: as they are, denoised with `--remove` of one artefact,
and what they would be without it.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from benchmarks.denoising.bench_removal import PLACES, Asked, rendered
from simnfnd.models.denoise.weighing.in_turn import asked_denoiser
from tools.real_pictures import side_by_side, tall, write

OUT = Path("docs/images/removal.png")
SHOWN = (("spokes", 22), ("spokes", 42), ("haze", 19))
"""Artefact, and number of the picture."""
_HEIGHT_PX = 420


def main() -> None:
    """Make the picture."""
    parts = []
    with tempfile.TemporaryDirectory() as folder:
        config, frames = rendered(Path(folder), PLACES)
        for artefact, number in SHOWN:
            sample = Asked(config, frames, (artefact,)).sample(number % len(frames), number)
            assert sample.clean is not None
            denoised = asked_denoiser(None, "cpu", [artefact])(sample.noisy, sample.geometry)
            parts += [tall(one, _HEIGHT_PX) for one in (sample.noisy, denoised, sample.clean)]
    write(OUT, side_by_side(parts, gap=1))


if __name__ == "__main__":
    main()
