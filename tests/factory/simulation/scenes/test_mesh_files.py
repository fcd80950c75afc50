"""Mesh files of other programs: materials, names, axes, far places, scenes, Blender's output."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from simnfnd.factory.common.array_types import Bools, Float64s
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.meshes.mesh_loading import MOST_PARTS
from simnfnd.factory.simulation.meshes.mesh_parts import files_of, read_model
from simnfnd.factory.simulation.meshes.triangle_mesh import box
from simnfnd.factory.simulation.scenes import open_reader
from simnfnd.factory.simulation.scenes.poses import trajectory
from tests.factory.simulation.scenes.test_own_worlds import (
    FORWARD,
    write_chunks,
    write_glb,
    write_mesh,
)

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"


def parts_of(path: Path) -> dict[str, Any]:
    model = read_model(path, "scenes.file", 1, 3000, "stated")
    return {part.name: part.mesh for part in model.parts}


def write_image(path: Path) -> None:
    """A left half in black and a right half in red."""
    pixels = np.zeros((8, 8, 3), np.uint8)
    pixels[:, 4:, 0] = 255
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray(pixels).save(path)


def textured(folder: Path, line: str, library: str = "bed.mtl") -> Bools:
    """Where a square with a material of that line is red, for x of 0.1 to 0.9."""
    (folder / "bed.mtl").write_text(
        f"newmtl rock\nKd 0.25 0.5 0.75\n{line}\nnewmtl other\nKd 1 1 1\n"
    )
    text = f"mtllib {library}\n{SQUARE}usemtl rock\nf 1/1 2/2 3/3 4/4\n"
    (folder / "bed.obj").write_text(text)
    (mesh,) = parts_of(folder / "bed.obj").values()
    x = mesh.vertices[:, 0]
    red = [np.median(mesh.colours[np.abs(x - at) < 0.02, 0]) for at in np.arange(0.1, 1, 0.1)]
    return np.array(red) > 0.5


RIGHT = [False] * 4 + [True] * 5
LINES = {
    "map_Kd half.png": RIGHT,
    "map_Kd -s 1 1 1 half.png": RIGHT,
    "map_Kd -o 0.5 0 0 half.png": [not red for red in RIGHT],
    "map_Kd -s 2 2 half.png": [False, False, True, True, False, False, False, True, True],
    "map_Kd -clamp on -o -1 0 0 half.png": [False] * 9,
    "map_Kd -blendu on -mm 0 1 -texres 64 half.png": RIGHT,
    "map_Kd my half.png": RIGHT,
    "map_Kd sub\\half.png": RIGHT,
    "map_Kd half.png\nmap_Bump -bm 0.5 absent.png": RIGHT,
}


@pytest.mark.parametrize("line", LINES)
def test_textures_are_found_after_their_options(tmp_path: Path, line: str) -> None:
    for name in ("half.png", "my half.png", "sub/half.png"):
        write_image(tmp_path / name)
    expected = LINES[line]
    shown = textured(tmp_path, line)
    is_edge = np.isin(np.round(np.arange(0.1, 1, 0.1), 1), (0.5,))  # between the halves
    assert (shown == expected)[~is_edge].mean() > 0.8


def test_a_material_without_a_texture_has_its_colour(tmp_path: Path) -> None:
    (tmp_path / "bed.mtl").write_text(
        "newmtl rock\nKd 0.25 0.5 0.75\nmap_Kd \nnewmtl other\nKd 1 1 1"
    )
    (tmp_path / "bed.obj").write_text(f"mtllib bed.mtl\n{SQUARE}usemtl rock\nf 1/1 2/2 3/3 4/4\n")
    (mesh,) = parts_of(tmp_path / "bed.obj").values()
    assert mesh.colours == pytest.approx(np.tile([0.25, 0.5, 0.75], (4, 1)))


COMMENTED = """# saved from C:\\scans\\
v 0 0 0 # origin
v 1 0 0#right
v 0 1 0	# a tab
usemtl steel#2 # of the frame
o bow #2
f 1 2 3  # left side
"""


def test_comments_of_an_obj_may_follow_a_statement(tmp_path: Path) -> None:
    (tmp_path / "noted.obj").write_text(COMMENTED)
    ((name, mesh),) = parts_of(tmp_path / "noted.obj").items()
    assert name == "bow #2"
    assert sorted(mesh.vertices.tolist()) == [[0, 0, 0], [0, 1, 0], [1, 0, 0]]


@pytest.mark.parametrize("library", ["a.mtl bed.mtl", "my bed.mtl"])
def test_libraries_may_be_several_or_have_spaces(tmp_path: Path, library: str) -> None:
    write_image(tmp_path / "half.png")
    textured(tmp_path, "map_Kd half.png")
    (tmp_path / "a.mtl").write_text("newmtl x\n")
    (tmp_path / "my bed.mtl").write_text((tmp_path / "bed.mtl").read_text())
    assert textured(tmp_path, "map_Kd half.png", library)[-1]
    names = {Path(file).name for file in files_of(tmp_path / "bed.obj", "k")}
    assert {"bed.obj", "half.png"} < names


@pytest.mark.parametrize(
    ("statements", "names"),
    [
        (("o seabed", "o valve"), ["seabed", "valve"]),
        (("g seabed", "g valve 2"), ["seabed", "valve 2"]),
        (("o all\ng seabed", "g valve"), ["seabed", "valve"]),
        (("o seabed\ng x", "o valve\ng x"), ["seabed", "valve"]),
        (("", "usemtl b"), ["world"]),
    ],
)
def test_objects_and_groups_of_an_obj_are_parts(
    tmp_path: Path, statements: tuple[str, str], names: list[str]
) -> None:
    first, second = statements
    (tmp_path / "world.obj").write_text(
        f"{first}\n{SQUARE}f 1 2 3\n{second}\nv 2 0 0\nv 3 0 0\nv 3 1 0\nf -3 -2 -1\n"
    )
    parts = parts_of(tmp_path / "world.obj")
    assert list(parts) == names
    if len(parts) == 2:
        assert parts[names[1]].vertices[:, 0].tolist() == [2, 3, 3]
    config = compose_config(
        ["scenes=mesh", f"scenes.file={tmp_path}/world.obj",
         f"scenes.classes=[{{class: Valve, parts: '{names[-1]}'}}]"]
    )  # fmt: skip
    open_reader(config.scenes).discover()


def test_an_obj_is_read_in_time_that_grows_with_its_size(tmp_path: Path) -> None:
    world = tmp_path / "empty-lines.obj"
    world.write_text("\n" * 200_000 + f"mtllib a.mtl\n{SQUARE}f 1 2 3\n")
    (tmp_path / "a.mtl").write_text("newmtl a\n" + "\n \n" * 100_000 + "map_Kd" + " " * 200_000)
    begun = time.monotonic()
    assert len(parts_of(world)["empty-lines"].triangles) == 1
    assert time.monotonic() - begun < 20


@pytest.mark.parametrize(
    ("faces", "said"),
    [("f 1 2 9", "vertices that are not there"), ("f 1/9 2/9 3/9", "texture coordinates"),
     ("f a b c", "damaged"), ("v 1 2", "damaged"), ("v 1 nan 2\nf 1 2 5", "no numbers")],
)  # fmt: skip
def test_a_damaged_obj_is_told(tmp_path: Path, faces: str, said: str) -> None:
    (tmp_path / "bad.obj").write_text(f"{SQUARE}{faces}\nf 1 2 3\n")
    with pytest.raises(FactoryError, match=said):
        parts_of(tmp_path / "bad.obj")


def test_more_parts_than_numbers_are_refused(tmp_path: Path) -> None:
    # Refused before the parts are read one by one.
    lines = [f"o {number}\nf 1 2 3" for number in range(MOST_PARTS + 1)]
    (tmp_path / "many.obj").write_text(SQUARE + "\n".join(lines))
    with pytest.raises(FactoryError, match="65,536 parts"):
        parts_of(tmp_path / "many.obj")


# --- far coordinates, axes


def bed(offset: tuple[float, float, float] = (0, 0, 0), y_up: bool = False) -> tuple[Float64s, str]:
    """Vertices (N, 3) of a wavy floor of 12 m, and the faces of an .obj."""
    across = np.linspace(-6, 6, 40)
    x, y = np.meshgrid(across, across)
    z = 0.15 * np.sin(3 * x) * np.cos(3 * y)
    points = np.stack([x, z, -y] if y_up else [x, y, z], axis=-1).reshape(-1, 3) + offset
    faces = [
        f"f {a} {a + 1} {a + 41}\nf {a} {a + 41} {a + 40}"
        for a in (40 * row + column + 1 for row in range(39) for column in range(39))
    ]
    return points, "\n".join(faces)


def write_bed(path: Path, *, binary: str = "double", **options: Any) -> Path:
    points, faces = bed(**options)
    if path.suffix == ".obj":
        path.write_text(
            "\n".join("v {:.4f} {:.4f} {:.4f}".format(*p) for p in points) + f"\n{faces}"
        )
        return path
    triangles = [[int(n) - 1 for n in line.split()[1:]] for line in faces.splitlines()]
    table = np.zeros(len(triangles), [("count", "u1"), ("corners", "<i4", 3)])
    table["count"] = 3
    table["corners"] = triangles
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property {binary} {axis}\n" for axis in "xyz")
    head += f"element face {len(table)}\nproperty list uchar int vertex_indices\nend_header\n"
    numbers = points.astype("<f8" if binary == "double" else "<f4")
    path.write_bytes(head.encode() + numbers.tobytes() + table.tobytes())
    return path


FAR = (352417.0, 5812345.0, -21.0)


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_far_coordinates_keep_their_shape(tmp_path: Path, suffix: str) -> None:
    near = read_model(write_bed(tmp_path / f"near{suffix}"), "scenes.file", 1, 3000, "z")
    far = read_model(write_bed(tmp_path / f"far{suffix}", offset=FAR), "scenes.file", 1, 3000, "z")
    assert near.origin_m.tolist() == [0, 0, 0]
    assert far.origin_m[:2].tolist() == [352417, 5812345]
    moved = far.parts[0].mesh.vertices + far.origin_m - FAR
    assert moved == pytest.approx(near.parts[0].mesh.vertices, abs=2e-4)
    assert any("352417" in note for note in far.notes)


def test_poses_are_in_the_coordinates_of_the_file(tmp_path: Path) -> None:
    frames = []
    for name, (x, y, z) in {"near": (0.0, 0.0, 0.0), "far": FAR}.items():
        write_bed(tmp_path / f"{name}.obj", offset=(x, y, z))
        turn = "-0.8 0 0 0.6"
        (tmp_path / f"{name}.txt").write_text(f"0 {x} {y - 5} {z + 1.5} {turn}\n")
        config = compose_config(
            ["scenes=mesh", f"scenes.file={tmp_path}/{name}.obj", "scenes.width=96",
             f"scenes.poses={tmp_path}/{name}.txt", "scenes.height=64"]
        )  # fmt: skip
        reader = open_reader(config.scenes)
        frames.append(reader.load(reader.discover().frames[0]))
    assert frames[0].depth_m == pytest.approx(frames[1].depth_m, abs=2e-3)


def test_coordinates_cut_to_32_bits_are_told(tmp_path: Path) -> None:
    path = write_bed(tmp_path / "cut.ply", offset=FAR, binary="float")
    notes = read_model(path, "scenes.file", 1, 3000, "z").notes
    assert any("steps of 0.5 m" in note for note in notes)


def test_far_nodes_of_a_glb_are_brought_near(tmp_path: Path) -> None:
    path = tmp_path / "far.glb"
    write_glb(path, {"a": box((1, 1, 1)), "b": box((1, 1, 1), (3, 0, 0))})
    content = path.read_bytes()
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length])
    chunk = content[28 + length :]
    nodes = document["nodes"]
    for node in nodes:
        node["translation"] = [0, 1.25, 0]
    nodes.append({"children": [0, 1], "translation": [352417.25, 0, -5812345.5]})
    document["scenes"] = [{"nodes": [2]}]
    write_chunks(path, document, chunk)
    model = read_model(path, "scenes.file", 1, 3000)
    first, second = (part.mesh.vertices + model.origin_m for part in model.parts)
    assert [part.name for part in model.parts] == ["a", "b"]
    assert first.mean(axis=0) == pytest.approx([352417.25, 5812345.5, 0.25], abs=1e-6)
    assert (second - first).mean(axis=0) == pytest.approx([3, 0, 0], abs=1e-5)


@pytest.mark.parametrize("suffix", [".obj", ".ply"])
def test_a_floor_with_y_up_is_turned_and_told(tmp_path: Path, suffix: str) -> None:
    path = write_bed(tmp_path / f"bed{suffix}", y_up=True)
    (note,) = read_model(path, "scenes.file", 1, 3000).notes
    assert "scenes.up=z" in note
    for up, height in (("auto", 0.3), ("y", 0.3), ("z", 12), ("stated", 12)):
        choice: Any = up
        (part,) = read_model(path, "scenes.file", 1, 3000, choice).parts
        assert np.ptp(part.mesh.vertices[:, 2]) == pytest.approx(height, abs=0.02)
    flat = write_bed(tmp_path / f"flat{suffix}")
    assert not read_model(flat, "scenes.file", 1, 3000).notes


def test_the_axis_of_an_own_object_may_be_said(tmp_path: Path) -> None:
    write_mesh(tmp_path / "post.ply", box((0.2, 2, 0.2)))
    heights = {}
    for up in ("auto", "y", "z"):
        entry = f"{{file: {tmp_path}/post.ply, class: post, up: {up}}}"
        config = compose_config([f"scenes.own_objects=[{entry}]"])
        (own,) = config.scenes.own_objects  # type: ignore[union-attr]
        mesh, _, _ = own.read("scenes.own_objects.0")
        heights[up] = float(np.ptp(mesh.vertices[:, 2]))
        assert ("up" in identity(config)["scenes"]["own_objects"][0]) == (up != "auto")
    assert heights == pytest.approx({"auto": 0.2, "y": 2, "z": 0.2})


# --- scenes and nodes of glTF


def test_only_what_the_default_scene_shows_is_read(tmp_path: Path) -> None:
    path = tmp_path / "scenes.glb"
    names = ["bed", "in another scene", "hidden", "below hidden", "coarse", "lines", "own"]
    write_glb(path, {name: box((1, 1, 1), (2 * k, 0, 0)) for k, name in enumerate(names)})
    content = path.read_bytes()
    length = int.from_bytes(content[12:16], "little")
    document = json.loads(content[20 : 20 + length])
    chunk = content[28 + length :]
    nodes = document["nodes"]
    meshes = document["meshes"]
    nodes[2] |= {"extensions": {"KHR_node_visibility": {"visible": False}}, "children": [3]}
    nodes[0]["extensions"] = {"MSFT_lod": {"ids": [4]}}
    meshes[5]["primitives"][0]["mode"] = 1
    document["scenes"] = [{"nodes": [1]}, {"nodes": [0, 2, 4, 5, 6]}]
    document["scene"] = 1
    write_chunks(path, document, chunk)
    assert list(parts_of(path)) == ["bed", "own"]
    document["scenes"][1]["nodes"] = [6, 0]  # whatever the order of their materials
    write_chunks(path, document, chunk)
    assert parts_of(path)["bed"].vertices[:, 0].max() == pytest.approx(0.5)
    nodes[0]["children"] = [0]
    write_chunks(path, document, chunk)
    with pytest.raises(FactoryError, match="twice"):
        parts_of(path)


def test_a_document_of_too_many_values_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "many.gltf"
    path.write_text('{"extras": [' + "[]," * 3_000_000 + "0]}")
    with pytest.raises(FactoryError, match=r"JSON has .* values"):
        files_of(path, "scenes.file")


# --- Blender files

OUTPUT = """
import bpy, sys
scene = bpy.context.scene
render = scene.render
output = render.image_settings
if hasattr(output, "media_type"):
    output.media_type = "VIDEO"
