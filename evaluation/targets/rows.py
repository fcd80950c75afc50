"""The rows of the benchmark: recorded frames, filters, means in time, networks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from ...factory.common.array_types import Bools
from ...factory.common.errors import FactoryError
from ...factory.dataset.fan_geometry import FanGeometry
from ...models.denoise.images import Denoising
from ...models.denoise.temporal.stream import SequenceFrame
from ..filters import REGISTRY, Baseline, Parameters, method_of
from ..filters.windows import mean_around, registered_mean
from ..judging import tuning
from ..judging.methods import Method, network, shown
from ..real.in_time import static_input, tuning_images
from .targets import Frames

REACH = 3
"""Frames before and after a frame that means in time are taken over."""

_TUNED_ON = 3  # frames

Stored = npt.NDArray[np.unsignedinteger]
"""(N, H, W) frames as a recording stores them."""


@dataclass(frozen=True)
class MethodRow:
    """A method as the benchmark runs it.

    kind: recorded, filter, mean, registered mean or network.
    name: in the registry, of the filter, or of the filter that follows a mean.
    parameters: of that filter; {}: none follows the mean.
    weights: file of a network.  frames: length of its window.
    """

    label: str
    kind: str
    name: str = ""
    parameters: Parameters = field(default_factory=dict)
    weights: str = ""
    frames: int = 1


RECORDED = MethodRow("recorded", "recorded")


def rows_of(
    frames: Frames,
    insonified: Bools,
    *,
    fixed: Sequence[dict[str, Parameters]],
    tuned: Sequence[Baseline],
    networks: Sequence[Method],
    windows: Sequence[int],
) -> list[MethodRow]:
    """All rows of a recording.

    frames: (N, H, W) in 0..1 without targets; filters are tuned on them where they are insonified,
    (H, W) bool.
    fixed: filters with their parameters.  windows: numbers of frames that the networks fuse.
    Raises FactoryError for a filter that does not exist or cannot be tuned.
    """
    static = static_input(frames, insonified)
    samples = tuple(tuning_images(static, _TUNED_ON))
    rows = [RECORDED]
    for filters in fixed:
        rows += [_fixed_filter(name, parameters) for name, parameters in filters.items()]
    for baseline in tuned:
        parameters = _tuned(baseline.name, samples)
        rows.append(MethodRow(f"{baseline.name}, tuned", "filter", baseline.name, parameters))
    window = 2 * REACH + 1
    tv_parameters = _tuned("tv", tuple(tuning_images(static, _TUNED_ON, REACH)))
    rows.append(MethodRow(f"mean of {window}", "mean"))
    rows.append(
        MethodRow(f"registered mean of {window} + TV", "registered mean", "tv", tv_parameters)
    )
    for method in networks:
        for frame_count in windows:
            fused = "single frames" if frame_count == 1 else f"{frame_count} frames"
            label = f"{method.label}, {fused}"
            rows.append(
                MethodRow(label, "network", weights=method.weights or "", frames=frame_count)
            )
    return rows


def _tuned(name: str, samples: tuple[tuning.TuningImage, ...]) -> Parameters:
    """The best parameters of a filter.  Raises FactoryError where it fails."""
    parameters = tuning.on_frames(tuning.TuningTask(name, samples))
    if isinstance(parameters, str):
        raise FactoryError(f"baselines: {name} cannot be tuned: {parameters}")
    return parameters


def _fixed_filter(name: str, parameters: Parameters) -> MethodRow:
    """Raises FactoryError for a filter or parameter that does not exist."""
    if name not in REGISTRY:
        raise FactoryError(f"fixed.{name}: no such filter; there are {', '.join(REGISTRY)}")
    default = REGISTRY[name].default
    if unknown := sorted(set(parameters) - set(default)):
        raise FactoryError(
            f"fixed.{name}.{unknown[0]}: no such parameter; {name} has {', '.join(default)}"
        )
    point = {**default, **parameters}
    return MethodRow(name + shown(point), "filter", name, point)


def denoise_sequence(
    row: MethodRow, stored: Stored, full_scale: int, geometry: FanGeometry | None, device: str
) -> Frames:
    """(N, H, W) float32 in 0..1: what a row makes of a sequence."""
    if row.kind == "network":
        return _by_network(row, stored, geometry, device) / np.float32(full_scale)
    frames = stored.astype(np.float32) / np.float32(full_scale)
    if row.kind == "recorded":
        return frames
    if row.kind == "filter":
        return np.stack([method_of(row.name)(frame, row.parameters) for frame in frames])
    mean = registered_mean if row.kind == "registered mean" else mean_around
    means = (mean(frames, number, REACH) for number in range(len(frames)))
    if not row.parameters:
        return np.stack(list(means))
    filtered_means = (method_of(row.name)(mean_frame, row.parameters) for mean_frame in means)
    return np.stack(list(filtered_means))


def _by_network(
    row: MethodRow, stored: Stored, geometry: FanGeometry | None, device: str
) -> Stored:
    """A sequence denoised as by `simnfnd denoise --frames N`, in the levels it is stored in."""
    denoising = Denoising(network(row.weights, device), frames=row.frames)

    def shots() -> Iterator[SequenceFrame]:
        for number, frame in enumerate(stored):
            yield denoising.shot(number, frame, lambda _: geometry)

    return np.stack([result.image for result in denoising.sequence(shots())])
