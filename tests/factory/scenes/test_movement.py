"""Recordings of a moving platform: the file of its path, poses, frames."""

import numpy as np
import pytest

from simnfnd.factory.config import from_mapping, identity
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.scenes import open_reader
from simnfnd.factory.scenes.seabed.camera import Movement, movements, pose

PATH = "time_s,surge_m,heave_m,yaw_deg\n0,0,0,0\n0.2,0.5,0.1,10\n"


def written(folder, text):
    path = folder / "path.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_path_is_read(tmp_path):
    found = movements(written(tmp_path, PATH))
    assert found == (Movement(0.0), Movement(0.2, surge_m=0.5, heave_m=0.1, yaw_deg=10.0))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "expected a header"),
        ("surge,yaw\n0,0\n", "expected a header"),
        ("surge_m,surge_m\n0,0\n", "expected a header"),
        ("surge_m\n", "0 lines"),
        ("surge_m,yaw_deg\n0,0\n1\n", "path.csv:3: expected 2 numbers"),
        ("surge_m\nnan\n", "path.csv:2"),
        ("surge_m\nx\n", "path.csv:2"),
    ],
)
def test_bad_files_are_one_line(tmp_path, text, says):
    with pytest.raises(FactoryError, match=says):
        movements(written(tmp_path, text))


def test_movements_are_along_the_first_heading():
    start = pose(np.array([1.0, 2.0, 3.0]), 90, 20, 0)  # looks along +y, 20 degrees down
    eye, rotation = Movement(surge_m=1, sway_m=2, heave_m=0.5).moved(start.eye, start.rotation)
    assert eye == pytest.approx([-1, 3, 3.5])
    assert rotation == pytest.approx(start.rotation)
    turn = Movement(yaw_deg=30, pitch_deg=5, roll_deg=3)
    _, rotation = turn.moved(start.eye, start.rotation)
    assert rotation == pytest.approx(pose(start.eye, 120, 25, 3).rotation)


def test_frames_are_the_lines(tmp_path):
    path = written(tmp_path, PATH)
    config = from_mapping(
        {
            "scenes": {
                "kind": "seabed", "locations": 1, "path": str(path), "width": 96, "height": 64,
            }
        }
    )  # fmt: skip
    reader = open_reader(config.scenes)
    refs = reader.discover().frames
    assert [ref.frame for ref in refs] == ["0000", "0001"]
    first, second = (reader.load(ref) for ref in refs)
    assert (first.time_s, second.time_s) == (0.0, 0.2)
    assert first.altitude_m is not None
    assert first.altitude_m > 0.5
    there, here = first.world_from_camera, second.world_from_camera
    assert there is not None
    assert here is not None
    assert np.linalg.norm(here[:2, 3] - there[:2, 3]) == pytest.approx(0.5)
    assert here[2, 3] - there[2, 3] == pytest.approx(0.1)
    known = identity(config)["scenes"]["path"]
    path.write_text(PATH + "0.4,1,0,0\n", encoding="utf-8")
    assert identity(config)["scenes"]["path"] != known
    path.unlink()
    with pytest.raises(FactoryError, match="cannot be read"):
        identity(config)
