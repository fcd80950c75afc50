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


def open_reader(settings: Scenes) -> Reader:
    """The reader of `settings.kind`; cheap, and equal in every process that has the settings."""
    # CsvListReader of csv_list.  Imported when it is opened: reading a configuration loads no
    # image or ray-casting library.
    name = f"{settings.kind.title().replace('_', '')}Reader"
    reader: Reader = getattr(import_module(f".{settings.kind}", __package__), name)(settings)
    return reader
