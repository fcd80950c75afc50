"""The name under which the render of a frame is kept: a hash of all that decides its pixels."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from ...frame import FrameRef
from ...scenes import Scenes
from ...scenes.seabed import GENERATOR
from ..base import RenderSettings
from ..mount import Mount

# Which frames are chosen changes none of them.
_NOT_PIXELS = (
    *("root", "file", "path", "locations", "first_location", "frames_per_location", "scenes"),
)
# All code between the files of a recording and the rendered pixels.
_CODE = ("compiled.py", "elementary.py", "frame.py", "labels.py", "render", "scenes")
_LIBRARY = {"cycles": "bpy", "embree": "open3d-cpu", "analytic": "numpy"}


class FrameKeys:
    """Keys of the frames of one configuration."""

    def __init__(self, scenes: Scenes, render: RenderSettings, mount: Mount) -> None:
        self._common = json.dumps(
            [
                {k: v for k, v in _plain(Scenes, scenes).items() if k not in _NOT_PIXELS},
                _plain(RenderSettings, render),
                _plain(Mount, mount),
                code_version(render.kind),
                GENERATOR if scenes.kind == "seabed" else None,
            ],
            sort_keys=True,
        )

    def of(self, ref: FrameRef) -> str:
        """32 hexadecimal digits.  Raises OSError when a file of the frame cannot be read.

        The content of its files counts and not where they lie, so a recording may be moved.
        """
        contents = [_content(path) for path in ref.paths]
        text = json.dumps([self._common, ref.location, ref.scene, ref.frame, contents])
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


@cache
def code_version(kind: str) -> str:
    """Stands for the source files and the library that a renderer consists of."""
    root = Path(__file__).parents[2]
    digest = hashlib.blake2b(digest_size=8)
    for path in _sources(root):
        digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    try:
        library = metadata.version(_LIBRARY[kind])
    except metadata.PackageNotFoundError:
        library = "another build"
    return f"{digest.hexdigest()} {_LIBRARY[kind]} {library}"


def _sources(root: Path) -> Iterable[Path]:
    for name in _CODE:
        path = root / name
        yield from sorted(path.rglob("*.py")) if path.is_dir() else [path]


def _content(path: str) -> str:
    status = os.stat(path)
    return _digest(path, status.st_size, status.st_mtime_ns)


@lru_cache(maxsize=64)
def _digest(path: str, size: int, modified_ns: int) -> str:
    # Calibrations and trajectories come with every frame of a recording: read them once.
    # SHA-256, for which processors have instructions: half the time of BLAKE2b.
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:32]


def _plain(kind: Any, value: object) -> dict[str, Any]:
    values: dict[str, Any] = TypeAdapter(kind).dump_python(value, mode="json")
    return values
