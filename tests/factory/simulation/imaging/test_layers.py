"""The optional layers: what lies behind a pixel, and each noise effect alone."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy import ndimage

from simnfnd.factory.common.errors import FactoryError, FrameError
from simnfnd.factory.dataset.schema import Pair, Provenance, config_hash, layers
from simnfnd.factory.dataset.validate import shard_facts
from simnfnd.factory.dataset.writer import write_shard
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping
from simnfnd.factory.simulation.frames.frame import Frame
from simnfnd.factory.simulation.noise.draws import StreamNames, draw
from simnfnd.factory.simulation.pairs import pair_maker as pairs
from simnfnd.factory.simulation.pairs.pair_maker import PairMaker
from simnfnd.factory.simulation.pairs.requested_columns import pose_row
from simnfnd.factory.simulation.pairs.views import Views
from simnfnd.factory.simulation.render.base import Mount
from simnfnd.factory.simulation.render.view import view_of
from simnfnd.factory.simulation.sonar.fan import fan_table
from tests.frames import HEIGHT_M, PITCH_RAD, POST_M, ground_and_post, labelled, plain_render
from tests.project.run_example import run
from tests.project_files import ROOT

TRUTH = ["range", "elevation", "valid_azimuth", "segmentation"]
EFFECTS = ("range_spreading", "multipath", "azimuth", "range_arc", "background")


def config(**keys: Any) -> FactoryConfig:
    return from_mapping({"scenes": {"kind": "seabed"}, **keys})


def make_pair(settings: FactoryConfig, frame: Frame | None = None, variant: int = 0) -> Pair:
    frame = frame or labelled()
    scene = pairs.observe(frame, plain_render(frame), settings)
    return pairs.make_pair(scene, variant, settings)


def test_each_effect_layer_is_the_noisy_image_with_that_effect_alone() -> None:
    """As another configuration would make it, in which all others are off."""
    noise = {effect: {"enabled": True} for effect in EFFECTS} | {"range_arc": {"count": 2}}
    noise["range_arc"]["enabled"] = True
    together = make_pair(config(noise=noise, dataset={"layers": ["effects"]}))
    assert set(together.layers) == {f"layers/{effect}" for effect in EFFECTS}
    for effect in EFFECTS:
        off: dict[str, Any] = {
            effect_off: {"enabled": False} for effect_off in EFFECTS if effect_off != effect
        }
        alone = make_pair(config(noise={**off, effect: noise[effect]}))
        np.testing.assert_array_equal(together.layers[f"layers/{effect}"], alone.noisy)
        assert np.abs(alone.noisy.astype(int) - alone.clean.astype(int)).sum() > 500


def test_effects_that_are_off_have_no_layer_and_asking_changes_no_image() -> None:
    off = {"background": {"enabled": False}}
    with_layers = make_pair(config(noise=off, dataset={"layers": ["effects", *TRUTH]}))
    plain = make_pair(config(noise=off))
    assert "layers/background" not in with_layers.layers
    for name in ("noisy", "clean", "shadow"):
        np.testing.assert_array_equal(getattr(with_layers, name), getattr(plain, name))
    assert str(with_layers.record) == str(
        plain.record
    )  # text, because an effect that is off is NaN


def test_outside_of_the_fan_there_is_nothing_nor_where_the_camera_saw_nothing() -> None:
    wide = config(sonar={"hfov_deg": 120}, dataset={"layers": TRUTH})
    frame = labelled()
    scene = pairs.observe(frame, plain_render(frame), wide)
    inside = fan_table(wide.sonar, scene.window.near_fraction).inside
    pair = pairs.make_pair(scene, 0, wide)
    for name, image in pair.layers.items():
        values = np.asarray(image)[~inside]
        assert (np.isnan(values) if values.dtype.kind == "f" else values == 0).all(), name
        assert image.dtype == {layer.name: layer.dtype for layer in layers("uint8", [name])}[name]
    valid = np.asarray(pair.layers["valid_azimuth"], np.bool_)
    assert valid[inside].mean() == pytest.approx(46 / 120, abs=0.03)
    # Grey values are interpolated beside valid pixels, labels never.
    elsewhere = ~ndimage.binary_dilation(valid, iterations=3)
    assert not np.asarray(pair.noisy)[elsewhere].any()


# --- Both image formations under one contract: `simnfnd.factory.simulation.imaging.contract` ---


def config_of(formation: str) -> FactoryConfig:
    words = {"pointwise": [], "coherent": ["experiment=physical", "noise.background.enabled=true"]}
    return compose_config([*words[formation], "dataset.dtype=float32", "dataset.layers=[effects]"])


@pytest.mark.parametrize("formation", ["pointwise", "coherent"])
def test_samples_of_a_scene_repeat(formation: str) -> None:
    settings = config_of(formation)
    frame = ground_and_post()
    observed = pairs.observe(frame, plain_render(frame), settings)
    draws = draw(settings.noise, settings.seed, StreamNames.of(frame.ref, 0, has_pose=False))
    first, again = (observed.scene.sample(0, draws.effects) for _ in range(2))
    bins = (settings.sonar.range_bins, settings.sonar.beams)
    assert first.clean.shape == observed.scene.filled.shape == bins
    assert set(first.added) == set(draws.names) & set(POINTS_OFF)
    assert first.points > 0
    assert 0 < first.rate <= 1
    noisy = first.noisy(draws.names)
    np.testing.assert_array_equal(again.noisy(draws.names), noisy)
    np.testing.assert_array_equal(again.noisy(draws.names), noisy)  # nothing was used up
    assert noisy.dtype == first.clean.dtype == np.float32
    assert 0 <= noisy.min() <= noisy.max() <= 1


@pytest.mark.parametrize("formation", ["pointwise", "coherent"])
def test_noise_of_a_call_is_that_of_another_configuration(formation: str) -> None:
    settings = config_of(formation)
    frame = ground_and_post()
    views = Views({frame.ref: view_of(frame, plain_render(frame), settings.sonar.mount)})
    maker = pairs.PairMaker(settings, views)
    block = replace(settings.noise.background, enabled=False)
    quieter = replace(settings.noise, background=block)
    (quiet_pair,) = maker.pairs(frame.ref, (1,), quieter)
    (configured,) = pairs.PairMaker(replace(settings, noise=quieter), views).pairs(frame.ref, (1,))
    (usual,) = maker.pairs(frame.ref, (1,))
    np.testing.assert_array_equal(quiet_pair.noisy, configured.noisy)
    assert str(quiet_pair.record) == str(configured.record)
    assert set(usual.layers) - set(quiet_pair.layers) == {"layers/background"}
    assert set(quiet_pair.record) == {column.name for column in maker.columns()}


# --- What was received, where from and by whom, read back by examples ---

LAYERS = ["range", "azimuth", "elevation", "elevation_min", "elevation_max", "segmentation"]
RECEIVED = ["intensity_db", "field"]
POINTS_OFF = ("range_spreading", "multipath", "azimuth", "range_arc", "background")
# A camera that looks along the world's x, 20 degrees down, from 1.5 m above the ground.
C = np.cos(PITCH_RAD)
S = np.sin(PITCH_RAD)
POSE = np.array([[0, -S, C, 2], [-1, 0, 0, 5], [0, -C, -S, HEIGHT_M], [0, 0, 0, 1]], np.float64)
PLACE = {"world_from_camera": POSE, "time_s": 12.5, "altitude_m": HEIGHT_M}


def field_config(**dataset):
    noise = {name: {"enabled": False} for name in POINTS_OFF} | {"speckle": {}, "receiver": {}}
    return from_mapping(
        {
            "scenes": {"kind": "seabed"},
            "sonar": {
                "image": {"layout": "polar"}, "vfov_deg": 60, "beams": 96, "range_bins": 160,
                "transfer": {"kind": "log", "dynamic_range_db": 120, "percentile": 50,
                             "reference": 0.5},
            },
            "acoustics": {"formation": "coherent"},
            "noise": noise,
            "dataset": dataset,
        }
    )  # fmt: skip


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """(folder of a dataset of one sample, its configuration, its pair)."""
    settings = field_config(
        layers=LAYERS + RECEIVED, columns=["pose", "calibration"], dtype="float32"
    )
    frame = labelled(**PLACE)
    view = view_of(frame, plain_render(frame), settings.sonar.mount)
    maker = PairMaker(settings, Views({frame.ref: view}))
    (pair,) = maker.pairs(frame.ref, (0,))
    folder = tmp_path_factory.mktemp("received")
    write_shard(
        folder, "train/shard-00000.h5", [pair], maker.axes(), maker.columns(),
        Provenance({}, config_hash({}), "tests"), settings.dataset,
    )  # fmt: skip
    return folder, settings, pair


def test_layers_are_read_back(written):
    folder, _, pair = written
    path = folder / "train/shard-00000.h5"
    assert not shard_facts(path, deep=True)["problems"]
    with h5py.File(path) as file:
        for name in [*LAYERS, *RECEIVED, "instance"]:
            np.testing.assert_array_equal(file[name][0], pair.layers[name])
        assert file["field"].dtype == np.complex64
        assert file["intensity_db"].attrs["units"] == "dB re 1 uPa"


def test_field_and_level_are_the_image(written):
    _, settings, pair = written
    field = pair.layers["field"]
    level_db = pair.layers["intensity_db"]
    heard = np.isfinite(level_db)
    assert heard.mean() > 0.8
    np.testing.assert_allclose(20 * np.log10(abs(field[heard])), level_db[heard], atol=1e-3)
    # The same through the gain, the full scale and the curve is the noisy image.
    near = pair.record["range_min_m"]
    far = pair.record["range_max_m"]
    range_m = near + (np.arange(160)[:, None] + 0.5) / 160 * (far - near)
    gain_db = pair.record["tvg_db_per_decade"] * np.log10(range_m)
    gain_db = gain_db + pair.record["tvg_db_per_m"] * range_m
    echo_db = level_db - pair.record["source_level_db"] + gain_db
    grey = 1 + (echo_db - 10 * np.log10(pair.record["full_scale"])) / 120
    np.testing.assert_allclose(np.clip(grey, 0, 1)[heard], pair.noisy[heard], atol=1e-4)
    assert settings.dataset.columns == ("pose", "calibration")


def test_elevations_of_a_bin_lie_around_that_of_its_strongest_echo(written):
    layers = written[2].layers
    known = np.isfinite(layers["elevation"])
    near, far = (written[2].record[f"range_{end}_m"] for end in ("min", "max"))
    rows = (layers["range"] - near) / (far - near) * 160 - np.arange(160)[:, None]
    np.testing.assert_array_equal(np.isfinite(rows), known)
    assert known.mean() > 0.3
    assert ((rows > -0.01) & (rows < 1.01))[known].all()
    assert (layers["elevation_min"] <= layers["elevation"])[known].all()
    assert (layers["elevation"] <= layers["elevation_max"])[known].all()
    # Where the post stands a bin holds the ground before it, too, and the post's height.
    span = layers["elevation_max"] - layers["elevation_min"]
    assert np.nanmax(span) > np.deg2rad(5)
    assert np.nanmedian(span) < np.deg2rad(1)


def test_pose_of_the_sonar(written):
    row = written[2].record
    assert row["time_s"] == 12.5
    assert row["sonar.tilt_deg"] == pytest.approx(20)
    assert row["sonar.heading_deg"] == pytest.approx(0)
    assert row["sonar.altitude_m"] == pytest.approx(HEIGHT_M)
    assert [row[f"camera.{axis}_m"] for axis in "xyz"] == [2, 5, HEIGHT_M]
    mount = Mount(translation_m=(1.0, 0.5, 0.25), pitch_deg=10, yaw_deg=30)
    moved = pose_row(labelled(**PLACE), mount)
    assert moved["sonar.x_m"] == pytest.approx(2 + C + 0.25 * S)
    assert moved["sonar.y_m"] == pytest.approx(5.5)
    assert float(moved["sonar.heading_deg"]) > 25
    unknown = pose_row(ground_and_post(), Mount())
    assert np.isnan(list(unknown.values())).all()


def shown(script, *words):
    done = run(script, *map(str, words), cwd=ROOT)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_example_of_a_point_cloud(written, tmp_path: Path):
    assert "1 objects" in shown("point_cloud.py", written[0], tmp_path / "cloud.ply")
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


def test_example_of_boxes(written):
    assert "here/plain" not in (actual := shown("boxes.py", written[0])).replace("plain/0001", "")
    assert "plain/0001: Pillar 7" in actual


def test_example_of_a_complex_field(written):
    actual = shown("complex_field.py", written[0])
    difference = float(actual.split("at most ")[1].split()[0])
    assert difference < 1e-3
    one_look, two_looks, four_looks = (
        float(x.split()[-2]) for x in actual.splitlines() if "looks:" in x
    )
    assert one_look > two_looks > four_looks


def test_what_is_not_there_is_refused():
    points = {"kind": "seabed"}
    flsea = {"kind": "flsea", "root": "x"}
    for scenes, dataset, said in (
        (points, {"layers": ["intensity_db"]}, "dataset: intensity_db is of acoustics=coherent"),
        (points, {"columns": ["calibration"]}, "dataset: calibration is of acoustics=coherent"),
        (points, {"columns": ["pose", "pose"]}, "names one twice"),
        (flsea, {"layers": ["segmentation"]}, "labelled frames.*scenes=seabed"),
    ):
        with pytest.raises(FactoryError, match=said):
            from_mapping({"scenes": scenes, "dataset": dataset})
    with pytest.raises(FrameError, match=r"here/plain/0001: .*labels"):
        make_pair(config(dataset={"layers": ["segmentation"]}), ground_and_post())
    settings = field_config(layers=["field"])
    speckle = replace(
        settings.noise.speckle, looks=type(settings.noise.speckle.looks)("number", (3.0,))
    )
    many = replace(settings, noise=replace(settings.noise, speckle=speckle))
    frame = labelled(**PLACE)
    with pytest.raises(FrameError, match="one look"):
        pairs.make_pair(pairs.observe(frame, plain_render(frame), many), 0, many)
