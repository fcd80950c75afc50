"""The message types of ROS 1 and 2 that bags of sonars are written and read with (extra `ros`)."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

SONAR = "marine_acoustic_msgs/msg/ProjectedSonarImage"


@lru_cache(maxsize=2)
def typestore(version: int) -> Typestore:
    """The types of ROS 1 or 2, with those of marine_acoustic_msgs.

    Their field names and types are those of https://github.com/apl-ocean-engineering/marine_msgs.
    """
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if version == 1 else Stores.ROS2_HUMBLE)
    text = Path(__file__).with_name("ProjectedSonarImage.msg").read_text(encoding="utf-8")
    store.register(get_types_from_msg(text, SONAR))
    return store
