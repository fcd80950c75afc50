"""Which pictures are tested by which training, and which of the others have labels."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.seeds import stream


def folds_of(component: npt.NDArray[np.int64], folds: int, seed: int) -> npt.NDArray[np.int64]:
    """(N,) the fold that tests each picture; a component lies in one fold whole.

    The largest components first, each into the fold that has the fewest pictures; `seed` decides
    among equals.  FactoryError with fewer components than folds.
    """
    sizes = np.bincount(component)
    if len(sizes) < folds:
        raise FactoryError(
            f"folds={folds}: the pictures fall into {len(sizes)} components of similarity; give "
            "more pictures, fewer folds or a higher alike="
        )
    random = stream(seed, "downstream", "folds")
    order = random.permutation(len(sizes))
    chosen = np.empty(len(sizes), np.int64)
    filled = np.zeros(folds, np.int64)
    for one in order[np.argsort(-sizes[order], kind="stable")]:
        least = np.flatnonzero(filled == filled.min())
        chosen[one] = random.choice(least)
        filled[chosen[one]] += sizes[one]
    return np.asarray(chosen[component])


def labelled_of(train: Sequence[int], percent: float, seed: int, fold: int) -> list[int]:
    """The pictures of a training that have labels, at least one.

    Those of a smaller percentage are among those of a larger one.
    """
    order = stream(seed, "downstream", "labels", fold).permutation(len(train))
    count = max(1, round(len(train) * percent / 100))
    return sorted(int(train[place]) for place in order[:count])
