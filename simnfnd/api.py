"""What `import simnfnd` offers for real sonars: `denoise` and `open_recording`."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self, overload

import numpy as np
import numpy.typing as npt

from .factory.common.array_types import Array, Float32s

if TYPE_CHECKING:
    from .factory.dataset.fan_geometry import FanGeometry
    from .factory.dataset.schema import Pair
    from .models.denoise.denoiser import Denoiser
    from .models.recordings import SonarFrame
    from .models.recordings.base import Beams
    from .models.recordings.fan_tracking import FanTracker


class DenoisedImage(NamedTuple):
    """What `denoise(..., return_removed=True)` returns.

    image: of the same shape and dtype as the noisy one.
    removed: (H, W) or (N, H, W) float32, noisy minus denoised in standard deviations of the local
        grain; 0 where nothing was insonified.
    """

    image: Array
    removed: Float32s


@overload
def denoise(
    image: npt.ArrayLike | Pair | RecordedFrame,
    *,
    weights: str | Path | None = None,
    geometry: Literal["find", "polar"] | FanGeometry | RecordedFrame | None = "find",
    opening_deg: float | None = None,
    strength: float = 1.0,
    frames: int = 15,
    causal: bool = False,
    device: Literal["auto", "cpu", "gpu"] = "auto",
    return_removed: Literal[False] = False,
) -> Array: ...


@overload
def denoise(
    image: npt.ArrayLike | Pair | RecordedFrame,
    *,
    weights: str | Path | None = None,
    geometry: Literal["find", "polar"] | FanGeometry | RecordedFrame | None = "find",
    opening_deg: float | None = None,
    strength: float = 1.0,
    frames: int = 15,
    causal: bool = False,
    device: Literal["auto", "cpu", "gpu"] = "auto",
    return_removed: Literal[True],
) -> DenoisedImage: ...


def denoise(
    image: npt.ArrayLike | Pair | RecordedFrame,
    *,
    weights: str | Path | None = None,
    geometry: Literal["find", "polar"] | FanGeometry | RecordedFrame | None = "find",
    opening_deg: float | None = None,
    strength: float = 1.0,
    frames: int = 15,
    causal: bool = False,
    device: Literal["auto", "cpu", "gpu"] = "auto",
    return_removed: bool = False,
) -> Array | DenoisedImage:
    """Denoise one sonar image, or a stack of them.

    image: (H, W), (N, H, W), or (H, W, C): C is 1, 2 (grey and alpha), 3 or 4 (colours, with
        alpha); uint8, uint16, or float in 0..1.
        Colours of a colour map are denoised as the levels that they stand for.  Of a `Pair` the
        noisy image is denoised, with the geometry of the pair; of a frame of `open_recording` the
        stored samples, with the geometry that the recording states.
    weights: a weights.safetensors of a training or the name of weights that ship: `simnfnd` for
        real sonars, `simnfnd-paper` for the points that the paper simulates.  They stay loaded for
        the next call.  None: `simnfnd`, and for a pointwise `Pair` `simnfnd-paper`.
    geometry: where range and bearing are, for networks that use it.  "find": the fan is looked for
        in each image, as `simnfnd denoise` does.  "polar": rows are ranges, near range first, and
        the columns span `opening_deg`.  A recorded frame: as it states for its samples, or for its
        image, whichever has the shape of the array.  None: not known.
    opening_deg: angle from the left edge of the first column to the right edge of the last one,
        degrees, of geometry="polar"; without it 30 are assumed, with a warning.
    strength: part of the change that an image gets, 0 to 1.
    frames: of a stack whose images follow each other in time: up to this many, odd, are laid over
        each other and fused where they show the same; 1: each alone.
    causal: fuse with images before alone.
    device: gpu means CUDA; auto takes it where it is usable.
    return_removed: whether the removed signal is returned, too.

    Returns an array of the same shape and dtype, or a `DenoisedImage`.
    Raises ValueError for another shape or dtype, NaN, floats outside 0..1, a geometry that does not
    fit the image, and parameters out of range; FactoryError for weights that are not there, a
    missing GPU, and where the extra `denoise` is not installed.
    """
    if isinstance(image, RecordedFrame):
        geometry = image if isinstance(geometry, str) and geometry == "find" else geometry
        image = image.samples
    image, weights, geometry = _input_of(image, weights, geometry)
    values = _values_of(image)
    network = _loaded_denoiser(weights, device, strength, frames)
    is_single = values.ndim == 2 or values.shape[2] <= 4
    rows, columns = values.shape[:2] if is_single else values.shape[1:]
    known_geometry = _checked_geometry(geometry, opening_deg, (rows, columns), stacklevel=3)
    from .models.denoise.images import Denoising
    from .models.recordings.fan_tracking import FanTracker

    tracker = FanTracker()

    def place(image: Array) -> FanGeometry | None:
        return tracker.geometry(image) if isinstance(known_geometry, str) else known_geometry

    known = values.astype(np.float32) if values.dtype.kind == "f" else values
    denoising = Denoising(network, frames=frames, causal=causal, strength=strength)
    if is_single:
        single = denoising.denoise_image(known, place)
        denoised_image = single.image.astype(values.dtype)
        if return_removed:
            return DenoisedImage(denoised_image, single.removed.signal)
        return denoised_image
    result = np.empty(values.shape, values.dtype)
    removed = np.empty(values.shape if return_removed else 0, np.float32)
    shots = (
        denoising.shot(number, image, place, number=number) for number, image in enumerate(known)
    )
    for denoised in denoising.sequence(shots, alone=len(values) < 2):
        result[denoised.key] = denoised.image
        if return_removed:
            removed[denoised.key] = denoised.removed.signal
    return DenoisedImage(result, removed) if return_removed else result


_ASSUMED_OPENING_DEG = 30.0
_LEAST_INSIDE = 0.6
"""Part of a fan that must lie in the image that it is said to belong to; screens crop a little."""
_MOST_FRAMES = 31


class _DenoiseInput(NamedTuple):
    """What `denoise` works on: an image, and the weights and geometry that are meant for it."""

    image: Any
    weights: Any
    geometry: Any


def _input_of(image: Any, weights: Any, geometry: Any) -> _DenoiseInput:
    """The input for `denoise`; a `Pair` states weights and geometry where the caller does not."""
    from .factory.dataset.schema import Pair

    if not isinstance(image, Pair):
        return _DenoiseInput(image, weights, geometry)
    if weights is None and image.formation == "pointwise":
        from .models.pretrained import POINTS

        weights = POINTS
    if isinstance(geometry, str) and geometry == "find" and image.geometry is not None:
        geometry = image.geometry
    return _DenoiseInput(image.noisy, weights, geometry)


def _values_of(image: Any) -> Array:
    """An image or a stack as an array.  Raises ValueError for a path, and for other shapes."""
    if isinstance(image, str | Path):
        raise ValueError(
            f"{image}: expected an array; read the file first (cv2.imread, open_recording), or "
            "run `simnfnd denoise FILE --out FOLDER`"
        )
    values = np.asarray(image)
    if values.ndim not in (2, 3):
        raise ValueError(f"image has shape {values.shape}; expected (H, W), (N, H, W) or (H, W, 3)")
    return values


def _loaded_denoiser(
    weights: str | Path | None, device: str, strength: float, frames: int
) -> Denoiser:
    """The network, its parameters checked.  Raises what `denoise` raises."""
    from .factory.common.extras import Need, require

    needed = ("onnxruntime", "safetensors", "cv2", "scipy")
    require(Need("simnfnd.denoise", module) for module in needed)
    from .models.pretrained import find_weights

    if device not in ("auto", "cpu", "gpu"):
        raise ValueError(f"device={device!r}: expected 'auto', 'cpu' or 'gpu' (CUDA)")
    if not 0 <= strength <= 1:
        raise ValueError(f"strength={strength}: expected 0 to 1")
    if not (1 <= frames <= _MOST_FRAMES and frames % 2):
        raise ValueError(f"frames={frames}: expected an odd number from 1 to {_MOST_FRAMES}")
    path = find_weights(weights)
    return _denoiser(path, path.stat().st_mtime_ns, device)


def _checked_geometry(
    geometry: Any,
    opening_deg: float | None,
    shape: tuple[int, int] | None,
    *,
    stacklevel: int,
) -> FanGeometry | Literal["find"] | None:
    """The geometry of images of a shape; None: of any, which `fitting_geometry` completes.

    stacklevel: of the warning where the opening angle is assumed.
    """
    from .factory.dataset.fan_geometry import FanGeometry

    if opening_deg is not None and geometry != "polar":
        raise ValueError('opening_deg: belongs to geometry="polar"')
    if isinstance(geometry, RecordedFrame):
        return _stated_geometry(geometry, shape)
    if isinstance(geometry, str) and geometry == "find":
        return "find"
    if isinstance(geometry, str) and geometry == "polar":
        if opening_deg is None:
            warnings.warn(
                f"geometry='polar': assumes {_ASSUMED_OPENING_DEG:g} degrees; state opening_deg=",
                stacklevel=stacklevel,
            )
            opening_deg = _ASSUMED_OPENING_DEG
        if not 0 < opening_deg <= 360:
            raise ValueError(f"opening_deg={opening_deg}: expected more than 0, up to 360")
        geometry = FanGeometry.polar(math.radians(opening_deg))
    if geometry is not None and not isinstance(geometry, FanGeometry):
        raise ValueError(
            f"geometry={geometry!r}: expected 'find', 'polar', a FanGeometry, a recorded frame or "
            "None"
        )
    if geometry is None or shape is None:
        return geometry
    return fitting_geometry(geometry, *shape)


def _stated_geometry(frame: RecordedFrame, shape: tuple[int, int] | None) -> FanGeometry | None:
    """What a recording states of arrays of the shape of a frame's samples, or of its image."""
    samples_shape = frame.samples.shape[:2]
    if shape in (None, samples_shape):
        return frame.samples_geometry
    if shape == frame.image.shape[:2]:
        return frame.geometry
    raise ValueError(
        f"geometry: the frame has samples of {samples_shape} and an image of "
        f"{frame.image.shape[:2]}; the array is {shape}"
    )


