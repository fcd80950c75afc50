"""One trial of a fit: pictures of the frames at hand with other noise, measured."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np

from ...factory.cli.compose import compose_config
from ...factory.config import FactoryConfig, from_mapping, plain
from ...factory.dataset.format.schema import Pair
from ...factory.errors import FactoryError, FrameError
from ...factory.frame import FrameRef
from ...factory.pairs import PairMaker
from ...factory.render.view import View
from ...factory.render.views import open_views
from ...factory.sonar.geometry import FanGeometry
from ..metrics.statistics import evenly
from ..realism.measure import Measured, joined, measure_picture
from ..realism.pictures import to_polar
from ..settings import Grid


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
            node, last = _holder(tree, key)
            node[last] = value
        return from_mapping(tree)

    def current(self, key: str) -> Any:
        """What the recipe says of a key.  Raises FactoryError when there is no such key."""
        node, last = _holder(self._plain, key)
        return node[last]

    def measured(self, values: Mapping[str, Any]) -> Measured:
        """The numbers of the pictures that these values make."""
        config = self.configured(values)
        maker = PairMaker(config, self._kept)
        pairs = (maker.pairs(ref, (0,))[0] for ref in self.refs)
        return joined([self._measure(pair, config) for pair in pairs])

    def _measure(self, pair: Pair, config: FactoryConfig) -> Measured:
        picture = pair.noisy
        full = 255.0 if picture.dtype == np.uint8 else 1.0
        geometry = FanGeometry.from_record(config.sonar, pair.record)
        grey = np.asarray(picture, np.float32) / np.float32(full)
        return measure_picture(to_polar(grey, geometry, self.grid), geometry.range_span_m)


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


def _holder(tree: dict[str, Any], key: str) -> tuple[dict[str, Any], str]:
    """The mapping that holds a dotted key, and the key's last part.  Raises FactoryError."""
    *parents, last = key.split(".")
    node: Any = tree
    for part in parents:
        node = node.get(part) if isinstance(node, dict) else None
    if not isinstance(node, dict) or last not in node:
        raise FactoryError(f"parameters.{key}: the factory has no such key")
    return node, last
