"""Strangers' meshes: read in a process of their own, bounded, and said in one line what is wrong.

All by Open3D: .glb and .gltf after `gltf`, .blend after `blend` has made them that.
"""

from __future__ import annotations

import io
import re
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from ..errors import FactoryError
from ..isolated import IsolatedProcess
from ..small_files import one_line
from .gltf import document_of, linked, with_own_materials
from .painted import Part, linear, painted
from .seabed.meshes import GREY, Mesh, join, mesh

MOST_FACES = 2_000_000
_MOST_BYTES = 1 << 29
# Blender reserves more than a gigabyte before it has read anything.
_MEMORY_BYTES = 3 << 30
SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl", ".blend")
_SMALLEST_M = 0.005
_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from y up, z towards the viewer


def files_of(path: Path, key: str) -> tuple[str, ...]:
    """The file and those that it names (buffers, materials, textures), all of which are there.

    Raises FactoryError that names the key and what is missing.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise FactoryError(f"{key}={path}: no mesh; give one of {' '.join(SUFFIXES)}")
    try:
        size = path.stat().st_size
        if not path.is_file() or size > _MOST_BYTES:
            raise FactoryError(f"{key}={path}: no file of at most {_MOST_BYTES >> 20} MB")
        named = _named(path)
    except (OSError, ValueError) as error:
        raise FactoryError(f"{key}={path}: cannot be read ({one_line(error)})") from error
    missing = [one for one in named if not one.is_file()]
    if missing:
        raise FactoryError(
            f"{key}={path}: its {missing[0].name} is missing; put it beside the mesh, or export "
            "with everything in one .glb"
        )
    return (str(path), *map(str, named))


def _named(path: Path) -> list[Path]:
    """Files that a .gltf or .obj names."""
    if path.suffix.lower() == ".gltf":
        return [path.parent / unquote(one["uri"]) for one in linked(document_of(path)[0])]
    if path.suffix.lower() != ".obj":
        return []
    libraries = _words(path, "mtllib")
    there = [library for library in libraries if library.is_file()]
    return libraries + [one for library in there for one in _words(library, "map_Kd")]


def _words(path: Path, keyword: str) -> list[Path]:
    pattern = re.compile(rf"^\s*{keyword}\s+(?:-\S+\s+\S+\s+)*(.+?)\s*$", re.MULTILINE)
    return [path.parent / name for name in pattern.findall(path.read_text("utf-8", "replace"))]


def read_parts(path: Path, key: str, scale: float, largest_m: float) -> tuple[Part, ...]:
    """The parts of a file, in metres.

    key: of the configuration, for errors; `scale` stands beside it.  largest_m: what is longer is
    taken for a mesh in millimetres.  Raises FactoryError.
    """
    files_of(path, key)
    try:
        parts = _parts(str(path), path.stat().st_mtime_ns)
    except FactoryError as error:
        raise FactoryError(f"{key}={path}: {error}") from error
    points = np.concatenate([part.mesh.vertices for part in parts])
    if not np.isfinite(points).all():
        raise FactoryError(f"{key}={path}: has vertices that are no numbers; export it again")
    size_m = float(np.ptp(points, axis=0).max()) * scale
    if not _SMALLEST_M <= size_m <= largest_m:
        wanted = scale / 1000 if size_m > largest_m else scale * 1000
        unit = "in millimetres?" if size_m > largest_m else "divided twice?"
        raise FactoryError(
            f"{key}={path}: is {size_m:,.4g} m long at scale {scale:g}, {unit} set "
            f"{key.rpartition('.')[0]}.scale to metres per unit of the file, such as {wanted:g}"
        )
    return tuple(Part(part.name, part.mesh.moved(scale=scale)) for part in parts)


@lru_cache(maxsize=16)
def _parts(path: str, _modified_ns: int) -> tuple[Part, ...]:
    content = READING.call(load, Path(path), limit_s=300.0)
    with np.load(io.BytesIO(content), allow_pickle=False) as saved:
        parts = enumerate(saved["names"].tolist())
        return tuple(Part(name, Mesh(*(saved[f"{of}{k}"] for of in "vct"))) for k, name in parts)


READING = IsolatedProcess(_MEMORY_BYTES)
"""Where files are read: what hangs, crashes or takes all memory there harms nothing here."""


def load(path: Path) -> bytes:
    """The parts of a file as .npz, each outside out.  Raises FactoryError without the file's name.

    Runs in a process of its own.
    """
    suffix = path.suffix.lower()
    try:
        with TemporaryDirectory() as folder:
            found = _by_open3d(path, suffix, Path(folder))
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OSError) as error:
        raise FactoryError(f"damaged, or no {suffix} file ({one_line(error)})") from error
    found = [part for part in found if len(part.mesh.triangles)]
    faces = sum(len(part.mesh.triangles) for part in found)
    if not faces:
        raise FactoryError("has no faces (points alone?); export a mesh of triangles")
    if faces > MOST_FACES:
        raise FactoryError(f"has {faces:,} faces; at most {MOST_FACES:,} go: decimate it")
    arrays: dict[str, npt.NDArray[Any]] = {"names": np.array([part.name for part in found])}
    for k, part in enumerate(found):
        least, most = part.mesh.triangles.min(), part.mesh.triangles.max()
        if least < 0 or most >= len(part.mesh.vertices):
            raise FactoryError("damaged: its faces name vertices that are not there")
        arrays |= {f"v{k}": part.mesh.vertices, f"c{k}": part.mesh.colours}
        arrays[f"t{k}"] = _outside_out(part.mesh)
    content = io.BytesIO()
    np.savez(content, **arrays)
    return content.getvalue()


def _outside_out(solid: Mesh) -> npt.NDArray[np.int32]:
    """Its triangles, turned where it is closed and inside out; light comes from outside."""
    corners = solid.vertices.astype(np.float64)[solid.triangles]
    corners -= corners.mean(axis=(0, 1))
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    outward = np.cross(b - a, c - a)
    # The areas of a closed surface, as vectors, add up to nothing.
    area = np.linalg.norm(outward, axis=1).sum()
    closed = np.linalg.norm(outward.sum(axis=0)) < 1e-3 * area
    if closed and (a * outward).sum() < 0:
        return np.ascontiguousarray(solid.triangles[:, ::-1])
    return solid.triangles


def _by_open3d(path: Path, suffix: str, folder: Path) -> list[Part]:
    """folder: for copies, an empty one."""
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise FactoryError(
            f"needs the module open3d ({one_line(error)}): pip install 'simnfnd[open3d]'"
        ) from error
    if (faces := _claimed_faces(path)) > MOST_FACES:
        raise FactoryError(f"claims {faces:,} faces; at most {MOST_FACES:,} go: decimate it")
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    reader: Any = open3d.io
    if suffix in (".ply", ".stl"):
        found = reader.read_triangle_mesh(str(path))
        if not found.has_vertex_colors():  # .stl has each corner of each face
            found.remove_duplicated_vertices()
        colours: npt.ArrayLike = GREY
        if found.has_vertex_colors():
            colours = linear(np.asarray(found.vertex_colors) * 255)
        solid = mesh(np.asarray(found.vertices), np.asarray(found.triangles), colours)
        return [Part(path.stem, solid)]
    if suffix == ".blend":
        from .blend import as_gltf

        source, path = path, folder / "scene.glb"
        as_gltf(source, path)
    if suffix == ".obj":
        model = reader.read_triangle_model(str(path))
        meshes = [_of_model(one, model.materials[one.material_idx]) for one in model.meshes]
        return [Part(path.stem, found) for found in meshes]
    copy, owners = with_own_materials(path, folder)
    model = reader.read_triangle_model(str(copy))
    if owners and not model.meshes:
        raise ValueError("Open3D reads nothing of it; compressed?")
    nodes: dict[tuple[int, str], list[Mesh]] = {owner: [] for owner in owners}
    for one in model.meshes:
        material = model.materials[one.material_idx]
        made = _of_model(one, material, material.base_color[:3])
        nodes[owners[one.material_idx]].append(made.moved(_Z_UP))
    return [Part(name, join(some)) for (_, name), some in nodes.items() if some]


def _claimed_faces(path: Path) -> int:
    """What the head of a .ply or a binary .stl says; 0 where it says nothing."""
    with path.open("rb") as file:
        head = file.read(1 << 16)
    if path.suffix.lower() == ".stl" and not head.startswith(b"solid"):
        return int.from_bytes(head[80:84], "little")
    found = re.search(rb"^element face (\d{1,18})", head, re.MULTILINE)
    return int(found[1]) if head.startswith(b"ply") and found else 0


def _of_model(one: Any, material: Any, tint: npt.ArrayLike = 1) -> Mesh:
    """tint: factor of its texture."""
    found = one.mesh
    points, triangles = np.asarray(found.vertices), np.asarray(found.triangles)
    picture = np.asarray(material.albedo_img) if material.albedo_img else np.empty(0)
    if picture.ndim == 3 and found.has_triangle_uvs():
        places = np.asarray(found.triangle_uvs).reshape(-1, 3, 2) * (1, -1) + (0, 1)
        albedo = linear(picture[..., :3]) * np.asarray(tint, np.float32)
        return painted(points[triangles].astype(np.float32), places, albedo)
    colours = np.asarray(found.vertex_colors) if found.has_vertex_colors() else None
    return mesh(points, triangles, material.base_color[:3] if colours is None else colours)
