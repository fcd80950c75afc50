"""From pictures as they are stored to denoised ones of the same kind: one composition for all.

The command, `simnfnd.denoise` and evaluation denoise by it, a picture or a sequence of them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, Generic, TypeVar

import numpy as np
import numpy.typing as npt

from ...factory.errors import FactoryError
from ...factory.scheduler.workers.machine import usable_cores
from ...factory.sonar.geometry import FanGeometry
from ..recordings.base import FULL_SCALE
from ..recordings.palettes import SUM, Painted, Palette, find_painted
from .temporal.stream import FRAMES, MOST_FRAMES, InTime, Network, Shot, Tally

Gray = npt.NDArray[np.float32]
Picture = npt.NDArray[Any]
Denoise = Callable[..., Gray]
"""(H, W) float32 in 0..1, and where range and bearing are, if known -> the same, denoised.

`frames` says how many frames count in each pixel of a fused picture, see `Denoiser`.
"""
Place = Callable[[Picture], FanGeometry | None]
"""Where range and bearing are in a picture; None where that is not known."""

Key = TypeVar("Key")


@dataclass(frozen=True, eq=False)
class Seen(Generic[Key]):
    """A picture as the network gets it.

    key: of the caller.  original: as it is stored.  painted: what its colours stand for.
    """

    key: Key
    original: Picture
    painted: Painted | None

    def finished(self, levels: Gray) -> Picture:
        """Denoised levels, (H, W) or (H, W, C) in 0..1, as a picture of the original's kind."""
        if self.painted is not None:
            return self.painted.repainted(levels)
        return restored(levels, self.original)


class Denoising:
    """What a run does to pictures, and what it did.

    tally: of pictures in time.  maps: colour map -> how many pictures had it.
    """

    def __init__(
        self,
        network: Network,
        *,
        frames: int = FRAMES,
        causal: bool = False,
        calibrated: bool = True,
    ) -> None:
        """See `InTime`.  Raises FactoryError for a number of frames that cannot be."""
        check_frames(frames)
        self.network, self.frames = network, frames
        self._causal, self._calibrated = causal, calibrated
        self.tally = Tally()
        self.maps: Counter[str] = Counter()
        self._last_map: Palette | None = None

    def seen(
        self,
        key: Key,
        picture: Picture,
        place: Place,
        shift_px: tuple[float, float] | None = None,
    ) -> Shot[Seen[Key]]:
        """A picture, its colours read.

        picture: (H, W) or (H, W, C) uint8, uint16 or float32 in 0..1.
        Raises ValueError for another dtype or shape, NaN, and floats outside 0..1.
        """
        check(picture)
        painted = find_painted(picture, self._last_map)
        if painted is not None:
            self._last_map = painted.palette
            self.maps[painted.palette.name] += 1
        plain = picture if painted is None else painted.levels
        seen = Seen(key, picture, painted)
        return Shot(seen, levels_of(plain), partial(place, plain), shift_px)

    def sequence(
        self, pictures: Iterable[Shot[Seen[Key]]], *, alone: bool = False
    ) -> Iterator[tuple[Seen[Key], Picture]]:
        """Each picture of a sequence and what became of it, in order."""
        stream: InTime[Seen[Key]] = InTime(
            self.network,
            frames=1 if alone else self.frames,
            causal=self._causal,
            calibrated=self._calibrated,
            tally=self.tally,
            at_once=1 if alone else usable_cores(),
        )
        for shot in pictures:
            for done, levels in stream.push(shot):
                yield done, done.finished(levels)
        for done, levels in stream.finish():
            yield done, done.finished(levels)

    def one(self, picture: Picture, place: Place) -> Picture:
        """A picture by itself.  Raises ValueError as `seen` does."""
        ((_, denoised),) = self.sequence([self.seen(None, picture, place)], alone=True)
        return denoised

    def summary(self) -> Iterator[str]:
        """A line if colours stood for levels, and lines of what was done in time."""
        if self.maps:
            named = ", ".join(f"{name} in {count}" for name, count in self.maps.items())
            yield (
                f"colour maps: {named}; their levels were denoised and painted again "
                f"({SUM}: a map that is not known, by the sum of its channels)"
            )
        yield from self.tally.lines(self.frames)


def denoise_image(image: Picture, denoise: Denoise, geometry: FanGeometry | None = None) -> Picture:
    """Denoise (H, W) or (H, W, C) uint8, uint16 or float32 (0..1); same shape and dtype out.

    Colour channels are denoised one by one (once, when they are equal); an alpha channel stays.
    Raises ValueError for another dtype or shape, NaN, and floats outside 0..1.
    """
    check(image)
    stream: InTime[None] = InTime(denoise, frames=1)
    ((_, levels),) = stream.push(Shot(None, levels_of(image), lambda: geometry))
    return restored(levels, image)


def check_frames(frames: int) -> None:
    """FactoryError for a number of frames that a window cannot have."""
    if not (1 <= frames <= MOST_FRAMES and frames % 2):
        raise FactoryError(
            f"--frames {frames}: give an odd number up to {MOST_FRAMES}: a picture and as many "
            "before it as after it"
        )


def check(picture: Picture) -> None:
    """ValueError for a picture that cannot be denoised."""
    if str(picture.dtype) not in FULL_SCALE:
        raise ValueError(f"pixels are {picture.dtype}; expected {', '.join(FULL_SCALE)}")
    if picture.ndim not in (2, 3) or 0 in picture.shape:
        raise ValueError(f"image has shape {picture.shape}; expected (H, W) or (H, W, C)")
    if picture.dtype == np.float32:
        colours = _colours(picture)
        if not (colours.min() >= 0 and colours.max() <= 1):
            raise ValueError("float pixels must lie in 0..1; divide by full scale")


def levels_of(picture: Picture) -> Gray:
    """(H, W) or (H, W, C) float32 in 0..1, without alpha; colours that are equal as one plane."""
    levels = _colours(picture).astype(np.float32) / np.float32(FULL_SCALE[str(picture.dtype)])
    if levels.ndim == 3 and (levels == levels[..., :1]).all():
        levels = np.ascontiguousarray(levels[..., 0])
    return levels


def restored(levels: Gray, picture: Picture) -> Picture:
    """The reverse of `levels_of`, with the dtype, shape and alpha of a picture."""
    full = FULL_SCALE[str(picture.dtype)]
    found = np.rint(levels.astype(np.float64) * full) if full > 1 else levels
    found = found.astype(picture.dtype)
    if picture.ndim == 2:
        return found
    result = picture.copy()
    _colours(result)[...] = found if found.ndim == 3 else found[..., None]
    return result


def _colours(picture: Picture) -> Picture:
    """A view without the alpha channel; of an unknown number of channels, the first."""
    if picture.ndim == 2:
        return picture
    return picture[..., : 3 if picture.shape[2] in (3, 4) else 1]
