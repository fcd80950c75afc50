"""Bags go in and out: frames as they were written, all else as it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import simnfnd
from simnfnd.factory.common.errors import FactoryError, FrameError
from simnfnd.factory.common.ros_types import SONAR, typestore
from simnfnd.models.recordings import kind_of, open_recording
from simnfnd.models.recordings.rosbag import COMPRESSED, IMAGE, RosBag
from tests.models.recordings.bag_files import (
    START_NS,
    STEP_NS,
    compressed,
    content,
    image,
    sonar,
    write_bag,
)
from tests.models.recordings.recording_files import pings

CASES = [
    ("a.bag", {}),
    ("b.bag", {"compression": "bz2"}),
    ("c", {}),
    ("d", {"storage": "mcap", "compression": "file"}),
    ("e", {"compression": "message"}),
    ("f.mcap", {}),
    ("g.db3", {}),
]


def version(name: str) -> int:
    return 1 if name.endswith(".bag") else 2


def sonar_bag(path: Path, samples: np.ndarray, bag_options: Any = None, **options: Any) -> Path:
    store = typestore(version(path.name))
    messages = [sonar(store, number, ping, **options) for number, ping in enumerate(samples)]
    return write_bag(path, {"/sonar": (SONAR, messages)}, **(bag_options or {}))


@pytest.mark.parametrize(("name", "bag_options"), CASES)
def test_a_bag_goes_in_and_out(tmp_path: Path, name: str, bag_options: dict[str, str]) -> None:
    samples = pings(4, 20, 16)
    path = sonar_bag(tmp_path / name, samples, bag_options)
    out = tmp_path / "out" / name
    with open_recording(path) as bag:
        assert isinstance(bag, RosBag)
        assert len(bag) == 4
        frames = list(bag)
        np.testing.assert_array_equal(np.stack([frame.samples for frame in frames]), samples)
        assert [frame.number for frame in frames] == [0, 1, 2, 3]
        assert [frame.time_s for frame in frames] == [1.6e9 + k + 0.25 for k in range(4)]
        beams = frames[0].beams
        assert beams is not None
        np.testing.assert_allclose(np.rad2deg(beams.azimuths_rad), np.linspace(-30, 30, 16))
        assert (beams.range_min_m, beams.range_max_m) == pytest.approx((1, 5), abs=1e-6)
        assert (frames[0].device.name, frames[0].device.frequency_khz) == ("sonar", 1200)
        assert bag[2].number == 2  # by number: on, again, and back
        np.testing.assert_array_equal(bag[2].samples, samples[2])
        np.testing.assert_array_equal(bag[0].samples, samples[0])
        bag.rewrite((frame.samples // 2 for frame in bag), out)
    assert kind_of(out) == "rosbag"
    assert [path.name for path in out.parent.iterdir()] == [name]
    before = list(content(path))
    after = list(content(out))
    assert [message[:3] for message in before] == [message[:3] for message in after]
    assert {message[2] for message in after} == {
        START_NS + k * STEP_NS + s for k in range(4) for s in (0, 1)
    }
    for (topic, _, _, old), (_, _, _, new) in zip(before, after, strict=True):
        if topic == "/sonar":
            half = old.image.data // 2
            np.testing.assert_array_equal(new.image.data, half)
            old.image.data = new.image.data = None
        assert repr(old) == repr(new)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("big", [False, True])
def test_samples_of_every_type_and_order(tmp_path: Path, dtype: str, big: bool) -> None:
    samples = pings(2, 20, 16).astype(dtype)
    samples = samples / np.float32(255) if dtype == "float32" else samples * samples.dtype.type(1)
    path = sonar_bag(tmp_path / "a.bag", samples, big=big)
    with RosBag(path) as bag:
        frames = list(bag)
        assert frames[0].samples.dtype == np.dtype(dtype)
        np.testing.assert_array_equal(np.stack([frame.samples for frame in frames]), samples)
        bag.rewrite([frame.samples[::-1] for frame in frames], tmp_path / "b.bag")
    with open_recording(tmp_path / "b.bag") as bag:
        np.testing.assert_array_equal(bag[1].samples, samples[1][::-1])


def test_beams_go_from_left_to_right_whatever_the_sign_of_y(tmp_path: Path) -> None:
    samples = pings(1, 20, 16)
    paths = [sonar_bag(tmp_path / f"{side}.bag", samples, side=side) for side in (1, -1)]
    right, left = (open_recording(path)[0] for path in paths)
    assert right.beams is not None
    assert left.beams is not None
    np.testing.assert_allclose(left.beams.azimuths_rad, right.beams.azimuths_rad)
    np.testing.assert_array_equal(left.samples, right.samples)


IMAGE_SETTINGS = [
    ("mono8", np.uint8, (30, 20)),
    ("mono16", np.uint16, (30, 20)),
    ("32FC1", np.float32, (30, 20)),
    ("rgb8", np.uint8, (30, 20, 3)),
    ("bgra8", np.uint8, (30, 20, 4)),
]


@pytest.mark.parametrize(("encoding", "dtype", "shape"), IMAGE_SETTINGS)
def test_images_keep_encoding_and_padding(
    tmp_path: Path, encoding: str, dtype: Any, shape: tuple[int, ...]
) -> None:
    samples = np.random.default_rng(1).integers(0, 256, shape).astype(dtype)
    samples = samples / np.float32(255) if encoding == "32FC1" else samples
    store = typestore(2)
    messages = [image(store, 0, samples, encoding, padding=8)]
    path = write_bag(tmp_path / "a.mcap", {"/images": (IMAGE, messages)})
    with RosBag(path) as bag:
        frame = bag[0]
        assert frame.beams is None
        np.testing.assert_array_equal(frame.samples, samples)
        bag.rewrite([frame.samples[::-1]], tmp_path / "b.mcap")
    with open_recording(tmp_path / "b.mcap") as bag:
        np.testing.assert_array_equal(bag[0].samples, samples[::-1])
    (message,) = (m for topic, _, _, m in content(tmp_path / "b.mcap") if topic == "/images")
    rows = message.data.reshape(30, -1)
    assert (rows[:, -8:] == 77).all()
    assert message.encoding == encoding


@pytest.mark.parametrize(("suffix", "apart"), [(".png", 0), (".jpg", 3)])
def test_compressed_images_stay_so(tmp_path: Path, suffix: str, apart: int) -> None:
    smooth = np.add.outer(np.arange(40), np.arange(60)).astype(np.uint8)
    messages = [compressed(typestore(1), 0, smooth, suffix)]
    path = write_bag(tmp_path / "a.bag", {"/images": (COMPRESSED, messages)})
    with RosBag(path) as bag:
        assert np.abs(bag[0].samples.astype(int) - smooth).max() <= apart
        bag.rewrite([smooth // 2], tmp_path / "b.bag")
    with open_recording(tmp_path / "b.bag") as bag:
        assert np.abs(bag[0].samples.astype(int) - smooth // 2).max() <= apart
    messages = [m for topic, _, _, m in content(tmp_path / "b.bag") if topic == "/images"]
    assert bytes(messages[0].data[:2]) == {".png": b"\x89P", ".jpg": b"\xff\xd8"}[suffix]


def test_which_topics_are_frames(tmp_path: Path) -> None:
    store = typestore(2)
    images = [image(store, number, ping) for number, ping in enumerate(pings(3, 12, 8))]
    both = {"/front": (IMAGE, images), "/back": (IMAGE, images[:2])}
    path = write_bag(tmp_path / "a.mcap", both)
    with pytest.raises(FactoryError, match=r"/front, /back.*--topic"):
        open_recording(path)
    with pytest.raises(FactoryError, match=r"/front, /back.*--topic"):
        simnfnd.open_recording(path)
    assert len(simnfnd.open_recording(path, topic="/front")) == 3
    assert len(simnfnd.open_recording(path, topic=["/front", "/back"])) == 5
    assert len(RosBag(path, ["/back"])) == 2
    assert len(RosBag(path, ["/back", "/front"])) == 5
    with pytest.raises(FactoryError, match=r"/notes.*/front, /back"):
        RosBag(path, ["/notes"])
    sonars = [sonar(store, 0, pings(1, 12, 8)[0])]
    path = write_bag(tmp_path / "b.mcap", {**both, "/sonar": (SONAR, sonars)})
    with RosBag(path) as bag:
        assert bag.topics == ("/sonar",)
    path = write_bag(tmp_path / "c.mcap", {"/only": ("std_msgs/msg/String", [])})
    with pytest.raises(FactoryError, match="no topic"):
        open_recording(path)


def test_unknown_types_are_copied_and_never_run(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Reader, Writer

    store = typestore(1)
    odd = "int32 a\n__import__('os').abort()\n"
    with Writer(tmp_path / "a.bag") as writer:
        odd_connection = writer.add_connection(
            "/odd", "my_msgs/msg/Odd", msgdef=odd, md5sum="0" * 32
        )
        images = writer.add_connection("/sonar", SONAR, typestore=store)
        writer.write(odd_connection, 5, b"abc")
        message = sonar(store, 0, pings(1, 12, 8)[0])
        writer.write(images, 6, store.serialize_ros1(message, SONAR))
    with RosBag(tmp_path / "a.bag") as bag:
        bag.rewrite([bag[0].samples], tmp_path / "b.bag")
    with Reader(tmp_path / "b.bag") as reader:
        actual = [
            (connection.topic, connection.msgdef.data, time, data)
            for connection, time, data in reader.messages()
        ]
        assert actual[0] == ("/odd", odd, 5, b"abc")


def test_another_type_of_the_same_name_is_refused(tmp_path: Path) -> None:
    from rosbags.rosbag1 import Writer

    with Writer(tmp_path / "a.bag") as writer:
        connection = writer.add_connection("/sonar", SONAR, msgdef="int32 a\n", md5sum="1" * 32)
        writer.write(connection, 5, b"abcd")
    with pytest.raises(FactoryError, match=r"/sonar .*1111"):
        open_recording(tmp_path / "a.bag")


def test_what_a_message_says_must_fit(tmp_path: Path) -> None:
    store = typestore(1)
    samples = pings(1, 12, 8)[0]
    odd, uneven, few = (sonar(store, 0, samples) for _ in range(3))
    odd.image.dtype = 4
    uneven.ranges = uneven.ranges**2
    few.beam_directions = few.beam_directions[::2]
    bayer = image(store, 0, samples, "bayer_rggb8")
    cut = compressed(store, 0, samples)
    cut.data = cut.data[8:]
    for number, (kind, message, words) in enumerate((
        (SONAR, odd, "message 0 of /p has samples of type 4"),
        (SONAR, uneven, "ranges that do not ascend evenly"),
        (SONAR, few, "8 beams and 4 directions"),
        (IMAGE, bayer, "the encoding 'bayer_rggb8', which cannot be denoised"),
        (COMPRESSED, cut, "not a readable image"),
    )):  # fmt: skip
        path = write_bag(tmp_path / f"{number}.bag", {"/p": (kind, [message])})
        with pytest.raises(FrameError, match=words), open_recording(path) as bag:
            list(bag)


def test_folders_with_odd_metadata(tmp_path: Path) -> None:
    path = sonar_bag(tmp_path / "a", pings(2, 12, 8), {"storage": "mcap"})
    metadata = path / "metadata.yaml"
    whole = metadata.read_bytes()
    secret = tmp_path / "secret.mcap"
    secret.write_bytes(b"")
    metadata.write_bytes(whole.replace(b"- a.mcap", b"- ../secret.mcap"))
    with pytest.raises(FactoryError, match=r"files are missing"):
        open_recording(path)
    metadata.write_bytes(whole.replace(b"message_count: 2", b"message_count: 99"))
    with open_recording(path) as bag:
        assert len(list(bag)) == 2
        assert "ends after 2 of 99 frames" in bag.warning
        with pytest.raises(FrameError, match="ends before frame 5"):
            bag[5]
