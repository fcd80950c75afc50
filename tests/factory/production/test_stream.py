"""`simnfnd stream`: an MCAP file read back field by field, shapes, real time, and errors."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from simnfnd import FactoryError, Pose, Sonar
from simnfnd.factory.common.ros_types import SONAR, typestore
from simnfnd.factory.production.commands.stream import Progress, main, sail
from simnfnd.factory.simulation.pings.trajectories import TimedPose, poses_of

WORDS = (
    "scenes.width=160", "scenes.height=100", "sonar.range.min_m=0.5", "sonar.range.max_m=8",
    "sonar.range_bins=96", "sonar.beams=64",
)  # fmt: skip


def messages(folder: Path) -> dict[str, list[tuple[float, Any]]]:
    """Times, seconds since 2000, and messages by topic."""
    from rosbags.rosbag2 import Reader

    store = typestore(2)
    by_topic: dict[str, list[tuple[float, Any]]] = {}
    with Reader(folder) as reader:
        for connection, time_ns, content in reader.messages():
            message = store.deserialize_cdr(content, connection.msgtype)
            entries = by_topic.setdefault(connection.topic, [])
            entries.append((time_ns / 1e9 - 946_684_800, message))
    return by_topic


def test_a_recording_holds_what_the_sonar_pings(tmp_path, capsys):
    path = tmp_path / "path.csv"
    path.write_text("time_s,surge_m,yaw_deg\n2,0,0\n2.25,0.1,5\n2.5,0.2,10\n")
    main(["--path", str(path), "--out", str(tmp_path / "dive"), "seed=4", *WORDS])
    assert "3 of 3 pings" in capsys.readouterr().out
    recorded = messages(tmp_path / "dive")
    assert set(recorded) == {
        "/tf_static", "/sonar/noisy", "/sonar/noisy/image", "/sonar/pose", "/tf", "/sonar/points",
        "/sonar/labels",
    }  # fmt: skip
    assert len(recorded["/tf_static"]) == 1
    with Sonar(seed=4, overrides=("scenes.frame_rate_hz=10", *WORDS)) as sonar:
        pings = [
            sonar.ping(
                Pose(surge_m=0.1 * index, yaw_deg=5.0 * index), index=index, time_s=index / 4
            )
            for index in range(3)
        ]
        for index, ping in enumerate(pings):
            for name in set(recorded) - {"/tf_static"}:
                assert recorded[name][index][0] == pytest.approx(index / 4, abs=1e-6)
            message = recorded["/sonar/noisy"][index][1]
            assert type(message).__name__.endswith("ProjectedSonarImage"), SONAR
            assert message.header.frame_id == "sonar_ping"
            assert message.header.stamp.nanosec == index * 250_000_000
            polar = message.image.data.reshape(96, message.image.beam_count)
            np.testing.assert_array_equal(polar, ping.polar)
            bin_m = 7.5 / 96
            np.testing.assert_allclose(
                message.ranges[[0, -1]], [0.5 + bin_m / 2, 8 - bin_m / 2], rtol=1e-5
            )
            first = message.beam_directions[0]
            assert math.hypot(first.x, first.y, first.z) == pytest.approx(1)
            assert first.y < 0 < message.beam_directions[-1].y
            image = recorded["/sonar/noisy/image"][index][1]
            assert image.encoding == "mono8"
            np.testing.assert_array_equal(image.data.reshape(image.height, image.width), ping.fan)
            labels = recorded["/sonar/labels"][index][1]
            np.testing.assert_array_equal(
                labels.data.reshape(ping.fan.shape), ping.labels.segmentation
            )
            cloud = recorded["/sonar/points"][index][1]
            assert [field.name for field in cloud.fields] == list(ping.points.dtype.names or ())
            assert cloud.header.frame_id == "sonar"
            assert cloud.data.tobytes() == ping.points.tobytes()
            pose = recorded["/sonar/pose"][index][1].pose
            (moved,) = recorded["/tf"][index][1].transforms
            assert (moved.header.frame_id, moved.child_frame_id) == ("world", "sonar")
            for at in (pose.position, moved.transform.translation):
                world = [ping.world[f"sonar.{axis}_m"] for axis in "xyz"]
                assert [at.x, at.y, at.z] == pytest.approx(world)


def test_in_real_time_late_pings_are_missed(tmp_path):
    poses = [TimedPose(0.001 * number, Pose()) for number in range(20)]
    with Sonar(overrides=WORDS) as sonar:
        report = sail(sonar, poses, tmp_path / "dive", in_real_time=True, only_images=True)
    made = int(report.split()[0])
    missed = int(report.split()[-2])
    assert made + missed == 20
    assert missed > 5
    assert set(messages(tmp_path / "dive")["/sonar/noisy"][0][1].image.data)
    assert str(Progress(3)).startswith("0 of 3 pings")


@pytest.mark.parametrize("name", ["line", "circle", "lawnmower"])
def test_shapes_are_sailed_at_their_speed(name):
    poses = poses_of(name, "seabed", count=600, rate_hz=20, speed_m_s=1.0)
    places = np.array([(pose.surge_m, pose.sway_m) for _, pose in poses])
    steps_m = np.hypot(*np.diff(places, axis=0).T)
    assert steps_m == pytest.approx(0.05, abs=2e-3)
    yaws_rad = np.deg2rad([pose.yaw_deg for _, pose in poses])[:-1]
    ahead = np.stack([np.cos(yaws_rad), np.sin(yaws_rad)], axis=1)
    along = (ahead * np.diff(places, axis=0)).sum(axis=1) / steps_m
    assert along.min() > 0.99


def test_what_a_user_can_correct_is_one_line(tmp_path):
    (tmp_path / "there").mkdir()
    for words, match in (
        (["--out", str(tmp_path / "there")], "--out"),
        (["--out", str(tmp_path / "dive"), "--path", "spiral"], "--path=spiral"),
        (["--out", str(tmp_path / "dive"), "--rate", "0"], "--rate"),
        (["--out", str(tmp_path / "dive"), "scenes=mesh"], "first pose"),
        (["--out", str(tmp_path / "dive"), "scenes=flsea"], "poses are recorded"),
    ):
        with pytest.raises(FactoryError, match=match):
            main(words)
