"""`data=mixed`: what the network that ships learns from, beside each other.

Pictures of drawn devices as single frames and as means of frames, the paper's points, and
recordings, each with a part of the visits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ...factory.seeds import stream
from ..removal import DEFAULT, vector
from .pairs import Sample, Source
from .time_stacks import Stack, standing, with_loud_beam

_TAUGHT = 0.8
"""Of the target of a drawn single frame, what a teacher makes of it; the rest is its clean one."""


class MixedSource:
    """A source of several; a `Source`."""

    def __init__(
        self,
        devices: Source,
        points: Source,
        stacks: Sequence[Stack],
        *,
        points_share: float,
        recordings_share: float,
        several: float,
        seed: int,
    ) -> None:
        """devices: drawn pairs, as many as there are renders.  points: those of the same renders.

        points_share, recordings_share: parts of the visits.  several: part of the drawn pictures
        that are means of frames.
        """
        self.devices, self.points, self.stacks = devices, points, tuple(stacks)
        self.points_share, self.recordings_share = points_share, recordings_share
        self.several, self.seed = several, seed

    def __len__(self) -> int:
        return len(self.devices)

    def sample(self, index: int, visit: int | None) -> Sample:
        """See `Source`."""
        if visit is None:
            return self.devices.sample(index, None)
        rng = stream(self.seed, "mixed", index, visit)
        kind = rng.random()
        if kind < self.points_share:
            return replace(self.points.sample(index, visit), taught=0.0)
        if kind < self.points_share + self.recordings_share and self.stacks:
            stack = self.stacks[int(rng.integers(len(self.stacks)))]
            return with_loud_beam(stack.sample(rng), rng)
        drawn = self.devices.sample(index, visit)
        usual = drawn.remove is None or bool((drawn.remove == vector(DEFAULT)).all())
        if usual and rng.random() < self.several:
            return with_loud_beam(standing(drawn, rng), rng)
        return with_loud_beam(replace(drawn, taught=_TAUGHT), rng)
