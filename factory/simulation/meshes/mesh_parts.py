"""Strangers' meshes as parts in metres, z up, and one line for what is wrong with them.

Files are opened in a process of their own (`mesh_loading`): what hangs, crashes or takes all memory
there harms nothing here.
"""

from __future__ import annotations

import io
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from ...common.array_types import Float64s
from ...common.errors import FactoryError
from ...common.files import real_path
from ...common.isolated import IsolatedProcess
from ...common.small_files import one_line
from ..frames.frame import LIKELY_M
from .blend_files import BLENDER_SUFFIXES
from .mesh_loading import Z_UP, linked_files, load
from .triangle_mesh import Mesh

SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl", *BLENDER_SUFFIXES)
# Formats that state which axis points up; z does in what is read of them.
_STATED_UP = {".glb": "y", ".gltf": "y"} | dict.fromkeys(BLENDER_SUFFIXES, "z")
# Suffixes of files that may name others.
_LINKING = (".gltf", ".obj", *BLENDER_SUFFIXES)
# Blender reserves more than a gigabyte before it has read anything.
READING = IsolatedProcess(3 << 30)
"""Where files are read."""

Up = Literal["auto", "y", "z"]
"""Which axis of a file points up; auto: as its format states, else as its ground lies."""
AsStated = Literal["stated"]
"""The axis that the format of a file states; z where it states none."""


class MeshPart(NamedTuple):
    """A mesh of a file and its name there, metres, z up.  turned: it came inside out."""

    name: str
    mesh: Mesh
    turned: bool


class Model(NamedTuple):
    """What a mesh file holds.

    origin_m: (3,) metres, z up, what was subtracted from the file's coordinates.
    notes: lines for the user.
    """

    parts: tuple[MeshPart, ...]
    origin_m: Float64s
    notes: tuple[str, ...]


