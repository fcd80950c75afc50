"""From an untrusted mesh file to arrays; runs in a process of its own, where Open3D may crash.

.ply and .stl are read by Open3D, .glb and .gltf by `gltf_files`, .obj by `obj_files`; what Blender
opens is exported as .glb first.
"""

from __future__ import annotations

import importlib
import io
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from ...common.array_types import Float64s
from ...common.errors import FactoryError
from ...common.small_files import one_line
from .blend_files import BLENDER_SUFFIXES, export_blend, linked_by_blend
from .gltf_files import MeshLimits, linked_by_gltf, read_gltf
from .obj_files import RawPart, linked_by_obj, read_obj
from .painted import linear_albedo, unit_colours
from .ply_headers import copy_with_header, read_header
from .triangle_mesh import GREY, Mesh

MOST_FACES = 2_000_000
MOST_PARTS = np.iinfo(np.uint16).max
"""What instance numbers of 16 bits tell apart."""
# From y up, z towards the viewer, to z up.
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


def linked_files(path: Path) -> tuple[list[str], list[str]]:
    """Files that a mesh needs beside it, and others that it names.  Raises FactoryError."""
    suffix = path.suffix.lower()
    needed: list[Path] = []
    named: list[Path] = []
    try:
        if suffix == ".gltf":
            needed = linked_by_gltf(path)
        elif suffix == ".obj":
            needed, named = linked_by_obj(path)
        elif suffix in BLENDER_SUFFIXES:
            needed = linked_by_blend(path)
    except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise FactoryError(f"cannot be read ({one_line(error)})") from error
    return list(map(str, needed)), list(map(str, named))


def load(path: Path) -> bytes:
    """The parts of a file as .npz, with faces that point outward.

    vertices, colours, triangles: of all parts; vertex_counts, face_counts, names, turned: of each.
    origin: (3,) what was subtracted from the vertices, units of the file.
    step: distance between neighbouring numbers of a file of 32 bits at the origin, or 0.
    remarks: sentences on what is not read.
    Raises FactoryError without the file's name.
    """
    suffix = path.suffix.lower()
    remarks: list[str] = []
    try:
        with tempfile.TemporaryDirectory() as folder:
            parts = _read(path, suffix, Path(folder))
        if suffix == ".ply":
            remarks = read_header(path).remarks
    except ImportError as error:
        raise FactoryError(
            f"needs the module open3d ({one_line(error)}): pip install 'simnfnd[open3d]'"
        ) from error
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OSError) as error:
        raise FactoryError(f"damaged, or no {suffix} file ({one_line(error)})") from error

    parts = [part for part in parts if len(part.triangles)]
    _check(parts)
    origin, step = _far_origin(parts)
    meshes = [
        Mesh((part.vertices - origin).astype(np.float32), part.colours, part.triangles)
        for part in parts
    ]
    is_turned = np.array([_is_inside_out(solid) for solid in meshes])
    triangles = [
        solid.triangles[:, :: -1 if turned else 1]
        for solid, turned in zip(meshes, is_turned, strict=True)
    ]
    content = io.BytesIO()
    np.savez(
        content,
        names=np.array([part.name for part in parts]),
        turned=is_turned,
        vertices=np.concatenate([solid.vertices for solid in meshes]),
        colours=np.concatenate([solid.colours for solid in meshes]),
        triangles=np.concatenate(triangles),
        vertex_counts=np.array([len(solid.vertices) for solid in meshes]),
        face_counts=np.array([len(solid.triangles) for solid in meshes]),
        origin=origin,
        step=step,
        remarks=np.array(remarks, np.str_),
    )
    return content.getvalue()


def _check(parts: list[RawPart]) -> None:
    """Raise FactoryError for what no reader of frames could use."""
    face_count = sum(len(part.triangles) for part in parts)
    if not face_count:
        raise FactoryError("has no faces (points alone?); export a mesh of triangles")
    if face_count > MOST_FACES:
        raise FactoryError(f"has {face_count:,} faces; at most {MOST_FACES:,} go: decimate it")
    if len(parts) > MOST_PARTS:
        raise FactoryError(f"has {len(parts):,} parts; at most {MOST_PARTS:,} go: join some")
    for part in parts:
        if not np.isfinite(part.vertices).all():
            raise FactoryError("has vertices that are no numbers; export it again")
        if part.triangles.min() < 0 or part.triangles.max() >= len(part.vertices):
            raise FactoryError("damaged: its faces name vertices that are not there")


