"""Directories of TIFF files: what they say of each page, and which pages are whole.

Reads classic TIFF (TIFF 6.0) and BigTIFF, and nothing but their directories.  Everything is
checked against the size of the file before it is used.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import IO, NamedTuple

from .page_axes import PageAxes, axes_of

WIDTH = 256
HEIGHT = 257
BITS = 258
COMPRESSION = 259
DESCRIPTION = 270
STRIP_OFFSETS = 273
ORIENTATION = 274
SAMPLES = 277
STRIP_BYTES = 279
X_RESOLUTION = 282
Y_RESOLUTION = 283
PLANES = 284
RESOLUTION_UNIT = 296
TILE_OFFSETS = 324
TILE_BYTES = 325
SAMPLE_FORMAT = 339
PHOTOMETRIC = 262
WHITE_IS_ZERO = 0
UNCOMPRESSED = 1
SEPARATE_PLANES = 2
TIFF_HEADS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")

_TYPES = {1: "B", 3: "H", 4: "I", 13: "I", 16: "Q", 18: "Q"}
_TEXT = 2
_FRACTION = 5
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8, 13: 4}
_SIZES |= {16: 8, 17: 8, 18: 8}
_MOST_ENTRIES = 4096
_MOST_VALUES = 1 << 22
_MOST_PAGES = 1 << 20
_FORMATS = {1: "u", 2: "i", 3: "f"}


Tags = dict[int, bytes | int | tuple[int, int]]
"""Tag -> its text, whole number, or fraction."""


class _Form(NamedTuple):
    """How the numbers of a file are stored.  order: `<` or `>`, as `struct` takes it."""

    order: str
    is_big: bool


@dataclass(frozen=True)
class Directory:
    """What a file says of one page.

    numbers: tag -> its whole numbers.  text: the description.  places: tag -> where its value
    stands in the file.  order: `<` or `>`, of the file's numbers.  fractions: tag -> numerator and
    denominator.
    """

    numbers: dict[int, tuple[int, ...]]
    text: str
    places: dict[int, int]
    order: str
    fractions: dict[int, tuple[int, int]]

    def number(self, tag: int, default: int = 0) -> int:
        """The first number of a tag."""
        return self.numbers.get(tag, (default,))[0]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        return self.number(WIDTH), self.number(HEIGHT)

    @property
    def dtype(self) -> str:
        """NumPy's name of the samples' type, in the order of the file; empty where it has none."""
        kind = _FORMATS.get(self.number(SAMPLE_FORMAT, 1), "")
        bits = self.number(BITS, 1)
        return f"{self.order}{kind}{bits // 8}" if kind and bits in (8, 16, 32, 64) else ""

    @property
    def page_bytes(self) -> int:
        """Bytes of the page's pixels without compression."""
        width, height = self.size
        return width * height * self.number(SAMPLES, 1) * self.number(BITS, 1) // 8

    @property
    def end(self) -> int:
        """Where the last strip or tile of the page ends."""
        offsets = self.numbers.get(STRIP_OFFSETS) or self.numbers.get(TILE_OFFSETS) or ()
        counts = self.numbers.get(STRIP_BYTES) or self.numbers.get(TILE_BYTES) or ()
        return max(
            (offset + count for offset, count in zip(offsets, counts, strict=False)), default=0
        )

    @property
    def axes(self) -> PageAxes | None:
        """How the pages of the file are counted; None where the description does not say."""
        width, height = self.size
        samples = self.number(SAMPLES, 1)
        page_shape: tuple[int, ...] = (height, width)
        if samples > 1:
            page_shape = (samples, *page_shape) if self.is_planar else (*page_shape, samples)
        return axes_of(self.text, page_shape)

    @property
    def is_planar(self) -> bool:
        """Whether the colours of a page lie one behind the other, each a plane."""
        return self.number(PLANES, 1) == SEPARATE_PLANES and self.number(SAMPLES, 1) > 1

    @property
    def is_white_zero(self) -> bool:
        """Whether 0 is white in whole numbers that libraries pass on as they are stored."""
        is_inverted = self.number(PHOTOMETRIC, 1) == WHITE_IS_ZERO
        return is_inverted and self.number(SAMPLES, 1) == 1 and self.number(BITS, 1) > 8

    @property
    def images_behind(self) -> int:
        """How many images lie one behind the other from the first strip on, as the text says.

        ImageJ writes a single directory for more than 4 GB (`images=N`), tifffile one before all
        pixels (`{"shape": [N, ...]}`); 1 where neither says so.
        """
        if self.number(COMPRESSION, 1) != UNCOMPRESSED or STRIP_OFFSETS not in self.numbers:
            return 1
        axes = self.axes
        return 1 if axes is None else axes.page_count


