"""Where the clean renders come from: made by one kind of worker, read by another.

`ViewMaker` loads and renders frames and needs Blender or Open3D; `open_views` gives what it made to
those that add noise, which need neither.  A render is kept under a hash of all that decides its
pixels.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path
from typing import Any, Protocol

from pydantic import TypeAdapter

from ..compiled import compile_needed
from ..dataset.format.schema import Prepared
from ..errors import FrameError, NotRendered
from ..frame import FrameRef
from ..scenes import Scenes, open_reader
from ..scenes.seabed import GENERATOR
from .base import Renderer, RenderSettings
from .cache import Cache, CacheSettings
from .mount import Mount
from .view import View, view_of

# Which frames are chosen changes none of them.
_NOT_PIXELS = {
    "root",
    "file",
    "path",
    "locations",
    "first_location",
    "frames_per_location",
    "scenes",
}
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
        states = [(path, os.stat(path)) for path in ref.paths]
        contents = [_digest(path, one.st_size, one.st_mtime_ns) for path, one in states]
        text = json.dumps([self._common, ref.location, ref.scene, ref.frame, contents])
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


@cache
def code_version(kind: str) -> str:
    """Stands for the source files and the library that a renderer consists of."""
    root = Path(__file__).parents[1]
    digest = hashlib.blake2b(digest_size=8)
    for place in (root / name for name in _CODE):
        for path in sorted(place.rglob("*.py")) if place.is_dir() else [place]:
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    try:
        library = metadata.version(_LIBRARY[kind])
    except metadata.PackageNotFoundError:
        library = "another build"
    return f"{digest.hexdigest()} {_LIBRARY[kind]} {library}"


@lru_cache(maxsize=64)
def _digest(path: str, size: int, modified_ns: int) -> str:
    # Calibrations and trajectories come with every frame of a recording: read them once.
    # SHA-256, for which processors have instructions: half the time of BLAKE2b.
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:32]


def _plain(kind: Any, value: object) -> dict[str, Any]:
    values: dict[str, Any] = TypeAdapter(kind).dump_python(value, mode="json")
    return values


class Mounted(Protocol):
    """What of a sonar a render depends on."""

    @property
    def mount(self) -> Mount:
        """Where it is."""


class RenderNeeds(Protocol):
    """The groups of the configuration that renders depend on."""

    @property
    def scenes(self) -> Scenes:
        """Which frames there are."""

    @property
    def render(self) -> RenderSettings:
        """How they are rendered."""

    @property
    def cache(self) -> CacheSettings:
        """Where renders are kept."""

    @property
    def sonar(self) -> Mounted:
        """Whose light it is."""


class Views(Protocol):
    """Gives the renders of frames."""

    def holds(self, ref: FrameRef) -> bool:
        """Whether the frame's render is there."""

    def view(self, ref: FrameRef) -> View:
        """The frame's render.  Raises NotRendered when it is not there (any more)."""


def open_views(config: RenderNeeds) -> Views:
    """The renders that the configuration means: of the cache, or of a pack."""
    if config.scenes.kind == "pack":
        from .pack import PackViews

        return PackViews(config.scenes.root, config.sonar.mount)
    return CachedViews(config)


class CachedViews:
    """Renders in the cache; a `Views`."""

    def __init__(self, config: RenderNeeds) -> None:
        self.cache = Cache(config.cache.folder)
        self.keys = FrameKeys(config.scenes, config.render, config.sonar.mount)
        self._expected: Mapping[str, str] = {}

    def expect(self, keys: Mapping[str, str]) -> None:
        """Look for these frames, by their names, under these keys and ask their files no more."""
        self._expected = dict(keys)

    def holds(self, ref: FrameRef) -> bool:
        """See `Views`."""
        try:
            return self.cache.holds(self._key(ref))
        except OSError:
            return False

    def view(self, ref: FrameRef) -> View:
        """See `Views`."""
        try:
            view = self.cache.get(self._key(ref))
        except OSError:
            view = None
        if view is None:
            raise NotRendered(ref.name)
        return view

    def _key(self, ref: FrameRef) -> str:
        """The frame's key.  Raises OSError when a file of it cannot be read."""
        return self._expected.get(ref.name) or self.keys.of(ref)


class OneView:
    """A render in memory, whatever the frame's name; a `Views`."""

    def __init__(self, view: View) -> None:
        self._view = view

    def holds(self, ref: FrameRef) -> bool:
        """See `Views`."""
        return True

    def view(self, ref: FrameRef) -> View:
        """See `Views`."""
        return self._view


class ViewMaker:
    """Renders frames into the cache; a `simnfnd.factory.dataset.format.schema.Preparer`."""

    def __init__(self, config: RenderNeeds) -> None:
        self.config = config
        self.reader = open_reader(config.scenes)
        self.views = CachedViews(config)
        self._renderer: Renderer | None = None

    def prepare(self, ref: FrameRef) -> Prepared:
        """Render one frame, unless that was done.  Raises FrameError when the frame is bad."""
        try:
            key = self.views.keys.of(ref)
        except OSError as error:
            self.reader.load(ref)  # knows best what to say about its files
            raise FrameError(f"{ref.name}: {error.filename}: {error.strerror}") from error
        if self.views.cache.holds(key):
            # Whether it is whole shows when it is read, once: by the worker that needs it.
            return Prepared(hit=True, bytes=0, key=key)
        return Prepared(hit=False, bytes=self.views.cache.put(key, self.render(ref)), key=key)

    def render(self, ref: FrameRef) -> View:
        """Load and render one frame."""
        if self._renderer is None:
            # Not before it is needed: with all renders at hand nobody has to load Blender.
            from . import open_renderer

            compile_needed(scenes=self.config.scenes.kind)
            self._renderer = open_renderer(self.config.render)
        frame = self.reader.load(ref)
        mount = self.config.sonar.mount
        return view_of(frame, self._renderer.render(frame, mount), mount)


def check_views(config: RenderNeeds, *, touch: bool = True) -> None:
    """Raise FactoryError when renders can be neither made nor kept; loads nothing heavy.

    touch: try to write into the cache.
    """
    from . import check_renderer

    if config.scenes.kind == "pack":
        return
    check_renderer(config.render)
    if config.cache.enabled and touch:
        Cache(config.cache.folder).check()
