"""Everything that is measured on a picture, once; distances are made of these numbers alone."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from ...factory.progress import progress_bar
from ..settings import Grid
from . import features, statistics
from .pictures import Collection, Gray

Values = npt.NDArray[np.float64]

LEVELS = 256
SCALARS = (
    "enl",
    "si",
    "cv",
    "acf_range",
    "acf_bearing",
    "spoke",
    "arc",
    "slope",
    "highlight",
    "shadow",
    "slope_per_m",
)


@dataclass(frozen=True, eq=False)
class Measured:
    """The numbers of N pictures, one row each.

    amplitude (N, 256), gradient (N, 64), pattern (N, 10): histograms, each row sums to 1.
    scalars (N, 11): as named in `SCALARS`, NaN where a picture has none.
    families (N, 5): see `statistics.family_costs`.
    radial, along, across (N, 24): spectra in dB.  description (N, D): `features.describe`.
    """

    amplitude: Values
    gradient: Values
    pattern: Values
    scalars: Values
    families: Values
    radial: Values
    along: Values
    across: Values
    description: Values

    def __len__(self) -> int:
        return len(self.amplitude)

    def scalar(self, name: str) -> Values:
        """(N,) one of `SCALARS`."""
        return np.asarray(self.scalars[:, SCALARS.index(name)])


def measure_picture(polar: Gray, span_m: float | None = None) -> Measured:
    """The numbers of one polar picture in 0..1, N = 1.

    span_m: length of its range window in metres; without it there is no slope per metre.
    """
    even = statistics.even_windows(polar)
    level = np.clip(np.rint(polar * (LEVELS - 1)), 0, LEVELS - 1).astype(np.intp)
    slope_db = statistics.range_slope_db(polar)
    scalars = [
        *statistics.speckle(even),
        *statistics.half_widths(polar),
        statistics.spoke_index(polar),
        statistics.arc_index(polar),
        slope_db,
        *statistics.contrasts_db(polar),
        slope_db / span_m if span_m else np.nan,
    ]
    radial, along, across = statistics.spectra(polar)

    def shares(counts: Values) -> Values:
        return np.asarray(counts / counts.sum())[None]

    return Measured(
        amplitude=shares(np.bincount(level.ravel(), minlength=LEVELS).astype(np.float64)),
        gradient=shares(statistics.gradients(polar)),
        pattern=shares(statistics.patterns(polar)),
        scalars=np.asarray(scalars)[None],
        families=statistics.family_costs(even)[None],
        radial=radial[None],
        along=along[None],
        across=across[None],
        description=features.describe(polar)[None],
    )


def joined(parts: Sequence[Measured]) -> Measured:
    """All rows of all parts, in order."""
    names = Measured.__dataclass_fields__
    return Measured(**{name: np.concatenate([getattr(p, name) for p in parts]) for name in names})


def measure(collection: Collection, grid: Grid) -> Measured:
    """The numbers of every picture of a collection.  Raises FactoryError when one is unreadable."""
    sources: Iterable = progress_bar(collection.sources, desc=collection.name, unit="picture")
    return joined(
        [measure_picture(source.polar(grid), source.geometry.range_span_m) for source in sources]
    )
