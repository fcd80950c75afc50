"""SimNFND: pairs (noisy, clean) of forward-looking sonar images, and denoisers made of them.

    from simnfnd import PairDataset, denoise, make_dataset, make_pair, open_recording

PairDataset reads a dataset (numpy and h5py are enough), `make_dataset` makes one, `make_pair` makes
a pair of an RGBD frame in memory, and `Sonar` pings at any `Pose` of a scene.  `denoise` takes an
image in memory, `Denoiser` the frames of a live sonar; `detect` and `Detector` find objects in
them.  `open_recording` reads the frames of a sonar's recording (docs/python.md).  What a caller can
correct is a FactoryError, one line; a frame that cannot be used is a FrameError.

Each name is imported when it is first used, so `import simnfnd` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from .rooms import search_path

if TYPE_CHECKING:
    from .api import OpenRecording, RecordedFrame, denoise, open_recording
    from .detecting import Detector, detect
    from .factory import __version__
    from .factory.common.errors import FactoryError, FrameError
    from .factory.common.progress import RunProgress
    from .factory.dataset import PairDataset
    from .factory.dataset.fan_geometry import FanGeometry
    from .factory.dataset.schema import Pair
    from .factory.simulation.pings.ping import Ping
    from .factory.simulation.pings.pose import Pose
    from .factory.simulation.pings.sonar import Sonar
    from .live import Denoiser
    from .making import DatasetResult, make_dataset, make_pair
    from .models.data.pair_stream import PairStream
    from .models.detection.objects import DetectedObject
    from .models.recordings.base import Beams

__path__ = search_path(Path(__file__).parent)

__all__ = [
    "Beams",
    "DatasetResult",
    "Denoiser",
    "DetectedObject",
    "Detector",
    "FactoryError",
    "FanGeometry",
    "FrameError",
    "OpenRecording",
    "Pair",
    "PairDataset",
    "PairStream",
    "Ping",
    "Pose",
    "RecordedFrame",
    "RunProgress",
    "Sonar",
    "__version__",
    "denoise",
    "detect",
    "make_dataset",
    "make_pair",
    "open_recording",
]

_MODULES = {
    "Beams": "models.recordings.base",
    "DatasetResult": "making",
    "Denoiser": "live",
    "DetectedObject": "models.detection.objects",
    "Detector": "detecting",
    "FactoryError": "factory.common.errors",
    "FanGeometry": "factory.dataset.fan_geometry",
    "FrameError": "factory.common.errors",
    "OpenRecording": "api",
    "Pair": "factory.dataset.schema",
    "PairDataset": "factory.dataset",
    "PairStream": "models.data.pair_stream",
    "Ping": "factory.simulation.pings.ping",
    "Pose": "factory.simulation.pings.pose",
    "RecordedFrame": "api",
    "RunProgress": "factory.common.progress",
    "Sonar": "factory.simulation.pings.sonar",
    "__version__": "factory",
    "denoise": "api",
    "detect": "detecting",
    "make_dataset": "making",
    "make_pair": "making",
    "open_recording": "api",
}


def __getattr__(name: str) -> object:
    if name not in _MODULES:
        raise AttributeError(f"module 'simnfnd' has no attribute {name!r}")
    return getattr(import_module(f".{_MODULES[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(_MODULES)
