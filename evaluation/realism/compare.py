"""How far two sets of pictures are apart: real against simulated, beside real against real.

`distances` draws halves of the real pictures and as many simulated ones, so that all sets have one
size: a simulation that is no different has the distance of the halves, however few there are.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.progress import progress_bar
from ...factory.seeds import stream
from ..settings import Grid
from .features import FEATURES, features_of
from .pictures import Collection

if TYPE_CHECKING:
    import pandas as pd

Values = npt.NDArray[np.float64]

REAL = "real"
"""What tables call the distance between two halves of the real pictures."""
SMALLEST = 8
"""Pictures that each side needs: fewer leave no half to compare."""
RESAMPLES = 20
_FAR = 1e3


def described(collection: Collection, grid: Grid) -> pd.DataFrame:
    """(pictures x features) of a collection.  Raises FactoryError when a picture is unreadable."""
    import pandas as pd

    found = []
    with progress_bar(total=len(collection.sources), unit="picture", desc=collection.name) as bar:
        for one in collection.sources:
            found.append(features_of(one.polar(grid), one.geometry.range_span_m))
            bar.update()
    return pd.DataFrame(found)


def kolmogorov_smirnov(one: Values, other: Values) -> float:
    """Largest difference of the cumulative distributions, 0 to 1; NaN without values."""
    if not one.size or not other.size:
        return float("nan")
    every = np.concatenate([one, other])
    shares = [np.searchsorted(np.sort(s), every, side="right") / s.size for s in (one, other)]
    return float(np.abs(shares[0] - shares[1]).max())


def distances(
    real: pd.DataFrame, simulated: Mapping[str, pd.DataFrame], seed: int
) -> tuple[pd.DataFrame, dict[str, float]]:
    """(features x sets) Kolmogorov-Smirnov distances; and set -> the overall number.

    Sets: REAL, between two halves of the real pictures, and each simulation.  Features that the
    real pictures lack are left out.  The overall number is the geometric mean over the features of
    max(1, earth mover's distance over that of the halves): it goes on where a Kolmogorov-Smirnov
    distance has reached 1, so that a search has somewhere to go.  1 is a perfect simulation.
    Means over RESAMPLES draws.  Raises FactoryError for too few pictures.
    """
    import pandas as pd
    from scipy.stats import wasserstein_distance

    sets = {REAL: real, **simulated}
    for name, one in sets.items():
        if len(one) < SMALLEST:
            raise FactoryError(
                f"{name}: {len(one)} pictures; at least {SMALLEST} are needed to compare halves"
            )
    size = min(map(len, sets.values())) // 2
    # Ranges in metres are not always known.
    metric = all(one["slope_per_m"].notna().any() for one in sets.values())
    features = [n for n in FEATURES if real[n].notna().any() and (metric or n != "slope_per_m")]
    rng = stream(seed, "realism", "halves")
    sums = {name: np.zeros((2, len(features))) for name in sets}
    for _ in range(RESAMPLES):
        order = rng.permutation(len(real))
        first = real.iloc[order[:size]]
        drawn = {
            name: one.iloc[rng.permutation(len(one))[:size]] for name, one in simulated.items()
        }
        for name, other in {REAL: real.iloc[order[size : 2 * size]], **drawn}.items():
            for number, feature in enumerate(features):
                pair = [part[feature].dropna().to_numpy(float) for part in (first, other)]
                moved = wasserstein_distance(*pair) if all(map(len, pair)) else np.nan
                sums[name][:, number] += kolmogorov_smirnov(*pair), moved
    table = pd.DataFrame({name: found[0] / RESAMPLES for name, found in sums.items()}, features)
    overall = {}
    for name in simulated:
        ratios = sums[name][1] / np.maximum(sums[REAL][1], 1e-9)
        # What the simulation lacks is far away.
        bounded = np.nan_to_num(ratios, nan=_FAR).clip(1, _FAR)
        overall[name] = float(np.exp(np.log(bounded).mean()))
    return table, overall
