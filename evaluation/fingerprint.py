"""What figures depend on beside picture, method and parameters: code, libraries and the device."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import lru_cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

_LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "scikit-image")
_MEASURING = (
    "simnfnd.evaluation.metrics",
    "simnfnd.evaluation.runner",
    "simnfnd.factory.dataset.describe.similarity",
)
# What turns files into pictures, and says where range and bearing are in them.
_READING = (
    "simnfnd.evaluation.pairs",
    "simnfnd.evaluation.image_files",
    "simnfnd.factory.dataset.read",
    "simnfnd.factory.sonar",
)
# Wider than need be: a digest that is too narrow would let old figures pass for new ones.
_NETWORKS = ("simnfnd.models", "simnfnd.evaluation.methods.networks")


def program_digest() -> str:
    """Changes with the code and the libraries that decide the figures of every method."""
    return _digest([sources_digest(*_MEASURING, *_READING), *map(_version, _LIBRARIES)])


def network_digest(device: str) -> str:
    """Changes with the code that runs networks, with torch, and with the kind of device.

    device: auto, cpu or gpu, as in the settings.
    """
    return _digest([sources_digest(*_NETWORKS), _version("torch"), _device_kind(device)])


@lru_cache(maxsize=16)
def sources_digest(*modules: str) -> str:
    """Changes with the source of these modules; of packages, with that of everything in them."""
    digest = hashlib.blake2b(digest_size=12)
    for module in modules:
        spec = find_spec(module)
        if spec is None or spec.origin is None:
            raise ModuleNotFoundError(module)
        path = Path(spec.origin)
        package = spec.submodule_search_locations is not None
        for file in sorted(path.parent.rglob("*.py")) if package else [path]:
            digest.update(f"{module} {file.relative_to(path.parent).as_posix()}\n".encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()


def _device_kind(device: str) -> str:
    import torch

    if device != "cpu" and torch.cuda.is_available():
        return torch.cuda.get_device_name()
    return "cpu"


def _version(library: str) -> str:
    try:
        return f"{library} {metadata.version(library)}"
    except metadata.PackageNotFoundError:
        return f"{library} absent"


def _digest(parts: Iterable[str]) -> str:
    return hashlib.blake2b("\n".join(parts).encode(), digest_size=12).hexdigest()
