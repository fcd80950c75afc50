"""A pack: renders of many frames in one file, to make pairs of where there is no Blender.

A zip archive: `pack.json` says what is in it, and each frame is a member in the format of
`simnfnd.factory.render.view`, with the checksum that zip has for it.
"""

from __future__ import annotations

import json
import os
import zipfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

from simnfnd.factory import __version__
from simnfnd.factory.errors import FactoryError, NotRendered
from simnfnd.factory.files import explain_os_errors
from simnfnd.factory.frame import FrameRef
from simnfnd.factory.render.mount import Mount
from simnfnd.factory.render.view import FINE, Precision, View, decode, encode

_SCHEMA = "simnfnd-pack 2"
_CONTENTS = "pack.json"
# Equal packs of equal renders, whenever they are made.
_TIME = (1980, 1, 1, 0, 0, 0)


@dataclass(frozen=True)
class Contents:
    """What a pack holds.

    members: frame -> name in the archive, in the order of the frames.  exact: pairs made of it are
    those that the renders themselves give, to the byte.
    """

    members: Mapping[FrameRef, str]
    mount: Mount
    render: str
    exact: bool


def write_pack(
    path: Path,
    refs: Iterable[FrameRef],
    view: Callable[[FrameRef], View],
    mount: Mount,
    render: str,
    precision: Precision = FINE,
) -> int:
    """Write the views of `refs` to `path`, whole or not at all; returns its bytes."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    frames: list[dict[str, str]] = []
    with explain_os_errors(path, "--out"):
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            with zipfile.ZipFile(temporary, "w") as archive:
                for number, ref in enumerate(refs):
                    member = f"{number:06d}.view"
                    _add(archive, member, encode(view(ref), precision))
                    names = {"location": ref.location, "scene": ref.scene, "frame": ref.frame}
                    frames.append({**names, "member": member})
                head = {
                    "schema": _SCHEMA,
                    "generator": f"simnfnd {__version__}",
                    "render": render,
                    "mount": asdict(mount),
                    "precision": asdict(precision),
                    "frames": frames,
                }
                _add(archive, _CONTENTS, json.dumps(head, indent=1).encode())
            size = temporary.stat().st_size
            os.replace(temporary, path)
        finally:
            temporary.unlink(missing_ok=True)
    return size


def _add(archive: zipfile.ZipFile, name: str, content: bytes) -> None:
    archive.writestr(zipfile.ZipInfo(name, _TIME), content)


def read_contents(path: Path) -> Contents:
    """What the pack holds.  Raises FactoryError when it is no pack."""
    try:
        with zipfile.ZipFile(path) as archive:
            head = json.loads(archive.read(_CONTENTS))
        if head["schema"] != _SCHEMA:
            raise ValueError(f"schema is {head['schema']!r}, expected {_SCHEMA!r}")
        mount = {**head["mount"], "translation_m": tuple(head["mount"]["translation_m"])}
        members = {
            FrameRef(item["location"], item["scene"], item["frame"]): str(item["member"])
            for item in head["frames"]
        }
        precision = Precision(**head["precision"])
        exact = (precision.depth_step, precision.radiance_step, precision.block) == (
            FINE.depth_step,
            FINE.radiance_step,
            FINE.block,
        )
        return Contents(members, Mount(**mount), str(head["render"]), exact)
    except OSError as error:
        raise FactoryError(f"scenes.root={path}: cannot be read ({error.strerror})") from error
    except (zipfile.BadZipFile, ValueError, KeyError, TypeError) as error:
        raise FactoryError(
            f"scenes.root={path}: no pack, or damaged ({error}); "
            "make one with `simnfnd cache pack --out FILE ...`"
        ) from error


class PackViews:
    """Renders in a pack; a `simnfnd.factory.renders.views.Views`."""

    def __init__(self, root: str, mount: Mount) -> None:
        """Raises FactoryError when the pack was made for another mount of the sonar."""
        self._path = Path(root).expanduser()
        self._contents = read_contents(self._path)
        if self._contents.mount != mount:
            raise FactoryError(
                f"sonar.mount: the pack {root} holds renders for {asdict(self._contents.mount)}; "
                "set the same, or pack renders of yours"
            )

    def holds(self, ref: FrameRef) -> bool:
        """See `simnfnd.factory.renders.views.Views`."""
        return ref in self._contents.members

    def view(self, ref: FrameRef) -> View:
        """See `simnfnd.factory.renders.views.Views`."""
        if ref not in self._contents.members:
            raise NotRendered(ref.name)
        try:
            with zipfile.ZipFile(self._path) as archive:
                return decode(archive.read(self._contents.members[ref]))
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise FactoryError(
                f"scenes.root={self._path}: {ref.name} is damaged ({error}); copy the pack again"
            ) from error
