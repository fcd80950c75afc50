"""From images as they are stored to denoised ones of the same kind: one composition for all.

The command, `simnfnd.denoise` and evaluation denoise by it, an image or a sequence of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from copy import copy
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from ...factory.common.array_types import Array, Float32s
from ...factory.common.errors import FactoryError
from ...factory.common.workers.machine import usable_cores
from ...factory.dataset.fan_geometry import FanGeometry
from ..recordings.base import FULL_SCALE, SonarFrame, colours_of, range_problem, white_of
from ..recordings.device_settings import RecordedSettings, settings_of
from ..recordings.palettes import Painted, Palette, find_painted
from ..recordings.views import polar_geometry
from .options import FRAMES
from .removed import Removed
from .temporal.stream import (
    MOST_FRAMES,
    FrameFacts,
    InTime,
    Network,
    SequenceFrame,
    StreamResult,
)

Place = Callable[[Array], FanGeometry | None]
"""Where range and bearing are in an image; None where that is not known."""


@dataclass(frozen=True, eq=False)
class Denoised:
    """A denoised image.

    key: the name that the caller gave the image.  image: of the same shape and dtype as stored.
    removed: what denoising took away.  facts: what was done to it.  colour_map: name of its colour
    map, empty for none.
    """

    key: Any
    image: Array
    removed: Removed
    facts: FrameFacts = field(default_factory=FrameFacts)
    colour_map: str = ""


@dataclass(frozen=True, eq=False)
class _Source:
    """An image that is being denoised.

    image: as it is stored.  shown: as it is denoised, inverted where it has a `white`.
    levels: float32 in 0..1.  painted: its colour map; None: it has none.
    strength: part of the change that the image gets, 0 to 1.
    level_range: the range that `image` was scaled by; None: it was not scaled.
    """

    key: Any
    image: Array
    strength: np.float32
    shown: Array
    levels: Float32s
    painted: Painted | None
    white: float | None
    level_range: LevelRange | None = None

    def result(self, levels: Float32s, facts: FrameFacts) -> Denoised:
        """The denoised image of denoised levels, (H, W) or (H, W, C)."""
        name = "" if self.painted is None else self.painted.palette.name
        denoised = replace(self._result(levels), facts=facts, colour_map=name)
        if self.level_range is None or self.strength == 0:
            return denoised
        return replace(denoised, image=self.level_range.restored(denoised.image, self.image))

    def _result(self, levels: Float32s) -> Denoised:
        painted = self.painted
        if self.strength != 1:
            levels = self.levels + self.strength * (levels - self.levels)
        if self.strength == 0:
            return Denoised(self.key, self.image.copy(), Removed(self.levels, levels))
        image = restored(levels, self.shown) if painted is None else painted.repainted(levels)
        if self.white is None:
            return Denoised(self.key, image, Removed(self.levels, levels))
        return Denoised(self.key, inverted(image, self.white), Removed(1 - self.levels, 1 - levels))


_MAP_RUN = 64
"""Images of a run; a colour map found in one is looked for first in those after it."""


class Denoising:
    """How a run denoises images.

    network, frames, causal, keeps_outside: see `InTime`.
    strength: part of the whole change, of fusion and network, that an image gets, 0 to 1.
    inverts: whether images show dark echoes on a bright ground.
    level_range: what is black and white in float images; None: 0 and 1.
    """

    def __init__(
        self,
        network: Network,
        *,
        frames: int = FRAMES,
        causal: bool = False,
        strength: float = 1.0,
        keeps_outside: bool = True,
        inverts: bool = False,
        level_range: LevelRange | None = None,
    ) -> None:
        """Raises FactoryError for a number of frames that a window cannot have."""
        if not (1 <= frames <= MOST_FRAMES and frames % 2):
            raise FactoryError(
                f"--frames {frames}: give an odd number up to {MOST_FRAMES}: an image and as many "
                "before it as after it"
            )
        self.frames = frames
        self.network = network
        self._in_time = partial(
            InTime,
            causal=causal,
            keeps_outside=keeps_outside,
        )
        self._strength = np.float32(strength)
        self._inverts = inverts
        self._level_range = level_range
        self._next = 0
        self._map_run = -1
        self._map: Palette | None = None

    def of_simulated(self, network: Network) -> Denoising:
        """The run with the network for simulated images, which have noise around their fan."""
        variant = copy(self)
        variant.network = network
        variant._in_time = partial(self._in_time, keeps_outside=False)
        return variant

    def shot(
        self,
        key: Any,
        image: Array,
        place: Place,
        shift_px: tuple[float, float] | None = None,
        *,
        number: int | None = None,
        wanted: bool = True,
        settings: RecordedSettings | None = None,
    ) -> SequenceFrame:
        """An image of a sequence, its colours read.

        image: (H, W) or (H, W, C) uint8, uint16 or float32 in 0..1.
        shift_px, number, wanted, settings: see `SequenceFrame`.
        place: finds the geometry of the image; called for each image, in order.
        Raises ValueError for another dtype or shape, NaN, and floats outside 0..1.
        """
        stored = image
        if self._level_range is not None:
            image = self._level_range.scaled(image)
        check(image)
        white = white_of(image) if self._inverts else None
        shown = image if white is None else inverted(image, white)
        plain = without_alpha(shown)
        number = self._next if number is None else number
        self._next = number + 1
        if number // _MAP_RUN != self._map_run:
            self._map_run = number // _MAP_RUN
            self._map = None
        painted = find_painted(shown, self._map)
        if painted is not None:
            plain = painted.levels
            self._map = self._map or painted.palette
        levels = levels_of(plain)
        source = _Source(
            key, stored, self._strength, shown, levels, painted, white, self._level_range
        )
        stated = RecordedSettings() if settings is None else settings
        return SequenceFrame(source, levels, place(plain), shift_px, number, wanted, stated)

    def sequence(
        self, shots: Iterable[SequenceFrame], *, alone: bool = False
    ) -> Iterator[Denoised]:
        """What became of each image of a sequence, in order; see `open_sequence`."""
        yield from self.open_sequence(alone=alone).run(shots)

    def open_sequence(
        self, *, alone: bool = False, at_once: int | None = None
    ) -> SequenceDenoising:
        """A sequence of images, to be denoised in order.

        Colour channels are denoised one by one (once, when they are equal); an alpha channel stays.
        alone: whether each is denoised alone.  at_once: see `InTime`; by default a core each.
        """
        # The first image is looked at anew, so that a sequence depends on none before it.
        self._next = 0
        self._map_run = -1
        if alone:
            return SequenceDenoising(self._in_time(self.network, frames=1, at_once=at_once or 1))
        cores = at_once or usable_cores()
        return SequenceDenoising(self._in_time(self.network, frames=self.frames, at_once=cores))

    def denoise_image(self, image: Array, place: Place) -> Denoised:
        """Denoise one image alone.  Raises ValueError as `shot` does."""
        (denoised,) = self.sequence([self.shot(None, image, place)], alone=True)
        return denoised


class SequenceDenoising:
    """A sequence of images that is being denoised: shots in, denoised images out, in order."""

    def __init__(self, stream: InTime) -> None:
        self._stream = stream

    def run(self, shots: Iterable[SequenceFrame]) -> Iterator[Denoised]:
        """Denoise a whole sequence."""
        for shot in shots:
            yield from self.push(shot)
        yield from self.finish()

    def push(self, shot: SequenceFrame) -> Iterator[Denoised]:
        """Take the next image; yields those that are denoised by now."""
        yield from map(_denoised, self._stream.push(shot))

    def finish(self) -> Iterator[Denoised]:
        """Yield the images that are left; the sequence has ended."""
        yield from map(_denoised, self._stream.finish())

    def close(self) -> None:
        """End the threads of a sequence that is not finished."""
        self._stream.close()


def _denoised(result: StreamResult) -> Denoised:
    source: _Source = result.key
    return source.result(result.levels, result.facts)


class FrameShots:
    """Turns the frames of a recording into shots, in order."""

    def __init__(
        self,
        denoising: Denoising,
        find_geometry: Callable[[Array, str, int], FanGeometry | None],
        settings: Callable[[SonarFrame], RecordedSettings] = settings_of,
    ) -> None:
        """find_geometry: of an image, given `sequence` and `number` of its frame; in order."""
        self._denoising = denoising
        self._find_geometry = find_geometry
        self._settings = settings
        self._previous: dict[str, SonarFrame] = {}

    def __call__(self, frame: SonarFrame, *, wanted: bool = True) -> SequenceFrame:
        """Make the shot of the next frame.  Raises ValueError as `Denoising.shot` does."""
        shift_px = _turned_px(frame, self._previous.get(frame.sequence))
        shot = self._denoising.shot(
            frame,
            frame.samples,
            partial(self._geometry, frame),
            shift_px,
            number=frame.number,
            wanted=wanted,
            settings=self._settings(frame),
        )
        self._previous[frame.sequence] = frame
        return shot

    def _geometry(self, frame: SonarFrame, image: Array) -> FanGeometry | None:
        if frame.beams is not None:
            return polar_geometry(frame.beams, len(image))
        return frame.geometry or self._find_geometry(image, frame.sequence, frame.number)


def _turned_px(frame: SonarFrame, previous: SonarFrame | None) -> tuple[float, float] | None:
    """How far a scene moved across the beams since the previous frame, by the compass."""
    heading_deg = frame.pose.heading_deg
    previous_deg = previous.pose.heading_deg if previous is not None else None
    if heading_deg is None or previous_deg is None or frame.beams is None:
        return None
    azimuths = frame.beams.azimuths_rad
    turned_deg = (heading_deg - previous_deg + 180) % 360 - 180
    spacing = (azimuths[-1] - azimuths[0]) / (len(azimuths) - 1)
    return -math.radians(turned_deg) / spacing, 0.0


class OutOfRange(ValueError):
    """Floats that are no grey values from 0 to 1."""


class LevelRange(NamedTuple):
    """Values of float images that are black and white, such as -60 and 0 of decibels."""

    black: float
    white: float

    def scaled(self, image: Array) -> Array:
        """A float image in 0..1; what lies outside is black or white.  Other images as they are."""
        if image.dtype != np.float32:
            return image
        span = np.float32(self.white - self.black)
        scaled = (image - np.float32(self.black)) / span
        return np.asarray(np.clip(scaled, 0, 1), np.float32)

    def restored(self, denoised: Array, image: Array) -> Array:
        """The reverse for a denoised image; what lay outside in the image does so again."""
        if image.dtype != np.float32:
            return denoised
        span = np.float32(self.white - self.black)
        beyond = image - np.clip(image, self.black, self.white)
        return np.asarray(np.float32(self.black) + span * denoised + beyond, np.float32)


def check(image: Array) -> None:
    """ValueError for an image that cannot be denoised."""
    if str(image.dtype) not in FULL_SCALE:
        raise ValueError(f"pixels are {image.dtype}; expected {', '.join(FULL_SCALE)}")
    is_image = image.ndim == 2 or (image.ndim == 3 and image.shape[2] <= 4)
    if not is_image or 0 in image.shape:
        raise ValueError(
            f"image has shape {image.shape}; expected (H, W), or (H, W, C) with C 1 (grey), 2 "
            "(grey and alpha), 3 or 4 (colours and alpha)"
        )
    problem = range_problem(colours_of(image))
    if problem:
        raise OutOfRange(problem)


def levels_of(image: Array) -> Float32s:
    """(H, W) or (H, W, C) float32 in 0..1, without alpha; colours that are equal as one plane."""
    levels = colours_of(image).astype(np.float32) / np.float32(FULL_SCALE[str(image.dtype)])
    if levels.ndim == 3 and (levels == levels[..., :1]).all():
        levels = np.ascontiguousarray(levels[..., 0])
    return levels


def restored(levels: Float32s, image: Array) -> Array:
    """The reverse of `levels_of`, with the dtype, shape and alpha of an image."""
    full = FULL_SCALE[str(image.dtype)]
    values = levels
    if full > 1:
        values = np.multiply(levels, full, dtype=np.float64)
        np.rint(values, out=values)
    result = image.copy()
    colours = colours_of(result)
    colours[...] = values if values.ndim == image.ndim else values[..., None]
    return result


def without_alpha(image: Array) -> Array:
    """(H, W) of grey with or without alpha, (H, W, 3) of colours."""
    colours = colours_of(image)
    return colours[..., 0] if colours.ndim == 3 and colours.shape[2] == 1 else colours


def inverted(image: Array, white: float) -> Array:
    """An image with white as black and black as white; alpha as it is."""
    result = image.copy()
    colours = colours_of(result)
    colours[...] = np.clip(white - colours_of(image), 0, white).astype(image.dtype)
    return result


def block_means(plane: Float32s, times: int) -> Float32s:
    """Means of `times` x `times` pixels, (H, W) -> (ceil(H / times), ceil(W / times)).

    The last row and column are repeated where a side is no multiple.
    """
    padded = np.pad(plane, [(0, -side % times) for side in plane.shape], mode="edge")
    total = padded[::times, ::times].copy()
    for column in range(times):
        for row in range(times):
            if row or column:
                total += padded[row::times, column::times]
    return np.asarray(total / np.float32(times * times), np.float32)
