"""Methods on sequences of frames: single frames, fusion in time, means followed by a filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...models.denoise.temporal.stream import InTime, SequenceFrame
from ..filters import method_of
from ..filters.windows import mean_around, registered_mean
from ..metrics.measure import Grey
from .methods import Method, network

How = Literal["single", "fusion", "mean", "registered mean"]


@dataclass(frozen=True)
class SequenceMethod(Method):
    """A row of a sequence, whose name is its label.

    how: single (each frame alone), fusion or a mean of frames.  window: frames that are fused or
    averaged, odd.  weights: of the network that denoises single or fused frames.
    after: the filter that follows, with `parameters`.
    """

    how: How = "single"
    window: int = 1
    after: str = ""

    @property
    def output(self) -> str:
        """See `Method`."""
        return self.name


def denoise_frames(method: SequenceMethod, frames: Grey, device: str, fold: int = 0) -> Grey:
    """(N, H, W) float32 in 0..1: what a method makes of the frames (N, H, W) of a sequence."""
    model = network(method.weights, device) if method.weights else None
    images = list(frames)
    if method.how == "fusion":
        stream = InTime(model, frames=method.window)
        sequence = (SequenceFrame(number, frame) for number, frame in enumerate(frames))
        images = [result.levels for result in stream(sequence)]
    elif model is not None:
        images = [model(frame, None) for frame in frames]
    elif method.how != "single":
        mean = mean_around if method.how == "mean" else registered_mean
        images = [mean(frames, number, method.window // 2) for number in range(len(frames))]
    if method.after:
        filter_of_row = method_of(method.after)
        images = [filter_of_row(image, method.parameters_of(fold)) for image in images]
    return np.stack(images)
