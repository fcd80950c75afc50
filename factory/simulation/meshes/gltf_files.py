"""glTF documents: the files that they name, and the parts that their default scene shows.

A part is a node with faces, or one of its instances.  Positions may be integers
(KHR_mesh_quantization); the weights of morph targets, joints and instances
(EXT_mesh_gpu_instancing) are applied.  An extension that a document requires and that
this reader does not know is refused by name, as glTF 2.0 asks for.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np

from ...common.array_types import Array, Float32s, Int64s
from ...common.errors import FactoryError
from ...common.small_files import parse_json
from .gltf_buffers import Buffers, Document
from .obj_files import RawPart
from .painted import linear_albedo, paint_surface, read_image, unit_colours
from .triangle_mesh import GREY

Matrix = Array
Dtype = type[np.float32] | type[np.float64]

# Each takes some hundred bytes once it is parsed; base64 of buffers has none of these.
_MOST_VALUES = 3_000_000
_TRIANGLES = 4
_STRIP = 5
_FAN = 6
# Translations beyond it are not left to arithmetic of 32 bits.
_FAR = 10_000.0
# Required extensions without which a part would have another shape, and that are read; of those
# that begin so, only the looks that no sonar sees are lost.
_KNOWN_EXTENSIONS = frozenset(
    {
        "KHR_mesh_quantization",
        "EXT_mesh_gpu_instancing",
        "KHR_texture_transform",
        "KHR_node_visibility",
        "KHR_lights_punctual",
        "KHR_xmp_json_ld",
        "EXT_texture_webp",
        "MSFT_lod",
    }
)
_LOOKS = ("KHR_materials_", "EXT_materials_", "KHR_lights_", "EXT_lights_")


class MeshLimits(NamedTuple):
    """The most faces and parts that a file may have."""

    faces: int
    parts: int


class Shape(NamedTuple):
    """Vertices (V, 3) of a primitive, their colours (V, 3) and its triangles (T, 3).

    uv: (V, 2) in its texture, or None.  albedo: (H, W, 3) of the texture, or None.
    """

    vertices: Array
    colours: Float32s
    triangles: Int64s
    uv: Array | None
    albedo: Float32s | None


def read_document(path: Path) -> tuple[Document, bytes]:
    """The JSON of a .gltf or .glb, and the chunk that follows it.

    Raises FactoryError when it has more values than the memory of a sound file's reader holds, and
    ValueError for what is no JSON object.
    """
    content = path.read_bytes()
    text = content
    chunk = b""
    if content[:4] == b"glTF":
        end = 20 + int.from_bytes(content[12:16], "little")
        text = content[20:end]
        chunk = content[end + 8 :]
    values = text.count(b",") + text.count(b"{") + text.count(b"[")
    if values > _MOST_VALUES:
        raise FactoryError(f"its JSON has {values:,} values; at most {_MOST_VALUES:,} are read")
    document = parse_json(text)
    if not isinstance(document, dict):
        raise ValueError("no JSON object")
    return document, chunk


def linked_by_gltf(path: Path) -> list[Path]:
    """Buffers and images of a .gltf that lie in other files."""
    return [path.parent / unquote(item["uri"]) for item in _links(read_document(path)[0])]


def _links(document: Document) -> list[Document]:
    listed = [*document.get("buffers", ()), *document.get("images", ())]
    return [item for item in listed if not item.get("uri", "data:").startswith("data:")]


def read_gltf(path: Path, limits: MeshLimits) -> list[RawPart]:
    """The parts of the default scene, y up, in the order of the nodes.

    Raises FactoryError for what is not read, and KeyError, IndexError, TypeError or ValueError for
    a damaged document.
    """
    document, chunk = read_document(path)
    _refuse_unknown_extensions(document)
    if _links(document) and path.suffix.lower() != ".gltf":  # those of a .gltf have been looked at
        raise FactoryError("names other files; export with everything in one .glb")
    reader = _SceneReader(Buffers(document, path.parent, chunk), limits)
    return list(reader.parts())


def _refuse_unknown_extensions(document: Document) -> None:
    for name in document.get("extensionsRequired", ()):
        if name not in _KNOWN_EXTENSIONS and not str(name).startswith(_LOOKS):
            raise FactoryError(
                f"requires the extension {name}, which is not read; export it without (Blender "
                "reads and writes many)"
            )


class _SceneReader:
    """Reads the parts of one document."""

    def __init__(self, buffers: Buffers, limits: MeshLimits) -> None:
        self._buffers = buffers
        self._document = buffers.document
        self._limits = limits
        self._nodes: list[Document] = self._document.get("nodes", [])
        roots = _roots(self._document)
        self._dtype: Dtype = np.float32
        self._in_world = _world_matrices(self._nodes, roots, self._dtype)
        offsets = [np.abs(matrix[:3, 3]).max() for matrix in self._in_world.values()]
        if max(offsets, default=0.0) > _FAR:
            self._dtype = np.float64
            self._in_world = _world_matrices(self._nodes, roots, self._dtype)
        self._albedos: dict[int, Float32s] = {}
        self._shapes: dict[tuple[int, tuple[float, ...], int | None], list[Shape]] = {}

    def parts(self) -> Iterator[RawPart]:
        """See `read_gltf`."""
        face_count = 0
        part_count = 0
        for number in sorted(self._in_world):
            node = self._nodes[number]
            if "mesh" not in node:
                continue
            shapes = self._shapes_of(node)
            if not shapes:  # points and lines alone
                continue
            matrices = self._instances(node, number)
            part_count += len(matrices)
            face_count += len(matrices) * sum(len(shape.triangles) for shape in shapes)
            if face_count > self._limits.faces:
                raise FactoryError(f"has more than {self._limits.faces:,} faces: decimate it")
            if part_count > self._limits.parts:
                raise FactoryError(f"has more than {self._limits.parts:,} parts: join some")

            mesh = self._document["meshes"][node["mesh"]]
            name = str(node.get("name") or mesh.get("name") or f"part {number}")
            for matrix in matrices:
                yield _part(name, shapes, matrix)

    def _shapes_of(self, node: Document) -> list[Shape]:
        """The primitives of a node's mesh that have faces, with its morph weights."""
        number = node["mesh"]
        mesh = self._document["meshes"][number]
        weights = tuple(map(float, node.get("weights", mesh.get("weights", ()))))
        skin = node.get("skin")
        key = number, weights, skin
        if key not in self._shapes:
            self._shapes[key] = [
                self._shape(primitive, weights, skin)
                for primitive in mesh["primitives"]
                if primitive.get("mode", _TRIANGLES) in (_TRIANGLES, _STRIP, _FAN)
            ]
        return self._shapes[key]

    def _shape(self, primitive: Document, weights: tuple[float, ...], skin: int | None) -> Shape:
        """A primitive with its morph weights and the pose of its skin applied.

        Raises FactoryError for compressed geometry, ValueError for faces without vertices.
        """
        attributes = primitive["attributes"]
        self._refuse_compression(primitive)
        vertices = self._buffers.numbers(attributes["POSITION"])[:, :3]
        for weight, target in zip(weights, primitive.get("targets", ()), strict=False):
            if weight and "POSITION" in target:
                vertices = vertices + weight * self._buffers.numbers(target["POSITION"])[:, :3]
        if skin is not None:
            vertices = self._posed(vertices, attributes, self._joint_matrices(skin))

        corners = np.arange(len(vertices), dtype=np.int64)
        if "indices" in primitive:
            corners = self._buffers.stored(primitive["indices"])[:, 0].astype(np.int64)
        triangles = _triangles(corners, primitive.get("mode", _TRIANGLES))
        if len(triangles) and triangles.max() >= len(vertices):
            raise ValueError("its faces name vertices that are not there")
        # Primitives often share the vertices of a whole file.
        used, used_corners = np.unique(triangles, return_inverse=True)

        surface = self._surface(primitive)
        colours = np.broadcast_to(np.array(surface.colour or GREY), vertices.shape)
        if "COLOR_0" in attributes:
            stored = self._buffers.stored(attributes["COLOR_0"])[:, :3]
            colours = np.array(surface.colour or (1.0, 1.0, 1.0)) * unit_colours(stored)
        uv = None
        if surface.texture is not None and f"TEXCOORD_{surface.coordinates}" in attributes:
            uv = self._buffers.numbers(attributes[f"TEXCOORD_{surface.coordinates}"])[:, :2]
            uv = _turned_twice(surface.transformed(uv))
        albedo = self._albedo(surface.texture) if uv is not None else None
        return Shape(
            vertices[used],
            np.asarray(colours[used], np.float32),
            used_corners.reshape(-1, 3),
            uv[used] if uv is not None else None,
            albedo,
        )

    def _refuse_compression(self, primitive: Document) -> None:
        for name in primitive.get("extensions", {}):
            accessors = [self._document["accessors"][n] for n in primitive["attributes"].values()]
            holds_values = all("bufferView" in item or "sparse" in item for item in accessors)
            if name.endswith("mesh_compression") and not holds_values:
                raise FactoryError(f"uses {name}, which is not read; export it uncompressed")

    def _surface(self, primitive: Document) -> _Surface:
        if "material" not in primitive:
            return _Surface()
        material = self._document["materials"][primitive["material"]]
        older = material.get("extensions", {}).get("KHR_materials_pbrSpecularGlossiness")
        if older is not None:
            return _surface(older, "diffuseFactor", "diffuseTexture")
        if not material.get("pbrMetallicRoughness"):
            return _Surface()
        return _surface(material["pbrMetallicRoughness"], "baseColorFactor", "baseColorTexture")

    def _albedo(self, texture_number: int | None) -> Float32s:
        assert texture_number is not None
        if texture_number not in self._albedos:
            texture = self._document["textures"][texture_number]
            webp = texture.get("extensions", {}).get("EXT_texture_webp", {})
            source = webp.get("source", texture.get("source"))
            if source is None:
                names = ", ".join(texture.get("extensions", {})) or "no image"
                raise FactoryError(f"has a texture of {names}, which is not read; use PNG or JPEG")
            image = read_image(self._buffers.image_content(source))
            self._albedos[texture_number] = linear_albedo(image)
        return self._albedos[texture_number]

    def _instances(self, node: Document, number: int) -> list[Matrix]:
        """(4, 4) of each instance of a node in the world; one where it has no instances."""
        # Joints put a skinned mesh into the world, and not its node.
        world = np.eye(4, dtype=self._dtype) if "skin" in node else self._in_world[number]
        extension = node.get("extensions", {}).get("EXT_mesh_gpu_instancing")
        if extension is None:
            return [world]
        columns = {
            name: self._buffers.numbers(extension["attributes"][name])
            for name in ("TRANSLATION", "ROTATION", "SCALE")
            if name in extension["attributes"]
        }
        count = min((len(values) for values in columns.values()), default=0)
        if count > self._limits.parts:
            raise FactoryError(f"has more than {self._limits.parts:,} parts: join some")
        instances = []
        for number in range(count):
            transform = {name.lower(): values[number] for name, values in columns.items()}
            instances.append(_product(world, _matrix(transform, self._dtype)))
        return instances

    def _joint_matrices(self, skin_number: int) -> Array:
        """(J, 4, 4): where each joint of a skin puts what it carries."""
        skin = self._document["skins"][skin_number]
        joints = np.stack([self._in_world.get(joint, np.eye(4)) for joint in skin["joints"]])
        if "inverseBindMatrices" not in skin:
            return joints
        stored = self._buffers.numbers(skin["inverseBindMatrices"]).reshape(-1, 4, 4)
        # They are column-major.
        return np.asarray(joints @ stored[: len(joints)].transpose(0, 2, 1))

    def _posed(self, vertices: Array, attributes: Document, joints: Array) -> Array:
        """Vertices (V, 3) where their joints (J, 4, 4) put them, in the world."""
        moved = np.zeros_like(vertices)
        for number in range(2):
            if f"JOINTS_{number}" in attributes:
                which = self._buffers.stored(attributes[f"JOINTS_{number}"]).astype(np.int64)
                weights = self._buffers.numbers(attributes[f"WEIGHTS_{number}"])
                moved += _blend(vertices, joints, which, weights)
        return moved


