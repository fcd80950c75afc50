"""Metrics of other packages, measured beside those that ship.

A metric is a pure function of an image and its pair.  A package names it as an entry point of the
group `simnfnd.metrics`; it is run once before anything is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from ...factory.common import extensions
from ...factory.common.array_types import Float32s
from ...factory.common.errors import FactoryError
from .measure import Figures, Grey, MeasuredPair, PairImages

_SIDE = 48


@dataclass(frozen=True)
class OwnMetric:
    """A metric of another package.

    name: of its column in tables and files.
    function: `(image, pair) -> number`; image (H, W) float32 in 0..1, NaN where there is no figure.
    better: 1 where a high figure is better, -1 where a low one is, 0 where neither is.
    """

    name: str
    function: Callable[[Grey, PairImages], float]
    better: int = 1


def register_metric(metric: OwnMetric) -> None:
    """Make a metric known in this process; `evaluate` then needs workers=1.

    Raises ValueError for a metric that declares or does something wrong.
    """
    problem = _problem_of(metric)
    if problem:
        raise ValueError(f"metric {getattr(metric, 'name', metric)!r}: {problem}")
    extensions.register("metric", metric.name, metric)


def own_metrics() -> list[OwnMetric]:
    """All metrics of other packages.  Raises FactoryError for one that cannot be used."""
    metrics = []
    for name in sorted(extensions.names("metric")):
        extension = extensions.find("metric", name)
        assert extension is not None
        metric = extension.value
        problem = _problem_of(metric)
        if not problem and metric.name != name:
            problem = f"is called {metric.name!r} itself"
        if problem:
            raise FactoryError(
                f"metric {name}: {extension.source}: {problem}; report it to the package's author"
            )
        metrics.append(metric)
    return metrics


def refuse_metrics_of_scripts(workers: int | str) -> None:
    """Raise FactoryError for a metric that a script registered, where worker processes measure."""
    if workers == 1:
        return
    for name in extensions.names("metric"):
        if not extensions.source_of("metric", name).package:
            raise FactoryError(
                f"metric {name}: is registered by a script, and worker processes know the metrics "
                "of packages alone; set workers=1, or name it as an entry point of a package"
            )


def own_figures(image: Grey, pair: PairImages) -> Figures:
    """Their figures of an image, by name.  Raises FactoryError for a metric that fails."""
    figures: Figures = {}
    for metric in own_metrics():
        try:
            figures[metric.name] = float(metric.function(image, pair))
        except Exception as error:  # the code of another package
            raise FactoryError(
                f"metric {metric.name}: fails ({type(error).__name__}: {error})"
            ) from error
    return figures


@lru_cache(maxsize=64)
def _problem_of(metric: Any) -> str:
    """What is wrong with a metric; "" for a sound one."""
    return next(_problems(metric), "")


def _problems(metric: Any) -> Iterator[str]:
    if not isinstance(metric, OwnMetric):
        yield f"is a {type(metric).__name__}; give an OwnMetric"
        return
    if metric.better not in (-1, 0, 1):
        yield f"better={metric.better!r}: give 1, -1 or 0"
    pair = _pair()
    if metric.name in MeasuredPair(pair).figures(pair.noisy):
        yield "there is one of that name"
    try:
        figure = metric.function(pair.noisy, pair)
        float(figure)
    except Exception as error:  # the code of another package
        yield f"fails on an image of {_SIDE} x {_SIDE} pixels ({type(error).__name__}: {error})"


def _pair() -> PairImages:
    """A wavy ground with a shadow, and speckle on it."""
    rng = np.random.default_rng(0)
    rows, columns = np.indices((_SIDE, _SIDE))
    clean: Float32s = (0.4 + 0.2 * np.sin(rows / 5)).astype(np.float32)
    shadow = (rows > 30) & (columns > 20) & (columns < 35)
    clean[shadow] = 0
    noisy = np.clip(clean * rng.rayleigh(0.8, clean.shape), 0, 1).astype(np.float32)
    return PairImages(noisy, clean, shadow, np.ones_like(shadow))
