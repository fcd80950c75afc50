"""Objects that move through a world of the user's: their places, ground, tracks and refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.renderer_choice import renderer_of
from simnfnd.factory.simulation.config.root import FactoryConfig
from simnfnd.factory.simulation.meshes.triangle_mesh import Mesh, box, join, sphere
from simnfnd.factory.simulation.pairs.pair_maker import PairMaker
from simnfnd.factory.simulation.pairs.views import Views
from simnfnd.factory.simulation.render import open_renderer
from simnfnd.factory.simulation.render.view import View, view_of
from simnfnd.factory.simulation.scenes import open_reader

SMALL = (
    "scenes=mesh", "sonar=didson_hf", "acoustics=coherent", "noise=none", "render=analytic",
    "sonar.image.width_px=192", "sonar.image.height_px=192", "scenes.width=242",
    "scenes.height=152", "sonar.range.auto=false", "sonar.range.min_m=1", "sonar.range.max_m=10",
    "dataset.layers=[static]", "dataset.columns=[pose,tracks]",
)  # fmt: skip
POSES = "10 2 3 1 -0.7071068 0 0 0.7071068\n10.5 2 3 1 -0.7071068 0 0 0.7071068\n"  # along y
PATH = "time_s,x_m,y_m,z_m,yaw_deg,pitch_deg,roll_deg\n0,4,0.2,-0.3,0,0,0\n1,4,-0.8,-0.3,0,0,0\n"


class MadeViews(Views):
    """Renders made when they are asked for."""

    def __init__(self, config: FactoryConfig) -> None:
        super().__init__({})
        self._config = config
        self._reader = open_reader(config.scenes)
        self._renderer = open_renderer(renderer_of(config).settings)

    def view(self, ref) -> View:
        """See `Views`."""
        mount = self._config.sonar.mount
        frame = self._reader.load(self._config.scenes.rendered_ref(ref))
        return view_of(frame, self._renderer.render(frame, mount), mount)


def write_obj(path: Path, solid: Mesh) -> Path:
    points = [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in solid.vertices.tolist()]
    faces = [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in solid.triangles.tolist()]
    path.write_text("\n".join([*points, *faces]) + "\n")
    return path


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A ground with a block on it, a ball, poses and a path."""
    root = tmp_path_factory.mktemp("worlds")
    ground = box((40, 40, 0.2), (0, 0, -0.1))
    write_obj(root / "world.obj", join([ground, box((4, 2, 3), (9, 6, 1.5))]))
    write_obj(root / "ball.obj", sphere(2).moved(scale=0.1))
    (root / "poses.txt").write_text(POSES)
    (root / "path.csv").write_text(PATH)
    return root


def world(folder: Path, *words: str) -> FactoryConfig:
    return compose_config([*SMALL, f"scenes.file={folder}/world.obj", "scenes.up=z", *words])


def moving_ball(folder: Path, **moving: Any) -> str:
    keys = ",".join(f"{key}: {value}" for key, value in moving.items())
    return f"scenes.own_objects=[{{file: {folder}/ball.obj, class: ball, moving: {{{keys}}}}}]"


def test_an_own_object_follows_its_path_from_the_first_pose(folder: Path) -> None:
    ball = moving_ball(folder, path=f"{folder}/path.csv", target_strength=-20)
    config = world(folder, f"scenes.poses={folder}/poses.txt", ball)
    maker = PairMaker(config, MadeViews(config))
    first, second = open_reader(config.scenes).discover().frames
    for ref, left_m, time_s in ((first, 0.2, 10.0), (second, -0.3, 10.5)):
        (pair,) = maker.pairs(ref, (0,))
        (track,) = json.loads(str(pair.record["tracks"]))
        assert track["position_m"] == pytest.approx([4, left_m, -0.3], abs=1e-3)
        assert track["range_m"] == pytest.approx(np.sqrt(16.09 + left_m**2) - 0.1, abs=0.05)
        assert pair.record["time_s"] == time_s
        left, top, width, height = track["box"]
        box_pixels = np.s_[top : top + height, left : left + width]
        assert pair.clean[box_pixels].max() > pair.layers["static"][box_pixels].max() + 20


def test_fish_swim_above_the_highest_thing_below_them(folder: Path) -> None:
    config = world(
        folder,
        *("scenes.frame_rate_hz=5", "scenes.speed_m_s=0", "scenes.paths=1"),
        "scenes.views_per_path=2",
        "scenes.moving_objects=[{moving: {speed_m_s: 0.5, school: {count: 3}}}]",
    )
    settings = config.scenes
    reader = open_reader(settings)
    refs = reader.discover().frames
    assert [settings.time_s(ref) for ref in refs] == [0, 0.2]
    assert {settings.rendered_ref(ref).frame for ref in refs} == {"0000"}
    around = reader.load(refs[0]).surroundings
    assert around is not None
    start_m = around.world_from_start[:3, 3]
    steps_m = (np.arange(len(around.ground_m)) - len(around.ground_m) // 2) * around.step_m
    x, y = np.meshgrid(start_m[0] + steps_m, start_m[1] + steps_m)
    is_block = (abs(x - 9) < 1.9) & (abs(y - 6) < 0.9)
    is_ground = (np.maximum(abs(x), abs(y)) < 19.8) & ((abs(x - 9) > 2.1) | (abs(y - 6) > 1.1))
    assert is_block.any()
    np.testing.assert_allclose(around.ground_m[is_block], 3, atol=0.01)
    np.testing.assert_allclose(around.ground_m[is_ground], 0, atol=0.01)

    maker = PairMaker(config, MadeViews(config))
    tracks = [json.loads(str(maker.pairs(ref, (0,))[0].record["tracks"])) for ref in refs]
    assert [[track["id"] for track in frame] for frame in tracks] == [[1, 2, 3]] * 2
    moved_m = np.subtract(tracks[1][0]["position_m"], tracks[0][0]["position_m"])
    assert np.linalg.norm(moved_m) == pytest.approx(0.1, abs=0.05)


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (("scenes.moving_objects=[{}]",), "frame_rate_hz"),
        (("scenes.speed_m_s=0",), "speed_m_s"),
        (("scenes.frame_rate_hz=5", "scenes.poses={folder}/poses.txt"), "frame_rate_hz"),
        (("scenes.own_objects=[{file: ball.obj, class: ball}]",), "own_objects"),
        (
            ("scenes.frame_rate_hz=5", "scenes.moving_objects=[{moving: {speed_m_s: 300}}]"),
            "moving_objects.0.moving.speed_m_s",
        ),
    ],
)
def test_refusals_name_the_key(folder: Path, words: tuple[str, ...], key: str) -> None:
    with pytest.raises(FactoryError, match=key) as refusal:
        world(
            folder, *(word.format(folder=folder) if "{folder}" in word else word for word in words)
        )
    assert "\n" not in str(refusal.value)
