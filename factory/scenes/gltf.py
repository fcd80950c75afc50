"""A glTF file as Open3D reads it whole, with the names of its nodes.

Open3D joins what has one material and loses the names, by which a world's parts have their classes.
"""

from __future__ import annotations

from copy import deepcopy
from json import dumps
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from ..small_files import parse_json


def document_of(path: Path) -> tuple[dict[str, Any], bytes]:
    """The JSON of a .gltf or .glb and the chunk that follows it."""
    content = path.read_bytes()
    if content[:4] != b"glTF":
        return parse_json(content), b""
    end = 20 + int.from_bytes(content[12:16], "little")
    return parse_json(content[20:end]), content[end + 8 :]


def linked(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Its buffers and images that lie in other files."""
    listed = [*document.get("buffers", ()), *document.get("images", ())]
    return [one for one in listed if "uri" in one and not one["uri"].startswith("data:")]


def with_own_materials(path: Path, folder: Path) -> tuple[Path, list[tuple[int, str]]]:
    """A copy in `folder` whose materials are each of one node, and number and name of those."""
    document, chunk = document_of(path)
    for k, item in enumerate(linked(document)):
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
        mesh = deepcopy(document["meshes"][node["mesh"]])
        for piece in mesh["primitives"]:
            given = document["materials"][piece["material"]] if "material" in piece else {}
            surface = given.get("pbrMetallicRoughness") or {"baseColorFactor": [0.5, 0.5, 0.5, 1]}
            # Equal materials would be joined, too.
            apart = {"roughnessFactor": len(materials) / 2**20}
            piece["material"] = len(materials)
            materials.append({"pbrMetallicRoughness": {**surface, **apart}})
            owners.append((number, str(node.get("name") or mesh.get("name") or f"part {number}")))
        node["mesh"] = len(meshes)
        meshes.append(mesh)
    children = {child for node in nodes for child in node.get("children", ())}
    roots = [number for number in range(len(nodes)) if number not in children]
    document |= {"meshes": meshes, "materials": materials, "scenes": [{"nodes": roots}], "scene": 0}
    copy = folder / "own.gltf"
    copy.write_text(dumps(document))
    return copy, owners
