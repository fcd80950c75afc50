"""What `import simnfnd` offers for real sonars: `denoise` and `open_recording`."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple, Self, overload

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from .factory.dataset.fan_geometry import FanGeometry
    from .factory.dataset.schema import Pair
    from .models.denoise.denoiser import Denoiser
    from .models.recordings import Frame
    from .models.recordings.fan_tracking import FanTracker


class DenoisedImage(NamedTuple):
    """What `denoise(..., return_removed=True)` returns.

    image: of the same shape and dtype as the noisy one.
    removed: (H, W) or (N, H, W) float32, noisy minus denoised in standard deviations of the local
        grain; 0 where nothing was insonified.
    """

    image: npt.NDArray[Any]
    removed: npt.NDArray[np.float32]


@overload
def denoise(
    image: npt.ArrayLike | Pair,
    *,
    weights: str | Path | None = None,
    geometry: Literal["find", "polar"] | FanGeometry | None = "find",
    strength: float = 1.0,
    frames: int = 7,
    causal: bool = False,
    device: Literal["auto", "cpu", "gpu"] = "auto",
    return_removed: Literal[False] = False,
) -> npt.NDArray[Any]: ...


@overload
def denoise(
    image: npt.ArrayLike | Pair,
    *,
    weights: str | Path | None = None,
    geometry: Literal["find", "polar"] | FanGeometry | None = "find",
    strength: float = 1.0,
    frames: int = 7,
    causal: bool = False,
    device: Literal["auto", "cpu", "gpu"] = "auto",
    return_removed: Literal[True],
) -> DenoisedImage: ...


def denoise(
    image: npt.ArrayLike | Pair,
    *,
    weights: str | Path | None = None,
    geometry: Literal["find", "polar"] | FanGeometry | None = "find",
    strength: float = 1.0,
    frames: int = 7,
    causal: bool = False,
    device: Literal["auto", "cpu", "gpu"] = "auto",
    return_removed: bool = False,
) -> npt.NDArray[Any] | DenoisedImage:
    """Denoise one sonar image, or a stack of them.

    image: (H, W), (N, H, W), or (H, W, C): C is 1, 2 (grey and alpha), 3 or 4 (colours, with
        alpha); uint8, uint16, or float in 0..1.
        Colours of a colour map are denoised as the levels that they stand for.  Of a `Pair` the
        noisy image is denoised, with the geometry of the pair.
    weights: a weights.safetensors of a training or the name of weights that ship: `simnfnd` for
        real sonars, `simnfnd-paper` for the points that the paper simulates.  They stay loaded for
        the next call.  None: `simnfnd`, and for a pointwise `Pair` `simnfnd-paper`.
    geometry: where range and bearing are, for networks that use it.  "find": the fan is looked for
        in each image, as `simnfnd denoise` does.  "polar": rows are ranges, near range first, and
        the columns span 30 degrees.  None: not known.
    strength: part of the change that an image gets, 0 to 1.
    frames: of a stack whose images follow each other in time: up to so many, odd, are laid over
        each other and fused where they show the same; 1: each alone.
    causal: fuse with images before alone.
    device: gpu means CUDA; auto takes it where it is usable.
    return_removed: whether the removed signal is returned, too.

    Returns an array of the same shape and dtype, or a `DenoisedImage`.
    Raises ValueError for another shape or dtype, NaN, and floats outside 0..1; FactoryError for
    weights that are not there, a missing GPU, and where the extra `denoise` is not installed.
    """
    from .factory.production.cli.extras import Need, require

    needed = ("onnxruntime", "safetensors", "cv2", "scipy")
    require(Need("simnfnd.denoise", module) for module in needed)
    from .factory.dataset.fan_geometry import FanGeometry
    from .factory.dataset.schema import Pair
    from .models.denoise.images import Denoising
    from .models.pretrained import POINTS, find_weights
    from .models.recordings.fan_finder import find_geometry

    if isinstance(image, Pair):
        if weights is None and image.formation == "pointwise":
            weights = POINTS
        if geometry == "find" and image.geometry is not None:
            geometry = image.geometry
        image = image.noisy
    if isinstance(image, str | Path):
        raise ValueError(
            f"{image}: expected an array; read the file first (cv2.imread, open_recording), or "
            "run `simnfnd denoise FILE --out FOLDER`"
        )
    values = np.asarray(image)
    if values.ndim not in (2, 3):
        raise ValueError(f"image has shape {values.shape}; expected (H, W), (N, H, W) or (H, W, 3)")
    path = find_weights(weights)
    if not 0 <= strength <= 1:
        raise ValueError(f"strength={strength}: expected 0 to 1")
    network = _denoiser(path, path.stat().st_mtime_ns, device)
    if isinstance(geometry, str) and geometry not in ("find", "polar"):
        raise ValueError(f"geometry={geometry!r}: expected 'find', 'polar', a FanGeometry or None")

    def place(image: npt.NDArray[Any]) -> FanGeometry | None:
        if geometry == "polar":
            return FanGeometry.polar().with_size(*image.shape[:2])
        return find_geometry(image) if isinstance(geometry, str) else geometry

    known = values.astype(np.float32) if values.dtype.kind == "f" else values
    denoising = Denoising(network, frames=frames, causal=causal, strength=strength)
    if values.ndim == 2 or values.shape[2] <= 4:
        single = denoising.denoise_image(known, place)
        denoised_image = single.image.astype(values.dtype)
        if return_removed:
            return DenoisedImage(denoised_image, single.removed.signal)
        return denoised_image
    result = np.empty(values.shape, values.dtype)
    removed = np.empty(values.shape if return_removed else 0, np.float32)
    shots = (denoising.shot(number, image, place) for number, image in enumerate(known))
    for denoised in denoising.sequence(shots, alone=len(values) < 2):
        result[denoised.key] = denoised.image
        if return_removed:
            removed[denoised.key] = denoised.removed.signal
    return DenoisedImage(result, removed) if return_removed else result


@lru_cache(maxsize=2)
def _denoiser(path: Path, changed_ns: int, device: str) -> Denoiser:
    """changed_ns: of the file, so that weights trained anew are loaded anew."""
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

    image: npt.NDArray[Any]
    geometry: FanGeometry | None
    time_s: float | None
    frame: Frame

    @property
    def picture(self) -> npt.NDArray[Any]:
        """`image` by its name of version 0.4."""
        return self.image


class OpenRecording:
    """An opened recording: iterate, index or measure it; close it, or use it in `with`."""

    def __init__(self, path: str | Path) -> None:
        """See `open_recording`."""
        from .models.recordings import open_recording as opened

        self._recording = opened(path)
        self._trackers: dict[tuple[int, ...], FanTracker] = {}

    def __len__(self) -> int:
        return len(self._recording)

    def __getitem__(self, number: int) -> RecordedFrame:
        """One frame, from 0.  Raises IndexError, and FrameError when it is damaged."""
        return self._shown(self._recording[number])

    def __iter__(self) -> Iterator[RecordedFrame]:
        """All frames in order.  Raises FrameError at one that is damaged."""
        return map(self._shown, self._recording)

    @property
    def warning(self) -> str:
        """What is wrong with the file though its frames can be read; mostly empty."""
        return self._recording.warning

    def close(self) -> None:
        """Let go of the file."""
        self._recording.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _shown(self, frame: Frame) -> RecordedFrame:
        from .models.recordings.views import fan_of, grey_of

        if frame.beams is not None:
            return RecordedFrame(*fan_of(grey_of(frame), frame.beams), frame.time_s, frame)
        if frame.geometry is not None:
            return RecordedFrame(frame.samples, frame.geometry, frame.time_s, frame)
        from .models.recordings.fan_finder import find_geometry  # of the extra sonar
        from .models.recordings.fan_tracking import FanTracker
        from .models.recordings.images import Images

        # Images of a folder may have a fan each; that of a video changes now and then.
        samples = frame.samples
        if isinstance(self._recording, Images):
            geometry = find_geometry(samples)
        else:
            tracker = self._trackers.setdefault(samples.shape, FanTracker())
            geometry = tracker.geometry(samples)
        return RecordedFrame(samples, geometry, frame.time_s, frame)


def open_recording(path: str | Path) -> OpenRecording:
    """Open the recording of a sonar, a bag, a video, or a folder of images.

    path: `.aris`, `.ddf`, Oculus `.raw`, bags of ROS 1 and 2 (extra `ros`), `.avi` and other
        videos, images; docs/how-to/recordings.md has them all.

    Frames are read when they are asked for.  Raises FactoryError, one line, for a file that is not
    there, of no known kind, or damaged.
    """
    return OpenRecording(path)
