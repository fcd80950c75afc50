"""Wavefront .obj and .mtl files, read line by line in time proportional to their size.

Coordinates keep their 64 bits, `o` and `g` give parts their names, and a texture is looked up where
its material's options place it.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...common.array_types import Colour, Float32s, Float64s, Int32s, Int64s
from ...common.errors import FactoryError
from .concave_faces import cut_concave_faces
from .painted import linear_albedo, paint_surface, read_image, unit_colours

# Colour of a material that states none.
_DEFAULT_COLOUR: Colour = (0.6, 0.6, 0.6)
# Options of a texture with one argument each; `-mm` has two, and these up to three numbers.
_ONE_ARGUMENT = frozenset(
    {"-blendu", "-blendv", "-bm", "-boost", "-cc", "-clamp", "-imfchan", "-texres", "-type"}
)
_NUMBERS = frozenset({"-o", "-s", "-t"})
# Statements of numbers alone, where # begins a comment without blanks around it, too.
_OF_NUMBERS = frozenset({"v", "vt", "f"})
# Names may hold a #, as in `steel#2` and `Material #25`.
_COMMENT = re.compile(r"(^#|(?<=\s)#(?=\s|$)).*")
_TEXTURES = ("map_", "bump", "disp", "decal", "refl", "norm")


@dataclass
class Texture:
    """An image over the faces of a material.

    scale, offset: texture coordinates are multiplied by the one, then the other is added.
    is_clamped: coordinates beyond the image take its edge instead of repeating it.
    """

    path: Path
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    is_clamped: bool = False


@dataclass
class Material:
    """A material of a library.

    colour: linear albedo.  texture: image in its place.  others: textures that are not used.
    """

    colour: Colour = _DEFAULT_COLOUR
    texture: Texture | None = None
    others: list[Path] = field(default_factory=list)


class RawPart(NamedTuple):
    """A part as its file has it: vertices (V, 3) float64, colours (V, 3), triangles (T, 3)."""

    name: str
    vertices: Float64s
    colours: Float32s
    triangles: Int32s


def linked_by_obj(path: Path) -> tuple[list[Path], list[Path]]:
    """Files that an .obj needs, and those that it merely names; a missing library is needed."""
    needed: list[Path] = []
    named: list[Path] = []
    for library in _libraries(path):
        needed.append(library)
        if not library.is_file():
            continue
        for material in read_materials(library).values():
            needed += [material.texture.path] if material.texture else []
            named += material.others
    return needed, named


def _libraries(path: Path) -> list[Path]:
    library_paths = []
    for keyword, rest in _statements(path):
        if keyword == "mtllib":
            library_paths += _library_paths(path.parent, rest)
    return list(dict.fromkeys(library_paths))


def _library_paths(folder: Path, rest: str) -> list[Path]:
    """Paths of one library, whose name may have spaces, or of several."""
    whole = folder / rest.replace("\\", "/")
    names = rest.split()
    if len(names) == 1 or whole.is_file():
        return [whole]
    return [folder / name.replace("\\", "/") for name in names]


def _statements(path: Path) -> Iterator[tuple[str, str]]:
    """(keyword, rest) of the lines without comments; a backslash at a line's end continues it."""
    pending = ""
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        for line in file:
            stripped = _COMMENT.sub("", line.strip()).rstrip()
            # A name may end so too, but only faces and curves are so long.
            if stripped.endswith("\\"):
                pending += stripped[:-1] + " "
                continue
            keyword, _, rest = (pending + stripped).partition(" ")
            if "\t" in keyword:
                keyword, _, rest = (pending + stripped).partition("\t")
            pending = ""
            if keyword in _OF_NUMBERS:
                rest = rest.partition("#")[0]
            if keyword:
                yield keyword, rest.strip()


def read_materials(path: Path) -> dict[str, Material]:
    """The materials of an .mtl by name.  Raises FactoryError for a colour that is none."""
    materials: dict[str, Material] = {}
    material = Material()  # what stands before the first name belongs to none
    for keyword, rest in _statements(path):
        lower = keyword.lower()
        if lower == "newmtl":
            material = materials.setdefault(rest, Material())
        elif lower == "kd":
            material.colour = _colour(path, rest)
        elif lower.startswith(_TEXTURES):
            texture = _texture(path.parent, rest)
            if texture is None:
                continue
            if lower == "map_kd":
                material.texture = texture
            else:
                material.others.append(texture.path)
    return materials


def _colour(path: Path, rest: str) -> Colour:
    try:
        values = [float(word) for word in rest.split()[:3]]
    except ValueError:  # `spectral FILE` and `xyz`
        return _DEFAULT_COLOUR
    if not values or not np.isfinite(values).all() or min(values) < 0:
        raise FactoryError(f"its material library {path.name} has a colour {rest[:40]!r}")
    values = values if len(values) == 3 else 3 * values[:1]
    red, green, blue = map(float, unit_colours(np.array(values)))
    return red, green, blue


