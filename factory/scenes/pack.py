"""The `pack` reader: frames whose renders somebody else has made and packed into one file."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic.dataclasses import dataclass

from ..errors import FactoryError, FrameError
from ..frame import Frame, FrameRef
from ..settings import STRICT
from .base import Discovery, Root, SceneSettings


@dataclass(frozen=True, config=STRICT, kw_only=True)
class PackSettings(SceneSettings):
    """Keys of `scenes=pack`.  root: a file that `simnfnd cache pack` has written."""

    kind: Literal["pack"] = "pack"
    root: Root

    def own_classes(self) -> tuple[str, ...]:
        """Those that were packed; none of a pack that cannot be read, as `discover` says."""
        from ..render.pack import read_contents

        try:
            return read_contents(Path(self.root).expanduser()).classes
        except FactoryError:
            return ()


class PackReader:
    """Lists the frames of a pack."""

    def __init__(self, settings: PackSettings) -> None:
        self.settings = settings

    def discover(self) -> Discovery:
        """See `simnfnd.factory.scenes.base.Reader`."""
        from ..render.pack import read_contents

        contents = read_contents(Path(self.settings.root).expanduser())
        if not contents.members:
            raise FactoryError(f"scenes.root={self.settings.root}: the pack is empty; pack again")
        note = f"pack: {len(contents.members)} frames of render.kind={contents.render.kind}"
        return Discovery(tuple(contents.members), {}, (note,))

    def load(self, ref: FrameRef) -> Frame:
        """Always raises: a pack holds what was rendered, without the colour to render it again."""
        raise FrameError(f"{ref.name}: scenes=pack has renders and no frames")
