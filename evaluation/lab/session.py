"""A frame of a configuration, made again and again with changed parameters, as `make` makes it."""

from __future__ import annotations

import importlib
from collections.abc import Collection, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any, NamedTuple

from ...factory.common.errors import FactoryError, NotRendered
from ...factory.common.extras import require
from ...factory.dataset.frame_ref import FrameRef
from ...factory.dataset.schema import Pair
from ...factory.simulation.config.compose import compose
from ...factory.simulation.config.key_effects import reason_without_effect
from ...factory.simulation.config.needs import needs_of
from ...factory.simulation.config.root import FactoryConfig, from_mapping
from ...factory.simulation.config.selection import choose_frames
from ...factory.simulation.pairs.compilation import compile_needed
from ...factory.simulation.pairs.pair_maker import PairMaker
from ...factory.simulation.pairs.views import ViewMaker, Views, open_views
from ...factory.simulation.render.base import Mount, RenderSettings
from ...factory.simulation.render.view import View
from ...factory.simulation.scenes import Scenes, open_reader
from .exports import Base, Exports, command_line, recipe, set_dotted, sweep_line
from .parameters import Control, parameters_of

Changes = Mapping[str, Any]
"""Changed parameters: plain values by dotted key."""

_MOST_VIEWS = 8
SEED = "seed"


class _Rendered(NamedTuple):
    """A render, and all that decides it."""

    scenes: Scenes
    render: RenderSettings
    mount: Mount
    ref: FrameRef
    view: View


class Session:
    """What the words of `simnfnd lab` mean, and the pairs of one frame under changed parameters.

    words: the words of `simnfnd make`.  frames: all frames of the configuration, in order.
    parameters: the controls of all parameters that may be changed.
    """

    def __init__(self, words: Sequence[str]) -> None:
        """Raises FactoryError for a wrong word, and for recordings without frames."""
        composition = compose(words)
        self.words = tuple(words)
        self.config = composition.config
        needs = list(needs_of(self.config))
        require(needs)
        if any(need.module == "bpy" for need in needs):
            # A thread of the server would load it, and a process crashes at its end unless its main
            # thread has loaded Blender.
            importlib.import_module("bpy")
        self.parameters: list[Control] = parameters_of(self.config)
        self.frames = choose_frames(open_reader(self.config.scenes).discover().frames, self.config)
        # In a sweep a comma of a name would begin another point, so names are quoted.
        flags = [word for word in words if word.startswith("-")]
        self._sweep_words = [*flags, *composition.overrides, *composition.pins]
        self._base = Base.of(composition.overrides, composition.values)
        self._keys = {parameter.key for parameter in self.parameters} | {SEED}
        self._rendered: list[_Rendered] = []
        self._maker: PairMaker | None = None
        is_coherent = self.config.acoustics.formation == "coherent"
        compile_needed(scenes=self.config.scenes.kind, field=is_coherent)

    def frame(self, name: str) -> int:
        """The number of a frame.  Raises FactoryError when there is none of that name."""
        names = [ref.name for ref in self.frames]
        if name not in names:
            raise FactoryError(f"{name}: no frame of that name; the first one is {names[0]}")
        return names.index(name)

    def configured(self, changes: Changes) -> FactoryConfig:
        """The configuration with changed parameters.

        Raises FactoryError with one line for a bad value and for a key that is no parameter.
        """
        for key in changes:
            if key not in self._keys:
                raise FactoryError(f"{key}: no parameter of this configuration")
        values = deepcopy(dict(self._base.values))
        for key, value in changes.items():
            set_dotted(values, key, value)
        config = from_mapping(values)
        # Layers and columns take time, and change no image.
        return replace(config, dataset=replace(config.dataset, layers=(), columns=()))

    def pairs(self, changes: Changes, number: int, variants: tuple[int, ...]) -> list[Pair]:
        """The pairs of a frame, to the byte those of `make`.

        Raises FactoryError for bad parameters, and FrameError where the sonar sees nothing.
        """
        config = self.configured(changes)
        ref = self.frames[number]
        return self._maker_of(config, ref).pairs(ref, variants, config.noise)

    def _maker_of(self, config: FactoryConfig, ref: FrameRef) -> PairMaker:
        """The maker of pairs; the previous one, which keeps the observed frame, if it fits."""
        view = self._view_of(config, ref)
        if self._maker is None or not _differs_in_noise_alone(self._maker, config, ref, view):
            self._maker = PairMaker(config, Views({ref: view}), kept_frames=1)
        return self._maker

    def _view_of(self, config: FactoryConfig, ref: FrameRef) -> View:
        decisive = (config.scenes, config.render, config.sonar.mount, ref)
        for rendered in self._rendered:
            if rendered[:-1] == decisive:
                return rendered.view
        view = _render(config, ref)
        self._rendered = [_Rendered(*decisive, view), *self._rendered[: _MOST_VIEWS - 1]]
        return view

    def inert(
        self, config: FactoryConfig, keys: Collection[str], named: Collection[str]
    ) -> dict[str, str]:
        """Keys that have no effect, each with the reason.

        named: the changed keys, beside which others may gain an effect.
        """
        reasons = {key: reason_without_effect(config, key, named) for key in keys}
        return {key: reason for key, reason in reasons.items() if reason is not None}

    def exports(self, changes: Changes, sweep: tuple[str, str] | None = None) -> Exports:
        """What makes the same images outside the lab.

        Changes without effect are left out, for `make` refuses them.
        sweep: a parameter and its values, as `a,b,c`.
        """
        config = self.configured(changes)
        acting = self._acting(config, changes)
        line = ""
        if sweep is not None:
            line = sweep_line(self._sweep_words, acting, *sweep)
        return Exports(command_line(self.words, acting), recipe(self._base, acting), line)

    def _acting(self, config: FactoryConfig, changes: Changes) -> Changes:
        acting = dict(changes)
        # A change may act only beside another one, so look again once one is left out.
        while inert := self.inert(config, acting, acting):
            acting = {key: value for key, value in acting.items() if key not in inert}
        return acting


def _differs_in_noise_alone(
    maker: PairMaker, config: FactoryConfig, ref: FrameRef, view: View
) -> bool:
    is_of_frame = maker.views.holds(ref) and maker.views.view(ref) is view
    return is_of_frame and replace(maker.config, noise=config.noise) == config


def _render(config: FactoryConfig, ref: FrameRef) -> View:
    """The render of a frame, from the cache or pack if it is there, else made."""
    views = open_views(config)
    try:
        return views.view(ref)
    except NotRendered:
        if config.scenes.kind == "pack":
            raise
    return ViewMaker(config).render(ref)
