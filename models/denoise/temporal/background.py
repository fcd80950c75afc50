"""The static scene of a recording and how each frame deviates from it, without a network.

for background in backgrounds(frames):
moving = np.abs(background.deviation) > 4
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from ....factory.common.array_types import Array, Float32s
from ..options import FRAMES
from .fusion import FusedFrame, enlarge
from .motion import grey_of
from .noise_level import at_level
from .stream import InTime, SequenceFrame


@dataclass(frozen=True, eq=False)
class Background:
    """The static scene as a frame sees it; all planes are (H, W) float32.

    scene: mean of the frames of the window that agree, in 0..1; where something moves it is that.
    noise: standard deviation of the noise of a single frame at each pixel.
    frame_count: effective number of frames averaged in the scene; 1 where nothing agrees.
    deviation: the frame less the scene in a small window (Gaussian of .8 reduced pixels), in
        standard deviations of that difference by noise alone.
    wide_deviation: the same in a window of 7 reduced pixels.
    evidence: significance of the best straight path through a pixel over 3 frames before and
        after, in standard deviations above the usual.
    """

    scene: Array
    noise: Array
    frame_count: Array
    deviation: Array
    wide_deviation: Array
    evidence: Array

    @classmethod
    def of(cls, fused: FusedFrame) -> Background:
        """The background of a frame that was fused with its neighbours."""
        scene = grey_of(fused.image)
        return cls(
            scene,
            at_level(scene, fused.pixel_noise),
            fused.frame_count,
            enlarge(fused.deviation, scene.shape),
            enlarge(fused.wide_deviation, scene.shape),
            enlarge(fused.evidence, scene.shape),
        )


def backgrounds(
    frames: Iterable[Float32s], *, window: int = FRAMES, causal: bool = False
) -> Iterator[Background]:
    """The background of each frame, in order; memory does not grow with their number.

    frames: (H, W) float32 in 0..1, of a sonar at rest or one that moves.  window: frames that are
    averaged at most, odd.  causal: whether no frame after the one in question counts.
    """
    stream = InTime(None, frames=window, causal=causal)
    shots = (SequenceFrame(number, np.asarray(frame)) for number, frame in enumerate(frames))
    for result in stream(shots):
        assert result.fused is not None
        yield Background.of(result.fused)
