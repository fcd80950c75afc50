"""The doors by which a method enters: a folder, a function, filters and weights of our own."""

from __future__ import annotations

import importlib
import inspect
import os
import sys
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ...factory.errors import FactoryError
from ...factory.sonar.geometry import FanGeometry
from ..methods.apply import denoised
from ..methods.method import Method, reason, weights_digest
from ..methods.networks import network, networks_at
from . import pictures
from .folder import Benchmark, Entry, PictureSet
from .pictures import Gray8, Pixels


@dataclass(frozen=True, eq=False)
class Given:
    """What a method gets.  noisy: (H, W) uint8, of the file `path`."""

    where: str
    path: Path
    noisy: Gray8
    geometry: FanGeometry | None


class Entrant(ABC):
    """A method that enters.  facts: what its result says of it, beside its name."""

    facts: Mapping[str, Any]

    def problems(self, benchmark: Benchmark) -> list[str]:
        """What is wrong with it before anything runs, a line each."""
        return []

    def begin(self, pictures_: PictureSet) -> None:
        """Told which set comes next."""
        return

    @abstractmethod
    def picture(self, given: Given) -> tuple[Pixels, float | None]:
        """(H, W), and the CPU seconds that it took, None where nobody knows.

        Raises whatever the method raises.
        """

    def run(self, pictures_: PictureSet) -> Iterator[tuple[Entry, Given, Gray8, float | None]]:
        """Every picture of a set in 8 bits.  FactoryError, one line, when one cannot be had."""
        self.begin(pictures_)
        for one in pictures_.pictures:
            where = f"{pictures_.name}/{one.name}.png"
            noisy = pictures_.noisy(one)
            given = Given(where, pictures_.path(one), noisy, pictures_.geometry(one))
            try:
                found, seconds = self.picture(given)
            except FactoryError as error:
                raise FactoryError(f"{where}: {error}") from error
            except Exception as error:  # of somebody else's program
                raise FactoryError(f"{where}: the method failed: {reason(error)[:300]}") from error
            if found.shape != noisy.shape:
                raise FactoryError(
                    f"{where}: the method gave an array {found.shape} for a picture {noisy.shape}"
                )
            yield one, given, pictures.in_8_bits(found, where), seconds


class Folder(Entrant):
    """Pictures that are there already: FOLDER/SET/NAME.png."""

    def __init__(self, folder: Path) -> None:
        """Raises FactoryError when there is no such folder."""
        if not folder.is_dir():
            raise FactoryError(f"--denoised {folder}: no such folder")
        self._folder = folder
        self.facts = {"kind": "folder"}

    def problems(self, benchmark: Benchmark) -> list[str]:
        """A line for each picture that is absent, unreadable or of another size."""
        found = []
        for one in benchmark.sets.values():
            for entry in one.pictures:
                path = self._folder / one.name / f"{entry.name}.png"
                if not path.is_file():
                    found.append(f"{path}: missing")
                    continue
                try:
                    shape = pictures.read(path).shape
                except FactoryError as error:
                    found.append(str(error))
                    continue
                if shape != (wanted := one.noisy(entry).shape):
                    sizes = [f"{width}x{height}" for height, width in (shape, wanted)]
                    found.append(f"{path}: {sizes[0]} pixels, expected {sizes[1]}")
        return found

    def picture(self, given: Given) -> tuple[Pixels, float | None]:
        """See `Entrant`."""
        return pictures.read(self._folder / given.where), None


class Function(Entrant):
    """`module:function` that the user names: (H, W) float32 in 0..1 in, floats in 0..1 out."""

    def __init__(self, named: str) -> None:
        """Imports it, also from the present folder.  Raises FactoryError when that fails."""
        module, _, path = named.partition(":")
        if not module or not path:
            raise FactoryError(f"--function {named}: expected MODULE:FUNCTION")
        if (here := os.getcwd()) not in sys.path:
            sys.path.insert(0, here)
        try:
            found: Any = importlib.import_module(module)
            for part in path.split("."):
                found = getattr(found, part)
        except Exception as error:  # of somebody else's program
            raise FactoryError(f"--function {named}: {reason(error)[:300]}") from error
        if not callable(found):
            raise FactoryError(f"--function {named}: is no function")
        self._function: Callable[..., Any] = found
        self._told = "geometry" in _parameters(found)
        self.facts = {"kind": "function", "source": named}

    def picture(self, given: Given) -> tuple[Pixels, float | None]:
        """See `Entrant`; a function with a parameter `geometry` gets that, too."""
        grey = pictures.in_unit_range(given.noisy)
        more = {"geometry": given.geometry} if self._told else {}
        start = time.process_time()
        found = self._function(grey, **more)
        return np.asarray(found), time.process_time() - start


class Own(Entrant):
    """A filter or weights of this project.

    methods: set -> the method there; a filter may be tuned for each.
    """

    def __init__(
        self, methods: Mapping[str, Method], facts: Mapping[str, Any], device: str = "auto"
    ) -> None:
        self._methods, self._device = methods, device
        self._method = next(iter(methods.values()))
        self.facts = facts

    def begin(self, pictures_: PictureSet) -> None:
        """See `Entrant`."""
        self._method = self._methods[pictures_.name]

    def picture(self, given: Given) -> tuple[Pixels, float | None]:
        """See `Entrant`."""
        method, clock = self._method, time.process_time
        if method.weights is not None and network(method.weights, self._device).on_gpu:
            clock = time.perf_counter  # a processor that waits for a GPU seems idle
        grey = pictures.in_unit_range(given.noisy)
        start = clock()
        found = denoised(method, grey, self._device, None, given.geometry)
        found = found if method.levels is None else method.levels(found)
        return found, clock() - start


def weights_of(named: str, sets: Mapping[str, PictureSet], device: str) -> Own:
    """Weights: a file, a folder of a training, or a name of weights that ship."""
    try:
        (method,) = networks_at([named], {})
    except FactoryError as error:
        raise FactoryError(str(error).replace("models:", "--weights:", 1)) from error
    assert method.weights is not None
    facts = {"kind": "weights", "source": method.name, "sha256": weights_digest(method.weights)}
    return Own(dict.fromkeys(sets, method), facts, device)


def _parameters(function: Callable[..., Any]) -> set[str]:
    try:
        return set(inspect.signature(function).parameters)
    except (TypeError, ValueError):  # of a compiled one nothing is known
        return set()
