"""SimNFND: pairs (noisy, clean) of forward-looking sonar pictures, and denoisers made of them.

    from simnfnd import PairDataset, denoise, make_pair, open_recording

PairDataset reads a dataset (numpy and h5py are enough), `denoise` takes a picture in memory,
`make_pair` makes a pair of an RGBD frame in memory, `open_recording` reads the frames of a sonar's
recording (docs/python.md).  What a caller can mend is a FactoryError, one
line; a frame that cannot be used is a FrameError.

Each name is imported when it is first used, so `import simnfnd` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .api import OpenRecording, RecordedFrame, denoise, make_pair, open_recording
    from .factory import __version__
    from .factory.dataset import PairDataset
    from .factory.dataset.schema import Pair
    from .factory.errors import FactoryError, FrameError

__all__ = [
    "FactoryError",
    "FrameError",
    "OpenRecording",
    "Pair",
    "PairDataset",
    "RecordedFrame",
    "__version__",
    "denoise",
    "make_pair",
    "open_recording",
]

# From the lightest on.
_MODULES = ("factory", "factory.errors", "factory.dataset", "factory.dataset.schema", "api")


def __getattr__(name: str) -> object:
    for module in _MODULES if name in __all__ else ():
        found = import_module(f".{module}", __name__)
        if hasattr(found, name):
            return getattr(found, name)
    raise AttributeError(f"module 'simnfnd' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted(__all__)