def directories_of(
    file: IO[bytes], size: int, most: int = _MOST_PAGES
) -> tuple[list[Directory], bool]:
    """The first directories of a file in order, and whether one of them lies beyond its end."""
    form = _form_of(file)
    if form is None:
        return [], False
    directories: list[Directory] = []
    visited: set[int] = set()
    offset = _first_offset(file, form)
    while offset and len(directories) < most:
        if offset in visited:  # a ring
            return directories, False
        visited.add(offset)
        directory = _directory_at(file, size, offset, form)
        if directory is None:
            return directories, True
        directories.append(directory[0])
        offset = directory[1]
    return directories, False


def _form_of(file: IO[bytes]) -> _Form | None:
    """Form of a TIFF; None for any other file."""
    file.seek(0)
    head = file.read(4)
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None or len(head) < 4:
        return None
    (version,) = struct.unpack(f"{order}H", head[2:])
    return _Form(order, version == 43) if version in (42, 43) else None


def _first_offset(file: IO[bytes], form: _Form) -> int:
    place, kind = (8, "Q") if form.is_big else (4, "I")
    return next(_numbers_at(file, place, 1, f"{form.order}{kind}"), 0)


def _directory_at(
    file: IO[bytes], size: int, offset: int, form: _Form
) -> tuple[Directory, int] | None:
    """A directory and where the next one lies; None where the file ends before it does."""
    # Bytes of the number of entries and of an entry, and the type of a place in the file.
    head, entry, link = (8, 20, "Q") if form.is_big else (2, 12, "I")
    count = next(_numbers_at(file, offset, 1, form.order + ("Q" if form.is_big else "H")), -1)
    link_place = offset + head + count * entry
    if not 0 < count <= _MOST_ENTRIES or link_place > size:
        return None
    numbers: dict[int, tuple[int, ...]] = {}
    places: dict[int, int] = {}
    fractions: dict[int, tuple[int, int]] = {}
    text = ""
    for number in range(count):
        at = offset + head + number * entry
        tag, kind = _numbers_at(file, at, 2, f"{form.order}H")
        length = next(_numbers_at(file, at + 4, 1, f"{form.order}{link}"), 0)
        # A value that fits stands in the entry itself; else its place does.
        inline = at + (12 if form.is_big else 8)
        place = inline
        if length * _SIZES.get(kind, 1) > (8 if form.is_big else 4):
            place = next(_numbers_at(file, inline, 1, f"{form.order}{link}"), 0)
        if length > _MOST_VALUES or place + length * _SIZES.get(kind, 1) > size:
            continue
        places[tag] = place
        if kind in _TYPES:
            numbers[tag] = tuple(_numbers_at(file, place, length, form.order + _TYPES[kind]))
        elif kind == _FRACTION and length == 1:
            numerator, denominator = _numbers_at(file, place, 2, f"{form.order}I")
            fractions[tag] = (numerator, denominator)
        elif kind == _TEXT and tag == DESCRIPTION and not text:
            file.seek(place)
            text = file.read(length).rstrip(b"\0").decode("latin-1")
    following = next(_numbers_at(file, link_place, 1, f"{form.order}{link}"), 0)
    values = {tag: value_list for tag, value_list in numbers.items() if value_list}
    return Directory(values, text, places, form.order, fractions), following


def _numbers_at(file: IO[bytes], place: int, count: int, kind: str) -> Iterator[int]:
    """Numbers of a type of `struct`, with its byte order; fewer at the end of the file."""
    file.seek(place)
    width = struct.calcsize(kind)
    content = file.read(count * width)
    content = content[: len(content) // width * width]
    return (value for (value,) in struct.iter_unpack(kind, content))


def with_upright_tags(content: bytes, directory: Directory) -> bytes:
    """The bytes of a file whose first page says that it is upright."""
    place = directory.places.get(ORIENTATION)
    if place is None:
        return content
    changed = bytearray(content)
    struct.pack_into(f"{directory.order}H", changed, place, 1)
    return bytes(changed)
