"""Methods on sequences of frames: single frames, fusion in time, means followed by a filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...models.denoise.temporal.stream import InTime, SequenceFrame
from ..filters import Parameters, method_of
from ..filters.windows import mean_around, registered_mean
from ..metrics.measure import Grey
from .methods import Method, network

How = Literal["single", "fusion", "mean", "registered mean"]


@dataclass(frozen=True)
class SequenceMethod(Method):
    """A row of a sequence, whose name is its label.

    how: single (each frame alone by the network), fusion (frames are fused, and denoised where
    there are weights), or a mean of frames, followed by the filter `after` with `parameters`.
    window: number of frames that are fused or averaged, odd.
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
    if method.how == "fusion":
        stream = InTime(model, frames=method.window)
        sequence = (SequenceFrame(number, frame) for number, frame in enumerate(frames))
        return np.stack([result.levels for result in stream(sequence)])
    if method.how == "single":
        assert model is not None
        return np.stack([model(frame, None) for frame in frames])
    mean = mean_around if method.how == "mean" else registered_mean
    means = [mean(frames, number, method.window // 2) for number in range(len(frames))]
    return np.stack([_filtered(image, method, method.parameters_of(fold)) for image in means])


def _filtered(image: Grey, method: SequenceMethod, parameters: Parameters) -> Grey:
    return method_of(method.after)(image, parameters) if method.after else image