class _Surface(NamedTuple):
    """What a material says of its colour.

    colour: linear albedo, a factor of the texture and of the vertices' colours; None: not said.
    texture: its number.
    coordinates: number of the set of texture coordinates.
    offset, rotation_rad, scale: of KHR_texture_transform.
    """

    colour: tuple[float, ...] | None = None
    texture: int | None = None
    coordinates: int = 0
    offset: tuple[float, float] = (0.0, 0.0)
    rotation_rad: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)

    def transformed(self, uv: Array) -> Array:
        """Texture coordinates (N, 2) as KHR_texture_transform changes them."""
        u, v = (uv * self.scale).T
        cosine = np.cos(self.rotation_rad)
        sine = np.sin(self.rotation_rad)
        turned = np.stack([cosine * u - sine * v, sine * u + cosine * v], axis=-1)
        return np.asarray(turned + self.offset)


def _surface(stated: Document, factor: str, texture: str) -> _Surface:
    # An absent factor is white, and an absent texture too.
    colour = tuple(unit_colours(np.array(stated.get(factor, (1.0, 1.0, 1.0))[:3], np.float64)))
    if texture not in stated:
        return _Surface(colour)
    information = stated[texture]
    transform = information.get("extensions", {}).get("KHR_texture_transform", {})
    return _Surface(
        colour,
        information["index"],
        int(transform.get("texCoord", information.get("texCoord", 0))),
        tuple(transform.get("offset", (0.0, 0.0))),
        float(transform.get("rotation", 0.0)),
        tuple(transform.get("scale", (1.0, 1.0))),
    )


