"""SimNFND: pairs (noisy, clean) of forward-looking sonar pictures, and denoisers made of them.

    from simnfnd import PairDataset

Each name is imported when it is first used, so `import simnfnd` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from simnfnd.factory import __version__
    from simnfnd.factory.dataset import PairDataset

__all__ = ["PairDataset", "__version__"]

_WHERE = {
    "PairDataset": "simnfnd.factory.dataset",
    "__version__": "simnfnd.factory",
}


def __getattr__(name: str) -> object:
    if name not in _WHERE:
        raise AttributeError(f"module 'simnfnd' has no attribute {name!r}")
    return getattr(import_module(_WHERE[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
