"""A finished (noisy, clean) pair and the words that describe it: what shards carry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from ...frame import FrameRef

if TYPE_CHECKING:
    from .echoes import EchoList


@dataclass(frozen=True, eq=False)
class Axis:
    """One image axis: the coordinate of every row or column centre, for example range in metres."""

    name: str
    units: str
    values: npt.NDArray[np.float64]
    description: str = ""


@dataclass(frozen=True)
class Column:
    """One column of the per-sample table: `dtype` is a numpy type string such as f4, i8 or S64."""

    name: str
    dtype: str
    units: str = ""
    description: str = ""


@dataclass(frozen=True, eq=False)
class Pair:
    """One sample.

    noisy, clean: (H, W) uint8, or float32 in [0, 1].
    shadow: (H, W) bool, True inside the sonar's sector where no echo arrives in the ideal image.
    record: column name -> value, everything needed to make this very sample again.
    layers: name -> (H, W) optional picture (rgb: (H, W, 3)), as `format.layers` describes them.
    echoes: every echo behind the pair, where that was asked for.
    """

    noisy: npt.NDArray[np.generic]
    clean: npt.NDArray[np.generic]
    shadow: npt.NDArray[np.bool_]
    record: Mapping[str, float | int | str] = field(default_factory=dict)
    layers: Mapping[str, npt.NDArray[np.generic]] = field(default_factory=dict)
    echoes: EchoList | None = None


@dataclass(frozen=True)
class Prepared:
    """What became of one frame.

    hit: it was ready already.  bytes: added to the cache.  key: what a `PairSource` finds it by, so
    that it need not be worked out again (by reading all files of the frame); empty: nothing.
    """

    hit: bool
    bytes: int
    key: str = ""


class PairSource(Protocol):
    """Makes the pairs of a frame; each worker process builds its own from the configuration."""

    def axes(self) -> tuple[Axis, Axis]:
        """The row and column axes of the images."""

    def columns(self) -> tuple[Column, ...]:
        """The columns that every pair's record has, in order."""

    def pairs(self, ref: FrameRef, variants: tuple[int, ...]) -> list[Pair]:
        """All asked variants of one frame.  Raises FrameError when the frame is bad."""

    def ready(self, ref: FrameRef) -> bool:
        """Whether `pairs` has all that it needs; else a `Preparer` has to see the frame first."""

    def expect(self, keys: Mapping[str, str]) -> None:
        """Take the keys of frames that were prepared, by their names; those before are forgotten.

        Frames without a key are found as before.
        """


class Preparer(Protocol):
    """Does what is slow and the same for all noise; its workers are few and heavy."""

    def prepare(self, ref: FrameRef) -> Prepared:
        """Make a frame ready for `PairSource.pairs`.  Raises FrameError when it is bad."""
