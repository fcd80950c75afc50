"""The doors for other programs: an ONNX file, and a command line."""

from __future__ import annotations

import resource
import shlex
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from ...factory.errors import FactoryError
from ...factory.files import sha256_of
from ...factory.small_files import one_line
from ...models.removal import DEFAULT, vector
from . import pictures
from .folder import PictureSet
from .methods import Entrant, Given
from .pictures import Pixels

_MAPS = ("range_fraction", "azimuth_rad", "sector")
_TYPES = {"tensor(float)": np.float32, "tensor(double)": np.float64, "tensor(float16)": np.float16}
_IN, _OUT, _IN_FOLDER, _OUT_FOLDER = "{in}", "{out}", "{in_folder}", "{out_folder}"


class Onnx(Entrant):
    """An ONNX file: its first input is the picture in 0..1, its first output the denoised one.

    Inputs of the names that `simnfnd export-weights` gives them (range_fraction, azimuth_rad,
    sector, remove) are filled in.
    """

    def __init__(self, path: Path) -> None:
        """Raises FactoryError for a file that onnxruntime does not take."""
        import onnxruntime

        if not path.is_file():
            raise FactoryError(f"--onnx {path}: no such file")
        options = onnxruntime.SessionOptions()
        # One thread, so that CPU seconds are those of the work.
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 4
        try:
            self._session = onnxruntime.InferenceSession(
                str(path), options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # onnxruntime has a dozen of its own
            raise FactoryError(f"--onnx {path}: not usable ({one_line(error)})") from error
        first, *others = self._session.get_inputs()
        if first.type not in _TYPES or len(first.shape) not in (2, 3, 4):
            raise FactoryError(
                f"--onnx {path}: input {first.name} is {first.type} of {len(first.shape)} axes; "
                "expected floats of shape (1, 1, H, W), (1, H, W) or (H, W)"
            )
        for one in others:
            if one.name not in (*_MAPS, "remove"):
                raise FactoryError(
                    f"--onnx {path}: what input {one.name} is is not known; give a file of one "
                    f"input, or with {', '.join(_MAPS)} and remove"
                )
        self._first, self._others = first, others
        self.facts = {"kind": "onnx", "source": path.name, "sha256": sha256_of(path)}

    def picture(self, given: Given) -> tuple[Pixels, float | None]:
        """See `Entrant`."""
        inputs = {self._first.name: self._shaped(pictures.in_unit_range(given.noisy), self._first)}
        for one in self._others:
            if one.name == "remove":
                inputs[one.name] = vector(DEFAULT)[None].astype(_TYPES.get(one.type, np.float32))
            elif given.geometry is None:
                raise FactoryError(f"input {one.name} needs the geometry, which is not known here")
            else:
                maps = given.geometry.maps(0, 0, *given.noisy.shape)
                inputs[one.name] = self._shaped(maps[one.name], one)
        start = time.process_time()
        found = np.asarray(self._session.run(None, inputs)[0])
        seconds = time.process_time() - start
        axes = tuple(axis for axis in range(found.ndim - 2) if found.shape[axis] == 1)
        return found.squeeze(axes).astype(np.float32), seconds

    def _shaped(self, picture: Pixels, wanted: Any) -> Pixels:
        shape = (*[1] * (len(wanted.shape) - 2), *picture.shape)
        return picture.reshape(shape).astype(_TYPES.get(wanted.type, np.float32))


class Command(Entrant):
    """A program that the user names, without a shell: `prog {in} {out}` for every picture.

    With {in_folder} and {out_folder} it runs once a set.
    """

    def __init__(self, line: str, timeout_s: float) -> None:
        """Raises FactoryError for a line without the two places."""
        try:
            self._words = shlex.split(line)
        except ValueError as error:
            raise FactoryError(f"--command {line}: {error}") from error
        places = [all(one in line for one in pair) for pair in (_PICTURE, _SET)]
        if sum(places) != 1 or any(one in self._words[0] for one in (*_PICTURE, *_SET)):
            raise FactoryError(
                f"--command {line}: give the program with {_IN} and {_OUT} (a picture at a time), "
                f"or {_IN_FOLDER} and {_OUT_FOLDER} (a set at a time), in quotes"
            )
        self._by_set, self._timeout_s = places[1], timeout_s
        self._seconds: float | None = None
        self._temporary = tempfile.TemporaryDirectory(prefix="simnfnd-benchmark-")
        self._out = Path(self._temporary.name)
        self.facts = {"kind": "command", "source": line}

    def begin(self, pictures_: PictureSet) -> None:
        """See `Entrant`."""
        if not self._by_set:
            return
        out = self._out / pictures_.name
        out.mkdir()
        folder = pictures_.folder.resolve()
        count = len(pictures_.pictures)
        try:
            seconds = self._run({_IN_FOLDER: folder, _OUT_FOLDER: out}, self._timeout_s * count)
        except FactoryError as error:
            raise FactoryError(f"{pictures_.name}: {error}") from error
        self._seconds = seconds / count

    def picture(self, given: Given) -> tuple[Pixels, float | None]:
        """See `Entrant`; the seconds hold the start of the program."""
        if self._by_set:
            path, seconds = self._out / given.where, self._seconds
        else:
            path = self._out / "denoised.png"
            path.unlink(missing_ok=True)
            seconds = self._run({_IN: given.path.resolve(), _OUT: path}, self._timeout_s)
        if not path.is_file():
            raise FactoryError(f"the program wrote no {path.name} where it was told to")
        return pictures.read(path), seconds

    def _run(self, places: dict[str, Path], timeout_s: float) -> float:
        words = self._words
        for place, path in places.items():
            words = [word.replace(place, str(path)) for word in words]
        before = _seconds_of_children()
        try:
            done = subprocess.run(
                words, capture_output=True, timeout=timeout_s, check=False, stdin=subprocess.DEVNULL
            )
        except subprocess.TimeoutExpired:
            raise FactoryError(
                f"the program took more than {timeout_s:g} s (--timeout-s)"
            ) from None
        except OSError as error:
            raise FactoryError(f"{words[0]}: cannot be run ({one_line(error)})") from error
        if done.returncode:
            said = done.stderr.decode(errors="replace").strip().splitlines()[-1:]
            raise FactoryError(f"the program ended with {done.returncode}: {''.join(said)[:300]}")
        return _seconds_of_children() - before


_PICTURE, _SET = (_IN, _OUT), (_IN_FOLDER, _OUT_FOLDER)


def _seconds_of_children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