def files_of(path: Path, key: str) -> tuple[str, ...]:
    """The file and those that it names (buffers, materials, textures, libraries), in its folder.

    Raises FactoryError that names the key, and what is missing or lies elsewhere.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise FactoryError(f"{key}={path}: no mesh; give one of {' '.join(SUFFIXES)}")
    try:
        status = path.stat()
        if not path.is_file():
            raise OSError("no file")
    except (OSError, ValueError) as error:
        raise FactoryError(f"{key}={path}: cannot be read ({one_line(error)})") from error
    if path.suffix.lower() not in _LINKING:
        return (str(path),)

    try:
        needed, named = _linked(str(path), status.st_mtime_ns)
    except FactoryError as error:
        raise FactoryError(f"{key}={path}: {error}") from error
    remedy = "put it beside the mesh, or export with everything in one .glb"
    for file in map(Path, (*needed, *named)):
        if not real_path(file).is_relative_to(real_path(path.parent)):
            problem = f"names {file}, which is not in the mesh's own folder"
            raise FactoryError(f"{key}={path}: {problem}; {remedy}")
    for file in map(Path, needed):
        if not file.is_file():
            raise FactoryError(f"{key}={path}: its {file.name} is missing; {remedy}")
    return (str(path), *dict.fromkeys(needed))


@lru_cache(maxsize=16)
def _linked(path: str, _modified_ns: int) -> tuple[list[str], list[str]]:
    needed, named = READING.call(linked_files, Path(path), limit_s=300.0)
    return needed, named


def read_model(
    path: Path, key: str, scale: float, largest_m: float, up: Up | AsStated = "auto"
) -> Model:
    """The parts of a file, in metres.

    key: the key of the configuration that errors name; `scale` stands beside it.
    largest_m: a longer mesh is taken for one in millimetres.
    up: see `Up`.  Raises FactoryError.
    """
    files_of(path, key)
    try:
        stored = _stored(str(path), path.stat().st_mtime_ns)
    except FactoryError as error:
        raise FactoryError(f"{key}={path}: {error}") from error

    _check_size(path, key, stored.parts, scale, largest_m)

    notes = [*_turned_note(path, stored.parts)]
    notes += [f"{path.name}: {remark}" for remark in stored.remarks]
    parts = [part._replace(mesh=part.mesh.moved(scale=scale)) for part in stored.parts]
    origin = stored.origin
    turn = _turn_up(path, key, stored.parts, up)
    if turn is not None:
        parts = [part._replace(mesh=part.mesh.rotated(turn)) for part in parts]
        origin = turn @ origin
        if up == "auto":
            notes.append(
                f"{path.name}: its ground lies along x and z, so y points up; "
                f"{key.rpartition('.')[0]}.up=z takes it as it stands"
            )
    if origin.any():
        x, y, z = origin * scale
        notes.append(f"{path.name}: coordinates count from ({x:.12g}, {y:.12g}, {z:.12g}) m")
    if stored.step:
        notes.append(
            f"{path.name}: coordinates so far away are stored in steps of {stored.step * scale:.2g}"
            " m; export it near the origin, or with 64 bits"
        )
    return Model(tuple(parts), origin * scale, tuple(notes))


def _check_size(
    path: Path, key: str, parts: tuple[MeshPart, ...], scale: float, largest_m: float
) -> None:
    """Raise FactoryError for a world too small or too large, whose unit is hardly the metre."""
    points = np.concatenate([part.mesh.vertices for part in parts])
    size_m = float(np.ptp(points, axis=0).max()) * scale
    if LIKELY_M[0] <= size_m <= largest_m:
        return
    wanted = scale / 1000 if size_m > largest_m else scale * 1000
    unit = "in millimetres?" if size_m > largest_m else "divided twice?"
    raise FactoryError(
        f"{key}={path}: is {size_m:,.4g} m long at scale {scale:g}, {unit} set "
        f"{key.rpartition('.')[0]}.scale to metres per unit of the file, such as {wanted:g}"
    )


def stands_like_a_wall(parts: tuple[MeshPart, ...]) -> bool:
    """Whether a world has its largest faces upright along x and z, as a floor with y up would."""
    points = np.concatenate([part.mesh.vertices for part in parts])
    width, thickness, height = np.ptp(points, axis=0)
    if not 0 < thickness < 0.35 * min(width, height):
        return False
    corners = [part.mesh.vertices[part.mesh.triangles].astype(np.float64) for part in parts]
    a, b, c = np.concatenate(corners).transpose(1, 0, 2)
    areas = np.abs(np.cross(b - a, c - a)).sum(axis=0)
    return bool(areas[1] > 0.5 * areas.sum())


def _turn_up(
    path: Path, key: str, parts: tuple[MeshPart, ...], up: Up | AsStated
) -> Float64s | None:
    """(3, 3) that turns what was read so that z points up; None where it does."""
    stated = _STATED_UP.get(path.suffix.lower())
    if stated is not None:
        if up in ("auto", "stated", stated):
            return None
        if stated == "z":
            raise FactoryError(f"{key.rpartition('.')[0]}.up=y: Blender turns z up; leave it")
        return Z_UP.T  # undoes what its format asks for
    is_y_up = up == "y" or (up == "auto" and stands_like_a_wall(parts))
    return Z_UP if is_y_up else None


def _turned_note(path: Path, parts: tuple[MeshPart, ...]) -> tuple[str, ...]:
    """A line that names the parts of a file that came inside out, if there are any."""
    names = sorted({part.name for part in parts if part.turned})
    return (f"{path.name}: inside out, turned: {', '.join(names)[:200]}",) if names else ()


class _Stored(NamedTuple):
    """Parts in units of the file; origin, step and remarks as of `mesh_loading.load`."""

    parts: tuple[MeshPart, ...]
    origin: Float64s
    step: float
    remarks: tuple[str, ...]


@lru_cache(maxsize=16)
def _stored(path: str, _modified_ns: int) -> _Stored:
    """The parts of a mesh file, read by another process.  _modified_ns: of the file, for caches."""
    content = READING.call(load, Path(path), limit_s=300.0)
    with np.load(io.BytesIO(content), allow_pickle=False) as saved:
        by_vertex = np.cumsum(saved["vertex_counts"])[:-1]
        by_face = np.cumsum(saved["face_counts"])[:-1]
        pieces = zip(
            saved["names"],
            np.split(saved["vertices"], by_vertex),
            np.split(saved["colours"], by_vertex),
            np.split(saved["triangles"], by_face),
            saved["turned"],
            strict=True,
        )
        parts = tuple(
            MeshPart(str(name), Mesh(vertices, colours, triangles), bool(turned))
            for name, vertices, colours, triangles, turned in pieces
        )
        remarks = tuple(map(str, saved["remarks"]))
        return _Stored(parts, saved["origin"], float(saved["step"]), remarks)
