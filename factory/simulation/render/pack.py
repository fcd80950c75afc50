"""A pack: renders of many frames in one file, to make pairs where Blender is not installed.

A zip archive: `pack.json` lists the frames and how they were rendered, and each frame is a member
in the format of `simulation.render.view`.  See `simulation.scenes.pack`.
"""

from __future__ import annotations

import json
import zipfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import NamedTuple

from pydantic import TypeAdapter

from ... import __version__
from ...common.errors import FactoryError
from ...common.files import whole_file
from ...dataset.frame_ref import FrameRef
from ..scenes.pack import (
    DAMAGE,
    INDEX_NAME,
    SCHEMA,
    Member,
    digest_of,
    digest_of_frames,
    opened_pack,
    pack_errors,
    read_index,
    read_member,
)
from .base import Mount, RenderSettings
from .view import View, decode, encode, mount_of

# A fixed time stamp: equal renders give equal packs, whenever they are packed.
_TIME = (1980, 1, 1, 0, 0, 0)


class Contents(NamedTuple):
    """The content of a pack.

    members: in the order of the frames.  render: what made the renders.  digest: of all frames
    and views.  classes: of the user's own objects, see `meaning.class_names`.
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
                    "digest": digest_of(content),
                }
                archive.writestr(zipfile.ZipInfo(frame["member"], _TIME), content)
                frames.append(frame)
            head = {
                "schema": SCHEMA,
                "generator": f"simnfnd {__version__}",
                "render": asdict(render),
                "mount": asdict(mount),
                "digest": digest_of_frames(frames),
                "frames": frames,
                **({"classes": list(classes)} if classes else {}),
            }
            archive.writestr(zipfile.ZipInfo(INDEX_NAME, _TIME), json.dumps(head, indent=1))
        size = partial.stat().st_size
    return size


def read_contents(path: Path) -> Contents:
    """Read and check what the pack holds.  Raises FactoryError when the file is no pack."""
    index = read_index(path)
    with pack_errors(path):
        mount = mount_of(index.mount)
        render = TypeAdapter(RenderSettings).validate_python(index.render)
    return Contents(index.members, mount, render, index.digest, index.classes)


def read_view(path: Path, member: Member) -> View:
    """Decode the view of a member of `Contents`.  Raises FactoryError when it is damaged."""
    try:
        with opened_pack(path) as archive:
            content = read_member(archive, member.name)
        if digest_of(content) != member.digest:
            raise ValueError("not the view that pack.json states")
        return decode(content)
    except (OSError, *DAMAGE) as error:
        raise FactoryError(
            f"scenes.root={path}: {member.name} is damaged ({error}); copy the pack again"
        ) from error
