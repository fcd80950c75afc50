"""Reads RGBD recordings into checked frames: one module for each `scenes.kind`."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Discriminator, PlainSerializer, PlainValidator, Tag, TypeAdapter

from ...common import extensions
from ...common.errors import FactoryError
from ...common.settings import build
from .base import (
    Discovery,
    OwnSceneSettings,
    Reader,
    ReaderEntry,
    SceneSettings,
    settings_fields,
)
from .csv_list import CsvListSettings
from .flsea import FlseaSettings
from .mesh import MeshSettings
from .pack import PackSettings
from .seabed import SeabedSettings

__all__ = [
    "Discovery",
    "Reader",
    "SceneSettings",
    "Scenes",
    "has_labels",
    "open_reader",
    "register_reader",
]

_BUILT_IN = ("flsea", "csv_list", "seabed", "mesh", "pack")
_LABELLED = ("seabed", "mesh", "pack")
_OWN = "own"


def _tag(values: Any) -> str:
    kind = _kind_of(values)
    return kind if kind in _BUILT_IN else _OWN


def _kind_of(values: Any) -> str:
    kind = values.get("kind") if isinstance(values, Mapping) else getattr(values, "kind", None)
    return kind if isinstance(kind, str) else ""


def _own_settings(values: Any) -> OwnSceneSettings:
    if isinstance(values, OwnSceneSettings):
        return values
    entry = reader_entry(_kind_of(values))
    settings: OwnSceneSettings = build(entry.settings, values, "scenes")
    return settings


def _plain_values(settings: OwnSceneSettings) -> dict[str, Any]:
    kind: TypeAdapter[Any] = TypeAdapter(type(settings))
    values: dict[str, Any] = kind.dump_python(settings, mode="json")
    return values


if TYPE_CHECKING:
    # `kind` tells these apart; settings of other packages are asked for by their class.
    Scenes = FlseaSettings | CsvListSettings | SeabedSettings | MeshSettings | PackSettings
else:
    Scenes = Annotated[
        Annotated[FlseaSettings, Tag("flsea")]
        | Annotated[CsvListSettings, Tag("csv_list")]
        | Annotated[SeabedSettings, Tag("seabed")]
        | Annotated[MeshSettings, Tag("mesh")]
        | Annotated[PackSettings, Tag("pack")]
        | Annotated[
            OwnSceneSettings,
            PlainValidator(_own_settings),
            PlainSerializer(_plain_values),
            Tag(_OWN),
        ],
        Discriminator(_tag),
    ]


def open_reader(settings: Scenes) -> Reader:
    """The reader of `settings.kind`; cheap, and equal in every process that has the settings."""
    if isinstance(settings, OwnSceneSettings):
        return reader_entry(settings.kind).reader(settings)
    # CsvListReader of csv_list.  Imported when it is opened: reading a configuration loads no
    # image or ray-casting library.
    name = f"{settings.kind.title().replace('_', '')}Reader"
    reader: Reader = getattr(import_module(f".{settings.kind}", __package__), name)(settings)
    return reader


def register_reader(entry: ReaderEntry) -> None:
    """Make a reader known in this process, as `scenes=KIND`.

    Raises ValueError for a kind that is taken or no name.
    """
    if entry.kind in _BUILT_IN:
        raise ValueError(f"reader {entry.kind!r}: there is one of that kind")
    extensions.register("reader", entry.kind, entry)


def reader_entry(kind: str) -> ReaderEntry:
    """The reader of another package.  Raises FactoryError where there is none of that kind."""
    extension = extensions.find("reader", kind)
    if extension is None:
        known = ", ".join((*_BUILT_IN, *extensions.names("reader")))
        raise FactoryError(f"scenes: kind={kind or '(none)'} is no reader; there are {known}")
    entry = extension.value
    if not isinstance(entry, ReaderEntry) or entry.kind != kind:
        raise FactoryError(
            f"scenes={kind}: {extension.source} gives no `ReaderEntry` of that kind; report it to "
            "the package's author"
        )
    return entry


def has_labels(settings: Scenes) -> bool:
    """Whether the frames can have segmentation and instance: a pack has what went into it."""
    if isinstance(settings, OwnSceneSettings):
        return reader_entry(settings.kind).has_labels
    return settings.kind in _LABELLED


def default_values(kind: str) -> dict[str, Any]:
    """Keys of the settings of another package's reader; "???" where the user has to give one.

    Raises FactoryError as `reader_entry` does.
    """
    settings = reader_entry(kind).settings
    values: dict[str, Any] = {}
    for name, info in settings_fields(settings).items():
        if info.is_required():
            values[name] = "???"
        else:
            kind_of_key: Any = info.annotation
            default: TypeAdapter[Any] = TypeAdapter(kind_of_key)
            value = info.get_default(call_default_factory=True)
            values[name] = default.dump_python(value, mode="json")
    return values
