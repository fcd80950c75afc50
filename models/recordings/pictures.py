"""Image files, one or a folder of them by name; arrays; pages of TIFF and animated GIF files."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property, lru_cache
from io import BytesIO
from pathlib import Path
from typing import IO, Any
from zipfile import ZipFile

import cv2
import numpy as np
from PIL import Image

from ...factory.errors import FactoryError, FrameError
from ...factory.isolated import look_at
from ...factory.quiet import quiet_stderr
from .base import (
    ARRAY_SUFFIX,
    ARRAY_SUFFIXES,
    FULL_SCALE,
    PICTURE_SUFFIXES,
    TOO_LARGE,
    Frame,
    Recording,
    Samples,
    ask_bytes,
    ask_pixels,
    explained,
    swapped,
    untinted,
)
from .names import in_order
from .orientation import EXIF_ORIENTATION, UPRIGHT, Orientation, orientation_of_exif
from .tiff import TIFF_HEADS, directories_of, with_upright_tags

_FORMAT: Any = np.lib.format  # whose functions are not typed
LEAST_SIDE_PX = 16  # smaller arrays are tables: poses, matrices, bearings
_COLOURS = ((1,), (3,), (4,))
# MATLAB's class -> dtype; the others (logical, char, cell, struct, sparse) are no pictures.
_MATLAB = {"double": "f8", "single": "f4"} | {
    f"{sign}int{8 * size}": f"{sign or 'i'}{size}" for sign in ("", "u") for size in (1, 2, 4)
}


class Pictures(Recording):
    """A `Recording` of picture files: one, those given, or all right in a folder, by name.

    Those of a folder come in the order of their sequences, see `names`.
    """

    def __init__(self, path: Path, files: Sequence[Path] = ()) -> None:
        """files: below the folder `path`.  Raises FactoryError when there are none."""
        self._given = files
        super().__init__(path)

    def _open(self) -> None:
        self.files = list(self._given) or [self.path]
        if self.path.is_dir() and not self._given:
            files = sorted(file for file in self.path.iterdir() if file.is_file())
            kinds = PICTURE_SUFFIXES
            images = [file for file in files if file.suffix.lower() in kinds]
            self.files = in_order([file for file in images if not is_table(file)])
        self.count = len(self.files)
        if not self.count:
            raise FactoryError(f"{self.path}: holds no picture ({', '.join(PICTURE_SUFFIXES)})")

    def _read(self, number: int) -> Frame:
        return Frame(number, read_picture(self.files[number]))


def read_picture(path: Path) -> Samples:
    """The pixels of a file as stored, (H, W) or (H, W, colours).  Raises FrameError; see `decoded`.

    Of a TIFF of several pages, and of an array of several pictures, the first.
    """
    if path.suffix.lower() == ARRAY_SUFFIX:
        with explained(f"{path}: not a readable array"), ArrayFile(path) as array:
            return array[0].samples
    try:
        content = path.read_bytes()
    except OSError as error:
        raise FrameError(f"{path}: not a readable picture ({error.strerror})") from error
    return decoded(content, str(path))


def decoded(content: bytes, what: str) -> Samples:
    """The pixels of a picture file, (H, W) or (H, W, colours).

    what: names it in errors.  Raises FrameError when it cannot be read or is too large.
    """
    # Its size first: a small file can decode to gigabytes.
    with _opened(BytesIO(content), what) as header:
        ask_pixels(what, *header.size)
        orientation = _orientation_of(header)
    if content[:4] in TIFF_HEADS and orientation != UPRIGHT:
        # OpenCV turns some of these itself and fails at the others; here all are turned below.
        directories, _ = directories_of(BytesIO(content), len(content))
        content = with_upright_tags(content, directories[0])
    # libjpeg and libtiff write to the terminal about damage that they pass over.
    with explained(f"{what}: not a readable picture"), quiet_stderr():
        picture = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    if picture is None:
        raise FrameError(f"{what}: not a readable picture")
    return as_samples(orientation.upright(np.asarray(picture)), what)


def _orientation_of(header: Image.Image) -> Orientation:
    """As the tag in an image file says; upright where it is damaged."""
    try:
        with explained("no Exif"):
            return orientation_of_exif(header.getexif().get(EXIF_ORIENTATION))
    except FrameError:
        return UPRIGHT


def _opened(file: IO[bytes], what: str, formats: tuple[str, ...] | None = None) -> Image.Image:
    """A picture whose pixels are not read yet.  Raises FrameError."""
    with explained(f"{what}: not a readable picture"):
        try:
            return Image.open(file, formats=formats)
        except Image.DecompressionBombError as error:
            raise FrameError(f"{what}: {TOO_LARGE}") from error


def as_samples(page: Samples, what: str) -> Samples:
    """A page whose numbers are grey values as they are: uint8, uint16, or floats as float32.

    what: names it in errors.  Raises FrameError for other dtypes, NaN and floats outside 0..1.
    """
    if page.dtype.kind == "f":
        with np.errstate(over="ignore"):  # infinite: outside 0..1
            page = page.astype(np.float32)
    if str(page.dtype) not in FULL_SCALE:
        raise FrameError(f"{what}: pixels are {page.dtype}; expected {', '.join(FULL_SCALE)}")
    if page.dtype == np.float32 and not (page.min() >= 0 and page.max() <= 1):
        raise FrameError(
            f"{what}: floats must be grey values from 0 to 1, these are {page.min():g} to "
            f"{page.max():g}; scale them (of echoes in linear units the logarithm)"
        )
    return page


class ArrayFile(Recording):
    """A `Recording` of the pictures in a file's one array of them, in BGR order (red first there).

    stored: the array, (H, W), (N, H, W), or either with colours; mapped in a .npy file.  The others
    are .npz and .mat (MATLAB up to version 7, where the number of the picture is the last axis).
    """

    def _open(self) -> None:
        found = _arrays(self.path)
        if not found:
            raise FrameError(
                f"{self.path}: holds no pictures; expected (H, W), (H, W, 3), (N, H, W) or "
                f"(N, H, W, 3), {LEAST_SIDE_PX} pixels or more on a side"
            )
        if len(found) > 1:
            raise FrameError(
                f"{self.path}: holds several arrays of pictures ({', '.join(list(found)[:6])}); "
                "save the one that is meant as .npy"
            )
        ((name, (shape, dtype)),) = found.items()
        height, width = shape[:2] if _is_single(shape) else shape[1:3]
        ask_pixels(str(self.path), width, height)
        if self.path.suffix.lower() != ARRAY_SUFFIX:
            ask_bytes(f"{self.path}: {name}", math.prod(shape) * dtype.itemsize, self.size)
        self._name, self._single = name, _is_single(shape)
        self.count = 1 if self._single else shape[0]

    @cached_property
    def stored(self) -> Samples:
        """See the class; unpacked when it is first asked for."""
        with explained(f"{self.path}: cannot be read; is the file damaged?", reason=True):
            return _load(self.path, self._name)

    def _read(self, number: int) -> Frame:
        what = f"{self.path}: picture {number + 1}" if self.count > 1 else str(self.path)
        page = self.stored if self._single else self.stored[number]
        return Frame(number, as_samples(np.ascontiguousarray(swapped(page)), what))


def kind_of_array(path: Path) -> str | None:
    """`pictures` for a .npy file of one, `array` for others, None where none is of pictures.

    Of a file that cannot be read, as if it held some.
    """
    alone = path.suffix.lower() == ARRAY_SUFFIX
    try:
        found = _arrays(path)
    except FactoryError:
        return "pictures" if alone else "array"
    if not found:
        return None
    return "pictures" if alone and _is_single(found[""][0]) else "array"


def is_table(path: Path) -> bool:
    """Whether a file of arrays holds no pictures: folders have such beside them."""
    return path.suffix.lower() in ARRAY_SUFFIXES and kind_of_array(path) is None


def _is_single(shape: tuple[int, ...]) -> bool:
    """Whether an array is one picture, without an axis for their number."""
    return len(shape) == 2 or shape[2:] in _COLOURS


def _arrays(path: Path) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
    """Name -> shape and dtype of the arrays that may be pictures; nothing is unpacked.

    Raises FactoryError.
    """
    with explained(f"{path}: not a readable array", reason=True):
        return _listed(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=4096)
def _listed(path: Path, changed_ns: int) -> dict[str, tuple[tuple[int, ...], np.dtype[Any]]]:
    """See `_arrays`; a file's kind is asked for several times before it is opened."""
    suffix = path.suffix.lower()
    if suffix == ".mat":
        # SciPy may crash over a damaged file, so another process looks at it first.
        listed = look_at(path, list_matlab, str(path))
    elif suffix == ".npz":
        listed = list(_members(path))
    else:
        array = _load(path, "")
        listed = [("", array.shape, array.dtype)]
    found = {name: (tuple(shape), np.dtype(kind)) for name, shape, kind in listed}
    return {name: one for name, one in found.items() if _may_be_pictures(*one)}


