"""Meshes of the user's: on the seabed, as whole worlds, and what is wrong with them."""

from __future__ import annotations

import importlib
import json
import struct
import subprocess
import sys
from pathlib import Path
from typing import Any

import cv2
import h5py
import numpy as np
import pytest

from simnfnd.command import main
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.dataset.schema import config_hash
from simnfnd.factory.dataset.validate import validate
from simnfnd.factory.production.export import export
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.identity import identity
from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping, plain
from simnfnd.factory.simulation.imaging.settings import CoherentSettings
from simnfnd.factory.simulation.meshes.camera import oriented
from simnfnd.factory.simulation.meshes.mesh_parts import read_model
from simnfnd.factory.simulation.meshes.triangle_mesh import box, sphere
from simnfnd.factory.simulation.pairs.pair_maker import observe
from simnfnd.factory.simulation.render import open_renderer
from simnfnd.factory.simulation.render.base import RenderSettings
from simnfnd.factory.simulation.render.pack import write_pack
from simnfnd.factory.simulation.render.view import decode, encode, view_of
from simnfnd.factory.simulation.scenes import open_reader

open3d: Any = importlib.import_module("open3d")  # its stubs fit no call
SMALL = ("scenes.width=242", "scenes.height=152", "render=analytic")
FORWARD = "0 0 0 1 -0.7071068 0 0 0.7071068\n"  # a level camera that looks along y


def write_mesh(path: Path, solid, flip: bool = False) -> Path:
    triangle_mesh = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(solid.vertices.astype(float)),
        open3d.utility.Vector3iVector(solid.triangles[:, ::-1] if flip else solid.triangles),
    )
    triangle_mesh.vertex_colors = open3d.utility.Vector3dVector(solid.colours.astype(float))
    assert open3d.io.write_triangle_mesh(str(path), triangle_mesh)
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """cube.ply, ball.ply, world.glb (ground and two named things) and poses.txt."""
    root = tmp_path_factory.mktemp("worlds")
    write_mesh(root / "cube.ply", box((0.6, 0.4, 0.5)))
    write_mesh(root / "ball.ply", sphere(4))
    ground = box((30, 30, 0.2), (0, 10, -0.1))
    parts = {"ground": ground, "valve.1": box((0.6, 0.4, 0.5), (0.3, 4, 0.25)),
             "post": box((0.2, 0.2, 2), (-1.2, 5, 1))}  # fmt: skip
    write_glb(root / "world.glb", parts)
    (root / "poses.txt").write_text(FORWARD + "1,0.3,0,0.9,-0.7071068,0,0,0.7071068\n")
    return root


def write_glb(path: Path, parts: dict) -> None:
    """With a buffer of its own, y up, each part as a node that is moved up by one."""
    content = b""
    views = []
    accessors = []
    meshes = []
    nodes = []
    for number, (name, solid) in enumerate(parts.items()):
        x, y, z = solid.vertices.T
        points = np.stack([x, z - 1, -y], axis=-1).astype("<f4")
        corners = solid.triangles.astype("<u4").ravel()
        for values, kind, shape in ((points, 5126, "VEC3"), (corners, 5125, "SCALAR")):
            views.append({"buffer": 0, "byteOffset": len(content), "byteLength": values.nbytes})
            accessors.append({"bufferView": len(views) - 1, "componentType": kind,
                              "count": len(values), "type": shape})  # fmt: skip
            content += values.tobytes()
        solid = {"attributes": {"POSITION": 2 * number}, "indices": 2 * number + 1}
        meshes.append({"primitives": [solid]})
        nodes.append({"name": name, "mesh": number, "translation": [0, 1, 0]})
    document = {"asset": {"version": "2.0"}, "buffers": [{"byteLength": len(content)}],
                "bufferViews": views, "accessors": accessors, "meshes": meshes,
                "nodes": nodes}  # fmt: skip
    write_chunks(path, document, content)


