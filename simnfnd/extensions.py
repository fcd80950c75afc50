"""All that an extension is written with: noise effects, readers, methods, metrics and networks.

An extension is one object: an `Effect`, a `ReaderEntry` (of RGBD scenes), a `RecordingEntry` (of a
sonar's recordings), a `Baseline`, an `OwnMetric` or a class of
`simnfnd.models.networks.network.Network`.  A package names it as an entry point, a script
registers it (docs/how-to/extending.md).
"""

from __future__ import annotations

from .evaluation.filters import Baseline, register_method
from .evaluation.metrics.measure import PairImages
from .evaluation.metrics.own import OwnMetric, register_metric
from .factory.common import extensions as _known
from .factory.common.distribution import AnyNumber, Fraction, NonNegative, Positive
from .factory.common.errors import FactoryError, FrameError
from .factory.common.settings import STRICT
from .factory.dataset.frame_ref import FrameRef
from .factory.simulation.frames.frame import Frame, Intrinsics, checked
from .factory.simulation.imaging.effect import Effect, EffectSettings, parameter
from .factory.simulation.imaging.signal import Ping, Signal
from .factory.simulation.noise.registry import register_effect
from .factory.simulation.scenes import register_reader
from .factory.simulation.scenes.base import (
    Discovery,
    OwnSceneSettings,
    Reader,
    ReaderEntry,
    discovery,
)
from .factory.simulation.sonar.polar import Echoes
from .factory.simulation.sonar.window import Window
from .models.recordings.base import Beams, RecordingDevice, SonarPose
from .models.recordings.base import SonarFrame as RecordingFrame
from .models.recordings.extension_files import (
    RecordingEntry,
    RecordingReader,
    register_recording,
)

__all__ = [
    "STRICT",
    "AnyNumber",
    "Baseline",
    "Beams",
    "Discovery",
    "Echoes",
    "Effect",
    "EffectSettings",
    "FactoryError",
    "Fraction",
    "Frame",
    "FrameError",
    "FrameRef",
    "Intrinsics",
    "NonNegative",
    "OwnMetric",
    "OwnSceneSettings",
    "PairImages",
    "Ping",
    "Positive",
    "Reader",
    "ReaderEntry",
    "RecordingDevice",
    "RecordingEntry",
    "RecordingFrame",
    "RecordingReader",
    "Signal",
    "SonarPose",
    "Window",
    "checked",
    "discovery",
    "parameter",
    "register_effect",
    "register_method",
    "register_metric",
    "register_network",
    "register_reader",
    "register_recording",
]


def register_network(kind: str, network: type) -> None:
    """Make a network known to `simnfnd train model=KIND` in this process.

    network: a class of `simnfnd.models.networks.network.Network`, whose attribute `settings` is its
    settings class, all keys with defaults.  Raises ValueError for a bad name.
    """
    _known.register("network", kind, network)