def _may_be_pictures(shape: tuple[int, ...], dtype: np.dtype[Any]) -> bool:
    pages = (1, *shape) if _is_single(shape) else shape
    fits = len(pages) == 3 or (len(pages) == 4 and pages[3:] in _COLOURS)
    return dtype.kind in "uif" and fits and pages[0] > 0 and min(pages[1:3]) >= LEAST_SIDE_PX


def _members(path: Path) -> Iterator[tuple[str, tuple[int, ...], np.dtype[Any]]]:
    """(name, shape, dtype) of the arrays in a .npz file."""
    with ZipFile(path) as archive:
        for name in archive.namelist():
            if name.endswith(ARRAY_SUFFIX):
                with archive.open(name) as stream:
                    version = "1_0" if _FORMAT.read_magic(stream) == (1, 0) else "2_0"
                    shape, _, dtype = getattr(_FORMAT, f"read_array_header_{version}")(stream)
                yield name.removesuffix(ARRAY_SUFFIX), shape, dtype


def list_matlab(path: str) -> list[list[Any]]:
    """[name, shape, dtype] of the numbers in a file, the number of the picture first.

    May crash, see `look_at`.
    """
    import scipy.io

    found = [one for one in scipy.io.whosmat(path) if one[2] in _MATLAB]
    return [[name, _stacked(shape), _MATLAB[kind]] for name, shape, kind in found]


