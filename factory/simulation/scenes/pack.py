"""The `pack` reader: frames that were rendered elsewhere and packed into one file."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic.dataclasses import dataclass

from ...common.errors import FactoryError, FrameError
from ...common.settings import STRICT
from ...dataset.frame_ref import FrameRef
from ..frames.frame import Frame
from .base import Discovery, Root, SceneSettings
from .pack_index import read_index


@dataclass(frozen=True, config=STRICT, kw_only=True)
class PackSettings(SceneSettings):
    """Keys of `scenes=pack`.  root: a file that `simnfnd cache pack` has written."""

    kind: Literal["pack"] = "pack"
    root: Root

    def own_classes(self) -> tuple[str, ...]:
        """The packed classes; empty for a pack that cannot be read, which `discover` refuses."""
        try:
            return read_index(Path(self.root).expanduser()).classes
        except FactoryError:
            return ()


class PackReader:
    """Lists the frames of a pack."""

    def __init__(self, settings: PackSettings) -> None:
        self.settings = settings

    def discover(self) -> Discovery:
        """See `simnfnd.factory.simulation.scenes.base.Reader`."""
        index = read_index(Path(self.settings.root).expanduser())
        if not index.members:
            raise FactoryError(f"scenes.root={self.settings.root}: the pack is empty; pack again")
        note = f"pack: {len(index.members)} frames of render.kind={index.render['kind']}"
        return Discovery(tuple(index.members), {}, (note,))

    def load(self, ref: FrameRef) -> Frame:
        """Always raises FrameError: a pack holds renders, and no colour to render them again."""
        raise FrameError(f"{ref.name}: scenes=pack has renders and no frames")
