"""Strangers' meshes: read by Open3D in a process of their own, and said in one line what is wrong.

Open3D joins what has one material and loses the names of nodes, by which a world's parts have their
classes; so it reads a copy of a .gltf in which each material is of one node.  Textures become
colours of corners.  A .blend is exported by Blender first, in that process too (one Blender, one
open file), and its scripts are never run.
"""

from __future__ import annotations

import importlib
import io
import re
import tempfile
from copy import deepcopy
from functools import lru_cache
from json import dumps
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from ..errors import FactoryError
from ..isolated import IsolatedProcess
from ..small_files import one_line, parse_json
from .seabed.meshes import GREY, Mesh, join, mesh

Floats = npt.NDArray[np.float32]

SUFFIXES = (".glb", ".gltf", ".obj", ".ply", ".stl", ".blend")
MOST_FACES = 2_000_000
_MOST_BYTES = 1 << 29
# Blender reserves more than a gigabyte before it has read anything.
READING = IsolatedProcess(3 << 30)
"""Where files are read: what hangs, crashes or takes all memory there harms nothing here."""
_SMALLEST_M = 0.005
_LEAST = 6000  # triangles of a textured part
_Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # from y up, z towards the viewer


class Part(NamedTuple):
    """A mesh of a file and its name there, metres, z up.  turned: it came inside out."""

    name: str
    mesh: Mesh
    turned: bool


def files_of(path: Path, key: str) -> tuple[str, ...]:
    """The file and those that it names (buffers, materials, textures), all in its folder.

    Raises FactoryError that names the key, and what is missing or lies elsewhere.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise FactoryError(f"{key}={path}: no mesh; give one of {' '.join(SUFFIXES)}")
    fault = ""
    try:
        if path.stat().st_size > _MOST_BYTES or not path.is_file():
            raise OSError(f"no file of at most {_MOST_BYTES >> 20} MB")
        named = _linked(path)
        for one in named:
            if not one.resolve().is_relative_to(path.parent.resolve()):
                fault = f"names {one}, which is not in the mesh's own folder"
            elif not one.is_file():
                fault = f"its {one.name} is missing"
    except (OSError, ValueError, TypeError, AttributeError) as error:
        raise FactoryError(f"{key}={path}: cannot be read ({one_line(error)})") from error
    if fault:
        raise FactoryError(
            f"{key}={path}: {fault}; put it beside the mesh, or export with everything in one .glb"
        )
    return (str(path), *map(str, named))


def _linked(path: Path) -> list[Path]:
    """Files that a .gltf or .obj names."""
    if path.suffix.lower() == ".gltf":
        return [path.parent / unquote(one["uri"]) for one in _links(_document(path)[0])]
    named = _named(path, "mtllib") if path.suffix.lower() == ".obj" else []
    return named + [one for library in named if library.is_file() for one in _named(library)]


def _document(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON of a .gltf or .glb and the chunk that follows it."""
    content = path.read_bytes()
    if content[:4] != b"glTF":
        return parse_json(content), b""
    end = 20 + int.from_bytes(content[12:16], "little")
    return parse_json(content[20:end]), content[end + 8 :]


