"""A pack: renders of many frames in one file, to make pairs of where there is no Blender.

A zip archive: `pack.json` says what is in it and how it was rendered, and each frame is a member in
the format of `simnfnd.factory.render.view`, whose digest pack.json states.
"""

from __future__ import annotations

import hashlib
import json
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

from pydantic import TypeAdapter

from .. import __version__
from ..errors import FactoryError
from ..files import whole_file
from ..frame import FrameRef
from ..settings import ClassName
from ..small_files import open_regular, parse_json
from .base import Mount, RenderSettings
from .view import View, decode, encode, mount_of

_SCHEMA = "simnfnd-pack 3"
# Of version 0.4: it named the renderer alone and had no digests.
_SCHEMA_OF_0_4 = "simnfnd-pack 2"
_DIGEST_BYTES = 16
_CONTENTS = "pack.json"
_MOST_MEMBER_BYTES = 1 << 27
_NO_PACK = (
    *(zipfile.BadZipFile, ValueError, KeyError, TypeError, AttributeError, NotImplementedError),
    *(RuntimeError, EOFError),
)
# Equal packs of equal renders, whenever they are made.
_TIME = (1980, 1, 1, 0, 0, 0)


class Member(NamedTuple):
    """Name of a view in the archive, and 32 hexadecimal digits of its content; empty: unknown."""

    name: str
    digest: str = ""


class Contents(NamedTuple):
    """What a pack holds.

    members: in the order of the frames.  render: what made the renders; of a pack of version 0.4
    its kind alone is known, and the others are the defaults.  digest: of all frames and views.
    classes: of the user's own objects, see `labels.class_names`.
    """

    members: Mapping[FrameRef, Member]
    mount: Mount
    render: RenderSettings
    digest: str
    classes: tuple[str, ...] = ()


def write_pack(
    path: Path,
    refs: Iterable[FrameRef],
    view: Callable[[FrameRef], View],
    mount: Mount,
    render: RenderSettings,
    classes: Sequence[str] = (),
) -> int:
    """Write the views of `refs` to `path`, whole or not at all; returns its bytes."""
    frames: list[dict[str, str]] = []
    with whole_file(path) as partial:
        with zipfile.ZipFile(partial, "w") as archive:
            for number, ref in enumerate(refs):
                content = encode(view(ref))
                frame = {
                    "location": ref.location,
                    "scene": ref.scene,
                    "frame": ref.frame,
                    "member": f"{number:06d}.view",
                    "digest": _digest_of(content),
                }
                archive.writestr(zipfile.ZipInfo(frame["member"], _TIME), content)
                frames.append(frame)
            head = {
                "schema": _SCHEMA,
                "generator": f"simnfnd {__version__}",
                "render": asdict(render),
                "mount": asdict(mount),
                "digest": _digest_of_frames(frames),
                "frames": frames,
                **({"classes": list(classes)} if classes else {}),
            }
            archive.writestr(zipfile.ZipInfo(_CONTENTS, _TIME), json.dumps(head, indent=1))
        size = partial.stat().st_size
    return size


def read_contents(path: Path) -> Contents:
    """What the pack holds.  Raises FactoryError when it is no pack."""
    try:
        with _opened(path) as archive:
            head = parse_json(_member(archive, _CONTENTS))
        if head["schema"] not in (_SCHEMA, _SCHEMA_OF_0_4):
            raise ValueError(f"schema is {head['schema']!r}, expected {_SCHEMA!r}")
        if not isinstance(head["frames"], list):
            raise ValueError("frames is no list")
        if head["schema"] == _SCHEMA_OF_0_4:
            head["render"] = {"kind": head["render"]}
            head["digest"] = _digest_of_file(path)
        elif head["digest"] != _digest_of_frames(head["frames"]):
            raise ValueError("its digest is not that of its frames")
        if head["render"]["kind"] == "auto":
            raise ValueError("it does not say which renderer made it")
        members = {
            _ref(item): Member(str(item["member"]), str(item.get("digest", "")))
            for item in head["frames"]
        }
        return Contents(
            members,
            mount_of(head["mount"]),
            TypeAdapter(RenderSettings).validate_python(head["render"]),
            str(head["digest"]),
            TypeAdapter(tuple[ClassName, ...]).validate_python(head.get("classes", ()))[:200],
        )
    except OSError as error:
        raise FactoryError(f"scenes.root={path}: cannot be read ({error.strerror})") from error
    except _NO_PACK as error:
        raise FactoryError(
            f"scenes.root={path}: no pack, or damaged ({error}); "
            "make one with `simnfnd cache pack --out FILE ...`"
        ) from error


@contextmanager
def _opened(path: Path) -> Iterator[zipfile.ZipFile]:
    with open_regular(path) as file, zipfile.ZipFile(file) as archive:
        yield archive


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    info = archive.getinfo(name)
    if info.compress_type != zipfile.ZIP_STORED or info.file_size != info.compress_size:
        raise zipfile.BadZipFile(f"{name[:40]} is compressed; packs hold their members as they are")
    if info.file_size > _MOST_MEMBER_BYTES:
        raise zipfile.BadZipFile(f"{name[:40]} has {info.file_size} bytes")
    return archive.read(info)


def _ref(item: Mapping[str, object]) -> FrameRef:
    """The frame of an entry of pack.json.  Raises ValueError for names that are none."""
    names = [item[key] for key in ("location", "scene", "frame")]
    if not all(isinstance(name, str) and name.isprintable() and len(name) < 200 for name in names):
        raise ValueError(f"no names of a frame: {str(names)[:60]}")
    location, scene, frame = map(str, names)
    return FrameRef(location, scene, frame)


def read_view(path: Path, member: Member) -> View:
    """The view of a member of `Contents`.  Raises FactoryError when it is damaged."""
    try:
        with _opened(path) as archive:
            content = _member(archive, member.name)
        if member.digest and _digest_of(content) != member.digest:
            raise ValueError("not the view that pack.json states")
        return decode(content)
    except (OSError, *_NO_PACK) as error:
        raise FactoryError(
            f"scenes.root={path}: {member.name} is damaged ({error}); copy the pack again"
        ) from error


def _digest_of(content: bytes) -> str:
    return hashlib.blake2b(content, digest_size=_DIGEST_BYTES).hexdigest()


def _digest_of_frames(frames: Sequence[Mapping[str, object]]) -> str:
    """Of the names and digests of all views, in order."""
    keys = ("location", "scene", "frame", "digest")
    listed = [[str(frame[key]) for key in keys] for frame in frames]
    return _digest_of(json.dumps(listed).encode())


def _digest_of_file(path: Path) -> str:
    digest = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    with open_regular(path) as file:
        while content := file.read(1 << 20):
            digest.update(content)
    return digest.hexdigest()
