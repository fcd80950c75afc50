"""`simnfnd.Denoiser`: frames of a sonar in, denoised frames out, as they come."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from .factory.common.array_types import Array

if TYPE_CHECKING:
    from .api import RecordedFrame
    from .factory.dataset.fan_geometry import FanGeometry
    from .models.recordings import SonarFrame
    from .models.recordings.fan_tracking import FanTracker


_MOST_SIZES = 8  # of images whose fans are remembered


class StreamCounts(NamedTuple):
    """What a stream has seen.

    frames: all of them.  repeated: copies of the frame before.  unmatched: frames that matched none
    of the frames before.  resized: how often the size of the frames changed.
    """

    frames: int
    repeated: int
    unmatched: int
    resized: int


class Denoiser:
    """Denoises the frames of a live sonar, each with those before it.

    Every call takes one frame and returns it denoised, with the bytes that
    `simnfnd denoise --causal` writes for the same frames.  Frames may be left out, come twice or
    change their size.  Memory does not grow with their number.  An object serves one stream;
    threads that share it take turns, in any order.

        with Denoiser() as stream:
            for frame in frames:
                denoised = stream(frame)
    """

    def __init__(
        self,
        *,
        weights: str | Path | None = None,
        geometry: Literal["find", "polar"] | FanGeometry | None = "find",
        opening_deg: float | None = None,
        strength: float = 1.0,
        frames: int = 15,
        invert: bool = False,
        device: Literal["auto", "cpu", "gpu"] = "auto",
    ) -> None:
        """weights, geometry, opening_deg, strength, device: as `denoise` takes them.

        frames: length of the window that ends with the newest frame, odd, up to 31; 1: each frame
            alone.
        invert: for dark echoes on a bright ground.
        With the GNU C library the process keeps memory that is freed, as the next frame needs it.

        Raises ValueError for values out of range, FactoryError for weights that are not there, a
        missing GPU, and where the extra `denoise` is not installed.
        """
        from .api import _checked_geometry, _loaded_denoiser
        from .factory.common.workers.machine import keep_freed_memory
        from .models.denoise.images import Denoising, FrameShots

        keep_freed_memory()  # every frame needs the same planes again
        network = _loaded_denoiser(weights, device, strength, frames)
        self._geometry = _checked_geometry(geometry, opening_deg, None, stacklevel=3)
        denoising = Denoising(
            network, frames=frames, causal=True, strength=strength, inverts=invert
        )
        self._shot_of = FrameShots(denoising, self._geometry_of)
        self._sequence = denoising.open_sequence(at_once=1)
        self._trackers: OrderedDict[tuple[str, tuple[int, ...]], FanTracker] = OrderedDict()
        self._is_open = True
        self._lock = threading.Lock()
        self._count = 0
        self._resized = 0
        self._repeated = 0
        self._unmatched = 0
        self._shape: tuple[int, ...] | None = None

    def __call__(
        self, frame: npt.ArrayLike | SonarFrame | RecordedFrame, *, time_s: float | None = None
    ) -> Array:
        """The next frame, denoised, of the same shape and dtype.

        frame: (H, W) or (H, W, C) as `denoise` takes an image; or a frame of `open_recording`, of
            which the stored samples are denoised, with the geometry that it states.
        time_s: when it was taken, seconds; a frame of a recording knows its own.

        Raises ValueError for another shape or dtype, NaN, floats outside 0..1, a geometry that does
        not fit, and after `close`.  The stream goes on after a frame that was refused.
        """
        if time_s is not None and not math.isfinite(time_s):
            raise ValueError(f"time_s={time_s}: expected seconds, or None")
        recorded = self._frame_of(frame, time_s)
        dtype = recorded.samples.dtype
        if dtype.kind == "f" and dtype != np.float32:
            recorded = replace(recorded, samples=recorded.samples.astype(np.float32))
        with self._lock:
            return self._denoise(recorded).astype(dtype, copy=False)

    def _denoise(self, recorded: SonarFrame) -> Array:
        """The samples of the next frame, denoised."""
        if not self._is_open:
            raise ValueError("the stream is closed; open another Denoiser")
        # Frames of a recording may come twice, or in another order.
        shot = self._shot_of(replace(recorded, number=self._count))
        self._count += 1
        shape = recorded.samples.shape
        self._resized += self._shape not in (None, shape)
        self._shape = shape
        (denoised,) = self._sequence.push(shot)
        self._repeated += bool(denoised.facts.is_copy)
        self._unmatched += 0 < denoised.facts.fused <= 1 and not denoised.facts.is_copy
        return denoised.image

    @property
    def counts(self) -> StreamCounts:
        """What the stream has seen so far."""
        return StreamCounts(self._count, self._repeated, self._unmatched, self._resized)

    def close(self) -> None:
        """End the stream."""
        self._is_open = False
        self._sequence.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _frame_of(self, frame: Any, time_s: float | None) -> SonarFrame:
        from .api import RecordedFrame, _values_of
        from .models.recordings import SonarFrame

        if isinstance(frame, RecordedFrame):
            return frame.frame
        if isinstance(frame, SonarFrame):
            return frame
        return SonarFrame(self._count, _values_of(frame), time_s=time_s)

    def _geometry_of(self, image: Array, sequence: str, number: int) -> FanGeometry | None:
        """The geometry of an image whose frame does not state it; see `SonarFrame`."""
        from .api import fitting_geometry
        from .models.recordings.fan_tracking import FanTracker

        if self._geometry is None:
            return None
        if not isinstance(self._geometry, str):
            return fitting_geometry(self._geometry, *image.shape[:2])
        key = sequence, image.shape
        tracker = self._trackers.pop(key, None) or FanTracker()
        self._trackers[key] = tracker
        if len(self._trackers) > _MOST_SIZES:
            self._trackers.popitem(last=False)
        return tracker.geometry(image, number)