def _part(name: str, shapes: list[Shape], matrix: Matrix) -> RawPart:
    """Shapes of one node at a place in the world."""
    pieces = [_piece(shape, matrix) for shape in shapes]
    starts = np.cumsum([0, *(len(points) for points, _, _ in pieces[:-1])])
    return RawPart(
        name,
        np.concatenate([points for points, _, _ in pieces]),
        np.concatenate([colours for _, colours, _ in pieces]),
        np.concatenate(
            [triangles + start for (_, _, triangles), start in zip(pieces, starts, strict=True)]
        ).astype(np.int32),
    )


def _piece(shape: Shape, matrix: Matrix) -> tuple[Array, Float32s, Any]:
    vertices = _moved(shape.vertices, matrix)
    triangles = shape.triangles
    if np.linalg.det(matrix[:3, :3]) < 0:  # a mirror image would be inside out
        triangles = triangles[:, ::-1]
    if shape.uv is None or shape.albedo is None:
        return vertices, shape.colours, triangles
    painted = paint_surface(
        vertices[triangles], shape.uv[triangles], shape.albedo, shape.colours[triangles]
    )
    return painted.vertices, painted.colours, painted.triangles


def _turned_twice(uv: Array) -> Array:
    """Texture coordinates rounded as by readers that count v from the bottom and back.

    Earlier versions read glTF through one of them, and datasets keep their bytes.
    """
    from_bottom = np.float32(1) - uv[:, 1].astype(np.float32)
    return np.stack([uv[:, 0], 1 - from_bottom.astype(np.float64)], axis=-1)