def _links(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Its buffers and images that lie in other files."""
    listed = [*document.get("buffers", ()), *document.get("images", ())]
    return [one for one in listed if not one.get("uri", "data:").startswith("data:")]


def _named(path: Path, keyword: str = r"(?:map_\w+|bump|disp|decal|refl|norm)") -> list[Path]:
    pattern = re.compile(rf"^\s*{keyword}\s+(?:-\S+\s+\S+\s+)*(.+?)\s*$", re.MULTILINE | re.I)
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
    size_m = float(np.ptp(points, axis=0).max()) * scale
    if not _SMALLEST_M <= size_m <= largest_m:
        wanted = scale / 1000 if size_m > largest_m else scale * 1000
        unit = "in millimetres?" if size_m > largest_m else "divided twice?"
        raise FactoryError(
            f"{key}={path}: is {size_m:,.4g} m long at scale {scale:g}, {unit} set "
            f"{key.rpartition('.')[0]}.scale to metres per unit of the file, such as {wanted:g}"
        )
    return tuple(part._replace(mesh=part.mesh.moved(scale=scale)) for part in parts)


def turned_note(path: Path, parts: tuple[Part, ...]) -> tuple[str, ...]:
    """A line that names the parts of a file that came inside out, if there are any."""
    names = sorted({part.name for part in parts if part.turned})
    return (f"{path.name}: inside out, turned: {', '.join(names)[:200]}",) if names else ()


@lru_cache(maxsize=16)
def _parts(path: str, _modified_ns: int) -> tuple[Part, ...]:
    content = READING.call(load, Path(path), limit_s=300.0)
    with np.load(io.BytesIO(content), allow_pickle=False) as saved:
        return tuple(
            Part(name, Mesh(*(saved[f"{of}{k}"] for of in "vct")), bool(turned))
            for k, (name, turned) in enumerate(zip(saved["names"], saved["turned"], strict=True))
        )


def load(path: Path) -> bytes:
    """The parts of a file as .npz, each outside out.  Raises FactoryError without the file's name.

    Runs in a process of its own.
    """
    suffix = path.suffix.lower()
    try:
        with tempfile.TemporaryDirectory() as folder:
            found = _by_open3d(path, suffix, Path(folder))
    except ImportError as error:
        raise FactoryError(
            f"needs the module open3d ({one_line(error)}): pip install 'simnfnd[open3d]'"
        ) from error
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OSError) as error:
        raise FactoryError(f"damaged, or no {suffix} file ({one_line(error)})") from error
    found = [(name, solid) for name, solid in found if len(solid.triangles)]
    faces = sum(len(solid.triangles) for _, solid in found)
    if not faces:
        raise FactoryError("has no faces (points alone?); export a mesh of triangles")
    if faces > MOST_FACES:
        raise FactoryError(f"has {faces:,} faces; at most {MOST_FACES:,} go: decimate it")
    names, turned = [], []
    arrays: dict[str, npt.NDArray[Any]] = {}
    for k, (name, solid) in enumerate(found):
        if not np.isfinite(solid.vertices).all():
            raise FactoryError("has vertices that are no numbers; export it again")
        if solid.triangles.min() < 0 or solid.triangles.max() >= len(solid.vertices):
            raise FactoryError("damaged: its faces name vertices that are not there")
        names.append(name)
        turned.append(_inside_out(solid))
        triangles = np.ascontiguousarray(solid.triangles[:, :: -1 if turned[-1] else 1])
        arrays |= {f"v{k}": solid.vertices, f"c{k}": solid.colours, f"t{k}": triangles}
    content = io.BytesIO()
    np.savez(content, names=np.array(names), turned=np.array(turned), **arrays)
    return content.getvalue()


def _inside_out(solid: Mesh) -> bool:
    """Whether it is closed and its faces look inwards; light comes from outside."""
    corners = solid.vertices.astype(np.float64)[solid.triangles]
    corners -= corners.mean(axis=(0, 1))
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    outward = np.cross(b - a, c - a)
    # The areas of a closed surface, as vectors, add up to nothing.
    area = np.linalg.norm(outward, axis=1).sum()
    closed = np.linalg.norm(outward.sum(axis=0)) < 1e-3 * area
    return bool(closed and (a * outward).sum() < 0)


def _by_open3d(path: Path, suffix: str, folder: Path) -> list[tuple[str, Mesh]]:
    """Name and mesh of the parts.  folder: for a copy, an empty one."""
    import open3d

    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    reader: Any = open3d.io
    if suffix in (".ply", ".stl"):
        found = reader.read_triangle_mesh(str(path))
        colours: npt.ArrayLike = GREY
        if found.has_vertex_colors():
            colours = _linear(np.asarray(found.vertex_colors) * 255)
        else:  # .stl has each corner of each face
            found.remove_duplicated_vertices()
        solid = mesh(np.asarray(found.vertices), np.asarray(found.triangles), colours)
        with path.open("rb") as file:
            claimed = re.search(rb"^element face (\d{1,18})", file.read(1 << 16), re.MULTILINE)
        if claimed and int(claimed[1]) > len(solid.triangles):  # Open3D says nothing of the rest
            raise ValueError(f"claims {int(claimed[1]):,} faces, holds {len(solid.triangles):,}")
        return [(path.stem, solid)]
    if suffix == ".obj":
        model = reader.read_triangle_model(str(path))
        return [(path.stem, _of_model(one, model)) for one in model.meshes]
    if suffix == ".blend":
        source, path = path, folder / "scene.glb"
        _opened(source.resolve()).ops.export_scene.gltf(
            filepath=str(path), export_apply=True, use_visible=True, export_animations=False,
            export_skins=False, export_morph=False, export_normals=False,
        )  # fmt: skip
    copy, owners = _with_own_materials(path, folder)
    model = reader.read_triangle_model(str(copy))
    if owners and not model.meshes:
        raise ValueError("Open3D reads nothing of it; compressed?")
    nodes: dict[tuple[int, str], list[Mesh]] = {owner: [] for owner in owners}
    for one in model.meshes:
        made = _of_model(one, model, tinted=True)
        nodes[owners[one.material_idx]].append(made.rotated(_Z_UP))
    return [(name, join(some)) for (_, name), some in nodes.items() if some]


def _with_own_materials(path: Path, folder: Path) -> tuple[Path, list[tuple[int, str]]]:
    """A copy whose materials are each of one node, and number and name of those."""
    document, chunk = _document(path)
    links = _links(document)
    if links and path.suffix.lower() != ".gltf":  # `files_of` has seen those of a .gltf
        raise FactoryError("names other files; export with everything in one .glb")
    for k, item in enumerate(links):
        name = f"{k}{Path(item['uri']).suffix}"
        (folder / name).symlink_to((path.parent / unquote(item["uri"])).resolve())
        item["uri"] = name
    for buffer in document.get("buffers", ()):
        if "uri" not in buffer:
            (folder / "chunk.bin").write_bytes(chunk)
            buffer["uri"] = "chunk.bin"
    nodes, owners = document.get("nodes", []), []
    meshes: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    for number, node in enumerate(nodes):
        if "mesh" not in node:
            continue
        solid = deepcopy(document["meshes"][node["mesh"]])
        for piece in solid["primitives"]:
            given = document["materials"][piece["material"]] if "material" in piece else {}
            surface = given.get("pbrMetallicRoughness") or {"baseColorFactor": [*GREY, 1]}
            # Equal materials would be joined, too.
            apart = {"roughnessFactor": len(materials) / 2**20}
            piece["material"] = len(materials)
            materials.append({"pbrMetallicRoughness": {**surface, **apart}})
            owners.append((number, str(node.get("name") or solid.get("name") or f"part {number}")))
        node["mesh"] = len(meshes)
        meshes.append(solid)
    children = {child for node in nodes for child in node.get("children", ())}
    roots = [number for number in range(len(nodes)) if number not in children]
    document |= {"meshes": meshes, "materials": materials, "scenes": [{"nodes": roots}], "scene": 0}
    copy = folder / "own.gltf"
    copy.write_text(dumps(document))
    return copy, owners


def _of_model(one: Any, model: Any, tinted: bool = False) -> Mesh:
    """tinted: the colour of the material is a factor of its texture."""
    found, material = one.mesh, model.materials[one.material_idx]
    points, triangles = np.asarray(found.vertices), np.asarray(found.triangles)
    colour = np.asarray(material.base_color[:3], np.float32)
    picture = np.asarray(material.albedo_img) if material.albedo_img else np.empty(0)
    if picture.ndim == 3 and found.has_triangle_uvs():
        places = np.asarray(found.triangle_uvs).reshape(-1, 3, 2) * (1, -1) + (0, 1)
        albedo = _linear(picture[..., :3]) * (colour if tinted else 1)
        return _painted(points[triangles].astype(np.float32), places, albedo)
    return mesh(points, triangles, found.vertex_colors if found.has_vertex_colors() else colour)


def _linear(srgb: npt.NDArray[Any]) -> Floats:
    """Albedo of sRGB values 0 to 255."""
    return np.asarray((np.asarray(srgb, np.float32) / 255) ** 2.2, np.float32)


def _painted(corners: Floats, places: npt.NDArray[Any], picture: Floats) -> Mesh:
    """A mesh with the colours of its texture, cut so fine that its corners show them.

    corners: (T, 3, 3).  places: (T, 3, 2) in widths and heights of the (H, W, 3) picture, whose
    top row has place 0.
    """
    cut = np.concatenate([corners, places], axis=-1).astype(np.float32)
    while 0 < len(cut) < _LEAST:
        a, b, c = cut[:, 0], cut[:, 1], cut[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        pieces = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        cut = np.concatenate([np.stack(piece, axis=1) for piece in pieces])
    points = cut.reshape(-1, 5)
    size = np.array(picture.shape[1::-1])
    # The far edge belongs to the picture, and what lies beyond it repeats it.
    inside = np.where(points[:, 3:] == 1, np.float32(1 - 1e-6), points[:, 3:]) % 1
    column, row = (np.floor(inside * size).astype(np.int64) % size).T
    triangles = np.arange(len(points), dtype=np.int32).reshape(-1, 3)
    return Mesh(np.ascontiguousarray(points[:, :3]), picture[row, column], triangles)


_SAMPLES = 8
_SENSOR_MM = 36.0


@lru_cache(maxsize=1)
def _opened(path: Path) -> Any:
    """Blender with the file open.  Raises FactoryError."""
    try:
        bpy: Any = importlib.import_module("bpy")
    except (ImportError, OSError) as error:
        raise FactoryError(
            f"needs the module bpy ({one_line(error)}): pip install 'simnfnd[blender]', "
            "or export a .glb"
        ) from error
    bpy.context.preferences.filepaths.use_scripts_auto_execute = False
    try:
        bpy.ops.wm.open_mainfile(filepath=str(path), load_ui=False, use_scripts=False)
    except RuntimeError as error:
        raise FactoryError(f"no .blend file that Blender opens ({one_line(error)})") from error
    for image in bpy.data.images:
        linked = image.source == "FILE" and image.filepath and not image.packed_file
        if linked and not Path(bpy.path.abspath(image.filepath)).is_file():
            name = Path(image.filepath.replace("\\", "/")).name
            raise FactoryError(f"its texture {name} is missing; pack it (File, External Data)")
    return bpy


def photograph(
    path: Path, world_from_camera: list[list[float]], lens: list[float], width: int, height: int
) -> bytes:
    """PNG of what a camera sees, by Cycles, with the file's own materials and lights.

    world_from_camera: (4, 4) in units of the file.  lens: fx, fy, cx, cy in pixels.
    """
    bpy = _opened(path.resolve())
    import mathutils  # comes with Blender

    scene = bpy.context.scene
    render, cycles = scene.render, scene.cycles
    render.engine, cycles.device, cycles.samples, cycles.seed = "CYCLES", "CPU", _SAMPLES, 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    render.threads_mode, render.threads = "FIXED", 1
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.use_compositing = render.use_sequencer = False
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
    scene.view_settings.view_transform = "Standard"
    camera = bpy.data.objects.get("simnfnd camera")
    if camera is None:
        data = bpy.data.cameras.new("simnfnd camera")
        camera = bpy.data.objects.new("simnfnd camera", data)
        scene.collection.objects.link(camera)
        if not any(one.type == "LIGHT" for one in scene.objects):
            # A lamp on the camera, as a vehicle has one.
            lamp = bpy.data.objects.new("simnfnd lamp", bpy.data.lights.new("lamp", "SUN"))
            lamp.data.energy, lamp.parent = 3.0, camera
            scene.collection.objects.link(lamp)
    fx, fy, cx, cy = lens
    camera.data.sensor_fit, camera.data.sensor_width = "HORIZONTAL", _SENSOR_MM
    camera.data.lens = fx * _SENSOR_MM / width
    camera.data.clip_start, camera.data.clip_end = 1e-3, 1e6
    camera.data.shift_x = (width / 2 - (cx + 0.5)) / width
    camera.data.shift_y = ((cy + 0.5) - height / 2) / width * fx / fy
    camera.matrix_world = mathutils.Matrix((np.array(world_from_camera) * (1, -1, -1, 1)).tolist())
    scene.camera = camera
    with tempfile.TemporaryDirectory() as folder:
        render.filepath = f"{folder}/seen.png"
        bpy.ops.render.render(write_still=True)
        return Path(render.filepath).read_bytes()