def _far_origin(parts: list[RawPart]) -> tuple[Float64s, float]:
    """What to subtract so that 32 bits hold the shape, and the step of a file of 32 bits there.

    (3,) whole units, 0 along axes where the mesh is near; georeferenced meshes are far.
    """
    low = np.min([part.vertices.min(axis=0) for part in parts], axis=0).astype(np.float64)
    high = np.max([part.vertices.max(axis=0) for part in parts], axis=0).astype(np.float64)
    centre = (low + high) / 2
    size = float((high - low).max())
    step = np.spacing(np.abs(centre).astype(np.float32)).astype(np.float64)
    is_far = (np.abs(centre) > 100 * size) | ((np.abs(centre) > 3 * size) & (step > 1e-3))
    origin = np.where(is_far, np.round(centre), 0.0)
    holds_32_bits = all(
        np.array_equal(part.vertices, part.vertices.astype(np.float32)) for part in parts
    )
    is_coarse = is_far.any() and holds_32_bits and step.max() > 1e-4 * size
    return origin, float(step.max()) if is_coarse else 0.0


def _is_inside_out(solid: Mesh) -> bool:
    """Whether a mesh is closed and its faces point inward; light comes from outside."""
    corners = solid.vertices.astype(np.float64)[solid.triangles]
    corners -= corners.mean(axis=(0, 1))
    a = corners[:, 0]
    b = corners[:, 1]
    c = corners[:, 2]
    outward = np.cross(b - a, c - a)
    # The areas of a closed surface, as vectors, add up to nothing.
    area = np.linalg.norm(outward, axis=1).sum()
    is_closed = np.linalg.norm(outward.sum(axis=0)) < 1e-3 * area
    return bool(is_closed and (a * outward).sum() < 0)


def _read(path: Path, suffix: str, folder: Path) -> list[RawPart]:
    """The parts of a file, z up.  folder: for a copy, an empty one."""
    if suffix == ".obj":
        return read_obj(path, MOST_FACES, MOST_PARTS)
    if suffix in (".ply", ".stl"):
        return [_read_single(path, folder)]
    if suffix in BLENDER_SUFFIXES:
        source = path
        path = folder / "scene.glb"
        export_blend(source, path)
    parts = read_gltf(path, MeshLimits(MOST_FACES, MOST_PARTS))
    return [part._replace(vertices=part.vertices @ Z_UP.T) for part in parts]


def _read_single(path: Path, folder: Path) -> RawPart:
    """The one mesh of a .ply or .stl.  folder: for a copy, an empty one."""
    open3d: Any = importlib.import_module("open3d")
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    header = read_header(path) if path.suffix.lower() == ".ply" else None
    if header is not None and header.has_strips:
        raise FactoryError(
            "holds triangle strips (element tristrips), which are not read; save it with faces, as "
            "MeshLab does"
        )
    source = path
    if header is not None and (text := header.with_usual_names()) != header.text:
        source = folder / "renamed.ply"  # Open3D knows colours by one name alone
        copy_with_header(path, len(header.text), text, source)
    solid = open3d.io.read_triangle_mesh(str(source))
    vertices = np.asarray(solid.vertices, np.float64)
    triangles = np.asarray(solid.triangles, np.int32)
    if header is not None and header.face_count > len(triangles):  # Open3D ignores the rest
        raise ValueError(f"claims {header.face_count:,} faces, holds {len(triangles):,}")

    if solid.has_vertex_colors():
        # Open3D takes every number for one of 0 to 255.
        stored = np.asarray(solid.vertex_colors, np.float64) * 255
        colours = linear_albedo(_in_bytes(stored, header.colour_type if header else None))
        return RawPart(path.stem, vertices, colours, triangles)
    # A .stl has each corner of each face.
    solid.remove_duplicated_vertices()
    vertices = np.asarray(solid.vertices, np.float64)
    triangles = np.asarray(solid.triangles, np.int32)
    shades = np.broadcast_to(np.asarray(GREY, np.float32), vertices.shape)
    return RawPart(path.stem, vertices, shades.copy(), triangles)


def _in_bytes(stored: Float64s, type_name: str | None) -> Float64s:
    """Colours in 0 to 255, as the type of a .ply tells what full scale is."""
    if type_name in (None, "uchar", "uint8"):
        return stored
    if type_name in ("ushort", "uint16"):
        return stored / 257
    return 255 * unit_colours(stored)
