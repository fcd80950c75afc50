"""Stand-ins for rclpy and message packages, as far as `examples/ros2_denoise.py` uses them."""

from __future__ import annotations

from pathlib import Path

_RCLPY = """
import pathlib, pickle

class Node:
    def __init__(self, name): self.sent, self.said, self.topics = [], [], []
    def create_publisher(self, kind, topic, depth):
        self.topics.append((topic, kind.__name__))
        return self
    def publish(self, message): self.sent.append(message)
    def create_subscription(self, kind, topic, callback, qos):
        self.topics.append((topic, kind.__name__))
        assert (qos.depth, qos.reliability) == (1, "best effort")
        self.callback = callback
    def get_logger(self): return self
    def info(self, text): self.said.append(text)
    warning = info
    def destroy_node(self): pass

def init(args): pass
create_node = Node
def try_shutdown(): pass

def spin(node):
    for message in pickle.loads(pathlib.Path("messages").read_bytes()):
        node.callback(message)
    result = (node.topics, node.sent, node.said)
    pathlib.Path("result").write_bytes(pickle.dumps(result))
    raise KeyboardInterrupt
"""
_QOS = """
class ReliabilityPolicy: BEST_EFFORT = "best effort"
class QoSProfile:
    def __init__(self, depth, reliability): self.depth, self.reliability = depth, reliability
"""
# As rosidl makes them: slots, and bytes as an array that accepts nothing else.
_MESSAGES = """
from array import array

class Message:
    __slots__ = ()
    def __init__(self, **fields):
        for name, value in fields.items(): setattr(self, name, value)

class Stamp(Message): __slots__ = ("sec", "nanosec")
class Header(Message): __slots__ = ("stamp", "frame_id")
class Vector3(Message): __slots__ = ("x", "y", "z")
class PingInfo(Message): __slots__ = ("frequency", "sound_speed")

class Bytes(Message):
    __slots__ = ("_data",)
    @property
    def data(self): return self._data
    @data.setter
    def data(self, value):
        assert isinstance(value, array) and value.typecode == "B"
        self._data = value

class Image(Bytes):
    __slots__ = ("header", "height", "width", "encoding", "is_bigendian", "step")
class SonarImageData(Bytes): __slots__ = ("is_bigendian", "dtype", "beam_count")
class ProjectedSonarImage(Message):
    __slots__ = ("header", "ping_info", "beam_directions", "ranges", "image")
"""


def write_fake_ros(folder: Path) -> Path:
    """Packages for PYTHONPATH; `rclpy.spin` feeds the file messages and writes the file result."""
    texts = {
        "rclpy/__init__.py": _RCLPY,
        "rclpy/qos.py": _QOS,
        "sensor_msgs/msg.py": _MESSAGES,
        "marine_acoustic_msgs/msg.py": "from sensor_msgs.msg import *\n",
    }
    for name, text in texts.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        (path.parent / "__init__.py").touch()
        path.write_text(text, encoding="utf-8")
    return folder
