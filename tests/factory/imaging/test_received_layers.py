"""What was received, where from and by whom: optional layers and columns, read back by examples."""

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from simnfnd.factory import pairs
from simnfnd.factory.config import from_mapping
from simnfnd.factory.dataset.schema import Provenance
from simnfnd.factory.dataset.validate import shard_facts
from simnfnd.factory.dataset.writer import write_shard
from simnfnd.factory.errors import FactoryError, FrameError
from simnfnd.factory.pairs import PairMaker
from simnfnd.factory.render.base import Mount
from simnfnd.factory.render.view import view_of
from simnfnd.factory.render.views import OneView
from simnfnd.factory.sample_table import pose_row
from tests.frames import HEIGHT_M, PITCH_RAD, POST_M, ground_and_post, labelled, plain_render
from tests.project.run_example import run
from tests.project_files import ROOT

LAYERS = ["range", "azimuth", "elevation", "elevation_min", "elevation_max", "segmentation"]
RECEIVED = ["intensity_db", "field"]
OFF = ("range_spreading", "multipath", "azimuth", "range_arc", "background")
# A camera that looks along the world's x, 20 degrees down, from 1.5 m above the ground.
C, S = np.cos(PITCH_RAD), np.sin(PITCH_RAD)
POSE = np.array([[0, -S, C, 2], [-1, 0, 0, 5], [0, -C, -S, HEIGHT_M], [0, 0, 0, 1]], np.float64)
PLACE = {"world_from_camera": POSE, "time_s": 12.5, "altitude_m": HEIGHT_M}


def config(**dataset):
    noise = {name: {"enabled": False} for name in OFF} | {"speckle": {}, "receiver": {}}
    return from_mapping(
        {
            "scenes": {"kind": "seabed"},
            "sonar": {
                "image": {"layout": "polar"}, "vfov_deg": 60, "beams": 96, "range_bins": 160,
                "transfer": {"kind": "log", "dynamic_range_db": 120, "percentile": 50,
                             "reference": 0.5},
            },
            "acoustics": {"formation": "field"},
            "noise": noise,
            "dataset": dataset,
        }
    )  # fmt: skip


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """(folder of a dataset of one sample, its configuration, its pair)."""
    settings = config(layers=LAYERS + RECEIVED, columns=["pose", "calibration"], dtype="float32")
    frame = labelled(**PLACE)
    view = view_of(frame, plain_render(frame), settings.sonar.mount)
    maker = PairMaker(settings, OneView(view))
    (pair,) = maker.pairs(frame.ref, (0,))
    folder = tmp_path_factory.mktemp("received")
    write_shard(
        folder, "train/shard-00000.h5", [pair], maker.axes(), maker.columns(),
        Provenance({}, "0" * 16, "tests"), settings.dataset,
    )  # fmt: skip
    return folder, settings, pair


def test_layers_are_read_back(made):
    folder, _, pair = made
    path = folder / "train/shard-00000.h5"
    assert not shard_facts(path, deep=True).problems
    with h5py.File(path) as file:
        for name in [*LAYERS, *RECEIVED, "instance"]:
            np.testing.assert_array_equal(file[name][0], pair.layers[name])
        assert file["field"].dtype == np.complex64
        assert file["intensity_db"].attrs["units"] == "dB re 1 uPa"


def test_field_and_level_are_the_picture(made):
    _, settings, pair = made
    field, level_db = pair.layers["field"], pair.layers["intensity_db"]
    heard = np.isfinite(level_db)
    assert heard.mean() > 0.8
    np.testing.assert_allclose(20 * np.log10(abs(field[heard])), level_db[heard], atol=1e-3)
    # The same through the gain, the full scale and the curve is the noisy picture.
    near, far = pair.record["range_min_m"], pair.record["range_max_m"]
    range_m = near + (np.arange(160)[:, None] + 0.5) / 160 * (far - near)
    gain_db = pair.record["tvg_db_per_decade"] * np.log10(range_m)
    gain_db = gain_db + pair.record["tvg_db_per_m"] * range_m
    echo_db = level_db - pair.record["source_level_db"] + gain_db
    grey = 1 + (echo_db - 10 * np.log10(pair.record["full_scale"])) / 120
    np.testing.assert_allclose(np.clip(grey, 0, 1)[heard], pair.noisy[heard], atol=1e-4)
    assert settings.dataset.columns == ("pose", "calibration")


