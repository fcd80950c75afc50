"""Frames of recordings among the training pictures, for which a teacher has the only answer.

A small network that has seen drawn pictures alone does what its teacher does on such pictures, and
less of it on recordings.  Nothing is known of a recording but what the teacher makes of it, so its
`clean` picture is NaN (`simnfnd.models.training.teacher` puts the teacher's there).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from ...factory.errors import FactoryError
from ...factory.files import sha256_of
from ...factory.seeds import stream
from ..recordings.arrays import file_of
from ..recordings.fan.finder import find_geometry
from ..recordings.presentation import presentation_of
from .images import list_images, read_sample
from .pairs import Sample, SampleRef, Source

_KEPT = 64
"""Frames in memory; one of 700x500 pixels takes 2 MB."""


class WithRecordings:
    """A source of which a part of the visits shows a frame of a recording; a `Source`."""

    def __init__(
        self, source: Source, frames: Sequence[SampleRef], share: float, patch: int, seed: int
    ) -> None:
        """share: part of the visits, 0 to 1.  patch: least side of a frame, pixels."""
        self.source, self.frames, self.share = source, tuple(frames), share
        self.patch, self.seed = patch, seed
        # Crops of one step have the same maps.
        self._told: bool | None = None

    def __len__(self) -> int:
        return len(self.source)

    def sample(self, index: int, visit: int | None) -> Sample:
        """See `Source`.  Raises FactoryError for a frame smaller than a crop, too."""
        if visit is None:
            return self.source.sample(index, None)
        rng = stream(self.seed, "recordings", index, visit)
        if rng.random() >= self.share:
            return self.source.sample(index, visit)
        ref = self.frames[int(rng.integers(len(self.frames)))]
        found = frame_of(ref)
        if min(found.noisy.shape) < self.patch:
            height, width = found.noisy.shape
            raise FactoryError(
                f"train.teacher_recordings: {ref.frame} has {height}x{width} pixels, fewer than "
                f"data.patch={self.patch}; leave it out"
            )
        if self._told is None:
            self._told = self.source.sample(index, visit).geometry is not None
        return found if self._told else replace(found, geometry=None)


def frames_with_geometry(paths: Sequence[str]) -> tuple[SampleRef, ...]:
    """The frames of recordings, and pictures of folders, in which range and bearing are known.

    Of each recording only the first frame is looked at.  Raises FactoryError where one of the paths
    holds none.
    """
    found: list[SampleRef] = []
    for path in paths:
        here = list_images(path, "train.teacher_recordings")
        known = {one.path: frame_of(one).geometry is not None for one in reversed(here)}
        usable = [one for one in here if known[one.path]]
        if not usable:
            raise FactoryError(
                f"train.teacher_recordings={path}: holds no frame with a fan that can be found"
            )
        found += usable
    return tuple(found)


def digest_of(frames: Sequence[SampleRef]) -> str:
    """Changes with the content of the files, not with where they lie."""
    hashes = sorted(
        {path: sha256_of(file_of(path)) for path in {one.path for one in frames}}.values()
    )
    return hashlib.blake2b(repr(hashes).encode(), digest_size=8).hexdigest()


@lru_cache(maxsize=_KEPT)
def frame_of(ref: SampleRef) -> Sample:
    """A frame as networks are shown it; its clean picture is NaN."""
    grey, geometry = read_sample(ref)
    if geometry is None:
        given = presentation_of(grey, find_geometry(grey))
        grey, geometry = given.shown(grey), given.geometry
    return Sample(grey, np.full_like(grey, np.nan), np.zeros_like(grey), geometry)
