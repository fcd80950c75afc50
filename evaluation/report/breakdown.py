"""Where a method is good and where not: by place, by noise effect and level, by resampling rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..metrics.statistics import estimate
from ..pairs import Item
from ..settings import EvaluationSettings
from .content import Row, as_dict

_MOST_PLACES = 12
_PAIRS_A_BIN = 8

Column = npt.NDArray[Any]


def breakdown_of(
    rows: Sequence[Row],
    items: Sequence[Item],
    drawn: Mapping[str, Column],
    labels: Sequence[str],
    settings: EvaluationSettings,
) -> list[dict[str, Any]]:
    """One entry a factor that varies: its bins, and the rows' mean PSNR and gain in each.

    drawn: columns of /meta.  labels: the rows to break down, in their order.  A number is cut into
    up to five bins of equally many pairs; an effect that is off in a pair has a bin `off`.
    """
    chosen = {row.method.label: row for row in rows if row.lost is None}
    kept = [label for label in labels if label in chosen]
    noisy = chosen["noisy"]
    options = {"resamples": settings.bootstrap, "seed": settings.seed}
    found = []
    for factor, unit, columns in _factors(noisy, items, drawn):
        bins = _bins(columns)
        if len(bins) < 2:
            continue
        entry: dict[str, Any] = {"factor": factor, "unit": unit, "bins": [], "rows": {}}
        for name, where, centre in bins:
            entry["bins"].append({"label": name, "pairs": int(where.sum()), "centre": centre})
            groups = [items[index].group for index in np.flatnonzero(where)]
            for label in kept:
                values = chosen[label].values["psnr"][where]
                line = as_dict(estimate(values, groups, **options))
                gain = values - noisy.values["psnr"][where]
                line["gain"] = (
                    None if label == "noisy" else as_dict(estimate(gain, groups, **options))
                )
                entry["rows"].setdefault(label, []).append(line)
        found.append(entry)
    return found


def _factors(
    noisy: Row, items: Sequence[Item], drawn: Mapping[str, Column]
) -> list[tuple[str, str, Column]]:
    places = np.array([item.location for item in items])
    if len(set(places)) < 2:
        places = np.array([item.scene for item in items])
        factors = [("scene", "", places)]
    else:
        factors = [("location", "", places)]
    factors.append(("PSNR of the noisy image", "dB", noisy.values["psnr"]))
    for name, column in drawn.items():
        if name.startswith("noise.") or name == "resample.rate":
            factors.append((name, "", column))
    return factors


def _bins(column: Column) -> list[tuple[str, npt.NDArray[np.bool_], float | None]]:
    """(label, (N,) bool, mean of the values) of each bin."""
    if column.dtype.kind in "US":
        names = [name for name in np.unique(column)]
        if len(names) > _MOST_PLACES:
            counts = {name: int((column == name).sum()) for name in names}
            names = sorted(sorted(names, key=lambda name: -counts[name])[:_MOST_PLACES])
        return [(str(name) or "off", column == name, None) for name in names]
    values = column.astype(float)
    known = np.isfinite(values)
    found: list[tuple[str, npt.NDArray[np.bool_], float | None]] = []
    if not known.all():
        found.append(("off", ~known, None))
    distinct = np.unique(values[known])
    if 1 <= distinct.size <= 5:
        found += [(f"{value:.3g}", values == value, float(value)) for value in distinct]
    elif distinct.size:
        count = int(np.clip(known.sum() // _PAIRS_A_BIN, 2, 5))
        edges = np.quantile(values[known], np.linspace(0, 1, count + 1))
        for low, high, last in zip(
            edges[:-1], edges[1:], [*[False] * (count - 1), True], strict=True
        ):
            inside = known & (values >= low) & ((values <= high) if last else (values < high))
            if inside.any():
                centre = float(values[inside].mean())
                found.append((f"{low:.3g} .. {high:.3g}", inside, centre))
    return found
