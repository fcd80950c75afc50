"""The scripts of examples/, run as a stranger runs them."""

from __future__ import annotations

import csv
import runpy
import shlex
import sys
from array import array
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image as PilImage

from simnfnd import denoise, make_dataset, open_recording
from simnfnd.command import main
from simnfnd.models.networks import build_network
from simnfnd.models.networks.weights import save_weights
from tests.fake_source import FakeConfig
from tests.project.page_steps import PAGES, steps
from tests.project.run_example import EXAMPLES, run
from tests.project_files import ROOT
from tests.run_fake import make


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """24 pairs that train, in shards of 8, with manifest and index."""
    root = tmp_path_factory.mktemp("examples") / "data"
    make(root, FakeConfig(shape=(48, 48)), scheduler={"backend": "serial"})
    return root


@pytest.fixture
def printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> Callable[..., str]:
    """Runs an example in `tmp_path` and in this process, which has imported torch already.

    Returns what it prints.
    """
    monkeypatch.chdir(tmp_path)

    def run_script(script: str, *words: str) -> str:
        monkeypatch.setattr(sys, "argv", [script, *words])
        capfd.readouterr()
        runpy.run_path(str(EXAMPLES / script), run_name="__main__")
        return capfd.readouterr().out

    return run_script


def test_an_example_runs_in_a_process_of_its_own(dataset: Path, tmp_path: Path) -> None:
    done = run("read_with_h5py.py", str(dataset), "100", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "100 random reads of 24 pairs in 3 shards" in done.stdout
    assert "index.h5 joins them: (24, 48, 48)" in done.stdout
    assert 5 < float(done.stdout.split("mean PSNR ")[1].split()[0]) < 25


@pytest.mark.slow
def test_a_tiny_network_learns_from_a_dataset(dataset: Path, printed: Callable[..., str]) -> None:
    line = printed("train_a_tiny_network.py", str(dataset), "60")
    before, after = line.removeprefix("mean squared error ").split(" -> ")
    assert float(after) < 0.5 * float(before)


def test_workers_of_a_loader_share_a_dataset(dataset: Path, printed: Callable[..., str]) -> None:
    assert printed("load_with_workers.py", str(dataset)).startswith("24 of 24 pairs, ")


@pytest.mark.slow
def test_a_u_net_trains_on_the_stream(tmp_path: Path, printed: Callable[..., str]) -> None:
    make_dataset(
        "experiment=demo", "render=analytic", "scenes.locations=2", "scenes.frames_per_location=1",
        "scenes.width=160", "scenes.height=100", "dataset.preview_pairs=0", "scheduler=serial",
        "sonar.image.width_px=96", "sonar.image.height_px=96", out=tmp_path / "data",
    )  # fmt: skip
    lines = printed("train_unet_on_stream.py", "data", "2").splitlines()
    assert lines[0].startswith("noisy: ")
    assert lines[1].startswith("step 2: loss 0.")
    assert lines[1].endswith(" dB")


class Message(SimpleNamespace):
    """As rosidl makes them."""


class Image(Message): ...


class ProjectedSonarImage(Message): ...


class Node:
    """A stand-in of rclpy and its node: what it is told is kept, what comes is fed by `spin`."""

    def __init__(self, messages: list[Any]) -> None:
        self.messages = messages
        self.topics: list[Any] = []
        self.sent: list[Any] = []
        self.said: list[str] = []
        self.info = self.warning = self.said.append
        self.publish = self.sent.append
        self.init = self.destroy_node = self.try_shutdown = lambda **_: None

    def create_node(self, *_: str) -> Node:
        return self

    get_logger = create_node

    def create_publisher(self, kind: type, topic: str, depth: int) -> Node:
        self.topics.append((topic, kind.__name__))
        return self

    def create_subscription(self, kind: type, topic: str, callback: Any, qos: Any) -> None:
        self.topics.append((topic, kind.__name__))
        assert (qos.depth, qos.reliability) == (1, "best effort")
        self.callback = callback

    def spin(self, node: Node) -> None:
        for message in self.messages:
            self.callback(message)
        raise KeyboardInterrupt


def test_a_node_of_ros_denoises_what_comes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two images and one that cannot be; a ping of a sonar.  ROS is a stand-in."""
    header = Message(stamp=Message(sec=7, nanosec=5), frame_id="sonar")
    noise = np.random.default_rng(1).integers(0, 256, (40, 32), dtype=np.uint8)

    def image(encoding: str) -> Any:
        return Image(
            header=header, height=40, width=32, encoding=encoding, is_bigendian=0, step=32,
            data=array("B", noise.tobytes()),
        )  # fmt: skip

    bearings = np.linspace(-0.5, 0.5, 32)
    ping = ProjectedSonarImage(
        header=header,
        ping_info=Message(frequency=1e6, sound_speed=1500.0),
        beam_directions=[Message(x=0.0, y=np.sin(b), z=np.cos(b)) for b in bearings],
        ranges=array("f", np.arange(40) + 0.5),
        image=Message(is_bigendian=False, dtype=0, beam_count=32, data=array("B", noise.tobytes())),
    )
    weights = tmp_path / "weights.safetensors"
    config = {"kind": "nafnet", "width": 4, "encoder": [1], "middle": 0, "decoder": [1]}
    torch.manual_seed(0)
    save_weights(weights, build_network(config), config, {})
    for kind, words, messages in (
        ("Image", [], [image("mono8"), image("yuv422"), image("mono8")]),
        ("ProjectedSonarImage", ["--sonar"], [ping]),
    ):
        node = Node(messages)
        qos = {"QoSProfile": Message, "ReliabilityPolicy": Message(BEST_EFFORT="best effort")}
        for name, module in (
            ("rclpy", node),
            ("rclpy.qos", Message(**qos)),
            ("sensor_msgs.msg", Message(Image=Image)),
            ("marine_acoustic_msgs.msg", Message(ProjectedSonarImage=ProjectedSonarImage)),
        ):
            monkeypatch.setitem(sys.modules, name, module)
        monkeypatch.setattr(sys, "argv", ["node", "/sonar", "--weights", str(weights), *words])
        runpy.run_path(str(EXAMPLES / "ros2_denoise.py"), run_name="__main__")
        topics = node.topics
        sent = node.sent
        said = node.said
        assert topics == [("/sonar/denoised", kind), ("/sonar", kind)]
        assert len(sent) == len(
            [message for message in messages if message is ping or message.encoding == "mono8"]
        )
        assert [line.split(":")[0] for line in said[1:]] == ["left out"] * (len(messages) > 1)
        expected = denoise(noise, weights=weights)
        for message in sent:
            assert (message.header.stamp.sec, message.header.frame_id) == (7, "sonar")
            data = (message if kind == "Image" else message.image).data
            assert isinstance(data, array)  # rclpy takes nothing else
            actual = np.frombuffer(data, np.uint8).reshape(40, 32)
            np.testing.assert_array_equal(actual, expected)


def test_a_node_of_ros_publishes_pings(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two pings of a small sonar.  ROS is a stand-in, whose messages take what they are given."""
    sent: dict[str, list[Any]] = {}

    class Publisher:
        def __init__(self, topic: str) -> None:
            self.topic = topic

        def publish(self, message: Any) -> None:
            sent.setdefault(self.topic, []).append(message)

    class Ros(Message):
        is_on = True

        def create_node(self, name: str) -> Any:
            return self

        def get_clock(self) -> Any:
            return Message(now=lambda: Message(nanoseconds=5_500_000_000))

        def create_publisher(self, kind: type, topic: str, qos: Any) -> Publisher:
            return Publisher(topic)

        def create_timer(self, period_s: float, callback: Callable[[], None]) -> None:
            assert period_s == 0.2
            self.callback = callback

        def init(self) -> None:
            pass

        def spin(self, node: Any) -> None:
            while self.is_on:
                self.callback()

        def destroy_node(self) -> None:
            pass

        def try_shutdown(self) -> None:
            self.is_on = False

    class AnyMessage(Message):
        def __getattr__(self, name: str) -> Any:
            return Message

    qos = Message(QoSProfile=Message, DurabilityPolicy=Message(TRANSIENT_LOCAL="latched"))
    for name in ("builtin_interfaces", "std_msgs", "sensor_msgs", "geometry_msgs", "tf2_msgs",
                 "marine_acoustic_msgs"):  # fmt: skip
        monkeypatch.setitem(sys.modules, name, AnyMessage())
        monkeypatch.setitem(sys.modules, f"{name}.msg", AnyMessage())
    monkeypatch.setitem(sys.modules, "rclpy", Ros())
    monkeypatch.setitem(sys.modules, "rclpy.qos", qos)
    words = ["scenes.width=96", "scenes.height=64", "sonar.range_bins=64", "sonar.beams=48"]
    monkeypatch.setattr(sys, "argv", ["node", "line", "--count", "2", *words])
    runpy.run_path(str(EXAMPLES / "ros2_sonar.py"), run_name="__main__")
    assert len(sent["/sonar/noisy"]) == len(sent["/sonar/points"]) == 2
    ping = sent["/sonar/noisy"][1]
    assert (ping.header.stamp.sec, ping.header.stamp.nanosec) == (5, 500_000_000)
    assert isinstance(ping.image.data, array)
    assert len(ping.image.data) == 64 * 48
    assert isinstance(ping.ranges, array)


def test_a_vehicle_keeps_its_altitude(tmp_path: Path, printed: Callable[..., str]) -> None:
    off_m = float(printed("keep_altitude.py", "12", str(tmp_path)).split()[4])
    assert off_m < 1
    assert len((tmp_path / "altitude.csv").read_text().splitlines()) == 13


@pytest.mark.slow
def test_the_papers_figures(tmp_path: Path, printed: Callable[..., str]) -> None:
    small = ("render=analytic", "scenes.width=242", "scenes.height=152", "scenes.locations=1")
    printed("paper_figures.py", "--out", str(tmp_path), "--only", "paper", *small)
    names = {path.stem for path in tmp_path.glob("*.png")}
    assert names == {f"figure-{number:02d}" for number in (3, 4, 5, 6, 7, 8, 12)}
    for path in tmp_path.glob("*.png"):
        assert np.asarray(PilImage.open(path).convert("L")).std() > 20


def test_a_listed_recording_becomes_pairs(tmp_path: Path, printed: Callable[..., str]) -> None:
    """Both 10.00 and 10.02 are near 10.008: the nearer gets it."""
    folder = tmp_path / "rgbd_dataset_freiburg1_desk"
    depth_m = np.broadcast_to(np.linspace(4, 1, 480)[:, None], (480, 640))
    for kind, times in (
        ("rgb", ["10.00", "10.02", "10.06", "10.50"]), ("depth", ["10.008", "10.065", "10.20"]),
    ):  # fmt: skip
        (folder / kind).mkdir(parents=True)
        for time in times:
            pixels = np.rint(depth_m * 5000).astype(np.uint16)
            stored = np.full((480, 640, 3), 128, np.uint8) if kind == "rgb" else pixels
            PilImage.fromarray(stored).save(folder / kind / f"{time}.png")
        lines = [f"{time} {kind}/{time}.png" for time in times]
        (folder / f"{kind}.txt").write_text("# timestamp filename\n" + "\n".join(lines) + "\n")
    command = printed("rgbd_to_csv.py", folder.name).splitlines()[1]
    assert (folder / "frames.csv").read_text().splitlines() == [
        "rgb/10.00.png,depth/10.008.png,rgbd_dataset_freiburg1_desk",
        "rgb/10.06.png,depth/10.065.png,rgbd_dataset_freiburg1_desk",
    ]
    words = shlex.split(command)[1:]
    assert "scenes.intrinsics=[517.3,516.5,318.6,255.3]" in words
    assert main([*words, "render=analytic", "scheduler=serial", "dataset.preview_pairs=0"]) == 0
    assert len(list(tmp_path.glob(f"outputs/{folder.name}/*/*.h5"))) == 1


@pytest.mark.slow
def test_labels_of_real_fish_lie_on_echoes() -> None:
    """Every plain box is brighter than the background of the recording, most by far."""
    frames = np.stack(
        [
            shot.frame.samples.reshape(774, 400, -1)[..., 0]
            for shot in open_recording(EXAMPLES / "didson/lamprey1.avi")
        ]
    ).astype(np.float32)
    change = frames - np.median(frames, axis=0)
    with (EXAMPLES / "didson/lamprey1-fish.csv").open(encoding="utf-8") as file:
        rows = [{key: int(text) for key, text in row.items()} for row in csv.DictReader(file)]
    assert {row["id"] for row in rows} == {1, 2, 3}
    assert len({(row["frame"], row["id"]) for row in rows}) == len(rows)
    brighter = []
    for row in rows:
        right, bottom = row["x"] + row["w"], row["y"] + row["h"]
        assert 0 <= row["frame"] < len(frames)
        assert min(row["x"], row["y"]) >= 0
        assert right <= 400
        assert bottom <= 774
        if row["visible"]:
            box = change[row["frame"], row["y"] : bottom, row["x"] : right]
            brighter.append(np.mean(box) / change[row["frame"]].std())
    assert min(brighter) > 0.5
    assert np.median(brighter) > 2


@pytest.mark.slow
def test_targets_are_classified_with_near_duplicates_in_one_fold(
    tmp_path: Path, printed: Callable[..., str]
) -> None:
    """Five kinds of pattern, four of each, each twice with hardly any difference."""
    rng = np.random.default_rng(0)
    classes = ("big_propeller", "cylinder", "fishing_net", "small_propeller", "soft_pipeline")
    across, down = np.meshgrid(np.linspace(0, 1, 24), np.linspace(0, 1, 24))
    patterns = (across, down, across * down, (across - 0.5) ** 2, (down - 0.5) ** 2)
    for name, pattern in zip(classes, patterns, strict=True):
        (tmp_path / "nksid" / name).mkdir(parents=True)
        for number in range(4):
            first = 150 * pattern + rng.normal(0, 60, (24, 24))
            for copy in range(2):
                pixels = np.clip(first + rng.normal(0, 3, (24, 24)) + 60, 0, 255).astype(np.uint8)
                file = tmp_path / "nksid" / name / f"img_{number}_{copy}.jpg"
                PilImage.fromarray(pixels).save(file, quality=95)
    output = printed("nksid_classifier.py", str(tmp_path / "nksid"))
    words = output.split()
    crop_count = int(words[0])
    group_count = int(words[3])
    assert crop_count == 40
    assert group_count <= 20
    assert "denoised: macro-F1" in output
    recorded_f1 = float(output.split("recorded: macro-F1 ")[1].split()[0])
    assert recorded_f1 > 0.3


def test_targets_become_meshes(tmp_path: Path, printed: Callable[..., str]) -> None:
    output = printed("make_targets.py", str(tmp_path / "targets"))
    assert output.count(" m\n") == 4
    names = {path.stem for path in (tmp_path / "targets").glob("*.ply")}
    assert names == {"big_propeller", "small_propeller", "soft_pipeline", "cylinder"}


def test_every_example_is_tested() -> None:
    tests = "".join(
        path.read_text(encoding="utf-8") for path in (ROOT / "tests").rglob("test_*.py")
    ) + "".join(step.text for page in PAGES for step in steps(page))
    for path in EXAMPLES.glob("*.py"):
        run = f'"{path.name}"' in tests or f"python examples/{path.name} " in tests
        assert run, f"{path.name} is run by no test"