def test_elevations_of_a_bin_lie_around_that_of_its_strongest_echo(made):
    layers = made[2].layers
    known = np.isfinite(layers["elevation"])
    assert (layers["elevation_min"] <= layers["elevation"])[known].all()
    assert (layers["elevation"] <= layers["elevation_max"])[known].all()
    # Where the post stands a bin holds the ground before it, too, and the post's height.
    span = layers["elevation_max"] - layers["elevation_min"]
    assert np.nanmax(span) > np.deg2rad(5)
    assert np.nanmedian(span) < np.deg2rad(1)


def test_pose_of_the_sonar(made):
    row = made[2].record
    assert row["time_s"] == 12.5
    assert row["sonar.tilt_deg"] == pytest.approx(20)
    assert row["sonar.heading_deg"] == pytest.approx(0)
    assert row["sonar.altitude_m"] == pytest.approx(HEIGHT_M)
    assert [row[f"camera.{axis}_m"] for axis in "xyz"] == [2, 5, HEIGHT_M]
    mount = Mount(translation_m=(1.0, 0.5, 0.25), pitch_deg=10, yaw_deg=30)
    moved = pose_row(labelled(**PLACE), mount)
    assert moved["sonar.x_m"] == pytest.approx(2 + C + 0.25 * S)
    assert moved["sonar.y_m"] == pytest.approx(5.5)
    assert moved["sonar.heading_deg"] > 25
    unknown = pose_row(ground_and_post(), Mount())
    assert np.isnan(list(unknown.values())).all()


def shown(script, *words):
    done = run(script, *map(str, words), cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_example_of_a_point_cloud(made, tmp_path: Path):
    assert "1 objects" in shown("point_cloud.py", made[0], tmp_path / "cloud.ply")
    content = (tmp_path / "cloud.ply").read_bytes()
    head, body = content.split(b"end_header\n", 1)
    kinds = [(n, "<f4") for n in ("x", "y", "z", "strength")] + [("class", "u1"), ("i", "<u2")]
    points = np.frombuffer(body, kinds)
    assert f"element vertex {len(points)}".encode() in head
    post = points["i"] == 7
    # World axes: the ground is level at 0, the post stands upright straight ahead.
    assert np.median(abs(points["z"][~post])) < 0.02
    assert (abs(points["y"][post] - 5) < 0.3).all()
    assert points["x"][post].min() == pytest.approx(2 + POST_M * C, abs=0.5)


def test_example_of_boxes(made):
    assert "here/plain" not in (found := shown("boxes.py", made[0])).replace("plain/0001", "")
    assert "plain/0001: Pillar 7" in found


def test_example_of_a_complex_field(made):
    found = shown("complex_field.py", made[0])
    difference = float(found.split("at most ")[1].split()[0])
    assert difference < 1e-3
    one, two, four = (float(x.split()[-2]) for x in found.splitlines() if "looks:" in x)
    assert one > two > four


def test_what_is_not_there_is_refused():
    points = {"scenes": {"kind": "seabed"}}
    with pytest.raises(FactoryError, match="physical profile alone"):
        from_mapping(points | {"dataset": {"layers": ["intensity_db"]}})
    with pytest.raises(FactoryError, match="calibration is of the physical"):
        from_mapping(points | {"dataset": {"columns": ["calibration"]}})
    with pytest.raises(FactoryError, match="names one twice"):
        config(columns=["pose", "pose"])
    settings = config(layers=["field"])
    speckle = replace(
        settings.noise.speckle, looks=type(settings.noise.speckle.looks)("number", (3.0,))
    )
    many = replace(settings, noise=replace(settings.noise, speckle=speckle))
    frame = labelled(**PLACE)
    with pytest.raises(FrameError, match="one look"):
        pairs.make_pair(pairs.observe(frame, plain_render(frame), many), 0, many)