def write_chunks(path: Path, document: dict, content: bytes) -> None:
    head = json.dumps(document).encode()
    head += b" " * (-len(head) % 4)
    chunks = struct.pack("<I4s", len(head), b"JSON") + head
    chunks += struct.pack("<I4s", len(content), b"BIN\0") + content
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def world(folder: Path, *words: str) -> FactoryConfig:
    return compose_config(
        [
            *("scenes=mesh", f"scenes.file={folder}/world.glb", *SMALL),
            "scenes.classes=[{class: target, parts: 'valve*', reflectivity_db: -12}]",
            *(f"scenes.poses={folder}/poses.txt", *words),
        ]
    )


def frames(config: FactoryConfig) -> list[Any]:
    reader = open_reader(config.scenes)
    return list(map(reader.load, reader.discover().frames))


def own(folder: Path, entry: str, *words: str) -> FactoryConfig:
    return compose_config([f"scenes.own_objects=[{{file: {folder}/{entry}}}]", *SMALL, *words])


@pytest.mark.slow
def test_own_objects_lie_in_every_place_and_leave_the_rest_as_it_was(folder: Path) -> None:
    own_object = "cube.ply, class: crate, per_place: [2, 3], reflectivity_db: -7"
    words = "scenes.locations=2", "scenes.frames_per_location=4"
    config = own(folder, own_object, *words, "scenes.boxes=true", "experiment=physical")
    assert isinstance(config.acoustics, CoherentSettings)
    assert config.acoustics.reflectivity_db["crate"] == -7
    assert from_mapping(plain(config)) == config
    without = compose_config([*SMALL, *words])
    observed = 0
    for frame, bare in zip(frames(config), frames(without), strict=True):
        assert frame.segmentation is not None
        assert frame.boxes is not None
        crates = frame.segmentation == 21
        observed += crates.sum() > 20
        sizes = frame.boxes[frame.boxes[:, 1] == 21, 5:8]  # upright for a camera that looks down
        assert ((sizes > 0.38) & (sizes < 0.9)).all()
        if np.array_equal(frame.world_from_camera, bare.world_from_camera) and not crates.any():
            assert np.array_equal(frame.segmentation, bare.segmentation)
    assert observed >= 2
    assert "classes" not in identity(without)
    assert "own_objects" not in identity(without)["scenes"]
    assert identity(config)["classes"] == ["crate"]


def test_a_world_is_what_rays_meet(folder: Path) -> None:
    first, second = frames(world(folder))
    parts = read_model(folder / "world.glb", "scenes.file", 1, 100, "stated").parts
    assert [part.name for part in parts] == ["ground", "valve.1", "post"]
    scene = open3d.t.geometry.RaycastingScene()
    for part in parts:
        scene.add_triangles(part.mesh.vertices, part.mesh.triangles.astype(np.uint32))
    lens = first.intrinsics
    camera = np.array([[lens.fx, 0, lens.cx], [0, lens.fy, lens.cy], [0, 0, 1]])
    camera_from_world = np.linalg.inv(first.world_from_camera)
    # Open3D's rays go through the corners of pixels.
    camera[:2, 2] += 0.5
    rays = scene.create_rays_pinhole(
        open3d.core.Tensor(camera), open3d.core.Tensor(camera_from_world), 242, 152
    )
    hit = scene.cast_rays(rays)
    depth_m = hit["t_hit"].numpy()
    which = hit["geometry_ids"].numpy()
    met = np.isfinite(depth_m)
    assert np.mean((first.depth_m > 0) == met) > 0.999
    both = met & (first.depth_m > 0)
    same = np.abs(first.depth_m - depth_m)[both] < 1e-3 * depth_m[both]
    assert same.mean() > 0.995
    assert np.mean((first.segmentation == 21) == (which == 1)) > 0.999
    assert first.time_s == 0
    assert (first.altitude_m, second.altitude_m) == pytest.approx((1, 0.9), abs=1e-4)
    with pytest.raises(FactoryError, match=r"pump.*ground, post"):
        frames(world(folder, "scenes.classes=[{class: a, parts: pump}]"))


