"""RGBD recordings in, checked frames out: one module a layout, chosen by `scenes.kind`."""

from __future__ import annotations

from importlib import import_module
from typing import Annotated

from pydantic import Field

from .base import Discovery, Reader, SceneSettings
from .csv_list import CsvListSettings
from .flsea import FlseaSettings
from .mesh import MeshSettings
from .pack import PackSettings
from .seabed import SeabedSettings

__all__ = ["Discovery", "Reader", "SceneSettings", "Scenes", "open_reader"]

Scenes = Annotated[
    FlseaSettings | CsvListSettings | SeabedSettings | MeshSettings | PackSettings,
    Field(discriminator="kind"),
]

# kind -> (module, reader class).  Modules are imported when a reader is opened, so that reading a
# configuration loads no image or ray-casting library.
_READERS = {
    "flsea": ("simnfnd.factory.scenes.flsea", "FlseaReader"),
    "csv_list": ("simnfnd.factory.scenes.csv_list", "CsvListReader"),
    "mesh": ("simnfnd.factory.scenes.mesh", "MeshReader"),
    "pack": ("simnfnd.factory.scenes.pack", "PackReader"),
    "seabed": ("simnfnd.factory.scenes.seabed", "SeabedReader"),
}


def open_reader(settings: Scenes) -> Reader:
    """The reader of `settings.kind`; cheap, and equal in every process that has the settings."""
    module, name = _READERS[settings.kind]
    reader: Reader = getattr(import_module(module), name)(settings)
    return reader
