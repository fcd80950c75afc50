"""The `pack` reader: frames that were rendered elsewhere and packed into one file.

A pack is a zip archive.  `pack.json` lists its frames, each with the member that holds its render
and the digest of that member; `simnfnd.factory.simulation.render.pack` decodes the renders.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import TypeAdapter
from pydantic.dataclasses import dataclass

from ...common.errors import FactoryError, FrameError
from ...common.settings import STRICT, ClassName
from ...common.small_files import open_regular, parse_json
from ...dataset.frame_ref import FrameRef
from ..frames.frame import Frame
from .base import Discovery, Root, SceneSettings

SCHEMA = "simnfnd-pack 3"
INDEX_NAME = "pack.json"
_DIGEST_BYTES = 16
DAMAGE = (
    zipfile.BadZipFile,
    ValueError,
    KeyError,
    TypeError,
    AttributeError,
    NotImplementedError,
    RuntimeError,
    EOFError,
)
"""What reading a damaged pack can raise."""


@dataclass(frozen=True, config=STRICT, kw_only=True)
class PackSettings(SceneSettings):
    """Keys of `scenes=pack`.  root: a file that `simnfnd cache pack` has written."""

    kind: Literal["pack"] = "pack"
    root: Root

    def own_classes(self) -> tuple[str, ...]:
        """The packed classes; empty for a pack that cannot be read, which `discover` refuses."""
        try:
            return read_index(Path(self.root).expanduser()).classes
        except FactoryError:
            return ()


class PackReader:
    """Lists the frames of a pack."""

    def __init__(self, settings: PackSettings) -> None:
        self.settings = settings

    def discover(self) -> Discovery:
        """See `simnfnd.factory.simulation.scenes.base.Reader`."""
        index = read_index(Path(self.settings.root).expanduser())
        if not index.members:
            raise FactoryError(f"scenes.root={self.settings.root}: the pack is empty; pack again")
        note = f"pack: {len(index.members)} frames of render.kind={index.render['kind']}"
        return Discovery(tuple(index.members), {}, (note,))

    def load(self, ref: FrameRef) -> Frame:
        """Always raises FrameError: a pack holds renders, and no colour to render them again."""
        raise FrameError(f"{ref.name}: scenes=pack has renders and no frames")


# --- the index


class Member(NamedTuple):
    """Name of a view in the archive, and 32 hexadecimal digits of its content."""

    name: str
    digest: str


class PackIndex(NamedTuple):
    """What `pack.json` states.

    members: in the order of the frames.  mount, render: settings, not yet validated.
    digest: of all frames and views.
    classes: of the user's own objects, see `meaning.class_names`.
    """

    members: Mapping[FrameRef, Member]
    mount: Any
    render: Mapping[str, Any]
    digest: str
    classes: tuple[str, ...]


def read_index(path: Path) -> PackIndex:
    """Read and check `pack.json`.  Raises FactoryError when the file is no pack."""
    with pack_errors(path):
        with opened_pack(path) as archive:
            head = parse_json(read_member(archive, INDEX_NAME))
        if head["schema"] != SCHEMA:
            raise ValueError(f"schema is {head['schema']!r}, expected {SCHEMA!r}")
        frames = head["frames"]
        if not isinstance(frames, list):
            raise ValueError("frames is no list")

        render = head["render"]
        digest = head["digest"]
        if digest != digest_of_frames(frames):
            raise ValueError("its digest is not that of its frames")
        if render["kind"] == "auto":
            raise ValueError("it does not say which renderer made it")

        members = {
            _frame_ref(entry): Member(str(entry["member"]), str(entry["digest"]))
            for entry in frames
        }
        classes: TypeAdapter[tuple[str, ...]] = TypeAdapter(tuple[ClassName, ...])
        class_names = classes.validate_python(head.get("classes", ()))
        return PackIndex(members, head["mount"], render, str(digest), class_names[:200])


@contextmanager
def pack_errors(path: Path) -> Iterator[None]:
    """Turn errors within the block into a FactoryError that names the pack and the remedy."""
    try:
        yield
    except OSError as error:
        raise FactoryError(f"scenes.root={path}: cannot be read ({error.strerror})") from error
    except DAMAGE as error:
        raise FactoryError(
            f"scenes.root={path}: no pack, or damaged ({error}); "
            "make one with `simnfnd cache pack --out FILE ...`"
        ) from error


@contextmanager
def opened_pack(path: Path) -> Iterator[zipfile.ZipFile]:
    """Open the archive for reading.  Raises OSError for what is no regular file."""
    with open_regular(path) as file, zipfile.ZipFile(file) as archive:
        yield archive


def read_member(archive: zipfile.ZipFile, name: str) -> bytes:
    """Return the content of a member.  Raises BadZipFile when it is compressed.

    A member that is stored as it is has no more bytes than the file.
    """
    info = archive.getinfo(name)
    if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
        raise zipfile.BadZipFile(f"{name[:40]} is compressed; members of packs are stored as is")
    return archive.read(info)


def _frame_ref(entry: Mapping[str, object]) -> FrameRef:
    """The frame of an entry of pack.json.  Raises ValueError for invalid names."""
    names = [entry[key] for key in ("location", "scene", "frame")]
    if not all(isinstance(name, str) and name.isprintable() and len(name) < 200 for name in names):
        raise ValueError(f"no names of a frame: {str(names)[:60]}")
    location, scene, frame = map(str, names)
    return FrameRef(location, scene, frame)


def digest_of(content: bytes) -> str:
    """BLAKE2b of a view, 32 hexadecimal digits."""
    return hashlib.blake2b(content, digest_size=_DIGEST_BYTES).hexdigest()


def digest_of_frames(frames: Sequence[Mapping[str, object]]) -> str:
    """BLAKE2b of the names and digests of all views, in order, 32 hexadecimal digits."""
    keys = ("location", "scene", "frame", "digest")
    rows = [[str(frame[key]) for key in keys] for frame in frames]
    return digest_of(json.dumps(rows).encode())
