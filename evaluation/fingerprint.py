"""What figures depend on beside picture, method and parameters: code, libraries and the device."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path

_LIBRARIES = ("numpy", "scipy", "opencv-python-headless", "scikit-image")
_RUNTIMES = ("torch", "onnxruntime")
# Wider than need be: a digest that is too narrow would let old figures pass for new ones.
_MEASURING = (
    "simnfnd.evaluation.metrics",
    "simnfnd.evaluation.runner",
    "simnfnd.evaluation.pairs",
    "simnfnd.evaluation.image_files",
    "simnfnd.factory.dataset.read",
    "simnfnd.factory.dataset.describe.similarity",
    "simnfnd.factory.sonar",
)
_NETWORKS = ("simnfnd.models", "simnfnd.evaluation.methods.networks")


def program_digest() -> str:
    """Changes with the code and the libraries that decide the figures of every method."""
    return _digest(sources_digest(*_MEASURING), *map(_version, _LIBRARIES))


def network_digest(device: str) -> str:
    """Changes with the code that runs networks, with what computes them, and with the device.

    device: auto, cpu or gpu, as in the settings.
    """
    runtimes = map(_version, _RUNTIMES)
    return _digest(sources_digest(*_NETWORKS), *runtimes, _device_kind(device))


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
    if device == "cpu" or find_spec("torch") is None:
        return device
    import torch

    return torch.cuda.get_device_name() if torch.cuda.is_available() else "cpu"


def _version(library: str) -> str:
    try:
        return f"{library} {metadata.version(library)}"
    except metadata.PackageNotFoundError:
        return f"{library} absent"


def _digest(*parts: str) -> str:
    return hashlib.blake2b("\n".join(parts).encode(), digest_size=12).hexdigest()