output.file_format = "FFMPEG"
render.use_multiview = True
render.views_format = "STEREO_3D"
render.use_border = render.use_crop_to_border = True
render.border_max_x = 0.3
render.pixel_aspect_x = 2.0
render.use_stamp = render.use_motion_blur = True
scene.view_layers.new("second")
scene.view_layers[0].use = False
scene.timeline_markers.new("cut", frame=1)
other = bpy.data.scenes.new("other")
hidden = {}
for name in ("valve", "hidden", "unrendered", "elsewhere"):
    where = other if name == "elsewhere" else scene
    made = bpy.data.meshes.new(name)
    size = 0.5
    corners = [(x, y, z) for x in (-size, size) for y in (-size, size) for z in (-size, size)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    made.from_pydata(corners, [], faces)
    thing = bpy.data.objects.new(name, made)
    thing.location = (0, 4 if name == "valve" else 2, 0)
    where.collection.objects.link(thing)
    hidden[name] = thing
hidden["hidden"].hide_set(True)
hidden["unrendered"].hide_render = True
"""


def save_blends(scripts: dict[Path, str], more: str = "") -> None:
    """In one process: it takes seconds to load Blender.  more: to run at the end."""
    lines = ["import bpy"]
    for path, script in scripts.items():
        lines.append("bpy.ops.wm.read_factory_settings(use_empty=True)")
        lines.append(script)
        lines.append(f"bpy.ops.wm.save_as_mainfile(filepath={str(path)!r})")
    command = [sys.executable, "-c", "\n".join([*lines, more])]
    subprocess.run(command, check=True, capture_output=True)


def test_fbx_and_usd_come_in_by_blender(tmp_path: Path) -> None:
    exports = [
        f"bpy.ops.export_scene.fbx(filepath={str(tmp_path / 'box.fbx')!r})",
        *(
            f"bpy.ops.wm.usd_export(filepath={str(tmp_path / f'box.{suffix}')!r})"
            for suffix in ("usda", "usdc", "usdz")
        ),
    ]
    script = """
bpy.ops.mesh.primitive_cube_add(size=1)
thing = bpy.context.object
thing.name = "box"
thing.scale = (1, 2, 3)
red = bpy.data.materials.new("red")
red.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.1, 0.1, 1)
thing.data.materials.append(red)
"""
    save_blends({tmp_path / "box.blend": script}, "\n".join(exports))
    for suffix in ("blend", "fbx", "usda", "usdc", "usdz"):
        (mesh,) = parts_of(tmp_path / f"box.{suffix}").values()
        assert np.ptp(mesh.vertices, axis=0) == pytest.approx([1, 2, 3], abs=1e-4), suffix
        assert mesh.colours[0] == pytest.approx([0.8, 0.1, 0.1], abs=1e-3), suffix
    (tmp_path / "bad.fbx").write_bytes(b"Kaydara FBX Binary  \0")
    with pytest.raises(FactoryError, match=r"no \.fbx file that Blender opens"):
        parts_of(tmp_path / "bad.fbx")


@pytest.mark.slow
def test_output_settings_of_a_blend_do_not_matter(tmp_path: Path) -> None:
    path = tmp_path / "world.blend"
    save_blends({path: OUTPUT})
    assert list(parts_of(path)) == ["valve"]
    (tmp_path / "poses.txt").write_text(FORWARD)
    config = compose_config(
        ["scenes=mesh", f"scenes.file={path}", f"scenes.poses={tmp_path}/poses.txt",
         "scenes.width=96", "scenes.height=64"]
    )  # fmt: skip
    reader = open_reader(config.scenes)
    frame = reader.load(reader.discover().frames[0])
    assert frame.rgb.shape == (64, 96, 3)
    is_valve = frame.depth_m > 0
    assert 0.02 < is_valve.mean() < 0.5
    assert frame.rgb[is_valve].mean() > frame.rgb[~is_valve].mean() + 20, "in the same pixels"


def test_files_that_a_blend_names_lie_beside_it(tmp_path: Path) -> None:
    (tmp_path / "inside").mkdir()
    write_image(tmp_path / "inside/own.png")
    write_image(tmp_path / "outside.png")
    image = "bpy.data.images.load({!r}).use_fake_user = True\n"
    path = tmp_path / "inside/world.blend"
    other = tmp_path / "inside/other.blend"
    save_blends(
        {
            path: image.format(str(tmp_path / "inside/own.png")),
            other: image.format(str(tmp_path / "outside.png")),
        }
    )
    assert files_of(path, "k") == (str(path), str(tmp_path / "inside/own.png"))
    with pytest.raises(FactoryError, match=r"outside\.png"):
        files_of(other, "k")


# --- poses

HEADERS = {
    "#timestamp [ns],p_x,p_y,p_z,q_w,q_x,q_y,q_z": "1000000000,1,2,3,0.9,0.1,0.2,0.3",
    "# timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], "
    "q_RS_z [], v_RS_R_x [m s^-1], b_w_RS_S_x [rad s^-1]": "1,1,2,3,0.9,0.1,0.2,0.3,7,7",
    "qx qy qz qw x y z time": "0.1 0.2 0.3 0.9 1 2 3 1",
    "time_ms tx [mm] ty [mm] tz [mm] qx qy qz qw": "1000 1000 2000 3000 0.1 0.2 0.3 0.9",
    "# a camera; x right, y down, z forward": "1 1 2 3 0.1 0.2 0.3 0.9",
}


@pytest.mark.parametrize("header", HEADERS)
def test_the_header_decides_order_and_unit(tmp_path: Path, header: str) -> None:
    (tmp_path / "plain.txt").write_text("1 1 2 3 0.1 0.2 0.3 0.9\n")
    (tmp_path / "poses.csv").write_text(f"# dive 3\n{header}\n{HEADERS[header]}\n")
    times, poses = trajectory(tmp_path / "poses.csv")
    expected = trajectory(tmp_path / "plain.txt")
    assert times == pytest.approx([1.0])
    assert poses == pytest.approx(expected[1])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("# nothing\n", "no poses in it"),
        ("1403636579763555584 1 2 3 0 0 0 1\n", r"no time in seconds; .*\[ns\]"),
        ("time x y z roll pitch yaw speed\n1 1 2 3 0 0 0 1\n", "qx, qy, qz, qw missing"),
        ("# t [h] x y z qx qy qz qw\n1 1 2 3 0 0 0 1\n", "unit 'h' is none of"),
    ],
)
def test_poses_that_cannot_be_meant_are_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(FactoryError, match=said):
        trajectory(tmp_path / "poses.txt")