def fitting_geometry(geometry: FanGeometry, rows: int, columns: int) -> FanGeometry:
    """The geometry of an image of this size.  Raises ValueError where it cannot be its own."""
    if geometry.layout == "polar":
        geometry = geometry.with_size(rows, columns)
        size = geometry.range_bins, len(geometry.beam_azimuths_rad)
        if size != (rows, columns):
            raise ValueError(
                f"geometry: is of {size[0]} ranges and {size[1]} beams, the image of "
                f"{rows} x {columns}"
            )
        return geometry
    width_rad = geometry.azimuth_max_rad - geometry.azimuth_min_rad
    area_px = width_rad / 2 * (geometry.far_px**2 - geometry.near_px**2) * geometry.x_scale
    inside_px = float(geometry.maps(0, 0, rows, columns)["sector"].sum())
    if inside_px < _LEAST_INSIDE * area_px:
        raise ValueError(
            f"geometry: only {100 * inside_px / area_px:.0f} % of its fan lie in this image of "
            f"{rows} x {columns} pixels; give that of this image (of a recorded frame's samples: "
            "the frame itself)"
        )
    return geometry


@lru_cache(maxsize=2)
def _denoiser(path: Path, changed_ns: int, device: str) -> Denoiser:
    """The denoiser of a weights file.

    changed_ns: time of the file, so that weights trained anew are loaded anew.
    """
    from .models.denoise.denoiser import Denoiser

    return Denoiser(path, device)


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """One frame of a recording.

    image: (H, W) float32 in 0..1, a fan with far range on top; or, of an image or video, its
        pixels as they are stored, (H, W) or (H, W, colours).
    geometry: where range and bearing are in it: as the file says, else as found in the image
        (range_fraction without metres); None where there is no fan.
    time_s: seconds since 1970 (UTC), or since the start where the file has no clock; None: unknown.
    frame: all that the file says: samples as stored, beams, pose and device.
    """

    image: Array
    geometry: FanGeometry | None
    time_s: float | None
    frame: SonarFrame

    @property
    def samples(self) -> Array:
        """What the file holds: (ranges, beams) of a ping, near range first, or the pixels."""
        return self.frame.samples

    @property
    def beams(self) -> Beams | None:
        """Bearings of the columns of `samples` and its range window; None of images."""
        return self.frame.beams

    @property
    def samples_geometry(self) -> FanGeometry | None:
        """Where range and bearing are in `samples`; of images `geometry`."""
        if self.frame.beams is None:
            return self.geometry
        from .models.recordings.views import polar_geometry

        return polar_geometry(self.frame.beams, len(self.frame.samples))


