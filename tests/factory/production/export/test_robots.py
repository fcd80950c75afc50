"""MCAP files that our own reader and rosbags read back, and point clouds that Open3D does."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd import PairDataset, make_dataset
from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.ros_types import SONAR, typestore
from simnfnd.factory.dataset.fan_geometry import FanGeometry
from simnfnd.factory.production.export import export
from simnfnd.factory.production.export.mcap import _timed
from simnfnd.factory.production.export.samples import ExportedSample
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.models.recordings.rosbag import RosBag

WORDS = (
    "render=analytic", "scenes.locations=2", "scenes.frames_per_location=2", "scenes.width=160",
    "scenes.height=100", "scheduler=serial", "dataset.preview_pairs=0", "dataset.columns=[pose]",
    "dataset.layers=[range,azimuth,elevation,segmentation]",
)  # fmt: skip
LAYOUTS = {
    "fan": ("experiment=demo",),
    "polar": ("experiment=demo", "sonar.image.layout=polar", "dataset.dtype=float32"),
}


@pytest.fixture(scope="module")
def datasets(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("robots")
    for layout, words in LAYOUTS.items():
        make_dataset(*words, *WORDS, out=root / layout)
    return {layout: root / layout for layout in LAYOUTS}


@pytest.mark.slow
@pytest.mark.parametrize("layout", LAYOUTS)
def test_pings_come_back_with_ranges_beams_and_times(
    datasets: dict[str, Path], layout: str, tmp_path: Path
) -> None:
    message = export(datasets[layout], "mcap", tmp_path / "out")
    assert message == "2 MCAP files, 4 pings"
    sonar = compose_config((*LAYOUTS[layout], *WORDS)).sonar
    layers = ("noisy", "clean", "range", "azimuth")
    with PairDataset(datasets[layout], "train", layers=layers, trusted=True) as pairs:
        samples = list(pairs)
        table = pairs.meta()
    file = tmp_path / "out/train/train.mcap"
    for layer in ("noisy", "clean"):
        bag = RosBag(file, [f"/sonar/{layer}"])
        frames = list(bag)
        bag.close()
        assert len(frames) == len(samples)
        times = [frame.time_s or 0.0 for frame in frames]
        assert times == sorted(set(times))
        for frame, sample, row in zip(frames, samples, table, strict=True):
            assert frame.beams is not None
            assert frame.samples.shape == (sonar.range_bins, sonar.beams)
            assert frame.samples.dtype == sample[layer].dtype
            np.testing.assert_allclose(
                frame.beams.azimuths_rad, sonar.beam_centres_rad(), atol=1e-6
            )
            near = frame.beams.range_min_m
            far = frame.beams.range_max_m
            np.testing.assert_allclose((near, far), (row["range_min_m"], row["range_max_m"]), 1e-4)
            assert frame.device.frequency_khz == pytest.approx(sonar.frequency_khz)
            if layout == "polar":
                np.testing.assert_array_equal(frame.samples, sample[layer])
            else:
                lies_where_the_pixels_do(frame.samples, sample, layer, sonar, row)


def lies_where_the_pixels_do(polar: Any, sample: Any, layer: str, sonar: Any, row: Any) -> None:
    """The echo of a bright pixel of the fan is at its range and bearing in the ping."""
    geometry = FanGeometry.from_record(sonar, row)
    image = sample[layer]
    shown = geometry.maps(0, 0, *image.shape)
    inside = (shown["sector"] > 0) & (np.abs(shown["azimuth_rad"]) < 0.9 * geometry.sector_rad / 2)
    places = np.argwhere(inside & (image > 0))[::501]
    for y, x in places:
        fraction = shown["range_fraction"][y, x]
        near = geometry.near_fraction
        step = float((fraction - near) / (1 - near) * sonar.range_bins - 0.5)
        bearing = shown["azimuth_rad"][y, x]
        beam = float(np.interp(bearing, sonar.beam_centres_rad(), np.arange(sonar.beams)))
        top = max(0, round(step) - 2)
        left = max(0, round(beam) - 2)
        assert image[y, x] in polar[top : top + 5, left : left + 5]


def test_poses_and_images_are_beside_the_pings(datasets: dict[str, Path], tmp_path: Path) -> None:
    from rosbags.rosbag2 import Reader

    export(datasets["fan"], "mcap", tmp_path / "out", split="train")
    store = typestore(2)
    with PairDataset(datasets["fan"], "train", trusted=True) as pairs:
        noisy = pairs[:]["noisy"]
        table = pairs.meta()
    poses = []
    images = []
    kinds = set()
    with Reader(tmp_path / "out/train") as reader:
        for connection, _, content in reader.messages():
            message: Any = store.deserialize_cdr(content, connection.msgtype)
            kinds.add(connection.msgtype)
            if connection.topic == "/sonar/pose":
                poses.append([getattr(message.pose.position, axis) for axis in "xyz"])
            if connection.topic == "/sonar/noisy/image":
                assert message.encoding == "mono8"
                images.append(message.data.reshape(message.height, message.width))
    assert SONAR in kinds
    np.testing.assert_allclose(poses, [[row[f"sonar.{a}_m"] for a in "xyz"] for row in table])
    np.testing.assert_array_equal(images, noisy)


def test_pings_follow_the_definitions_of_their_messages(
    datasets: dict[str, Path], tmp_path: Path
) -> None:
    """Sound speed, beam widths, and frames that are joined: pings, the sonar, the world."""
    from rosbags.rosbag2 import Reader

    export(datasets["fan"], "mcap", tmp_path / "out", split="train")
    store = typestore(2)
    messages: dict[str, list[Any]] = {}
    with Reader(tmp_path / "out/train") as reader:
        for connection, _, content in reader.messages():
            message = store.deserialize_cdr(content, connection.msgtype)
            messages.setdefault(connection.topic, []).append(message)
    config = compose_config((*LAYOUTS["fan"], *WORDS))
    info = messages["/sonar/noisy"][0].ping_info
    assert info.sound_speed == pytest.approx(config.water.sound_speed_m_s())
    assert info.tx_beamwidths == pytest.approx([np.deg2rad(config.sonar.vfov_deg)])
    assert len(info.rx_beamwidths) == config.sonar.beams
    spacing = np.diff(config.sonar.beam_centres_rad()).mean()
    assert info.rx_beamwidths[0] == pytest.approx(spacing, rel=1e-3)

    (static,) = messages["/tf_static"][0].transforms
    (moving,) = messages["/tf"][0].transforms
    assert moving.header.frame_id == "world"
    assert moving.child_frame_id == static.header.frame_id == "sonar"
    ping = messages["/sonar/noisy"][0]
    assert static.child_frame_id == ping.header.frame_id
    assert messages["/sonar/pose"][0].header.frame_id == "world"
    # Beams to the right of the device, whose y is to the left.
    turn = static.transform.rotation
    right = ping.beam_directions[-1]
    ahead_left_up = rotated((turn.x, turn.y, turn.z, turn.w), (right.x, right.y, right.z))
    bearing = config.sonar.beam_centres_rad()[-1]
    np.testing.assert_allclose(ahead_left_up, [np.cos(bearing), -np.sin(bearing), 0], atol=1e-9)
    assert "REP 103" in (tmp_path / "out/README.md").read_text()


def rotated(quaternion: tuple[float, ...], vector: tuple[float, ...]) -> Any:
    axis = np.array(quaternion[:3])
    twice = 2 * np.cross(axis, vector)
    return np.array(vector) + quaternion[3] * twice + np.cross(axis, twice)


def test_scenes_with_a_clock_keep_their_times() -> None:
    """Unless they overlap with the one before; others follow with a pause."""
    clock_s = 1.7e9

    def sample(scene: str, time_s: float) -> Any:
        record: dict[str, float | int | str] = {
            "location": "a",
            "scene": scene,
            "variant": 0,
            "time_s": time_s,
        }
        return ExportedSample("train", 0, {}, record)

    times = [("a", clock_s), ("a", clock_s + 2), ("b", clock_s + 1), ("c", clock_s + 60), ("d", 3)]
    stamps = [stamp for _, stamp in _timed(iter([sample(*time) for time in times]))]
    assert stamps == [clock_s, clock_s + 2, clock_s + 12, clock_s + 60, clock_s + 70]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_point_cloud_has_class_and_intensity(
    datasets: dict[str, Path], layout: str, tmp_path: Path
) -> None:
    open3d = pytest.importorskip("open3d")
    export(datasets[layout], "ply", tmp_path / "out")
    with PairDataset(datasets[layout], "train", layers=None, trusted=True) as pairs:
        sample = pairs[0]
    cloud = open3d.t.io.read_point_cloud(str(tmp_path / "out/train/000000.ply"))
    points = cloud.point["positions"].numpy()
    is_echo = np.isfinite(sample["range"])
    assert len(points) == is_echo.sum()
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), sample["range"][is_echo], rtol=1e-5)
    bearing = np.arctan2(-points[:, 1], points[:, 0])
    np.testing.assert_allclose(bearing, sample["azimuth"][is_echo], atol=1e-5)
    clean = cloud.point["clean"].numpy()[:, 0]
    full_scale = 255 if layout == "fan" else 1
    np.testing.assert_allclose(clean, sample["clean"][is_echo] / full_scale, atol=1e-6)
    classes = cloud.point["class"].numpy()[:, 0]
    np.testing.assert_array_equal(classes, sample["segmentation"][is_echo])
    assert "intensity" in cloud.point


@pytest.mark.slow
def test_what_does_not_fit_is_told(tmp_path: Path) -> None:
    small = ("scenes.locations=1", "scenes.frames_per_location=1")
    plain = ("experiment=demo", *WORDS[:-2], *small)
    make_dataset(*plain, out=tmp_path / "plain")
    with pytest.raises(FactoryError, match=r"no layer range.*dataset\.layers"):
        export(tmp_path / "plain", "ply", tmp_path / "out")
    drawn = ("experiment=any_sonar", "scenes=seabed", *WORDS[:-2], *small)
    make_dataset(*drawn, out=tmp_path / "drawn")
    with pytest.raises(FactoryError, match="points seen from above"):
        export(tmp_path / "drawn", "mcap", tmp_path / "out")
