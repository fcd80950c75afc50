"""What is known of a denoised frame beside its pixels, in numbers alone.

A block keeps them on disk beside the pixels, where a number can do less harm than a word.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...factory.common.array_types import Array
from ..recordings.palettes import NAMES
from .images import Denoised
from .inverted import looks_inverted
from .removed import Structure
from .temporal.stream import FrameFacts
from .unchanged import has_bright_border, is_unchanged

NUMBERS = len(FrameFacts._fields) + len(Structure._fields) + 5


class FrameRecord(NamedTuple):
    """What was done to a frame, and what reports say of it.

    structure: the most suspicious spot of what was removed; None where none could be judged.
    unchanged, bright_border, inverted: see `unchanged` and `inverted`.
    colour_map: name of its colour map; empty for none.
    """

    facts: FrameFacts
    structure: Structure | None
    unchanged: bool
    bright_border: bool
    inverted: bool
    colour_map: str

    @classmethod
    def of(cls, image: Array, denoised: Denoised) -> FrameRecord:
        """The record of an image, as it is stored, and what became of it."""
        unchanged = is_unchanged(image, denoised.image)
        return cls(
            denoised.facts,
            denoised.removed.structure,
            unchanged,
            unchanged and has_bright_border(image),
            looks_inverted(image, denoised.removed.noisy),
            denoised.colour_map,
        )

    def numbers(self) -> list[float]:
        """The record as `NUMBERS` finite numbers."""
        structure = self.structure or Structure(0, 0, 0.0, 0.0)
        flags = self.structure is not None, self.unchanged, self.bright_border, self.inverted
        colour_map = NAMES.index(self.colour_map) if self.colour_map else -1
        return [*map(float, (*self.facts, *structure, *flags, colour_map))]

    @classmethod
    def of_numbers(cls, numbers: Array) -> FrameRecord:
        """The reverse of `numbers`.  Raises ValueError for what cannot be."""
        if numbers.shape != (NUMBERS,) or not np.isfinite(numbers).all():
            raise ValueError("no record of a frame")
        values = numbers.tolist()
        facts = FrameFacts(*values[: len(FrameFacts._fields)])
        row, column, deviation, share, has_structure, *flags, colour_map = values[len(facts) :]
        structure = Structure(int(row), int(column), deviation, share)
        unchanged, bright_border, inverted = map(bool, flags)
        index = int(colour_map)
        return cls(
            facts,
            structure if has_structure else None,
            unchanged,
            bright_border,
            inverted,
            NAMES[index] if 0 <= index < len(NAMES) else "",
        )
