"""The index of a pack: which frames the archive holds, checked without decoding any of them.

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
from typing import Any, NamedTuple

from pydantic import TypeAdapter

from ...common.errors import FactoryError
from ...common.settings import ClassName
from ...common.small_files import open_regular, parse_json
from ...dataset.frame_ref import FrameRef

SCHEMA = "simnfnd-pack 3"
# The schema of version 0.4, which named the renderer alone and had no digests.
_SCHEMA_OF_0_4 = "simnfnd-pack 2"
INDEX_NAME = "pack.json"
_DIGEST_BYTES = 16
_MOST_MEMBER_BYTES = 1 << 27
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


class Member(NamedTuple):
    """Name of a view in the archive, and 32 hexadecimal digits of its content; empty: unknown."""

    name: str
    digest: str = ""


class PackIndex(NamedTuple):
    """What `pack.json` states.

    members: in the order of the frames.  mount, render: settings, not yet validated; packs of
    version 0.4 state the kind of the renderer alone.  digest: of all frames and views.
    classes: of the user's own objects, see `labels.class_names`.
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
        if head["schema"] not in (SCHEMA, _SCHEMA_OF_0_4):
            raise ValueError(f"schema is {head['schema']!r}, expected {SCHEMA!r}")
        frames = head["frames"]
        if not isinstance(frames, list):
            raise ValueError("frames is no list")

        render = head["render"]
        if head["schema"] == _SCHEMA_OF_0_4:
            render = {"kind": render}
            digest = _digest_of_file(path)
        else:
            digest = head["digest"]
            if digest != digest_of_frames(frames):
                raise ValueError("its digest is not that of its frames")
        if render["kind"] == "auto":
            raise ValueError("it does not say which renderer made it")

        members = {
            _frame_ref(entry): Member(str(entry["member"]), str(entry.get("digest", "")))
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
    """Return the content of a member.  Raises BadZipFile when it is compressed or too large."""
    info = archive.getinfo(name)
    if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
        raise zipfile.BadZipFile(f"{name[:40]} is compressed; members of packs are stored as is")
    if info.file_size > _MOST_MEMBER_BYTES:
        raise zipfile.BadZipFile(f"{name[:40]} has {info.file_size} bytes")
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


def _digest_of_file(path: Path) -> str:
    digest = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    with open_regular(path) as file:
        while content := file.read(1 << 20):
            digest.update(content)
    return digest.hexdigest()
