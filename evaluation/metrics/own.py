"""Metrics of other packages, measured beside those that ship.

A metric is a pure function of an image and its pair.  A package names it as an entry point of the
group `simnfnd.metrics`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ...factory.common import extensions
from ...factory.common.errors import FactoryError
from .measure import METRICS, Figures, Grey, PairImages


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

    def __post_init__(self) -> None:
        if self.name in METRICS:
            raise ValueError(f"metric {self.name!r}: there is one of that name")
        if self.better not in (-1, 0, 1):
            raise ValueError(f"metric {self.name!r}: better={self.better!r}: give 1, -1 or 0")


def register_metric(metric: OwnMetric) -> None:
    """Make a metric known in this process; `evaluate` then needs workers=1.

    Raises ValueError for an object that is no metric, and for an unusable name.
    """
    if not isinstance(metric, OwnMetric):
        raise ValueError(f"{metric!r}: is a {type(metric).__name__}; give an OwnMetric")
    extensions.register("metric", metric.name, metric)


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
    for name in sorted(extensions.names("metric")):
        metric = extensions.find_of_type("metric", name, OwnMetric)
        assert metric is not None
        try:
            figures[name] = float(metric.function(image, pair))
        except Exception as error:  # the code of another package
            raise FactoryError(f"metric {name}: fails ({type(error).__name__}: {error})") from error
    return figures