def _texture(folder: Path, rest: str) -> Texture | None:
    """The file of a texture after its options; None when it names none."""
    texture = Texture(folder)
    while rest.startswith("-"):
        option, _, after = rest.partition(" ")
        words = after.split()
        count = 1 if option in _ONE_ARGUMENT else 2 if option == "-mm" else 0
        if option in _NUMBERS:
            count = _leading_numbers(words[:3])
            values = [float(word) for word in words[:count]]
            if option == "-s":
                texture.scale = _pair(values, 1.0)
            if option == "-o":
                texture.offset = _pair(values, 0.0)
        elif count == 0:
            break  # a file whose name starts with a dash
        if option == "-clamp":
            texture.is_clamped = words[:1] == ["on"]
        rest = _after_words(after, count)
    if not rest:
        return None
    texture.path = folder / rest.replace("\\", "/")
    return texture


def _leading_numbers(words: list[str]) -> int:
    for count, word in enumerate(words):
        try:
            float(word)
        except ValueError:
            return count
    return len(words)


def _pair(values: list[float], usual: float) -> tuple[float, float]:
    first, second = [*values, usual, usual][:2]
    return first, second


def _after_words(text: str, count: int) -> str:
    """Text without its first words; names keep their own spaces."""
    parts = text.split(maxsplit=count)
    return parts[count] if len(parts) > count else ""


# --- geometry


@dataclass
class _Geometry:
    """What the lines of an .obj add up to.

    coordinates, texture_coordinates, colours: flat numbers, three, two and three for each.
    corners: of triangles, three of each: numbers of vertices.  uv_corners: of texture coordinates,
        -1: none.  groups, materials: of each triangle, numbers in the lists of names.
    polygons: of each face of more than three corners its first triangle and number of corners.
    """

    coordinates: array[float] = field(default_factory=lambda: array("d"))
    colours: array[float] = field(default_factory=lambda: array("d"))
    texture_coordinates: array[float] = field(default_factory=lambda: array("d"))
    corners: array[int] = field(default_factory=lambda: array("q"))
    uv_corners: array[int] = field(default_factory=lambda: array("q"))
    groups: array[int] = field(default_factory=lambda: array("q"))
    polygons: array[int] = field(default_factory=lambda: array("q"))
    materials: array[int] = field(default_factory=lambda: array("q"))
    group_names: dict[tuple[str, str], int] = field(default_factory=dict)
    material_names: dict[str, int] = field(default_factory=dict)
    libraries: list[Path] = field(default_factory=list)


def read_obj(path: Path, most_faces: int, most_parts: int) -> list[RawPart]:
    """The parts of an .obj: one for each object (`o`), or group (`g`) where these tell apart.

    Raises FactoryError and ValueError for damage.
    """
    geometry = _read_geometry(path, most_faces)
    vertices = np.array(geometry.coordinates, np.float64).reshape(-1, 3)
    has_colours = len(geometry.colours) == len(geometry.coordinates) > 0
    colours = None
    if has_colours:
        stored_colours = np.array(geometry.colours, np.float32).reshape(-1, 3)
        colours = unit_colours(stored_colours).astype(np.float32)
    uv = np.array(geometry.texture_coordinates, np.float64).reshape(-1, 2)
    corners = np.array(geometry.corners, np.int64).reshape(-1, 3)
    uv_corners = np.array(geometry.uv_corners, np.int64).reshape(-1, 3)
    if len(corners) and not (corners.min() >= 0 and corners.max() < len(vertices)):
        raise FactoryError("damaged: its faces name vertices that are not there")
    if len(uv_corners) and uv_corners.max() >= len(uv):
        raise FactoryError("damaged: its faces name texture coordinates that are not there")
    polygons = np.array(geometry.polygons, np.int64).reshape(-1, 2)
    cut_concave_faces(vertices, polygons, corners, uv_corners)

    library: dict[str, Material] = {}
    for file in geometry.libraries:
        library |= read_materials(file) if file.is_file() else {}
    names = _part_names(path, list(geometry.group_names))
    part_of_group = {name: number for number, name in enumerate(dict.fromkeys(names))}
    part = np.array([part_of_group[name] for name in names])[np.array(geometry.groups, np.int64)]
    part_count = len(np.unique(part))
    if part_count > most_parts:
        raise FactoryError(f"has {part_count:,} parts; at most {most_parts:,} go: join some")
    material_names = list(geometry.material_names)
    material = np.array(geometry.materials, np.int64)

    # Sorted once, so that thousands of parts cost no more than one.
    order = np.lexsort((material, part))
    is_first = np.diff(part[order] * len(material_names) + material[order], prepend=-1) != 0
    pieces: dict[int, list[RawPart]] = {number: [] for number in part_of_group.values()}
    for chosen in np.split(order, np.flatnonzero(is_first)[1:]) if len(order) else ():
        face_material = library.get(material_names[material[chosen[0]]], Material())
        pieces[part[chosen[0]]] += _pieces(
            vertices, colours, uv, corners[chosen], uv_corners[chosen], face_material
        )
    return [_joined(name, pieces[number]) for name, number in part_of_group.items()]


