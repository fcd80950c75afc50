"""Optional parts of an install: which of them a command requires, and one line for missing ones.

Searches for modules without importing them, so that a run is refused before it does any work.
"""

from __future__ import annotations

from collections.abc import Iterable
from importlib.util import find_spec
from typing import NamedTuple

from .errors import FactoryError

EXTRAS = {
    "cv2": "sonar",
    "av": "sonar",
    "scipy": "sonar",
    "bpy": "blender",
    "open3d": "open3d",
    "torch": "train",
    "safetensors": "denoise",
    "optuna": "report",
    "pandas": "report",
    "pycocotools": "report",
    "pyarrow": "export",
    "skimage": "report",
    "jinja2": "report",
    "distributed": "cluster",
    "huggingface_hub": "export",
    "webdataset": "export",
    "onnx": "onnx",
    "onnxruntime": "denoise",
    "matplotlib": "figures",
    "rosbags": "ros",
    "s3fs": "cloud",
}
"""Module -> the extra of pyproject.toml that installs it."""


class Need(NamedTuple):
    """A module that a choice of the user requires.

    choice: the override that requires it, for example `render=cycles`.
    instead: overrides that do not require it; empty: there are none.
    """

    choice: str
    module: str
    instead: str = ""


def install_command(*extras: str) -> str:
    """Return the shell command that installs `extras`."""
    return f'pip install "simnfnd[{",".join(dict.fromkeys(extras))}]"'


def require(needs: Iterable[Need]) -> None:
    """Raise FactoryError, one line, unless all modules are installed."""
    missing = [need for need in needs if find_spec(need.module) is None]
    if not missing:
        return

    modules_of_choice: dict[str, list[str]] = {}
    for need in missing:
        modules_of_choice.setdefault(need.choice, []).append(need.module)
    reasons = ", ".join(
        f"{choice} needs {' and '.join(modules)}" for choice, modules in modules_of_choice.items()
    )
    remedy = install_command(*(EXTRAS[need.module] for need in missing))
    others = "; ".join(dict.fromkeys(need.instead for need in missing if need.instead))
    if others:
        remedy += f", or choose {others}"
    raise FactoryError(f"{reasons}: {remedy}")
