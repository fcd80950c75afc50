"""The rows of the benchmark: recorded frames, filters, means in time, networks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import numpy.typing as npt

from ...factory.common.errors import FactoryError
from ...factory.dataset.fan_geometry import FanGeometry
from ...models.denoise.images import Denoising
from ...models.denoise.temporal.stream import SequenceFrame
from ..filters import REGISTRY, Baseline, Parameters
from ..judging import tuning
from ..judging.methods import Method, network, shown
from ..judging.sequences import SequenceMethod, denoise_frames
from ..real.in_time import static_input, tuning_images
from .recording import StaticRecording
from .targets import Frames

REACH = 3
"""Frames before and after a frame that means in time are taken over."""

_TUNED_ON = 3  # frames

Stored = npt.NDArray[np.unsignedinteger]
"""(N, H, W) frames as a recording stores them."""

RECORDED = SequenceMethod("recorded", "", {})


def rows_of(
    recordings: Sequence[StaticRecording],
    *,
    fixed: Sequence[dict[str, Parameters]],
    tuned: Sequence[Baseline],
    networks: Sequence[Method],
    windows: Sequence[int],
) -> list[SequenceMethod]:
    """All rows; the fold of a filter that is tuned is the number of the recording.

    fixed: filters with their parameters.  windows: numbers of frames that the networks fuse.
    Raises FactoryError for a filter that does not exist or cannot be tuned.
    """
    window = 2 * REACH + 1
    rows = [RECORDED]
    for filters in fixed:
        rows += [_fixed_filter(name, parameters) for name, parameters in filters.items()]
    for baseline in tuned:
        points = _tuned(baseline.name, recordings, 0)
        label = f"{baseline.name}, tuned"
        rows.append(SequenceMethod(label, "", {}, folds=points, after=baseline.name))
    points = _tuned("tv", recordings, REACH)
    rows.append(SequenceMethod(f"mean of {window}", "", {}, how="mean", window=window))
    label = f"registered mean of {window} + TV"
    rows.append(
        SequenceMethod(
            label, "", {}, folds=points, how="registered mean", window=window, after="tv"
        )
    )
    for method in networks:
        for frames in windows:
            fused = "single frames" if frames == 1 else f"{frames} frames"
            label = f"{method.label}, {fused}"
            rows.append(SequenceMethod(label, "", {}, weights=method.weights, window=frames))
    return rows


def _tuned(name: str, recordings: Sequence[StaticRecording], reach: int) -> tuple[Parameters, ...]:
    """The best parameters of a filter of each recording.  Raises FactoryError where it fails.

    reach: the filter follows means over frames up to this far.
    """
    points = []
    for recording in recordings:
        static = static_input(recording.frames, recording.insonified)
        samples = tuple(tuning_images(static, _TUNED_ON, reach))
        point = tuning.on_frames(tuning.TuningTask(name, samples))
        if isinstance(point, str):
            raise FactoryError(f"baselines: {name} cannot be tuned: {point}")
        points.append(point)
    return tuple(points)


def _fixed_filter(name: str, parameters: Parameters) -> SequenceMethod:
    """Raises FactoryError for a filter or parameter that does not exist."""
    if name not in REGISTRY:
        raise FactoryError(f"fixed.{name}: no such filter; there are {', '.join(REGISTRY)}")
    default = REGISTRY[name].default
    if unknown := sorted(set(parameters) - set(default)):
        raise FactoryError(
            f"fixed.{name}.{unknown[0]}: no such parameter; {name} has {', '.join(default)}"
        )
    point = {**default, **parameters}
    return SequenceMethod(name + shown(point), "", point, after=name)


def denoise_stored(
    method: SequenceMethod,
    stored: Stored,
    full_scale: int,
    geometry: FanGeometry | None,
    device: str,
    fold: int,
) -> Frames:
    """(N, H, W) float32 in 0..1: a sequence denoised, by networks as `simnfnd denoise` does it."""
    if not method.weights:
        frames = stored.astype(np.float32) / np.float32(full_scale)
        return denoise_frames(method, frames, device, fold)
    denoising = Denoising(network(method.weights, device), frames=method.window)

    def shots() -> Iterator[SequenceFrame]:
        for number, frame in enumerate(stored):
            yield denoising.shot(number, frame, lambda _: geometry)

    images = [result.image for result in denoising.sequence(shots())]
    return np.stack(images) / np.float32(full_scale)
