"""Where the clean renders come from: made by one kind of worker, kept on disk, read by another.

`ViewMaker` loads and renders frames and needs Blender or Open3D; `open_views` gives what it made to
those that add noise, which need neither.  A render is kept under a hash of all that decides its
pixels, one file an entry, written whole or not at all, with checksums: an entry that was damaged is
removed when it is met, and made again.  The file's time is when it was last used.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass as plain_dataclass
from functools import cache, lru_cache
from importlib import metadata
from pathlib import Path
from typing import Annotated, Any, Protocol

from pydantic import Field, TypeAdapter
from pydantic.dataclasses import dataclass

from ..compiled import compile_needed
from ..dataset.schema import Prepared
from ..errors import FrameError, NotRendered
from ..files import check_writable, explain_os_errors, remove_stale_temporaries, write_atomically
from ..frame import FrameRef
from ..scenes import Scenes, open_reader
from ..scenes.seabed import GENERATOR
from ..settings import STRICT
from ..small_files import read_regular
from .base import Mount, Renderer, RenderSettings
from .view import View, decode, encode, view_of

_SUFFIX = ".view"
_MOST_BYTES = 1 << 27
# Room made at once, so that a full cache does not have to be gone through for every entry.
_EVICT_TO = 0.9


@dataclass(frozen=True, config=STRICT)
class CacheSettings:
    """Keys of the `cache` group.

    enabled: keep renders for later runs; else they last until the run ends.
    dir: folder of the cache.  max_bytes: when it holds more, what was not used for longest goes.
    """

    enabled: bool = True
    dir: Annotated[str, Field(min_length=1)] = "outputs/cache"
    max_bytes: Annotated[int, Field(ge=1)] = 20_000_000_000

    @property
    def folder(self) -> Path:
        """`dir` as an absolute path: workers may have another working folder."""
        return Path(os.path.abspath(Path(self.dir).expanduser()))


@plain_dataclass(frozen=True)
class Entry:
    """One file of the cache."""

    key: str
    path: Path
    bytes: int
    used_ns: int


class Cache:
    """The entries below one folder; any number of processes may use it at once."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def check(self) -> None:
        """Raise FactoryError with one line when the folder cannot be written."""
        check_writable(self.folder, "cache.dir")

    def holds(self, key: str) -> bool:
        """Whether there is an entry (whole or not)."""
        return self._path(key).exists()

    def get(self, key: str, *, used: bool = True) -> View | None:
        """The entry, or None when it is absent or was damaged (and is now removed).

        used: note that it was, so that it stays longer.
        """
        path = self._path(key)
        try:
            view = decode(read_regular(path, _MOST_BYTES))
        except (OSError, ValueError):
            path.unlink(missing_ok=True)
            return None
        with suppress(OSError):  # a cache that others own may be read only
            if used:
                os.utime(path)
        return view

    def put(self, key: str, view: View) -> int:
        """Store an entry; returns its bytes.  Raises FactoryError when there is no room."""
        content = encode(view)
        path = self._path(key)
        with explain_os_errors(path.parent, "cache.dir"):
            path.parent.mkdir(parents=True, exist_ok=True)
        # Its checksums tell what a power cut left half done, so waiting for the disk is needless.
        write_atomically(path, content, durable=False, key="cache.dir")
        return len(content)

    def entries(self) -> Iterator[Entry]:
        """All entries; those that vanish meanwhile are left out."""
        for path in sorted(self.folder.glob(f"??/*{_SUFFIX}")):
            try:
                status = path.stat()
            except FileNotFoundError:
                continue
            yield Entry(path.stem, path, status.st_size, status.st_mtime_ns)

    def evict(self, max_bytes: int) -> int:
        """When there is more than `max_bytes`, remove what was unused longest; returns bytes left.

        Temp files of dead writers go, too.
        """
        for folder in self.folder.glob("??"):
            remove_stale_temporaries(folder)
        entries = sorted(self.entries(), key=lambda entry: (entry.used_ns, entry.key))
        total = sum(entry.bytes for entry in entries)
        if total <= max_bytes:
            return total
        for entry in entries:
            if total <= _EVICT_TO * max_bytes:
                break
            entry.path.unlink(missing_ok=True)
            total -= entry.bytes
        return total

    def clear(self) -> int:
        """Remove every entry; returns how many there were."""
        entries = list(self.entries())
        for entry in entries:
            with explain_os_errors(entry.path, "cache.dir"):
                entry.path.unlink(missing_ok=True)
        return len(entries)

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}{_SUFFIX}"


class Limit:
    """Keeps a cache within its size while it grows: call it with the bytes that were added."""

    def __init__(self, settings: CacheSettings) -> None:
        self._cache, self._max_bytes = Cache(settings.folder), settings.max_bytes
        self._total: int | None = None

    def __call__(self, added_bytes: int) -> None:
        """Evict when there is too much.  Looks at the folder at the first call and then."""
        if added_bytes and self._total is not None:
            self._total += added_bytes
        if added_bytes and (self._total is None or self._total > self._max_bytes):
            self._total = self._cache.evict(self._max_bytes)


# Which frames are chosen changes none of them.
_NOT_PIXELS = [
    "root",
    "file",
    "path",
    "locations",
    "first_location",
    "frames_per_location",
    "scenes",
]
# All code between the files of a recording and the rendered pixels.
_CODE = ("compiled.py", "elementary.py", "frame.py", "labels.py", "render", "scenes")
_LIBRARY = {"cycles": "bpy", "embree": "open3d-cpu", "analytic": "numpy"}


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
        scenes, mount = _plain(Scenes, config.scenes), _plain(Mount, config.sonar.mount)
        pixels = {key: value for key, value in scenes.items() if key not in _NOT_PIXELS}
        version = GENERATOR if config.scenes.kind == "seabed" else None
        render = _plain(RenderSettings, config.render)
        common = pixels, render, mount, code_version(config.render.kind), version
        self._common = json.dumps(common, sort_keys=True)
        self._expected: Mapping[str, str] = {}

    def key(self, ref: FrameRef) -> str:
        """32 hexadecimal digits.  Raises OSError when a file of the frame cannot be read.

        The content of its files counts and not where they lie, so a recording may be moved.
        """
        states = [(path, os.stat(path)) for path in ref.paths]
        contents = [_digest(path, one.st_size, one.st_mtime_ns) for path, one in states]
        text = json.dumps([self._common, ref.location, ref.scene, ref.frame, contents])
        return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()

    def expect(self, keys: Mapping[str, str]) -> None:
        """Look for these frames, by their names, under these keys and ask their files no more."""
        self._expected = dict(keys)

    def holds(self, ref: FrameRef) -> bool:
        """See `Views`."""
        with suppress(OSError):
            return self.cache.holds(self._expected.get(ref.name) or self.key(ref))
        return False

    def view(self, ref: FrameRef) -> View:
        """See `Views`."""
        with suppress(OSError):
            view = self.cache.get(self._expected.get(ref.name) or self.key(ref))
            if view is not None:
                return view
        raise NotRendered(ref.name)


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
    """Renders frames into the cache; a `simnfnd.factory.dataset.schema.Preparer`."""

    def __init__(self, config: RenderNeeds) -> None:
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