@pytest.mark.parametrize("route", ["orbit", "transect"])
def test_drawn_paths_go_round_and_across(folder: Path, route: str) -> None:
    config = world(folder, "scenes.poses=null", f"scenes.route={route}", "scenes.paths=2",
                   "scenes.views_per_path=4")  # fmt: skip
    actual = frames(config)
    assert len(actual) == 8
    eyes = np.array([frame.world_from_camera[:3, 3] for frame in actual])
    apart = np.linalg.norm(np.diff(eyes[:4], axis=0), axis=1)
    assert apart == pytest.approx(0.5, rel=0.02)
    assert all(0.29 <= frame.altitude_m <= 2.6 for frame in actual if frame.altitude_m)
    if route == "orbit":
        assert all((frame.segmentation == 21).any() for frame in actual)
    again = frames(config)[-1]
    assert np.array_equal(again.depth_m, actual[-1].depth_m)


def test_a_box_holds_its_object() -> None:
    points = box((0.6, 0.4, 0.5), (0.3, 4, 0.25)).vertices.astype(float) @ np.array(
        [[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1]]
    )
    *centre, length, width, height, yaw = oriented(points)
    c = np.cos(yaw)
    s = np.sin(yaw)
    local = (points - centre) @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    assert np.abs(local).max(axis=0) == pytest.approx([length / 2, width / 2, height / 2], abs=1e-3)
    assert (length, width, height) == pytest.approx((0.6, 0.4, 0.5), abs=1e-3)


@pytest.mark.slow
def test_labels_boxes_and_exports_agree(folder: Path, tmp_path: Path) -> None:
    """COCO's box is that of the projected mesh; names go through to every format."""
    out = tmp_path / "set"
    words = [
        *("scenes=mesh", f"scenes.file={folder}/world.glb", "scenes.width=484"),
        *("scenes.height=304", "render=analytic", f"scenes.poses={folder}/poses.txt"),
        *("scenes.classes=[{class: target, parts: 'valve*'}]", "experiment=physical"),
        *(
            "sonar.image.layout=polar",
            "sonar.range.auto=true",
            "sonar.range.max_m=6",
            "split.test_fraction=0",
        ),
        *("dataset.layers=[segmentation]", "dataset.columns=[boxes]", "scheduler=serial"),
        *("dataset.preview_pairs=0", f"cache.dir={tmp_path}/cache"),
    ]
    assert main(["make", *words, f"dataset.dir={out}"]) == 0
    (out / "status.0of2.json").write_text("{}")  # of a slice
    assert validate(out, deep=True).findings == ()
    export(out, "coco", tmp_path / "coco")
    document = json.loads((tmp_path / "coco/annotations/instances_train.json").read_text())
    assert document["categories"][-1] == {"id": 1, "name": "target", "supercategory": "object"}
    config = compose_config(words)
    with h5py.File(out / "train/shard-00000.h5") as shard:
        assert list(shard["segmentation"].attrs["classes"])[21:] == ["target"]
        for number, frame in enumerate(frames(config)):
            row = shard["meta"][number]
            (entry,) = json.loads(row["boxes"])
            assert entry["class"] == "target"
            assert entry["insonified"] > 0.9
            assert entry["shadowed"] < 0.05
            # The mesh's pixels, projected by hand, and the bins that they fall into.
            lens = frame.intrinsics
            rows, columns = np.nonzero(frame.segmentation == 21)
            z = frame.depth_m[rows, columns].astype(float)
            right = (columns - lens.cx) / lens.fx * z
            down = (rows - lens.cy) / lens.fy * z
            range_m = np.sqrt(right**2 + down**2 + z**2)
            bearing = np.arcsin(right / range_m)
            spans = [
                np.array([coordinate.min(), coordinate.max()]) for coordinate in (range_m, bearing)
            ]
            near = row["range_min_m"]
            far = row["range_max_m"]
            centres = config.sonar.beam_centres_rad()
            beams = np.searchsorted((centres[1:] + centres[:-1]) / 2, spans[1])
            bins = np.floor((spans[0] - near) / (far - near) * config.sonar.range_bins)
            actual = [a["bbox"] for a in document["annotations"] if a["image_id"] == number + 1]
            ((left, top, width, height),) = actual
            theirs = (beams[0], beams[1] + 1, bins[0], bins[1] + 1)
            assert overlap((left, left + width, top, top + height), theirs) >= 0.9
            assert entry["range_m"] == pytest.approx(spans[0], abs=0.02)
            assert entry["bearing_deg"] == pytest.approx(np.rad2deg(spans[1]), abs=0.3)
    export(out, "yolo", tmp_path / "yolo")
    assert "0: target" in (tmp_path / "yolo/data.yaml").read_text()
    export(out, "huggingface", tmp_path / "hub")
    import datasets

    loaded = datasets.load_dataset(str(tmp_path / "hub"), cache_dir=str(tmp_path / "hf"))["train"]
    assert loaded.features["objects"]["category"].feature.names == ["target"]
    assert loaded[0]["objects"]["category"][0] == 0


