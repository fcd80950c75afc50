"""The user's own meshes on the seabed, in places that follow from the location's number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass as plain_dataclass
from pathlib import Path as FilePath
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from ...errors import FactoryError
from ...seeds import stream
from ...settings import STRICT
from ..base import OwnClass, Root

if TYPE_CHECKING:
    from .meshes import Mesh
    from .path import Path
    from .placement import Site

_LARGEST_M = 15.0
_VIEWS = 10  # objects lie before the first so many views of a path, where cameras pass
_AHEAD_M = 1.5
_Share = Annotated[float, Field(ge=0, le=1)]
_Count = Annotated[int, Field(ge=0, le=200)]


@dataclass(frozen=True, config=ConfigDict(**STRICT, serialize_by_alias=True), kw_only=True)
class OwnObject(OwnClass):
    """An entry of `scenes.own_objects`; see also `OwnClass`.

    file: .glb, .gltf, .obj, .ply, .stl or .blend; its z (of .glb: y) points up.
    per_place: least and most of them in a place.  scale: metres per unit of the file.
    burial: least and most of its height in the ground.  tilt_deg: likewise, from upright.
    colour: albedo (red, green, blue; 0 to 1) instead of the mesh's own colours and textures.
    """

    file: Root
    per_place: tuple[_Count, _Count] = (0, 1)
    scale: Annotated[float, Field(gt=0)] = 1.0
    burial: tuple[_Share, _Share] = (0.02, 0.18)
    tilt_deg: tuple[float, float] = (0.0, 10.0)
    colour: tuple[_Share, _Share, _Share] | None = None

    def __post_init__(self) -> None:
        for name in ("per_place", "burial", "tilt_deg"):
            low, high = getattr(self, name)
            if low > high:
                raise ValueError(f"{name}: give the least first, then the most")


@plain_dataclass(frozen=True, eq=False)
class Owned:
    """An entry with its mesh, centred above the origin.

    files: what the mesh was read from.  notes: for the user.
    """

    settings: OwnObject
    mesh: Mesh
    files: tuple[str, ...]
    notes: tuple[str, ...]


def owned(settings: Sequence[OwnObject]) -> tuple[Owned, ...]:
    """Read the meshes.  Raises FactoryError that names file and key."""
    return tuple(_read(one, f"scenes.own_objects.{k}.file") for k, one in enumerate(settings))


def _read(settings: OwnObject, key: str) -> Owned:
    from ..mesh_parts import files_of, read_parts, turned_note
    from .meshes import join

    if settings.label == "Background":
        raise FactoryError(f"{key.removesuffix('file')}class: Background is the ground; name it")
    path = FilePath(settings.file).expanduser()
    parts = read_parts(path, key, settings.scale, _LARGEST_M)
    whole = join(part.mesh for part in parts)
    low, high = whole.vertices.min(axis=0), whole.vertices.max(axis=0)
    whole = whole.moved(offset=-(low + high) / 2)
    if settings.colour is not None:
        whole = whole.tinted(settings.colour)
    return Owned(settings, whole, files_of(path, key), turned_note(path, parts))


def place_own(site: Site, path: Path, location: int, own: Sequence[Owned]) -> None:
    """Put the user's objects beside the part of the path that views show."""
    from .fields import WORLD_SEED
    from .meshes import rotation

    first = path.start_m + _AHEAD_M
    for number, one in enumerate(own):
        site.rng = rng = stream(WORLD_SEED, "seabed", location, "own", number)
        site.stretch_m = (first, first + _VIEWS * path.step_m)
        settings = one.settings
        for _ in range(int(rng.integers(settings.per_place[0], settings.per_place[1] + 1))):
            tilt, toward = np.deg2rad(rng.uniform(*settings.tilt_deg)), rng.uniform(0, 2 * np.pi)
            turn = rotation("z", toward) @ rotation("y", tilt) @ rotation("z", -toward)
            turned = one.mesh.moved(turn @ rotation("z", rng.uniform(0, 2 * np.pi))).standing()
            reach = float(np.sqrt((turned.vertices[:, :2] ** 2).sum(axis=1).max()))
            spot = site.spot(reach, float(turned.vertices[:, 2].max()))
            if spot is not None:
                site.settle(turned, settings.label, spot, reach, settings.burial)
    site.stretch_m = None
