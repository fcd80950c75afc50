"""Meshes of a glTF 2.0 file by the names of their nodes, with base colours and textures.

Open3D's reader joins what has one material and loses the names, by which a world's parts have
their classes.  https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html
"""

from __future__ import annotations

import base64
import struct
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from ..errors import FactoryError
from ..small_files import parse_json
from .painted import Part, linear, painted
from .seabed.meshes import Mesh, join

_TYPES = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
# From y up, z towards the viewer, to z up.
_Z_UP = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]], np.float64)
_READ = ("KHR_materials_", "KHR_texture_transform", "KHR_lights_", "KHR_mesh_quantization")


class _File:
    """A file with the buffers that it names."""

    def __init__(self, path: Path) -> None:
        content = path.read_bytes()
        self._folder, self._chunk = path.parent, b""
        if content[:4] == b"glTF":
            (length,) = struct.unpack_from("<I", content, 12)
            text, self._chunk = content[20 : 20 + length], content[28 + length :]
        else:
            text = content
        self.document = parse_json(text)
        self._buffers: dict[int, bytes] = {}

    def linked(self, uri: str) -> bytes:
        """What a URI of the file holds."""
        if uri.startswith("data:"):
            return base64.b64decode(uri.split(",", 1)[1])
        return (self._folder / unquote(uri)).read_bytes()

    def view(self, number: int) -> tuple[bytes, int]:
        """Buffer and first byte of a buffer view."""
        view = self.document["bufferViews"][number]
        which = view["buffer"]
        if which not in self._buffers:
            uri = self.document["buffers"][which].get("uri")
            self._buffers[which] = self._chunk if uri is None else self.linked(uri)
        return self._buffers[which], view.get("byteOffset", 0)

    def array(self, number: int) -> npt.NDArray[Any]:
        """(count, width) numbers of an accessor; normalized ones are fractions."""
        accessor = self.document["accessors"][number]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise ValueError("sparse accessors are not read; export without them")
        buffer, first = self.view(accessor["bufferView"])
        dtype, width = np.dtype(_TYPES[accessor["componentType"]]), _WIDTHS[accessor["type"]]
        stride = self.document["bufferViews"][accessor["bufferView"]].get("byteStride")
        steps = stride or width * dtype.itemsize, dtype.itemsize
        start, shape = first + accessor.get("byteOffset", 0), (accessor["count"], width)
        values: npt.NDArray[Any] = np.ndarray(shape, dtype, buffer, start, steps)
        return values / np.iinfo(dtype).max if accessor.get("normalized") else values.copy()

    def picture(self, texture: int) -> npt.NDArray[np.uint8]:
        """(H, W, 3) sRGB of a texture."""
        import cv2

        image = self.document["images"][self.document["textures"][texture]["source"]]
        if "uri" in image:
            content = self.linked(image["uri"])
        else:
            buffer, first = self.view(image["bufferView"])
            length = self.document["bufferViews"][image["bufferView"]]["byteLength"]
            content = buffer[first : first + length]
        found = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
        if found is None:
            raise ValueError("a texture is no picture")
        return np.asarray(found[..., ::-1], np.uint8)


def parts(path: Path) -> list[Part]:
    """The meshes of a file, a part for each node that has one; z up, units of the file."""
    file = _File(path)
    document = file.document
    unread = [e for e in document.get("extensionsRequired", ()) if not e.startswith(_READ)]
    if unread:
        raise FactoryError(f"needs {unread[0]}, which is not read; export without compression")
    nodes, found = document.get("nodes", []), []
    children = {child for node in nodes for child in node.get("children", ())}
    waiting = [(number, _Z_UP) for number in range(len(nodes)) if number not in children]
    seen = 0
    while waiting:
        number, outer = waiting.pop(0)
        seen += 1
        if seen > len(nodes):
            raise ValueError("its nodes have two parents")
        node = nodes[number]
        place = outer @ _matrix(node)
        waiting += [(child, place) for child in node.get("children", ())]
        if "mesh" in node:
            given = document["meshes"][node["mesh"]]
            meshes = [_primitive(file, one) for one in given["primitives"]]
            if whole := [mesh for mesh in meshes if mesh is not None]:
                name = str(node.get("name") or given.get("name") or f"part {number}")
                found.append(Part(name, _moved(join(whole), place)))
    return found


def _moved(mesh: Mesh, place: npt.NDArray[np.float64]) -> Mesh:
    points = mesh.vertices.astype(np.float64) @ place[:3, :3].T + place[:3, 3]
    mirrored = np.linalg.det(place[:3, :3]) < 0
    triangles = mesh.triangles[:, ::-1] if mirrored else mesh.triangles
    return Mesh(points.astype(np.float32), mesh.colours, np.ascontiguousarray(triangles))


def _matrix(node: dict[str, Any]) -> npt.NDArray[np.float64]:
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    made = np.eye(4)
    made[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    made[:3, :3] *= np.array(node.get("scale", (1.0, 1.0, 1.0)))
    made[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return made


def _primitive(file: _File, given: dict[str, Any]) -> Mesh | None:
    """Triangles of a primitive; lines and points are none."""
    if given.get("mode", 4) != 4 or "POSITION" not in given["attributes"]:
        return None
    has = given["attributes"]
    points = file.array(has["POSITION"]).astype(np.float32)
    order = file.array(given["indices"]) if "indices" in given else np.arange(len(points))
    triangles = order.reshape(-1, 3).astype(np.int64)
    material = file.document["materials"][given["material"]] if "material" in given else {}
    surface = material.get("pbrMetallicRoughness", {})
    factor = np.array(surface.get("baseColorFactor", (0.5, 0.5, 0.5) if not surface else (1,) * 3))
    colours = np.broadcast_to(factor[:3], points.shape).astype(np.float32)
    if "COLOR_0" in has:
        colours = file.array(has["COLOR_0"])[:, :3].astype(np.float32)
    texture = surface.get("baseColorTexture")
    if texture is None:
        return Mesh(points, np.ascontiguousarray(colours), triangles.astype(np.int32))
    places = file.array(has[f"TEXCOORD_{texture.get('texCoord', 0)}"])
    picture = linear(file.picture(texture["index"])) * factor[:3].astype(np.float32)
    return painted(points[triangles], places[triangles], picture)
