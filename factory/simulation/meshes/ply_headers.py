"""Headers of .ply files: how many faces one claims, and how its colours are stored and called."""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass
from pathlib import Path

_MOST_HEADER_BYTES = 1 << 16
_ELEMENT = re.compile(r"element\s+(\S+)\s+(\d{1,18})")
_PROPERTY = re.compile(r"property\s+(\S+)\s+(\S+)")
_USUAL = ("red", "green", "blue")
_OTHER_NAMES = (("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))


@dataclass(frozen=True)
class PlyHeader:
    """What the header of a .ply says.

    text: the header itself, with its last line end.  face_count: of the faces that it claims.
    vertex_types: name -> type of the properties of a vertex.  face_names: of a face's.
    has_strips: whether triangles stand in strips, as in scans of the Stanford collection.
    """

    text: str
    face_count: int
    vertex_types: dict[str, str]
    face_names: frozenset[str]
    has_strips: bool

    @property
    def colour_type(self) -> str | None:
        """Type of the colours of vertices, such as `uchar`; None where there are none."""
        for names in (_USUAL, *_OTHER_NAMES):
            if self.vertex_types.keys() >= set(names):
                return self.vertex_types[names[0]]
        return None

    @property
    def remarks(self) -> list[str]:
        """What it has and is not read."""
        remarks = []
        if self.colour_type is None and "red" in self.face_names:
            remarks.append("colours of faces are not read; give them to the vertices")
        if re.search(r"^comment TextureFile ", self.text, re.MULTILINE):
            remarks.append("the texture of a .ply is not read; export a .glb or .obj")
        return remarks

    def with_usual_names(self) -> str:
        """The header with colours called red, green and blue."""
        text = self.text
        if self.vertex_types.keys() >= set(_USUAL):
            return text
        for names in _OTHER_NAMES:
            if self.vertex_types.keys() >= set(names):
                for name, usual in zip(names, _USUAL, strict=True):
                    text = re.sub(rf"(property\s+\S+\s+){name}(?=\s)", rf"\g<1>{usual}", text)
                break
        return text


def read_header(path: Path) -> PlyHeader:
    """The header of a .ply.  Raises ValueError for a file without one."""
    with path.open("rb") as file:
        content = file.read(_MOST_HEADER_BYTES)
    end = re.search(rb"^end_header[^\n]*\n", content, re.MULTILINE)
    if not content.startswith(b"ply") or end is None:
        raise ValueError("no header of a .ply")
    text = content[: end.end()].decode("latin-1")
    face_count = 0
    vertex_types: dict[str, str] = {}
    face_names: set[str] = set()
    has_strips = False
    element = ""
    for line in text.splitlines():
        if match := _ELEMENT.match(line):
            element = match[1]
            face_count += int(match[2]) if element == "face" else 0
            has_strips = has_strips or (element == "tristrips" and int(match[2]) > 0)
        elif match := _PROPERTY.match(line):
            if element == "vertex":
                vertex_types[match[2]] = match[1]
            if element == "face":
                face_names.add(match[2])
    return PlyHeader(text, face_count, vertex_types, frozenset(face_names), has_strips)


def copy_with_header(path: Path, length: int, text: str, copy: Path) -> None:
    """Write a copy of a file whose first `length` bytes are another header."""
    with path.open("rb") as source, copy.open("wb") as target:
        source.seek(length)
        target.write(text.encode("latin-1"))
        shutil.copyfileobj(source, target)
