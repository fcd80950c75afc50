"""Images that the network left as they are, mostly dark echoes on a bright ground."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence

import numpy as np

from ...factory.common.array_types import Array
from ..recordings.base import FULL_SCALE

_CHANGED_SHARE = 0.005  # of the pixels: fewer are none
_LEAST_CONTRAST = 0.02  # of full scale: what is darker or flat has nothing to denoise
_BRIGHT = 0.5  # of the largest grey value, at the image's border
_NAMED = 3


class UnchangedReport:
    """Counts images that did not change, by the file that they are of."""

    def __init__(self) -> None:
        self._images: Counter[str] = Counter()
        self._bright = 0

    def add(self, name: str, *, bright_border: bool) -> None:
        """An image that did not change.  name: of its file."""
        self._images[name] += 1
        self._bright += bright_border

    def merge(self, other: UnchangedReport) -> None:
        """Add what another report counted."""
        self._images.update(other._images)
        self._bright += other._bright

    @property
    def count(self) -> int:
        """How many images did not change."""
        return self._images.total()

    def summary(self) -> Iterator[str]:
        """One line, if there was an image that did not change."""
        if not self._images:
            return
        hint = ""
        if self._bright:
            hint = "; where echoes are dark on a bright ground, add --invert"
        count = self._images.total()
        names = first_of(list(self._images))
        yield f"unchanged: {count} image{'s' * (count != 1)} of {names}{hint}"


def first_of(names: Sequence[str]) -> str:
    """The first names, and how many more there are."""
    named = ", ".join(names[:_NAMED])
    return named if len(names) <= _NAMED else f"{named} and {len(names) - _NAMED} more"


def is_unchanged(image: Array, denoised: Array) -> bool:
    """Whether denoising left an image, (H, W[, C]), as it was, though it shows something."""
    differs = image != denoised
    if differs.ndim == 3:
        differs = differs.any(axis=2)
    return bool(differs.mean() < _CHANGED_SHARE) and _has_contrast(image)


def _has_contrast(image: Array) -> bool:
    spread = float(image.max()) - float(image.min())
    return spread > _LEAST_CONTRAST * FULL_SCALE[str(image.dtype)]


def has_bright_border(image: Array) -> bool:
    """Whether the border of an image is bright, as a page is."""
    colours = image[..., :3].mean(axis=2) if image.ndim == 3 else image
    border = np.concatenate([colours[0], colours[-1], colours[:, 0], colours[:, -1]])
    return bool(np.median(border) > _BRIGHT * float(colours.max()))