def overlap(a: tuple, b: tuple) -> float:
    """Intersection over union of (left, right, top, bottom)."""
    inner = [max(a[0], b[0]), min(a[1], b[1]), max(a[2], b[2]), min(a[3], b[3])]
    common = max(inner[1] - inner[0], 0) * max(inner[3] - inner[2], 0)
    areas = [(x[1] - x[0]) * (x[3] - x[2]) for x in (a, b)]
    return float(common / (sum(areas) - common))


@pytest.mark.parametrize("exponent", [1.0, 3.0])
@pytest.mark.parametrize("shape", ["sphere", "plate"])
def test_target_strengths_are_those_of_theory(tmp_path: Path, shape: str, exponent: float) -> None:
    """A rough sphere's is 2 pi a^2 mu / (n + 1), a plate's mu A, 1 / r^4 away.

    With Lambert's n = 2 and mu = 3 / 8 pi that sphere's is the a^2 / 4 of a large rigid one (Urick
    1983, table 9.1).
    """
    far_m = 8.0
    radius = 0.25
    mu = 3 / (8 * np.pi)
    if shape == "sphere":
        solid = sphere(5).moved(scale=radius, offset=(0, far_m + radius, 0))
        sigma = 2 * np.pi * radius**2 * mu / (exponent + 1)
    else:
        solid = box((0.5, 0.02, 0.4), (0, far_m + 0.01, 0))
        sigma = mu * 0.5 * 0.4
    write_mesh(tmp_path / "target.ply", solid)
    (tmp_path / "poses.txt").write_text(FORWARD.replace("0 0 0 1", "0 0 0 0", 1))
    # Reflectivity is for an albedo of 1; constant albedo is 0.5.
    level_db = 10 * np.log10(2 * mu)
    (tmp_path / "materials.csv").write_text(
        f"class,reflectivity_db,lambert_exponent\ntarget,{level_db},{exponent}\n"
    )
    config = compose_config(
        [
            *("scenes=mesh", f"scenes.file={tmp_path}/target.ply", "render=analytic"),
            *(f"scenes.poses={tmp_path}/poses.txt", "experiment=physical", "sonar.vfov_deg=60"),
            *("render.albedo=constant", f"acoustics.materials={tmp_path}/materials.csv"),
            "scenes.classes=[{class: target, parts: '*'}]",
        ]
    )
    range_m = far_m + (radius * 0.25 if shape == "sphere" else 0)
    theory_db = 10 * np.log10(sigma) - 40 * np.log10(range_m)
    (frame,) = frames(config)
    rendered = open_renderer(config.render).render(frame, config.sonar.mount)
    scene: Any = observe(frame, rendered, config).scene
    seen_m = float(np.median(frame.depth_m[frame.valid]))
    loss_db = 2 * config.water.absorption_db_per_m(config.sonar.frequency_khz) * seen_m
    level_db = 10 * np.log10(scene.scatterers.power.sum()) + loss_db
    assert level_db == pytest.approx(theory_db, abs=0.5)


def test_materials_name_known_classes(folder: Path, tmp_path: Path) -> None:
    listed = tmp_path / "materials.csv"
    for line, said in (
        ("pump,-3,", "no class is called pump"),
        ("Tire,loud,2", r"materials.csv:2: expected class,reflectivity_db"),
    ):
        listed.write_text(f"class,reflectivity_db,lambert_exponent\n{line}\n")
        with pytest.raises(FactoryError, match=said):
            compose_config(["experiment=physical", f"acoustics.materials={listed}"])
    two = "cube.ply, class: a, reflectivity_db: -3}, {file: b.ply, class: a"
    with pytest.raises(FactoryError, match="a has two"):
        own(folder, two, "experiment=physical")


