"""glTF documents: the files that they name, and a copy of what their default scene shows.

Open3D joins what has one material and loses the names of nodes, by which a world's parts have their
classes; so it reads a copy in which each material is of one node.
"""

from __future__ import annotations

from copy import deepcopy
from json import dumps
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
import numpy.typing as npt

from ...common.errors import FactoryError
from ...common.small_files import parse_json
from .triangle_mesh import GREY

# Each takes some hundred bytes once it is parsed; base64 of buffers has none of these.
_MOST_VALUES = 3_000_000
_TRIANGLE_MODES = (4, 5, 6)
# Roughness numbers the materials; 32 bits hold these fractions exactly.
_ROUGHNESS_STEPS = 2**20
# Translations beyond it are not left to arithmetic of 32 bits.
_FAR = 10_000.0


class Owner(NamedTuple):
    """The node that a material is of: its number in the file, and its name or its mesh's."""

    node: int
    name: str


class OwnMaterials(NamedTuple):
    """A copy of a document.  owners: of its materials.  origin: (3,) what was subtracted, y up."""

    path: Path
    owners: list[Owner]
    origin: npt.NDArray[np.float64]


def read_document(path: Path) -> tuple[dict[str, Any], bytes]:
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


def _links(document: dict[str, Any]) -> list[dict[str, Any]]:
    listed = [*document.get("buffers", ()), *document.get("images", ())]
    return [item for item in listed if not item.get("uri", "data:").startswith("data:")]


def with_own_materials(path: Path, folder: Path) -> OwnMaterials:
    """A copy, in an empty folder, of what the default scene shows, each material of one node.

    Raises FactoryError when a .glb names other files.
    """
    document, chunk = read_document(path)
    links = _links(document)
    if links and path.suffix.lower() != ".gltf":  # those of a .gltf have been looked at
        raise FactoryError("names other files; export with everything in one .glb")
    for number, item in enumerate(links):
        name = f"{number}{Path(item['uri']).suffix}"
        (folder / name).symlink_to((path.parent / unquote(item["uri"])).resolve())
        item["uri"] = name
    for buffer in document.get("buffers", ()):
        if "uri" not in buffer:
            (folder / "chunk.bin").write_bytes(chunk)
            buffer["uri"] = "chunk.bin"

    nodes = document.get("nodes", [])
    roots = _roots(document)
    shown = _shown_nodes(nodes, roots)
    owners: list[Owner] = []
    meshes: list[dict[str, Any]] = []
    materials: list[dict[str, Any]] = []
    for number, node in enumerate(nodes):
        if number not in shown:
            node.pop("mesh", None)
        if "mesh" not in node:
            continue
        solid = deepcopy(document["meshes"][node["mesh"]])
        faces = [item for item in solid["primitives"] if item.get("mode", 4) in _TRIANGLE_MODES]
        if not faces:  # points and lines alone
            del node["mesh"]
            continue
        solid["primitives"] = faces
        name = str(node.get("name") or solid.get("name") or f"part {number}")
        for primitive in faces:
            stated = document["materials"][primitive["material"]] if "material" in primitive else {}
            surface = stated.get("pbrMetallicRoughness") or {"baseColorFactor": [*GREY, 1]}
            # Equal materials would be joined, too.
            distinct = {"roughnessFactor": len(materials) / _ROUGHNESS_STEPS}
            primitive["material"] = len(materials)
            materials.append({"pbrMetallicRoughness": {**surface, **distinct}})
            owners.append(Owner(number, name))
        node["mesh"] = len(meshes)
        meshes.append(solid)

    document |= {"meshes": meshes, "materials": materials}
    document["scenes"] = [{"nodes": sorted(roots)}]
    document["scene"] = 0
    origin = _recentre(document, roots)
    copy = folder / "own.gltf"
    copy.write_text(dumps(document))
    return OwnMaterials(copy, owners, origin)


def material_number(roughness: float) -> int:
    """The place of a material among the owners, by its roughness."""
    return round(roughness * _ROUGHNESS_STEPS)


def _roots(document: dict[str, Any]) -> list[int]:
    """The nodes at the top of the default scene; in a file without scenes, of all there is."""
    nodes = document.get("nodes", [])
    scenes = document.get("scenes", [])
    if scenes:
        return list(scenes[document.get("scene", 0)].get("nodes", ()))
    children = {child for node in nodes for child in node.get("children", ())}
    return [number for number in range(len(nodes)) if number not in children]


def _shown_nodes(nodes: list[dict[str, Any]], roots: list[int]) -> set[int]:
    """The nodes below the roots, without hidden ones, what hangs on these, and coarser models.

    Raises ValueError when a node is its own ancestor, or has two parents.
    """
    coarser = {
        number
        for node in nodes
        for number in node.get("extensions", {}).get("MSFT_lod", {}).get("ids", ())
    }
    shown: set[int] = set()
    waiting = list(roots)
    while waiting:
        number = waiting.pop()
        if number in shown:
            raise ValueError(f"node {number} is twice in the scene")
        node = nodes[number]
        visibility = node.get("extensions", {}).get("KHR_node_visibility", {})
        if number in coarser or visibility.get("visible", True) is False:
            continue
        shown.add(number)
        waiting += node.get("children", ())
    return shown


def _recentre(document: dict[str, Any], roots: list[int]) -> npt.NDArray[np.float64]:
    """Move a scene whose nodes are far away to the origin; returns (3,) what was subtracted.

    Nodes become roots with matrices of their own, multiplied in 64 bits.
    """
    nodes = document.get("nodes", [])
    in_world: dict[int, npt.NDArray[np.float64]] = {}
    waiting = [(number, np.eye(4)) for number in roots]
    while waiting:
        number, parent = waiting.pop()
        matrix = parent @ _matrix(nodes[number])
        waiting += [(child, matrix) for child in nodes[number].get("children", ())]
        if "mesh" in nodes[number]:
            in_world[number] = matrix
    places = np.array([matrix[:3, 3] for matrix in in_world.values()]).reshape(-1, 3)
    if not len(places) or np.abs(places).max() < _FAR:
        return np.zeros(3)

    origin: npt.NDArray[np.float64] = np.round(places.mean(axis=0))
    moved = []
    for number, matrix in in_world.items():
        matrix[:3, 3] -= origin
        moved.append({"mesh": nodes[number]["mesh"], "matrix": matrix.T.ravel().tolist()})
    document["nodes"] = moved
    document["scenes"] = [{"nodes": list(range(len(moved)))}]
    return origin


def _matrix(node: dict[str, Any]) -> npt.NDArray[np.float64]:
    """(4, 4) of a node: column-major `matrix`, or translation, rotation (x, y, z, w) and scale."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", (0, 0, 0, 1)), np.float64)
    rotation = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix = np.eye(4)
    matrix[:3, :3] = np.array(rotation) * np.array(node.get("scale", (1, 1, 1)), np.float64)
    matrix[:3, 3] = node.get("translation", (0, 0, 0))
    return matrix