def _read_geometry(path: Path, most_faces: int) -> _Geometry:
    """Vertices, faces, groups and materials of an .obj, statement by statement.

    Raises ValueError for a damaged statement, FactoryError for too many faces.
    """
    geometry = _Geometry()
    names = ["", ""]  # of the object and the group
    group = geometry.group_names.setdefault(("", ""), 0)
    material = geometry.material_names.setdefault("", 0)
    for keyword, rest in _statements(path):
        if keyword == "v":
            numbers = [float(word) for word in rest.split()]
            geometry.coordinates.extend(numbers[:3])
            if len(numbers) >= 6:
                geometry.colours.extend(numbers[-3:])
            if len(numbers) < 3:
                raise ValueError(f"a vertex of {len(numbers)} numbers")
        elif keyword == "vt":
            numbers = [float(word) for word in rest.split()[:2]]
            geometry.texture_coordinates.extend([*numbers, 0.0][:2])
        elif keyword == "f":
            count = _add_face(geometry, rest)
            geometry.groups.extend([group] * count)
            geometry.materials.extend([material] * count)
            if len(geometry.groups) > most_faces:
                raise FactoryError(f"has more than {most_faces:,} faces: decimate it")
        elif keyword in ("o", "g"):
            names[keyword == "g"] = rest
            group = geometry.group_names.setdefault((names[0], names[1]), len(geometry.group_names))
        elif keyword == "usemtl":
            material = geometry.material_names.setdefault(rest, len(geometry.material_names))
        elif keyword == "mtllib":
            geometry.libraries += _library_paths(path.parent, rest)
    return geometry


def _add_face(geometry: _Geometry, rest: str) -> int:
    """Add a polygon as a fan of triangles; returns their number.

    A fan fills what is concave; `cut_concave_faces` puts it right once all vertices are known.
    """
    vertex_count = len(geometry.coordinates) // 3
    uv_count = len(geometry.texture_coordinates) // 2
    corners = []
    uv_corners = []
    for word in rest.split():
        vertex, _, others = word.partition("/")
        uv_text = others.partition("/")[0]
        number = int(vertex)
        corners.append(number - 1 if number > 0 else vertex_count + number)
        number = int(uv_text) if uv_text else 0
        uv_corners.append(number - 1 if number >= 0 else uv_count + number)
    if len(corners) > 3:
        geometry.polygons.extend((len(geometry.groups), len(corners)))
    for second in range(1, len(corners) - 1):
        geometry.corners.extend((corners[0], corners[second], corners[second + 1]))
        geometry.uv_corners.extend((uv_corners[0], uv_corners[second], uv_corners[second + 1]))
    return max(len(corners) - 2, 0)


def _part_names(path: Path, groups: list[tuple[str, str]]) -> list[str]:
    """The name of the part of each (object, group): what tells parts apart, the object's first."""
    objects = {name for name, _ in groups if name}
    grouped = {name for _, name in groups if name}
    by_group = (len(objects) < 2 and len(grouped) > 1) or not objects
    return [(group or name if by_group else name or group) or path.stem for name, group in groups]


def _pieces(
    vertices: Float64s,
    colours: Float32s | None,
    uv: Float64s,
    corners: Int64s,
    uv_corners: Int64s,
    material: Material,
) -> list[RawPart]:
    """The triangles of one material, painted where it has a texture and they have coordinates."""
    pieces = []
    is_painted = np.zeros(len(corners), bool)
    texture = material.texture
    if texture is not None and len(uv):
        is_painted = (uv_corners >= 0).all(axis=1)
    if texture is not None and is_painted.any():
        coordinates = uv[uv_corners[is_painted]] * texture.scale + texture.offset
        if texture.is_clamped:
            coordinates = np.clip(coordinates, 0, 1)
        from_top = coordinates * (1, -1) + (0, 1)
        points, painted, triangles = paint_surface(
            vertices[corners[is_painted]],
            from_top,
            linear_albedo(read_image(texture.path.read_bytes())),
        )
        pieces.append(RawPart("", points, painted, triangles))
    if not is_painted.all():
        used, plain_corners = np.unique(corners[~is_painted], return_inverse=True)
        plain = np.broadcast_to(np.array(material.colour, np.float32), (len(used), 3))
        shades = plain.copy() if colours is None else colours[used]
        triangles = plain_corners.reshape(-1, 3).astype(np.int32)
        pieces.append(RawPart("", vertices[used], shades, triangles))
    return pieces


def _joined(name: str, pieces: list[RawPart]) -> RawPart:
    starts = np.cumsum([0, *(len(piece.vertices) for piece in pieces[:-1])], dtype=np.int32)
    return RawPart(
        name,
        np.concatenate([piece.vertices for piece in pieces] or [np.empty((0, 3))]),
        np.concatenate([piece.colours for piece in pieces] or [np.empty((0, 3), np.float32)]),
        np.concatenate(
            [piece.triangles + start for piece, start in zip(pieces, starts, strict=False)]
            or [np.empty((0, 3), np.int32)]
        ),
    )
