"""Speckle: how smooth are the smooth places, and is what was removed really noise?"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from .fidelity import Image, Mask

Values = npt.NDArray[np.float64]

SIDE = 16
"""Of an even zone, pixels."""

_DARK = 0.01  # of full scale: below, a ratio says nothing
_LEVELS = 16  # gray levels of the co-occurrence matrix
_CLOSENESS = 1 / (1 + np.square(np.subtract.outer(np.arange(_LEVELS), np.arange(_LEVELS))))


def homogeneous_zones(
    image: Image, *, data_range: float, sector: Mask, share: float = 0.1
) -> npt.NDArray[np.int64]:
    """(N, 2) top-left corners of the image's most even blocks, the evenest first.

    Blocks of 16x16 pixels on a grid without overlap, wholly inside `sector` and with a mean above
    5 % of full scale (shadow is even, too, but has no speckle); of these the `share` (at least one)
    with the least std/mean.  Choose them on the clean image where there is one, so that all methods
    are measured in the same places.  Empty when no block qualifies.
    """
    rows, columns = (size // SIDE for size in image.shape)

    def blocks(array: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
        cut = array[: rows * SIDE, : columns * SIDE].reshape(rows, SIDE, columns, SIDE)
        return cut.transpose(0, 2, 1, 3).reshape(rows * columns, SIDE * SIDE)

    values = blocks(image.astype(np.float64))
    mean, deviation = values.mean(axis=1), values.std(axis=1)
    (usable,) = np.nonzero(blocks(sector).all(axis=1) & (mean > 0.05 * data_range))
    if not usable.size:
        return np.empty((0, 2), dtype=np.int64)
    count = max(1, round(share * usable.size))
    order = np.argsort(deviation[usable] / mean[usable], kind="stable")[:count]
    chosen = usable[order]
    corners = np.stack([chosen // columns * SIDE, chosen % columns * SIDE], axis=1)
    return np.asarray(corners, dtype=np.int64)


def zone_enl(image: Image, zones: npt.NDArray[np.int64]) -> Values:
    """(N,) equivalent number of looks of each zone, mean^2 / variance; inf where all is equal."""
    return _looks(_blocks(image, zones).astype(np.float64))


def enl(image: Image, zones: npt.NDArray[np.int64]) -> float:
    """Median ENL over the zones (NaN without any).  Blur alone raises it: never read it alone."""
    return float(np.median(zone_enl(image, zones))) if len(zones) else math.nan


def contrast_to_noise(image: Image, bright: Mask, dark: Mask) -> float:
    """CNR of two regions, |m1 - m2| / sqrt(v1 + v2) with population variances (linear, not dB).

    Here `bright` is the insonified seabed and `dark` the true shadow.  NaN when a region is empty,
    inf when both are constant and differ.
    """
    gray = np.asarray(image, dtype=np.float64)
    one, other = gray[bright], gray[dark]
    if not one.size or not other.size:
        return math.nan
    difference = abs(float(one.mean() - other.mean()))
    noise = math.sqrt(float(one.var() + other.var()))
    if noise == 0:
        return math.inf if difference else 0.0
    return difference / noise


def ratio_image(noisy: Image, denoised: Image, data_range: float = 1.0) -> Values:
    """(H, W) noisy / denoised: pure speckle of mean 1 if the filter took nothing but noise.

    NaN where the denoised image is below 1 % of full scale.
    """
    above, below = noisy.astype(np.float64), denoised.astype(np.float64)
    result = np.full(below.shape, np.nan)
    np.divide(above, below, out=result, where=below >= _DARK * data_range)
    return result


def mean_ratio(ratio: Values) -> float:
    """Mean of a ratio image, 1 = the mean is preserved; NaN where nothing of it is known."""
    values = ratio[np.isfinite(ratio)]
    return float(values.mean()) if values.size else math.nan


def structure(ratio: Values) -> float:
    """Delta h of Gomez et al. 2017: how much structure a ratio image keeps, 0 = pure speckle.

    100 |h - h'| / h with the homogeneity h = sum p(i, j) / (1 + (i - j)^2) of the co-occurrence
    matrix of horizontal and vertical neighbours, and h' its mean over images of the same pixels in
    random order; here the mean over all orders, which needs no random numbers.  Our choices: 16
    levels, equally frequent ones, because a few bright ratios would squeeze all others into one
    level; only neighbours that both exist (no NaN).  NaN with fewer than two neighbours.
    """
    flat = ratio.ravel()
    known = np.flatnonzero(np.isfinite(flat))
    values = flat[known]
    if values.size < 2:
        return math.nan
    # Equal frequencies: the level is the rank, ties (a noiseless region) share the lowest one.
    # The level rises where a share of k/16 of all pixels is below, so 15 of the sorted values do.
    last = -(-np.arange(1, _LEVELS) * values.size // _LEVELS) - 1
    edges = np.partition(values, np.unique(last))[last]
    ranks = np.searchsorted(edges, values, side="left")
    levels = np.full(flat.shape, _LEVELS)
    levels[known] = ranks
    before = _homogeneity(levels.reshape(ratio.shape))
    if math.isnan(before):
        return math.nan
    return 100 * abs(before - _shuffled_homogeneity(ranks)) / before


def m_index(ratio: Values, before: Values, zones: npt.NDArray[np.int64]) -> float:
    """M of Gomez, Ospina and Frery (Remote Sensing 9(4), 389, 2017): 0 = an ideal speckle filter.

    ratio: the `ratio_image`.  before: (N,) ENL of the noisy image's zones.
    M = r + delta h.  r is half the mean over the homogeneous zones of |ENL_noisy - ENL_ratio| /
    ENL_noisy + |1 - mean ratio|: a perfect filter leaves all of the speckle, with mean 1, in the
    ratio image.  Mean and not sum over zones, so that it does not grow with their number.  delta h
    is `structure` of the whole ratio image.  A zone's ENL term counts at most 1.  Mind: a filter
    that does nothing gets 0.5 (a ratio of 1 everywhere has no structure), so M ranks filters that
    do something, beside PSNR.  NaN without zones.
    """
    blocks = _blocks(ratio, zones)
    usable = np.isfinite(blocks).any(axis=1) & np.isfinite(before) & (before != 0)
    if not usable.any():
        return math.nan
    blocks, before = blocks[usable], before[usable]
    # Without variance ENL is infinite; such a zone counts as wholly unlike.
    unlike = np.minimum(np.abs(before - _looks(blocks)) / before, 1.0)
    residuals = 0.5 * (unlike + np.abs(1 - np.nanmean(blocks, axis=1)))
    return float(residuals.mean()) + structure(ratio)


def _blocks(image: Image, zones: npt.NDArray[np.int64]) -> Image:
    """(N, SIDE * SIDE) pixels of the zones."""
    offsets = np.arange(SIDE)
    rows, columns = zones[:, :1] + offsets, zones[:, 1:] + offsets
    blocks = image[rows[:, :, None], columns[:, None, :]]
    return np.asarray(blocks.reshape(len(zones), SIDE * SIDE))


def _looks(blocks: Values) -> Values:
    """(N,) mean^2 / variance of each row; inf for a constant, whose variance is rounding alone.

    NaN pixels are left out; each row has one that is none.
    """
    squared, variance = np.nanmean(blocks, axis=1) ** 2, np.nanvar(blocks, axis=1)
    some = variance > 1e-20 * squared
    return np.where(some, squared / np.where(some, variance, 1.0), math.inf)


def _homogeneity(levels: npt.NDArray[np.int64]) -> float:
    """Homogeneity of the co-occurrence of right and lower neighbours, NaN without any pair.

    levels: (H, W), _LEVELS where unknown.
    """
    side = _LEVELS + 1  # one more for the unknown: counting them is cheaper than taking them out
    together = np.zeros(side * side)
    for first, second in ((np.s_[:, :-1], np.s_[:, 1:]), (np.s_[:-1], np.s_[1:])):
        pairs = levels[first] * side + levels[second]
        together += np.bincount(pairs.ravel(), minlength=together.size)
    together = together.reshape(side, side)[:_LEVELS, :_LEVELS]
    count = float(together.sum())
    return float((together * _CLOSENESS).sum()) / count if count else math.nan


def _shuffled_homogeneity(levels: npt.NDArray[np.int64]) -> float:
    """Expected homogeneity when all orders of these pixels, two at least, are equally likely."""
    share = np.bincount(levels, minlength=_LEVELS).astype(np.float64)
    count = float(levels.size)
    # Two different pixels are neighbours: a pixel and itself (closeness 1) is taken out again.
    return (float(share @ _CLOSENESS @ share) - count) / (count * (count - 1))
