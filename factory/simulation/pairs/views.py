"""Where the clean renders come from: made by one kind of worker, kept on disk, read by another.

`ViewMaker` loads and renders frames and needs Blender or Open3D; `open_views` gives what it made to
those that add noise, which need neither.  A render is kept under a hash of all that decides its
pixels, one file an entry, written whole or not at all, with checksums: an entry that was damaged is
removed when it is met, and made again.  The file's time is when it was last used.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import TypeAdapter

from ...common import extensions
from ...common.errors import FactoryError, FrameError, NotRendered
from ...common.files import explain_os_errors, remove_stale_temporaries, write_atomically
from ...common.small_files import open_regular, read_regular
from ...dataset.frame_ref import FrameRef
from ...dataset.schema import Prepared
from ..config.renderer_choice import renderer_of
from ..render.base import CacheSettings, Mount, Renderer, RenderSettings
from ..render.pack import read_contents, read_view
from ..render.view import View, decode, encode, view_of
from ..scenes import Scenes, open_reader
from ..scenes.base import OwnSceneSettings
from ..scenes.seabed import GENERATOR
from .compilation import compile_needed

if TYPE_CHECKING:
    from ..config.root import FactoryConfig

_SUFFIX = ".view"
_MOST_BYTES = 1 << 27
# Errors of files that are too large or no files: reading again cannot help.
_NO_VIEW = (errno.EFBIG, errno.EINVAL)
# Evicted at once, so that a full cache is not scanned for every entry.
_EVICT_TO = 0.9


class CacheEntry(NamedTuple):
    """A render on disk; entries sort by the time of their last use, ns since 1970."""

    used_ns: int
    path: Path
    size_bytes: int


class Cache:
    """The entries below one folder; any number of processes may use it at once."""

    def __init__(self, settings: CacheSettings) -> None:
        self.folder = settings.folder
        self._max_bytes = settings.max_bytes
        self._total: int | None = None

    def path(self, key: str) -> Path:
        """Where an entry is, or would be."""
        return self.folder / key[:2] / f"{key}{_SUFFIX}"

    def get(self, key: str) -> View | None:
        """The entry, or None when it is absent or was damaged (and is now removed).

        Raises OSError when it is there and cannot be read now: it may be whole.
        """
        path = self.path(key)
        try:
            content = read_regular(path, _MOST_BYTES)
        except FileNotFoundError:
            return None
        except OSError as error:
            if error.errno not in _NO_VIEW:
                raise
            path.unlink(missing_ok=True)
            return None
        try:
            view = decode(content)
        except ValueError:
            path.unlink(missing_ok=True)
            return None
        with suppress(OSError):  # a cache that others own may be read only
            os.utime(path)
        return view

    def put(self, key: str, view: View) -> int:
        """Store an entry; returns its bytes.  Raises FactoryError when there is no room."""
        content = encode(view)
        path = self.path(key)
        with explain_os_errors(path.parent, "cache.dir"):
            path.parent.mkdir(parents=True, exist_ok=True)
        # Its checksums tell what a power cut left half done, so waiting for the disk is needless.
        write_atomically(path, content, durable=False, key="cache.dir")
        return len(content)

    def entries(self) -> list[CacheEntry]:
        """List the entries; leaves out those that vanish meanwhile."""
        entries = []
        for path in sorted(self.folder.glob(f"??/*{_SUFFIX}")):
            with suppress(FileNotFoundError):
                status = path.stat()
                entries.append(CacheEntry(status.st_mtime_ns, path, status.st_size))
        return entries

    def note_growth(self, added_bytes: int) -> None:
        """Count the bytes of entries that were added; beyond the limit, make room.

        Removes the entries that were unused longest, and temporary files of dead writers.
        """
        if not added_bytes:
            return
        if self._total is not None:
            self._total += added_bytes
            if self._total <= self._max_bytes:
                return
        for folder in self.folder.glob("??"):
            remove_stale_temporaries(folder)
        entries = sorted(self.entries())
        self._total = sum(size for _, _, size in entries)
        most = _EVICT_TO * self._max_bytes if self._total > self._max_bytes else self._total
        for _, path, size in entries:
            if self._total <= most:
                break
            path.unlink(missing_ok=True)
            self._total -= size


# Which frames are chosen changes none of them.
_NOT_PIXELS = {
    "root",
    "file",
    "path",
    "locations",
    "first_location",
    "frames_per_location",
    "scenes",
    # Moving objects are put into a frame after it was rendered.
    "moving_objects",
}
# All code and data between the files of a recording and the rendered pixels.
RENDER_CODE = (
    "common/array_types.py",
    "common/compiled.py",
    "common/distribution.py",
    "common/elementary.py",
    "common/errors.py",
    "common/files.py",
    "common/isolated.py",
    "common/limits.py",
    "common/private_apis.py",
    "common/quiet.py",
    "common/seeds.py",
    "common/settings.py",
    "common/small_files.py",
    "dataset/frame_ref.py",
    "dataset/meaning.py",
    "simulation/frames",
    "simulation/meshes",
    "simulation/render",
    "simulation/scenes",
)
"""Modules and rooms of the factory; of a room, all files."""
_LIBRARY = {"cycles": "bpy", "embree": "open3d-cpu", "analytic": "numpy"}


@cache
def _code_version(kind: str) -> str:
    """Stands for the source files and the library that a renderer consists of."""
    root = Path(__file__).parents[2]
    digest = hashlib.blake2b(digest_size=8)
    for place in (root / name for name in RENDER_CODE):
        files = sorted(place.rglob("*.py")) + sorted(place.rglob("*.yaml"))
        for path in files or [place]:
            digest.update(path.relative_to(root).as_posix().encode() + b"\0" + path.read_bytes())
    try:
        library = metadata.version(_LIBRARY[kind])
    except metadata.PackageNotFoundError:
        library = "another build"
    return f"{digest.hexdigest()} {_LIBRARY[kind]} {library}"


@lru_cache(maxsize=64)
def _digest(path: str, size: int, modified_ns: int, changed_ns: int) -> str:
    """Hash of a file's content, computed again once its size or one of its times has changed.

    A tool that rewrites a file may restore its size and its time of modification, but not
    `changed_ns`.  Calibrations and trajectories come with every frame, and are read once.
    """
    # Processors have instructions for SHA-256: it takes half the time of BLAKE2b.
    with open_regular(Path(path)) as file:  # reading a pipe would wait for ever
        return hashlib.file_digest(file, "sha256").hexdigest()[:32]  # type: ignore[arg-type]


class Views:
    """Gives the renders of frames; this class those in memory, its subclasses those on disk."""

    def __init__(self, views: Mapping[FrameRef, Any]) -> None:
        self._views = views

    def holds(self, ref: FrameRef) -> bool:
        """Whether the frame's render is there."""
        return ref in self._views

    def view(self, ref: FrameRef) -> View:
        """The frame's render.  Raises NotRendered when it is not there (any more)."""
        if ref not in self._views:
            raise NotRendered(ref.name)
        view: View = self._views[ref]
        return view


