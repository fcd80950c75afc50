"""How near a picture is to the nearly noise-free reference of a scene that stands still."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ..metrics.fidelity import decibels, finite_psnr, psnr, ssim
from ..metrics.levels import fit_levels

Gray = npt.NDArray[np.float32]
Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Score:
    """One picture against its reference, after one gain and offset: PSNR in dB, and SSIM."""

    psnr_db: float
    ssim: float


def score(picture: Gray, reference: Gray, where: Mask) -> Score:
    """How near a picture is to its reference where `where`, after one gain and offset."""
    fitted = fit_levels([(picture[where], reference[where])])(picture)
    return Score(
        finite_psnr(psnr(reference, fitted, data_range=1.0, mask=where)),
        ssim(reference, fitted, data_range=1.0, mask=where),
    )


def psnr_of(picture: Gray, reference: Gray, where: Mask) -> float:
    """The PSNR of `score` alone, dB; several times as fast."""
    near, far = picture[where], reference[where]
    fitted = fit_levels([(near, far)])(near)
    squared = float(np.mean(np.square(fitted - far, dtype=np.float64)))
    return finite_psnr(decibels(squared, 1.0))
