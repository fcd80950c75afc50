"""One trial of a fit: pictures of the frames at hand with other noise, described."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ...factory.cli.compose import compose_config
from ...factory.config import FactoryConfig, from_mapping, plain
from ...factory.dataset.pair_dataset import in_unit_range
from ...factory.errors import FactoryError, FrameError
from ...factory.frame import FrameRef
from ...factory.pairs import PairMaker
from ...factory.render.view import View
from ...factory.render.views import open_views
from ...factory.sonar.geometry import FanGeometry
from ..metrics.statistics import evenly
from ..realism.features import features_of
from ..realism.pictures import to_polar
from ..settings import Grid

if TYPE_CHECKING:
    import pandas as pd


class Simulation:
    """Makes and measures the pictures of a recipe, with any values of its other keys."""

    def __init__(self, recipe: tuple[str, ...], frames: int, grid: Grid) -> None:
        """Raises FactoryError when the recipe is wrong or no frame of it is rendered."""
        from ...factory.scenes import open_reader
        from ...factory.selection import choose_frames

        self.config = compose_config(recipe)
        self.grid = grid
        self._plain = plain(self.config)
        views = open_views(self.config)
        found = choose_frames(open_reader(self.config.scenes).discover().frames, self.config)
        there = [ref for ref in found if views.holds(ref)]
        if len(there) < min(8, len(found)):
            raise FactoryError(
                f"recipe: only {len(there)} of its {len(found)} frames are rendered in "
                f"{self.config.cache.folder}; run `simnfnd make {' '.join(recipe)}` first"
            )
        spread = evenly(there, frames)
        self._kept = _Kept({ref: views.view(ref) for ref in spread})
        maker = PairMaker(self.config, self._kept)
        self.refs = [ref for ref in spread if _usable(maker, ref)]
        if not self.refs:
            raise FactoryError("recipe: the sonar sees nothing in any of its frames; see sonar.*")

    def configured(self, values: Mapping[str, Any]) -> FactoryConfig:
        """The recipe's configuration with some keys set.  Raises FactoryError for a bad key."""
        tree = copy.deepcopy(self._plain)
        for key, value in values.items():
            *parents, last = key.split(".")
            node: Any = tree
            for part in parents:
                node = node.get(part) if isinstance(node, dict) else None
            if not isinstance(node, dict) or last not in node:
                raise FactoryError(f"parameters.{key}: the factory has no such key")
            node[last] = value
        return from_mapping(tree)

    def described(self, values: Mapping[str, Any]) -> pd.DataFrame:
        """The features of the pictures that these values make."""
        import pandas as pd

        config = self.configured(values)
        maker = PairMaker(config, self._kept)
        rows = []
        for ref in self.refs:
            (pair,) = maker.pairs(ref, (0,))
            geometry = FanGeometry.from_record(config.sonar, pair.record)
            polar = to_polar(in_unit_range(pair.noisy), geometry, self.grid)
            rows.append(features_of(polar, geometry.range_span_m))
        return pd.DataFrame(rows)


def _usable(maker: PairMaker, ref: FrameRef) -> bool:
    """Whether the frame makes a picture: the factory leaves out those that do not."""
    try:
        maker.pairs(ref, (0,))
    except FrameError:
        return False
    return True


class _Kept:
    """Renders in memory; a `simnfnd.factory.render.views.Views`."""

    def __init__(self, views: dict[FrameRef, View]) -> None:
        self._views = views

    def holds(self, ref: FrameRef) -> bool:
        return ref in self._views

    def view(self, ref: FrameRef) -> View:
        return self._views[ref]