BAD = {
    "in millimetres": ("big.ply", r"600 m long at scale 1, in millimetres\? set .* 0\.001"),
    "tiny": ("small.ply", r"0.0006 m long .* set scenes.own_objects.0.scale"),
    "no faces": ("points.ply", "has no faces"),
    "many faces": ("many.ply", "claims 1,000,000,000 faces, holds 1"),
    "damaged": ("broken.glb", "damaged, or no .glb file"),
    "NaN": ("nan.ply", "vertices that are no numbers"),
    "unknown kind": ("notes.txt", "no mesh; give one of .glb"),
    "absent": ("absent.stl", "cannot be read"),
    "no texture": ("painted.obj", "its rust.png is missing; put it beside"),
    "a texture elsewhere": ("absolute.obj", "names /etc/passwd, which is not in the mesh's own"),
    "materials elsewhere": ("above.obj", r"names .*\.\./a.mtl, which is not in the mesh's own"),
    "a buffer elsewhere": ("linked.glb", "names other files; export with everything in one .glb"),
    "a buffer by URL": ("url.gltf", "names .*, which is not in the mesh's own|is missing"),
}


@pytest.fixture(scope="module")
def bad(folder: Path) -> Path:
    cube = box((0.6, 0.4, 0.5))
    write_mesh(folder / "big.ply", cube.moved(scale=1000))
    write_mesh(folder / "small.ply", cube.moved(scale=0.001))
    head = "ply\nformat ascii 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty "
    head += "float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n"
    (folder / "points.ply").write_text(head.format(2, 0) + "0 0 0\n1 1 1\n")
    (folder / "many.ply").write_text(head.format(3, 10**9) + "0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n")
    (folder / "nan.ply").write_text(head.format(3, 1) + "0 0 0\n1 0 0\n0 nan 0\n3 0 1 2\n")
    (folder / "broken.glb").write_bytes(b"glTF\2\0\0\0 nothing more")
    (folder / "notes.txt").write_text("no mesh")
    for name, library, image in (
        ("painted", "painted.mtl", "map_Kd rust.png"),
        ("absolute", "absolute.mtl", "map_Bump /etc/passwd"),
        ("above", "../a.mtl", ""),
    ):
        faces = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"
        (folder / f"{name}.obj").write_text(f"mtllib {library}\n{faces}")
        (folder / f"{name}.mtl").write_text(f"newmtl a\n{image}\n")
    url = {"buffers": [{"uri": "file:///etc/passwd", "byteLength": 9}]}
    (folder / "url.gltf").write_text(json.dumps(url))
    write_chunks(folder / "linked.glb", {"buffers": [{"uri": "../a.bin", "byteLength": 9}]}, b"")
    return folder


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_one_line(bad: Path, case: str) -> None:
    name, expected = BAD[case]
    with pytest.raises(FactoryError, match=expected) as raised:
        open_reader(own(bad, f"{name}, class: a").scenes).discover()
    text = str(raised.value)
    assert "\n" not in text
    assert text.startswith("scenes.own_objects.0.file=")
    assert name in text


def test_inside_out_is_turned_and_textures_are_colours(folder: Path) -> None:
    write_mesh(folder / "inside.ply", sphere(2), flip=True)
    (right,) = read_model(folder / "ball.ply", "key.file", 1, 10, "stated").parts
    (turned,) = read_model(folder / "inside.ply", "key.file", 1, 10, "stated").parts
    actual = open_reader(own(folder, "inside.ply, class: ball").scenes).discover()
    assert actual.notes == ("inside.ply: inside out, turned: inside",)
    assert not open_reader(own(folder, "ball.ply, class: ball").scenes).discover().notes
    for part in (right, turned):
        a, b, c = (part.mesh.vertices[part.mesh.triangles[:, k]] for k in range(3))
        assert ((np.cross(b - a, c - a) * a).sum(axis=1) > 0).all()
    image = np.zeros((8, 8, 3), np.uint8)
    image[:, 4:] = (0, 0, 255)  # the right half is red
    cv2.imwrite(str(folder / "half.png"), image)
    (folder / "sheet.mtl").write_text("newmtl a\nmap_Kd half.png\n")
    (folder / "sheet.obj").write_text(
        "mtllib sheet.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
        "usemtl a\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
    )
    (sheet,) = read_model(folder / "sheet.obj", "key.file", 1, 10, "stated").parts
    x = sheet.mesh.vertices[:, 0]
    red = sheet.mesh.colours[:, 0]
    assert (red[x > 0.55] > 0.9).all()
    assert (red[x < 0.45] < 0.1).all()