class OpenRecording:
    """An opened recording: iterate, index or measure it; close it, or use it in `with`."""

    def __init__(self, path: str | Path, topic: str | Sequence[str] | None = None) -> None:
        """See `open_recording`."""
        from .models.recordings import open_recording as opened

        topics = (topic,) if isinstance(topic, str) else tuple(topic or ())
        self._recording = opened(path, topics)
        self._trackers: dict[tuple[int, ...], FanTracker] = {}

    def __len__(self) -> int:
        return len(self._recording)

    def __getitem__(self, number: int) -> RecordedFrame:
        """One frame, from 0.  Raises IndexError, and FrameError when it is damaged."""
        return self._shown(self._recording[number])

    def __iter__(self) -> Iterator[RecordedFrame]:
        """All frames in order.  Raises FrameError at one that is damaged."""
        for frame in self._recording:
            yield self._shown(frame)

    @property
    def warning(self) -> str:
        """What is wrong with the file though its frames can be read; mostly empty."""
        return self._recording.warning

    def close(self) -> None:
        """Close the file."""
        self._recording.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _shown(self, frame: SonarFrame) -> RecordedFrame:
        """A frame as users get it: pings as fans, images with the fan that is found in them."""
        from .models.recordings.views import fan_of, grey_of

        if frame.beams is not None:
            return RecordedFrame(*fan_of(grey_of(frame), frame.beams), frame.time_s, frame)
        if frame.geometry is not None:
            return RecordedFrame(frame.samples, frame.geometry, frame.time_s, frame)
        from .models.recordings.fan_finder import find_geometry  # of the extra sonar
        from .models.recordings.fan_tracking import FanTracker
        from .models.recordings.images import ImageFiles

        # Images of a folder may have a fan each; that of a video changes now and then.
        samples = frame.samples
        if isinstance(self._recording, ImageFiles):
            geometry = find_geometry(samples)
        else:
            tracker = self._trackers.setdefault(samples.shape, FanTracker())
            geometry = tracker.geometry(samples)
        return RecordedFrame(samples, geometry, frame.time_s, frame)


def open_recording(path: str | Path, *, topic: str | Sequence[str] | None = None) -> OpenRecording:
    """Open the recording of a sonar, a bag, a video, or a folder of images.

    path: `.aris`, `.ddf`, Oculus `.raw`, bags of ROS 1 and 2 (extra `ros`), `.avi` and other
        videos, images; docs/how-to/recordings.md has them all.
    topic: of a bag, whose messages are the frames, one or several; None: those of sonars, or else
        the only one with images.

    Frames are read when they are asked for.  Raises FactoryError, one line, for a file that is not
    there, of no known kind, damaged, or without such a topic.
    """
    return OpenRecording(path, topic)
