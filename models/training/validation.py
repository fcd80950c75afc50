"""Measures a network on validation images, and says which check was the best."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...factory.common.errors import FactoryError
from ...factory.dataset.quality import psnr_db, ssim
from ..data.crops import whole_image
from ..data.pairs import Data
from ..networks.network import Network
from .loop import Row, TrainingLoop, denoised

_FIGURES = ("psnr_noisy", "psnr", "ssim_noisy", "ssim")


def best_row(rows: Sequence[Row]) -> Row:
    """The row of the weights that are kept: the highest PSNR; of equal ones the first."""
    return max(rows, key=lambda row: row["psnr"])


def validate(loop: TrainingLoop[Network], data: Data) -> dict[str, float]:
    """Means of the figures over the validation images, one at a time: whole and of any size.

    Raises FactoryError where one of these is not a number.
    """
    figures = []
    for index in range(len(data.validation)):
        sample = data.validation.sample(index, None)
        with loop.autocast():
            denoised_image = denoised(loop.average, whole_image(sample, loop.average.extras))
        images = (sample.noisy, denoised_image)
        psnrs = [psnr_db(sample.clean, image) for image in images]
        ssims = [ssim(sample.clean, image) for image in images]
        figures.append(psnrs + ssims)
        loop.stop_if_asked()
    means = dict(zip(_FIGURES, np.mean(figures, axis=0).tolist(), strict=True))
    if not all(math.isfinite(value) for value in means.values()):
        raise FactoryError(
            f"the network returns NaN at step {loop.step}; lower train.learning_rate"
        )
    return {**means, "gain_db": means["psnr"] - means["psnr_noisy"]}
