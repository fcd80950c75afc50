"""What mesh files may hold: integers, instances, weights, joints, colours of any type, notches."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.common.array_types import Array
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.simulation.meshes.mesh_parts import read_model
from simnfnd.factory.simulation.meshes.painted import linear_albedo, unit_colours

Document = dict[str, Any]

CORNERS = np.array(
    [[x, y, z] for x in (0, 1) for y in (0, 2) for z in (0, 3)], np.float32
) - np.array([0.5, 1, 1.5], np.float32)  # fmt: skip
# A box of 1 x 2 x 3 in a file whose y points up.
FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6],
     [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]], np.uint16,
)  # fmt: skip
TYPES = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "u4": 5125, "f4": 5126}
SHAPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Glb:
    """A document with a box, to be changed and written."""

    def __init__(self, positions: Array = CORNERS, **about: Any) -> None:
        self.content = b""
        self.document: Document = {"asset": {"version": "2.0"}, "bufferViews": [], "accessors": []}
        attributes = {"POSITION": self.add(positions, **about)}
        self.primitive: Document = {"attributes": attributes, "indices": self.add(FACES.ravel())}
        self.node: Document = {"mesh": 0, "name": "box"}
        self.document |= {"meshes": [{"primitives": [self.primitive]}], "nodes": [self.node]}

    def add(self, values: Array, **about: Any) -> int:
        """Add an accessor; returns its number."""
        rows = values.reshape(len(values), -1)
        step = -(-rows[:1].nbytes // 4) * 4
        padded = np.zeros((len(rows), step), np.uint8)
        padded[:, : rows[:1].nbytes] = np.ascontiguousarray(rows).view(np.uint8)
        is_index = values.ndim == 1
        data = values.tobytes() if is_index else padded.tobytes()
        self.content += b"\0" * (-len(self.content) % 4)
        view = {"buffer": 0, "byteOffset": len(self.content), "byteLength": len(data)}
        self.document["bufferViews"].append(view if is_index else {**view, "byteStride": step})
        self.content += data
        self.document["accessors"].append(
            {"bufferView": len(self.document["bufferViews"]) - 1, "count": len(rows),
             "componentType": TYPES[values.dtype.str[1:]], "type": SHAPES[rows.shape[1]], **about}
        )  # fmt: skip
        return len(self.document["accessors"]) - 1

    def write(self, path: Path) -> Path:
        document = {**self.document, "buffers": [{"byteLength": len(self.content)}]}
        head = json.dumps(document).encode()
        head += b" " * (-len(head) % 4)
        chunks = struct.pack("<I4s", len(head), b"JSON") + head
        chunks += struct.pack("<I4s", len(self.content), b"BIN\0") + self.content
        path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
        return path


def parts_of(path: Path) -> list[Any]:
    return [part.mesh for part in read_model(path, "scenes.file", 1, 3000, "stated").parts]


def extent(mesh: Any) -> list[float]:
    """Along x, y and z, z up."""
    return [float(size) for size in np.ptp(mesh.vertices, axis=0).round(3)]


def quantised(glb: type[Glb]) -> Glb:
    made = glb(np.rint(CORNERS / 2 * 32767).astype(np.int16), normalized=True)
    made.node["scale"] = [2, 2, 2]
    made.document["extensionsRequired"] = ["KHR_mesh_quantization"]
    return made


def morphed(glb: type[Glb]) -> Glb:
    made = glb()
    target = made.add(CORNERS * np.array([0, 0, 2], np.float32))
    made.primitive["targets"] = [{"POSITION": target}]
    made.node["weights"] = [1.0]
    return made


def sparse(glb: type[Glb]) -> Glb:
    made = glb()
    indices = made.add(np.array([0], np.uint16))
    values = made.add(np.array([[-0.5, -1, -7.5]], np.float32))
    views = [made.document["accessors"][number]["bufferView"] for number in (indices, values)]
    made.document["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": views[0], "componentType": 5123},
        "values": {"bufferView": views[1]},
    }
    return made


def skinned(glb: type[Glb]) -> Glb:
    made = glb()
    attributes = made.primitive["attributes"]
    attributes["JOINTS_0"] = made.add(np.tile(np.array([0, 1, 0, 0], np.uint8), (8, 1)))
    attributes["WEIGHTS_0"] = made.add(np.tile(np.array([0.5, 0.5, 0, 0], np.float32), (8, 1)))
    made.node |= {"skin": 0, "translation": [100, 100, 100]}  # which its joints overrule
    made.document["skins"] = [{"joints": [1, 2]}]
    made.document["nodes"] += [{"scale": [1, 1, 1]}, {"scale": [1, 1, 5]}]
    return made


MADE: dict[str, tuple[Callable[[type[Glb]], Glb], list[float]]] = {
    "quantised": (quantised, [1, 3, 2]),
    "morphed": (morphed, [1, 9, 2]),
    "sparse": (sparse, [1, 9, 2]),
    "skinned": (skinned, [1, 9, 2]),
}


@pytest.mark.parametrize("kind", MADE)
def test_a_glb_has_the_shape_that_it_states(tmp_path: Path, kind: str) -> None:
    make, expected = MADE[kind]
    (mesh,) = parts_of(make(Glb).write(tmp_path / "box.glb"))
    assert extent(mesh) == pytest.approx(expected, abs=2e-3)


def test_each_instance_is_a_part_at_its_own_place(tmp_path: Path) -> None:
    glb = Glb()
    quarter = np.array([[0, 0, 0, 1], [0, 0.7071068, 0, 0.7071068]], np.float32)
    attributes = {
        "TRANSLATION": glb.add(np.array([[0, 0, 0], [5, 0, 0]], np.float32)),
        "ROTATION": glb.add(quarter),
        "SCALE": glb.add(np.array([[1, 1, 1], [2, 2, 2]], np.float32)),
    }
    glb.node["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    glb.document["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    first, second = parts_of(glb.write(tmp_path / "boxes.glb"))
    assert extent(first) == pytest.approx([1, 3, 2], abs=1e-3)
    assert extent(second) == pytest.approx([6, 2, 4], abs=1e-3)
    assert second.vertices[:, 0].mean() == pytest.approx(5, abs=1e-3)


@pytest.mark.parametrize(("mode", "corners"), [(5, [0, 1, 2, 3]), (6, [0, 1, 3, 2])])
def test_strips_and_fans_are_triangles(tmp_path: Path, mode: int, corners: list[int]) -> None:
    glb = Glb()
    glb.primitive |= {"mode": mode, "indices": glb.add(np.array(corners, np.uint16))}
    (mesh,) = parts_of(glb.write(tmp_path / "strip.glb"))
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a) / 2
    assert normals.sum(axis=0) == pytest.approx(normals[0] * 2), "both look the same way"
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(6, abs=1e-3)


COLOURS: dict[str, Array] = {
    "float": np.full((8, 4), 0.5, np.float32),
    "bytes": np.full((8, 4), 128, np.uint8),
    "shorts": np.full((8, 3), 32768, np.uint16),
}


@pytest.mark.parametrize("kind", COLOURS)
def test_colours_of_vertices_are_factors_of_the_material(tmp_path: Path, kind: str) -> None:
    glb = Glb()
    stored = COLOURS[kind]
    glb.primitive["attributes"]["COLOR_0"] = glb.add(stored, normalized=stored.dtype.kind == "u")
    (plain,) = parts_of(glb.write(tmp_path / f"{kind}.glb"))
    assert plain.colours == pytest.approx(np.full((8, 3), 0.5), abs=3e-3)
    factor = {"baseColorFactor": [1, 0.5, 0.25, 1]}
    glb.document["materials"] = [{"pbrMetallicRoughness": factor}]
    glb.primitive["material"] = 0
    (tinted,) = parts_of(glb.write(tmp_path / f"{kind}-tinted.glb"))
    assert tinted.colours == pytest.approx(np.tile([0.5, 0.25, 0.125], (8, 1)), abs=3e-3)


def test_a_mirrored_node_is_not_inside_out(tmp_path: Path) -> None:
    glb = Glb()
    glb.node["scale"] = [-1, 1, 1]
    assert not read_model(glb.write(tmp_path / "mirrored.glb"), "scenes.file", 1, 3000).notes


def test_what_is_not_read_is_refused_by_name(tmp_path: Path) -> None:
    glb = Glb()
    glb.document["extensionsRequired"] = ["VENDOR_voxels"]
    with pytest.raises(FactoryError, match="VENDOR_voxels"):
        parts_of(glb.write(tmp_path / "voxels.glb"))
    glb.document["extensionsRequired"] = []
    glb.document["bufferViews"][0]["extensions"] = {"EXT_meshopt_compression": {}}
    with pytest.raises(FactoryError, match="EXT_meshopt_compression"):
        parts_of(glb.write(tmp_path / "meshopt.glb"))
    glb.primitive["extensions"] = {"KHR_draco_mesh_compression": {}}
    del glb.document["accessors"][0]["bufferView"]
    with pytest.raises(FactoryError, match="KHR_draco_mesh_compression"):
        parts_of(glb.write(tmp_path / "draco.glb"))


@pytest.mark.parametrize("field", ["count", "byteOffset", "bufferView"])
def test_accessors_beyond_their_buffer_are_damage(tmp_path: Path, field: str) -> None:
    glb = Glb()
    glb.document["accessors"][0][field] = 9_000_000
    with pytest.raises(FactoryError, match="damaged"):
        parts_of(glb.write(tmp_path / "bad.glb"))


# --- concave faces of an .obj

OUTLINES = {
    "slot": ([(0, 0), (3, 0), (3, 2), (2, 2), (2, 1), (1, 1), (1, 2), (0, 2)], 5.0),
    "arrow": ([(0, 0), (2, 1), (0, 2), (1, 1)], 1.0),
    "clockwise L": ([(0, 0), (0, 3), (1, 3), (1, 1), (3, 1), (3, 0)], 5.0),
    "bridge to a hole": (
        [(0, 0), (3, 0), (3, 3), (0, 3), (0, 0), (1, 1), (1, 2), (2, 2), (2, 1), (1, 1)],
        8.0,
    ),
    "square": ([(0, 0), (1, 0), (1, 1), (0, 1)], 1.0),
}


@pytest.mark.parametrize("name", OUTLINES)
def test_a_face_covers_its_outline_alone(tmp_path: Path, name: str) -> None:
    outline, area = OUTLINES[name]
    path = tmp_path / "wall.obj"
    lines = [f"v {x} {x / 2} {z}" for x, z in outline]  # on a slanting wall
    path.write_text("\n".join(lines) + f"\nf {' '.join(map(str, range(1, len(outline) + 1)))}\n")
    (mesh,) = parts_of(path)
    a, b, c = mesh.vertices[mesh.triangles].transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    assert areas.sum() == pytest.approx(area * np.hypot(1, 0.5), rel=1e-5)
    assert len(mesh.triangles) == len(outline) - 2


def test_texture_coordinates_follow_the_cut_of_a_face(tmp_path: Path) -> None:
    outline, _ = OUTLINES["slot"]
    (tmp_path / "a.mtl").write_text("newmtl a\nmap_Kd ramp.png\n")
    from PIL import Image

    ramp = np.repeat(np.arange(0, 256, 2, np.uint8)[None], 8, axis=0)
    Image.fromarray(ramp).convert("RGB").save(tmp_path / "ramp.png")
    lines = [f"v {x} 0 {z}\nvt {x / 3} {z / 2}" for x, z in outline]
    face = " ".join(f"{number}/{number}" for number in range(1, 9))
    (tmp_path / "wall.obj").write_text(
        "mtllib a.mtl\n" + "\n".join(lines) + f"\nusemtl a\nf {face}"
    )
    (mesh,) = parts_of(tmp_path / "wall.obj")
    shown = 255 * mesh.colours[:, 0] ** (1 / 2.2)
    assert shown == pytest.approx(mesh.vertices[:, 0] / 3 * 256, abs=6)


def test_a_face_of_too_many_corners_is_refused(tmp_path: Path) -> None:
    teeth = [(number / 100, 5 * (number % 2)) for number in range(5998)]
    corners = [*teeth, (60, -1), (0, -1)]
    comb = "\n".join(f"v {x} {y} 0" for x, y in corners)
    (tmp_path / "comb.obj").write_text(f"{comb}\nf {' '.join(map(str, range(1, 6001)))}\n")
    with pytest.raises(FactoryError, match="6,000 corners"):
        parts_of(tmp_path / "comb.obj")


def test_strips_of_a_ply_are_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "scan.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
        "property float z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n1 1 0\n4 0 1 2 3\n"
    )
    with pytest.raises(FactoryError, match="tristrips"):
        parts_of(tmp_path / "scan.ply")


# --- colours

STORED = {
    "uchar": ("red green blue", 188),
    "float": ("red green blue", 188 / 255),
    "double": ("red green blue", 188.0),
    "ushort": ("red green blue", 188 * 257),
    "uint8": ("diffuse_red diffuse_green diffuse_blue", 188),
    "float32": ("r g b", 188 / 255),
}


@pytest.mark.parametrize("kind", STORED)
def test_colours_of_a_ply_mean_the_same_in_any_type(tmp_path: Path, kind: str) -> None:
    names, value = STORED[kind]
    lines = ["ply", "format ascii 1.0", "element vertex 3"]
    lines += [f"property float {axis}" for axis in "xyz"]
    lines += [f"property {kind} {name}" for name in names.split()]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header"]
    lines += [f"{x} {y} 0 {value} {value} {value}" for x, y in ((0, 0), (1, 0), (0, 1))]
    (tmp_path / "a.ply").write_text("\n".join([*lines, "3 0 1 2", ""]))
    (mesh,) = parts_of(tmp_path / "a.ply")
    assert mesh.colours == pytest.approx(np.full((3, 3), linear_albedo(np.array(188.0))), rel=1e-4)


def test_colours_of_faces_are_named_as_not_read(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n3 0 1 2 9 9 9\n"
    )
    (note,) = read_model(tmp_path / "a.ply", "scenes.file", 1, 3000).notes
    assert "colours of faces" in note


@pytest.mark.parametrize("value", [0.5, 127.5, 32767.5])
def test_colours_of_an_obj_may_count_to_one_or_255(tmp_path: Path, value: float) -> None:
    rows = [f"v {x} {y} 0 {value} {value} {value}" for x, y in ((0, 0), (1, 0), (0, 1))]
    (tmp_path / "a.obj").write_text("\n".join(rows) + "\nf 1 2 3\n")
    (mesh,) = parts_of(tmp_path / "a.obj")
    assert mesh.colours == pytest.approx(np.full((3, 3), 0.5), abs=1e-6)


@pytest.mark.parametrize("bad", [[-0.1], [np.nan], [1e6]])
def test_colours_that_are_none_are_refused(bad: list[float]) -> None:
    with pytest.raises(FactoryError):
        unit_colours(np.array(bad))