def _triangles(corners: Int64s, mode: int) -> Int64s:
    """(T, 3) of the corners of triangles, a strip or a fan."""
    if mode == _TRIANGLES:
        return np.asarray(corners[: len(corners) // 3 * 3].reshape(-1, 3))
    count = max(len(corners) - 2, 0)
    first = corners[:count] if mode == _STRIP else np.broadcast_to(corners[:1], count)
    triangles = np.stack([first, corners[1 : count + 1], corners[2 : count + 2]], axis=-1)
    if mode == _STRIP:  # every second one would look the other way
        triangles[1::2] = triangles[1::2, [1, 0, 2]]
    return np.asarray(triangles)


def _blend(vertices: Array, joints: Array, which: Int64s, weights: Array) -> Array:
    """(V, 3): the weighted sum of where up to four joints (J, 4, 4) put each vertex."""
    homogeneous = np.append(vertices, np.ones((len(vertices), 1)), axis=1)
    moved = np.zeros_like(vertices)
    for joint in range(which.shape[1]):
        at_joint = np.einsum("vij,vj->vi", joints[which[:, joint], :3], homogeneous)
        moved += weights[:, joint, None] * at_joint
    return moved


def _roots(document: Document) -> list[int]:
    """The nodes at the top of the default scene; in a file without scenes, of all there is."""
    nodes = document.get("nodes", [])
    scenes = document.get("scenes", [])
    if scenes:
        return list(scenes[document.get("scene", 0)].get("nodes", ()))
    children = {child for node in nodes for child in node.get("children", ())}
    return [number for number in range(len(nodes)) if number not in children]


def _world_matrices(nodes: list[Document], roots: list[int], dtype: Dtype) -> dict[int, Matrix]:
    """(4, 4) of each node that is shown: no hidden ones, what hangs on these, or coarser models.

    Raises ValueError when a node is its own ancestor, or has two parents.
    """
    coarser = {
        number
        for node in nodes
        for number in node.get("extensions", {}).get("MSFT_lod", {}).get("ids", ())
    }
    in_world: dict[int, Matrix] = {}
    waiting: list[tuple[int, Matrix]] = [(number, np.eye(4, dtype=dtype)) for number in roots]
    while waiting:
        number, parent = waiting.pop()
        if number in in_world:
            raise ValueError(f"node {number} is twice in the scene")
        node = nodes[number]
        visibility = node.get("extensions", {}).get("KHR_node_visibility", {})
        if number in coarser or visibility.get("visible", True) is False:
            continue
        in_world[number] = _product(parent, _matrix(node, dtype))
        waiting += [(child, in_world[number]) for child in node.get("children", ())]
    return in_world


def _matrix(node: Document, dtype: Dtype) -> Matrix:
    """(4, 4) of a node: column-major `matrix`, or translation, rotation (x, y, z, w) and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], dtype).reshape(4, 4).T
    quaternion: Array = np.array(node.get("rotation", (0, 0, 0, 1)), dtype)
    length = np.linalg.norm(quaternion)
    if abs(length - 1) > 1e-3 and length > 0:  # integers of few bits
        quaternion = quaternion / length
    x, y, z, w = quaternion
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix = np.eye(4, dtype=dtype)
    matrix[:3, :3] = np.array(rotation, dtype) * np.array(node.get("scale", (1, 1, 1)), dtype)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix


def _product(left: Matrix, right: Matrix) -> Matrix:
    """(4, 4), summed in order: a matrix product of numpy rounds as the machine's library does."""
    terms = [left[:, index, None] * right[None, index] for index in range(4)]
    return np.asarray(terms[0] + terms[1] + terms[2] + terms[3])


def _moved(points: Array, matrix: Matrix) -> Array:
    """Points (V, 3) moved by (4, 4), in its precision."""
    x, y, z = points.astype(matrix.dtype).T
    columns = [x * row[0] + y * row[1] + z * row[2] + row[3] for row in matrix[:3]]
    return np.stack(columns, axis=-1)
