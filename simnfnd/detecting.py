"""`simnfnd.detect` and `simnfnd.Detector`: objects in sonar images, with their places."""

from __future__ import annotations

from collections.abc import Collection
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from .factory.common.array_types import Array

if TYPE_CHECKING:
    from .api import RecordedFrame
    from .factory.dataset.fan_geometry import FanGeometry
    from .models.detection.objects import DetectedObject
    from .models.detection.runtime import DetectorRuntime
    from .models.recordings import SonarFrame

_SHIPPED = "simnfnd"
_THRESHOLD = 0.5


def detect(
    image: npt.ArrayLike | RecordedFrame,
    *,
    detector: str | Path = _SHIPPED,
    threshold: float = _THRESHOLD,
    classes: Collection[str] = (),
    geometry: Literal["find", "polar"] | FanGeometry | None = "find",
    opening_deg: float | None = None,
) -> list[DetectedObject]:
    """Find the objects in one sonar image, best first.

    image: (H, W) or (H, W, C) uint8, uint16 or float in 0..1, far range on top, or turned as its
        geometry says; or a frame of `open_recording`, whose `image` is looked at.
    detector: a detector.safetensors of `simnfnd evaluate transfer`, or the name of the one that
        ships.  It stays loaded for the next call.
    threshold: least probability of an object, 0 to 1.  classes: those to find; none: all.
    geometry, opening_deg: as `denoise` takes them.  Ranges and sizes need one with metres.

    Raises ValueError for another shape or dtype, NaN, floats outside 0..1, a geometry that does not
    fit, a class that the detector lacks; FactoryError for a detector that is not there, and where
    the extra `denoise` is not installed.
    """
    with Detector(
        detector=detector,
        threshold=threshold,
        classes=classes,
        geometry=geometry,
        opening_deg=opening_deg,
    ) as finder:
        return finder(image)


class Detector:
    """Finds objects in the frames of a live sonar, each frame alone.

    Every call takes one frame and returns its objects, best first, with boxes in its pixels.

        with Detector(threshold=0.6) as find:
            for frame in frames:
                for item in find(frame):
                    print(item.class_name, item.score, item.slant_range_m)
    """

    def __init__(
        self,
        *,
        detector: str | Path = _SHIPPED,
        threshold: float = _THRESHOLD,
        classes: Collection[str] = (),
        geometry: Literal["find", "polar"] | FanGeometry | None = "find",
        opening_deg: float | None = None,
    ) -> None:
        """All as `detect` takes them, and the same errors."""
        from .api import _checked_geometry

        if not 0 <= threshold <= 1:
            raise ValueError(f"threshold={threshold}: expected 0 to 1")
        self._runtime = _loaded_detector(detector)
        for name in classes:
            if name not in self._runtime.facts.classes:
                known = ", ".join(self._runtime.facts.classes)
                raise ValueError(f"classes: the detector has no {name!r}; it has {known}")
        self._threshold = threshold
        self._classes = tuple(classes)
        self._geometry = _checked_geometry(geometry, opening_deg, None, stacklevel=3)
        self._find_fan: Any = None
        self._is_open = True
        self._count = 0

    def __call__(self, frame: npt.ArrayLike | SonarFrame | RecordedFrame) -> list[DetectedObject]:
        """The objects in the next frame.  Raises ValueError as `detect`, and after `close`."""
        from .api import RecordedFrame, _values_of
        from .models.detection.frames import shown_frame
        from .models.detection.objects import find_objects
        from .models.recordings import SonarFrame

        if not self._is_open:
            raise ValueError("the detector is closed; open another one")
        recorded = frame.frame if isinstance(frame, RecordedFrame) else frame
        if not isinstance(recorded, SonarFrame):
            recorded = SonarFrame(self._count, _samples(_values_of(recorded)))
        self._count += 1
        shown = shown_frame(recorded, self._geometry_of)
        (objects,) = find_objects(
            self._runtime, [shown], threshold=self._threshold, classes=self._classes
        )
        return objects

    def close(self) -> None:
        """End the stream."""
        self._is_open = False

    def __enter__(self) -> Detector:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _geometry_of(self, image: Array) -> FanGeometry | None:
        """The geometry of an image whose frame does not state it."""
        from .api import fitting_geometry
        from .models.recordings.fan_tracking import FanTracker

        if self._geometry is None:
            return None
        if not isinstance(self._geometry, str):
            return fitting_geometry(self._geometry, *image.shape[:2])
        if self._find_fan is None or self._find_fan[0] != image.shape:
            self._find_fan = image.shape, FanTracker()
        geometry: FanGeometry | None = self._find_fan[1].geometry(image)
        return geometry


def _samples(image: Array) -> Array:
    """An image as frames hold it.  Raises ValueError for other dtypes and values."""
    from .models.denoise.images import check

    if image.dtype.kind == "f":
        image = image.astype(np.float32)
    check(image)
    return image


def _loaded_detector(detector: str | Path) -> DetectorRuntime:
    """The detector of a file or name.  FactoryError where the extra is not installed."""
    from .factory.common.extras import Need, require

    needed = ("onnxruntime", "safetensors", "cv2", "scipy")
    require(Need("simnfnd.detect", module) for module in needed)
    from .models.detection import find_detector

    path = find_detector(str(detector))
    return _opened_detector(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=2)
def _opened_detector(path: Path, changed_ns: int) -> DetectorRuntime:
    """changed_ns: time of the file, so that a detector trained anew is loaded anew."""
    from .models.detection.runtime import DetectorRuntime

    return DetectorRuntime(path)