class PackViews(Views):
    """Renders in a pack."""

    def __init__(self, root: str, mount: Mount) -> None:
        """Raises FactoryError when the pack was made for another mount of the sonar."""
        self._path = Path(root).expanduser()
        contents = read_contents(self._path)
        super().__init__(contents.members)
        if contents.mount != mount:
            raise FactoryError(
                f"sonar.mount: the pack {root} holds renders for {asdict(contents.mount)}; "
                "set the same, or pack renders of yours"
            )

    def view(self, ref: FrameRef) -> View:
        """See `Views`."""
        if not self.holds(ref):
            raise NotRendered(ref.name)
        return read_view(self._path, self._views[ref])


def open_views(config: FactoryConfig) -> Views:
    """The renders that the configuration means: of the cache, or of a pack."""
    if config.scenes.kind == "pack":
        return PackViews(config.scenes.root, config.sonar.mount)
    return CachedViews(config)


class CachedViews(Views):
    """Renders in the cache."""

    def __init__(self, config: FactoryConfig) -> None:
        self.cache = Cache(config.cache)
        kinds: TypeAdapter[object] = TypeAdapter(tuple[Scenes, RenderSettings, Mount])
        render = renderer_of(config).settings
        pixel_settings = config.scenes, render, config.sonar.mount
        scenes, *others = kinds.dump_python(pixel_settings, mode="json")
        pixels = {key: value for key, value in scenes.items() if key not in _NOT_PIXELS}
        version = GENERATOR if config.scenes.kind == "seabed" else None
        common: tuple[Any, ...] = pixels, *others, _code_version(render.kind), version
        if isinstance(config.scenes, OwnSceneSettings):
            common = *common, extensions.provenance("reader", config.scenes.kind)
        self._common = json.dumps(common, sort_keys=True)
        self._scenes = config.scenes
        self._expected: Mapping[str, str] = {}

    def key(self, ref: FrameRef) -> str:
        """32 hexadecimal digits.  Raises OSError when a file of the frame cannot be read.

        The content of its files counts and not where they lie, so a recording may be moved.
        """
        ref = self._scenes.rendered_ref(ref)
        states = [(path, os.stat(path)) for path in ref.paths]
        contents = [
            _digest(path, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
            for path, status in states
        ]
        text = json.dumps([self._common, ref.location, ref.scene, ref.frame, contents])
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def set_cache_keys(self, keys: Mapping[str, str]) -> None:
        """Look for these frames, by their names, under these keys and ask their files no more."""
        self._expected = dict(keys)

    def holds(self, ref: FrameRef) -> bool:
        """See `Views`."""
        with suppress(OSError):
            return self.cache.path(self._expected.get(ref.name) or self.key(ref)).exists()
        return False

    def view(self, ref: FrameRef) -> View:
        """See `Views`."""
        key = self._expected.get(ref.name)
        if not key:
            try:
                key = self.key(ref)
            except OSError as error:  # a file of the recording: who renders it says which
                raise NotRendered(ref.name) from error
        try:
            view = self.cache.get(key)
        except OSError as error:
            raise FrameError(
                f"{ref.name}: its render {self.cache.path(key)} cannot be read "
                f"({error.strerror}); it is kept, run again"
            ) from error
        if view is None:
            raise NotRendered(ref.name)
        return view


class ViewMaker:
    """Renders frames into the cache; a `simnfnd.factory.dataset.schema.Preparer`."""

    def __init__(self, config: FactoryConfig) -> None:
        self.config = config
        self.reader = open_reader(config.scenes)
        self.views = CachedViews(config)
        self._renderer: Renderer | None = None

    def prepare(self, ref: FrameRef) -> Prepared:
        """Render one frame, unless that was done.  Raises FrameError when the frame is bad."""
        try:
            key = self.views.key(ref)
        except OSError as error:
            self.reader.load(ref)  # knows best what to say about its files
            raise FrameError(f"{ref.name}: {error.filename}: {error.strerror}") from error
        if self.views.cache.path(key).exists():
            # Whether it is whole shows when it is read, once: by the worker that needs it.
            return Prepared(hit=True, bytes=0, key=key)
        return Prepared(hit=False, bytes=self.views.cache.put(key, self.render(ref)), key=key)

    def render(self, ref: FrameRef) -> View:
        """Load and render one frame."""
        if self._renderer is None:
            # Not before it is needed: with all renders at hand Blender need not be loaded.
            from ..render import open_renderer

            compile_needed(scenes=self.config.scenes.kind)
            self._renderer = open_renderer(renderer_of(self.config).settings)
        mount = self.config.sonar.mount
        frame = self.reader.load(self.config.scenes.rendered_ref(ref))
        return view_of(frame, self._renderer.render(frame, mount), mount)
