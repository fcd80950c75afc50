"""MS-SSIM: structural similarity at five scales."""

from __future__ import annotations

from ...factory.dataset.describe.similarity import inner
from .checks import Image, checked_pair
from .reference import Compared, Reference

WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
"""Exponents of the five scales, the finest first (Wang et al. 2003, section 3.2)."""

SMALLEST = 176
"""Pixels a side: the 11-pixel window must still fit into the fifth scale."""


def ms_ssim(reference: Image, image: Image, *, data_range: float) -> float:
    """Multi-scale SSIM in 0..1, 1 = identical (Wang, Simoncelli and Bovik 2003).

    Product over five scales of the mean contrast-structure term to the power WEIGHTS; the coarsest
    scale has the luminance term, too.  Window: Gaussian, sigma 1.5, 11 pixels, only where it fits
    wholly; between scales the mean of 2x2 blocks, an odd last row or column left out.  A negative
    mean counts as 0, because it has no real power.  MetricError below SMALLEST pixels a side.
    """
    a, b = checked_pair(reference, image, data_range, smallest=SMALLEST)
    return ms_ssim_of(Compared(Reference(a, data_range), b))


def ms_ssim_of(compared: Compared) -> float:
    """The same for an image that was checked already."""
    product = 1.0
    for scale, weight in enumerate(WEIGHTS):
        if scale:
            compared = compared.halved
        luminance, structure = compared.terms
        last = scale == len(WEIGHTS) - 1
        terms = luminance * structure if last else structure
        mean = float(inner(terms).mean())
        product *= max(mean, 0.0) ** weight
    return product
