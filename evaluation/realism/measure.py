"""Everything that is measured on a picture, once; distances are made of these numbers alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache

import cv2
import numpy as np
import numpy.typing as npt

from ...factory.progress import progress_bar
from ...factory.seeds import stream
from ..settings import Grid
from . import statistics
from .pictures import Collection, Gray

Measured = Mapping[str, npt.NDArray[np.float64]]
"""The numbers of N pictures, one row each.

amplitude (N, 256), gradient (N, 64), pattern (N, 10): histograms, each row sums to 1.
radial, along, across (N, 24): spectra in dB.  description (N, SIZE): `describe`.
enl, si, cv, acf_range, acf_bearing, spoke, arc, slope, highlight, shadow, slope_per_m: (N,), NaN
where a picture has none.
"""

LEVELS = 256


def measure_picture(polar: Gray, span_m: float | None = None) -> Measured:
    """The numbers of one polar picture in 0..1, N = 1.

    span_m: length of its range window in metres; without it there is no slope per metre.
    """
    level = np.clip(np.rint(polar * (LEVELS - 1)), 0, LEVELS - 1).astype(np.intp)
    counts = {
        "amplitude": np.bincount(level.ravel(), minlength=LEVELS).astype(np.float64),
        "gradient": statistics.gradients(polar),
        "pattern": statistics.patterns(polar),
    }
    slope_db = statistics.range_slope_db(polar)
    found = {
        **{name: one / one.sum() for name, one in counts.items()},
        **dict(zip(("radial", "along", "across"), statistics.spectra(polar), strict=True)),
        **dict(zip(("enl", "si", "cv"), statistics.speckle(polar), strict=True)),
        **dict(zip(("acf_range", "acf_bearing"), statistics.half_widths(polar), strict=True)),
        "spoke": statistics.spread_of_means(polar, 0),
        "arc": statistics.spread_of_means(polar, 1),
        "slope": slope_db,
        **dict(zip(("highlight", "shadow"), statistics.contrasts_db(polar), strict=True)),
        "slope_per_m": slope_db / span_m if span_m else np.nan,
        "description": describe(polar),
    }
    return {name: np.asarray(one, np.float64)[None] for name, one in found.items()}


def joined(parts: Sequence[Measured]) -> Measured:
    """All rows of all parts, in order."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def measure(collection: Collection, grid: Grid) -> Measured:
    """The numbers of every picture of a collection.  Raises FactoryError when one is unreadable."""
    sources = progress_bar(collection.sources, desc=collection.name, unit="picture")
    return joined([measure_picture(one.polar(grid), one.geometry.range_span_m) for one in sources])


# A fixed description of a picture in numbers, for KID and for the classifier's two-sample test.
# Two layers of small filters, drawn once from a seed and never trained (random features: Jarrett et
# al. 2009; Saxe et al. 2011).  They see local texture at two scales and, by the four bands along
# range, where it is; two simulators that differ in objects alone look alike to them.  Figures are
# not to be compared with KID on Inception features.
_SEED = 2024
_FIRST, _SECOND, _FANS = 12, 24, 3
_BANDS = 4
SIZE = _BANDS * (_FIRST + 2) + 2 * _SECOND
"""Length of a description."""


def describe(polar: Gray) -> npt.NDArray[np.float64]:
    """(SIZE,) description of a polar picture in 0..1.

    First layer: 12 filters of 7x7, absolute value, mean over each of four bands along range
    (as logarithm).  Second layer: each of 24 filters of 5x5 reads three maps of the first, a
    quarter as fine; mean and standard deviation over the picture.  Mean and standard deviation of
    the grey values of each band come with it.
    """
    first, second, wiring = _filters()
    maps = [np.abs(cv2.filter2D(polar, cv2.CV_32F, kernel)) for kernel in first]
    bands = [np.array_split(one, _BANDS, axis=0) for one in [polar, *maps]]
    found: list[float] = [float(part.mean()) for part in bands[0]]
    found += [float(part.std()) for part in bands[0]]
    found += [float(np.log(part.mean() + 1e-3)) for one in bands[1:] for part in one]
    small = [cv2.resize(one, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA) for one in maps]
    for kernels, sources in zip(second, wiring, strict=True):
        mixed = sum(
            cv2.filter2D(small[source], cv2.CV_32F, kernel)
            for kernel, source in zip(kernels, sources, strict=True)
        )
        lit = np.abs(mixed)
        found += [float(np.log(lit.mean() + 1e-4)), float(np.log(lit.std() + 1e-4))]
    return np.asarray(found)


@lru_cache(maxsize=1)
def _filters() -> tuple[Gray, Gray, npt.NDArray[np.intp]]:
    """Filters without mean and of unit length, and which maps each of the second layer reads."""
    rng = stream(_SEED, "realism", "features")
    first = rng.standard_normal((_FIRST, 7, 7))
    second = rng.standard_normal((_SECOND, _FANS, 5, 5))
    wiring = np.stack([rng.permutation(_FIRST)[:_FANS] for _ in range(_SECOND)])
    return _unit(first), _unit(second), wiring


def _unit(filters: npt.NDArray[np.float64]) -> Gray:
    centred = filters - filters.mean(axis=(-2, -1), keepdims=True)
    length = np.sqrt((centred**2).sum(axis=(-2, -1), keepdims=True))
    return np.asarray(centred / length, dtype=np.float32)
