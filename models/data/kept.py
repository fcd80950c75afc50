"""Pictures that are cropped more than once: drawing one costs more than learning from it."""

from __future__ import annotations

from collections import OrderedDict

from ...factory.seeds import stream
from .pairs import Sample, Source

KEPT = 96
"""Pictures in memory; one of 700x500 pixels takes 4 MB."""


def drawn(number: int, reuse: int, seed: int) -> int:
    """The number of the picture of this visit when every picture serves `reuse` visits on average.

    Every `reuse`-th visit shows the next picture, the others one of the last `KEPT`.
    """
    newest = number // reuse
    if number % reuse == 0:
        return newest
    return max(newest - int(stream(seed, "reuse", number).integers(KEPT)), 0)


class KeptSource:
    """The last `KEPT` samples of a source are not made again; a `Source`."""

    def __init__(self, source: Source) -> None:
        self.source = source
        self._kept: OrderedDict[tuple[int, int], Sample] = OrderedDict()

    def __len__(self) -> int:
        return len(self.source)

    def __getstate__(self) -> dict[str, object]:
        return {"source": self.source, "_kept": OrderedDict()}

    def sample(self, index: int, visit: int | None) -> Sample:
        """See `Source`."""
        if visit is None:
            return self.source.sample(index, None)
        name = index, visit
        if name not in self._kept:
            self._kept[name] = self.source.sample(index, visit)
            if len(self._kept) > KEPT:
                self._kept.popitem(last=False)
        self._kept.move_to_end(name)
        return self._kept[name]
