"""Where a method is good and where not: by place, by noise effect and level, by resampling rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from ..pairs import Item
from .tables import written

_MOST_PLACES = 12
_BINS, _PAIRS_A_BIN = 5, 8


def breakdown_of(
    psnr: pd.DataFrame,
    items: Sequence[Item],
    drawn: Mapping[str, npt.NDArray[Any]],
    labels: Sequence[str],
) -> list[pd.DataFrame]:
    """A table a factor that varies, as text: the rows' mean PSNR in dB in each of its bins.

    psnr: of each pair (rows) by each method (columns).  drawn: columns of /meta.  labels: methods
    to break down, in their order.  A number is cut into up to five bins of equally many pairs; an
    effect that is off in a pair has a bin `off`.
    """
    place = "location" if len({item.location for item in items}) > 1 else "scene"
    factors: dict[str, Any] = {place: [getattr(item, place) for item in items]}
    factors["PSNR of the noisy image, dB"] = psnr["noisy"]
    factors |= {
        name: column
        for name, column in drawn.items()
        if name.startswith("noise.") or name == "resample.rate"
    }
    found = []
    for factor, column in factors.items():
        bins = _bins(pd.Series(column))
        if bins.nunique() < 2:
            continue
        means = psnr[list(labels)].groupby(bins, observed=True).mean()
        pairs = bins.value_counts()
        table = means.map(lambda value: written(value, 2)).T
        table.columns = [f"{name} ({pairs[name]})" for name in means.index]
        found.append(table.rename_axis(factor).reset_index())
    return found


def _bins(values: pd.Series[Any]) -> pd.Series[Any]:
    """The bin of each value, in order; none for the rarest of many words."""
    if not pd.api.types.is_numeric_dtype(values):
        most = values.value_counts().index[:_MOST_PLACES]
        return values.where(values.isin(most)).replace("", "off")
    if values.nunique() <= _BINS:
        names = dict.fromkeys(f"{one:.3g}" for one in sorted(values.dropna().unique()))
        cut = pd.Categorical(values.map("{:.3g}".format, na_action="ignore"), list(names))
    else:
        count = int(np.clip(values.count() // _PAIRS_A_BIN, 2, _BINS))
        cut = pd.qcut(values, count, duplicates="drop").array
        cut = cut.rename_categories(lambda one: f"{one.left:.3g} .. {one.right:.3g}")
    return pd.Series(cut.set_categories(["off", *cut.categories]), values.index).fillna("off")
