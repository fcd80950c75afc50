"""The user's own meshes for the seabed: what is said of them, and their files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import ConfigDict, Field
from pydantic.dataclasses import dataclass

from ...errors import FactoryError
from ...settings import STRICT
from ..base import OwnClass, Root

if TYPE_CHECKING:
    from .meshes import Mesh

_LARGEST_M = 15.0
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

    def read(self, key: str) -> tuple[Mesh, tuple[str, ...], tuple[str, ...]]:
        """Its mesh, centred above the origin, the files it was read from, and notes for the user.

        Raises FactoryError that names file and key.
        """
        from ..mesh_parts import files_of, read_parts, turned_note
        from .meshes import join

        if self.label == "Background":
            raise FactoryError(f"{key}.class: Background is the ground; name it")
        path = Path(self.file).expanduser()
        parts = read_parts(path, f"{key}.file", self.scale, _LARGEST_M)
        whole = join(part.mesh for part in parts)
        whole = whole.moved(-(whole.vertices.min(axis=0) + whole.vertices.max(axis=0)) / 2)
        if self.colour is not None:
            whole = whole.tinted(self.colour)
        return whole, files_of(path, f"{key}.file"), turned_note(path, parts)