def test_scripts_of_a_blend_are_never_run(tmp_path: Path) -> None:
    """It is read for its meshes and colours, and rendered by Cycles."""
    world = tmp_path / "world.blend"
    marker = tmp_path / "ran"
    script = f"""
import bpy
bpy.ops.wm.read_factory_settings(use_empty=True)
bpy.ops.mesh.primitive_cube_add(size=1, location=(0, 4, 0))
cube = bpy.context.object
cube.name = "valve"
material = bpy.data.materials.new("red")
material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (.8, 0, 0, 1)
cube.data.materials.append(material)
text = bpy.data.texts.new("autorun.py")
text.write("open({str(marker)!r}, 'w')")
text.use_module = True
cube.driver_add("location", 0).driver.expression = "[0, open({str(marker)!r}, 'w')][0]"
bpy.ops.wm.save_as_mainfile(filepath={str(world)!r})
"""
    subprocess.run([sys.executable, "-c", script], check=True, capture_output=True)
    marker.unlink(missing_ok=True)  # Blender drives while it makes the file
    (tmp_path / "poses.txt").write_text(FORWARD)
    config = compose_config(
        [
            *("scenes=mesh", f"scenes.file={world}", f"scenes.poses={tmp_path}/poses.txt"),
            *("scenes.width=96", "scenes.height=64", "render=analytic"),
            "scenes.classes=[{class: valve, parts: valve}]",
        ]
    )
    (frame,) = frames(config)
    assert not marker.exists()
    on = frame.segmentation == 21
    assert on.any()
    red, green, _ = frame.rgb[on].astype(float).T
    assert np.median(red) > 60
    assert np.median(green) < 0.5 * np.median(red)


def test_renders_and_packs_keep_boxes_and_classes(folder: Path, tmp_path: Path) -> None:
    config = world(folder, "scenes.boxes=true")
    reader = open_reader(config.scenes)
    ref = reader.discover().frames[0]
    frame = reader.load(ref)
    mount = config.sonar.mount
    view = view_of(frame, open_renderer(config.render).render(frame, mount), mount)
    again = decode(encode(view)).unnamed_frame
    assert again.boxes is not None
    assert np.array_equal(again.boxes, np.round(np.asarray(frame.boxes), 5))
    classes = config.scenes.own_classes()
    write_pack(
        tmp_path / "a.pack", [ref], lambda _: view, mount, RenderSettings("analytic"), classes
    )
    packed = compose_config(["scenes=pack", f"scenes.root={tmp_path}/a.pack"])
    assert packed.scenes.own_classes() == ("target",)
    assert identity(packed)["classes"] == ["target"]


def test_every_file_of_a_mesh_counts(folder: Path, tmp_path: Path) -> None:
    """Of a .gltf its buffer, of an .obj its materials: alone in a world, and as an object."""
    points = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4")
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], "<u2")
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": "a.bin", "byteLength": points.nbytes + faces.nbytes}],
        "meshes": [{"primitives": []}],
    }
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    (tmp_path / "a.obj").write_text("mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")

    def hashes() -> list[str]:
        actual = []
        for name in ("a.gltf", "a.obj"):
            file = str(tmp_path / name)
            scenes = [
                {"kind": "mesh", "file": file},
                {"kind": "seabed", "own_objects": [{"file": file, "class": "thing"}]},
            ]
            actual += [
                config_hash(identity(from_mapping({"scenes": scene_settings})))
                for scene_settings in scenes
            ]
        return actual

    (tmp_path / "a.bin").write_bytes(points.tobytes() + faces.tobytes())
    (tmp_path / "a.mtl").write_text("newmtl grey\nKd 0.5 0.5 0.5\n")
    first = hashes()
    assert hashes() == first
    (tmp_path / "a.bin").write_bytes((2 * points).tobytes() + faces.tobytes())
    (tmp_path / "a.mtl").write_text("newmtl grey\nKd 0.1 0.1 0.1\n")
    assert not set(first) & set(hashes())