def _stacked(shape: Sequence[int]) -> list[int]:
    """The shape with the last axis first where it counts pictures, (H, W, N) or (H, W, 3, N)."""
    sizes = [int(size) for size in shape]
    single = len(sizes) == 2 or sizes[2:] == [3]  # four are rather four pictures
    return sizes if single else [sizes[-1], *sizes[:-1]]


def _load(path: Path, name: str) -> Samples:
    """An array of a file.  May raise nearly anything."""
    suffix = path.suffix.lower()
    if suffix == ".mat":
        import scipy.io

        # Where numbers are complex SciPy would leave out the imaginary part.
        warnings.simplefilter("error", np.exceptions.ComplexWarning)
        # With its class: whole numbers of class double are stored as smaller ones.
        array = scipy.io.loadmat(path, mat_dtype=True, variable_names=[name])[name]
        is_stack = _stacked(array.shape) != list(array.shape)
        return np.asarray(np.moveaxis(array, -1, 0) if is_stack else array)
    if suffix == ".npz":
        with ZipFile(path) as archive, archive.open(name + ARRAY_SUFFIX) as stream:
            return np.asarray(_FORMAT.read_array(stream, allow_pickle=False))
    return np.asarray(np.load(path, mmap_mode="r", allow_pickle=False))


def write_array(file: IO[bytes], pictures: Iterable[Samples], like: Samples) -> None:
    """Write a .npy file with the shape and dtype of `like`, picture by picture.

    pictures: (H, W) or (H, W, colours) in BGR order.  Raises OSError.
    """
    dtype = like.dtype.newbyteorder("=")
    _FORMAT.write_array_header_1_0(
        file, {"descr": dtype.str, "fortran_order": False, "shape": like.shape}
    )
    for picture in pictures:
        file.write(np.ascontiguousarray(swapped(picture), dtype).tobytes())


def is_stack(path: Path) -> bool:
    """Whether a file is a TIFF whose second page is as large as the first (no smaller copy)."""
    try:
        with explained("no stack"), Image.open(path, formats=("TIFF",)) as image:
            first = image.size
            image.seek(1)
            return image.size == first
    except FrameError:
        return False


class StackFile(Recording):
    """A TIFF or GIF file; a `Recording` of pictures, (H, W) or (H, W, 3) BGR, one a page."""

    def _open(self) -> None:
        assert self._file is not None
        what = str(self.path)
        self._image = _opened(self._file, what, ("TIFF", "GIF"))
        with explained(f"{what}: not a readable picture"):
            self.count = int(getattr(self._image, "n_frames", 1))
        width, height = self._first = self._image.size
        ask_pixels(what, width, height)
        mode = self._image.mode
        wide = 2 if "16" in mode else 4 if mode in ("I", "F") else len(self._image.getbands())
        ask_bytes(what, self.count * width * height * wide, self.size, streamed=True)

    def _read(self, number: int) -> Frame:
        what = f"{self.path}: page {number + 1}"
        with explained(f"{what} cannot be read"), quiet_stderr():
            self._image.seek(number)
            size, colours = self._image.size, self._image.format == "GIF" or self._image.mode == "P"
            page = np.asarray(self._image.convert("RGB") if colours else self._image)
        if size != self._first:
            own, first = (f"{width} x {height}" for width, height in (size, self._first))
            raise FrameError(f"{what} has {own} pixels, the first {first}")
        # ImageJ writes 16 bits with the most significant byte first.
        page = np.ascontiguousarray(swapped(page))
        return Frame(number, as_samples(untinted(page) if colours else page, what))
