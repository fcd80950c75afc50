"""What `import simnfnd` offers: `denoise`, `make_pair` and `open_recording`."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from .factory.config import FactoryConfig
    from .factory.dataset.schema import Pair
    from .factory.render.base import Renderer, RenderSettings
    from .factory.sonar.geometry import FanGeometry
    from .models.denoise.denoiser import Denoiser
    from .models.recordings import Frame


def denoise(
    picture: npt.ArrayLike,
    *,
    weights: str | Path | None = None,
    geometry: Literal["find", "polar"] | FanGeometry | None = "find",
    strength: float = 1.0,
    frames: int = 7,
    causal: bool = False,
    device: Literal["auto", "cpu", "gpu"] = "auto",
) -> npt.NDArray[Any]:
    """Denoise one sonar picture, or a stack of them.

    picture: (H, W), (N, H, W), or (H, W, 3 or 4) in colours; uint8, uint16, or float in 0..1.
        Colours of a colour map are denoised as the levels that they stand for.
    weights: a weights.safetensors of a training or the name of weights that ship: `simnfnd` (None)
        for real sonars, `simnfnd-paper` for the points that the paper simulates.  They stay loaded
        for the next call.
    geometry: where range and bearing are, for networks that use it.  "find": the fan is looked for
        in each picture, as `simnfnd denoise` does.  "polar": rows are ranges, near range first, and
        the columns span 30 degrees.  None: not known.
    strength: part of the change that a picture gets, 0 to 1.
    frames: of a stack whose pictures follow each other in time: up to so many, odd, are laid over
        each other and fused where they show the same; 1: each by itself.
    causal: fuse with pictures before alone.
    device: gpu means CUDA; auto takes it where it is usable.

    Returns an array of the same shape and dtype.
    Raises ValueError for another shape or dtype, NaN, and floats outside 0..1; FactoryError for
    weights that are not there, a missing GPU, and where the extra `denoise` is not installed.
    """
    from .factory.cli.extras import Need, require

    needed = ("onnxruntime", "safetensors", "cv2", "scipy")
    require(Need("simnfnd.denoise", module) for module in needed)
    from .factory.sonar.geometry import FanGeometry
    from .models.denoise.pictures import Denoising
    from .models.pretrained import find_weights
    from .models.recordings.fan_finder import find_geometry

    given = np.asarray(picture)
    if given.ndim not in (2, 3):
        raise ValueError(
            f"picture has shape {given.shape}; expected (H, W), (N, H, W) or (H, W, 3)"
        )
    path = find_weights(weights)
    if not 0 <= strength <= 1:
        raise ValueError(f"strength={strength}: expected 0 to 1")
    network = _denoiser(path, path.stat().st_mtime_ns, device, strength)
    if isinstance(geometry, str) and geometry not in ("find", "polar"):
        raise ValueError(f"geometry={geometry!r}: expected 'find', 'polar', a FanGeometry or None")

    def place(image: npt.NDArray[Any]) -> FanGeometry | None:
        if geometry == "polar":
            return FanGeometry.polar().with_size(*image.shape[:2])
        return find_geometry(image) if isinstance(geometry, str) else geometry

    known = given.astype(np.float32) if given.dtype.kind == "f" else given
    denoising = Denoising(network, frames=frames, causal=causal, calibrated=strength == 1)
    if given.ndim == 2 or given.shape[2] in (3, 4):
        return denoising.one(known, place).astype(given.dtype)
    result = np.empty(given.shape, given.dtype)
    shots = (denoising.shot(number, image, place) for number, image in enumerate(known))
    for number, denoised in denoising.sequence(shots, alone=len(given) < 2):
        result[number] = denoised
    return result


def make_pair(
    rgb: npt.NDArray[np.uint8],
    depth_m: npt.ArrayLike,
    *,
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    config: Sequence[str] = ("experiment=simnfnd", "render=analytic"),
    seed: int | None = None,
    variant: int = 0,
    name: str = "frame",
    scene: str = "",
) -> Pair:
    """One (noisy, clean) pair of sonar pictures from an RGBD frame.

    rgb: (H, W, 3) uint8, in the order red, green, blue.
    depth_m: (H, W) distance along the optical axis in metres; 0, negative, infinite and NaN mean
        that nothing was measured.
    fx, fy, cx, cy: focal lengths and principal point of this very image size, in pixels.
    config: words of `simnfnd make`, for example ("experiment=physical", "sonar=didson_hf");
        those of scenes, frames, scheduler and cache change nothing here.
    seed: the same as "seed=..." among `config`.
    variant: other numbers thin the echoes and draw the noise anew.
    name, scene: of the frame; with seed and variant they decide what is drawn.

    Returns a `Pair`: noisy and clean (H', W') uint8 in 0..255 (float32 in 0..1 with
    "dataset.dtype=float32"), shadow (H', W') bool, layers, and record, with every drawn parameter.
    Raises FrameError when the frame has no usable depth or the sonar would see nothing of it, and
    FactoryError for wrong words and modules that are not installed.
    """
    from .factory.cli.extras import needs_of, require
    from .factory.frame import Frame, FrameRef, Intrinsics, checked
    from .factory.pairs import PairMaker
    from .factory.render.view import view_of
    from .factory.views import Views

    settings = _config((*config, *(() if seed is None else (f"seed={seed}",))))
    require(needs_of(settings))
    ref = FrameRef("", scene, name)
    depth = np.asarray(depth_m, dtype=np.float32)
    frame = checked(Frame(ref, rgb, depth, Intrinsics(fx, fy, cx, cy)), bad_depth="mask")
    mount = settings.sonar.mount
    rendered = _renderer(settings.render).render(frame, mount)
    maker = PairMaker(settings, Views({ref: view_of(frame, rendered, mount)}))
    (pair,) = maker.pairs(ref, (variant,))
    return pair


@lru_cache(maxsize=8)
def _config(words: tuple[str, ...]) -> FactoryConfig:
    from .factory.cli.compose import compose_config

    # The frame is at hand, so where recordings are does not matter.
    return compose_config(words, {"kind": "csv_list", "file": ".", "intrinsics": [1, 1, 0, 0]})


@lru_cache(maxsize=1)
def _renderer(settings: RenderSettings) -> Renderer:
    from .factory.render import open_renderer

    return open_renderer(settings)


@lru_cache(maxsize=2)
def _denoiser(path: Path, changed_ns: int, device: str, strength: float) -> Denoiser:
    """changed_ns: of the file, so that weights trained anew are loaded anew."""
    from .models.denoise.denoiser import Denoiser

    return Denoiser(path, device, strength=strength)


@dataclass(frozen=True, eq=False)
class RecordedFrame:
    """One frame of a recording.

    picture: (H, W) float32 in 0..1, a fan with far range on top; or, of a picture or video, its
        pixels as they are stored, (H, W) or (H, W, colours).
    geometry: where range and bearing are in it: as the file says, else as found in the picture
        (range_fraction without metres); None where there is no fan.
    time_s: seconds since 1970 (UTC), or since the start where the file has no clock; None: unknown.
    frame: all that the file says: samples as stored, beams, pose and device.
    """

    picture: npt.NDArray[Any]
    geometry: FanGeometry | None
    time_s: float | None
    frame: Frame


class OpenRecording:
    """An opened recording: iterate, index or measure it; close it, or use it in `with`."""

    def __init__(self, path: str | Path) -> None:
        """See `open_recording`."""
        from .models.recordings import open_recording as opened

        self._recording = opened(path)
        self._found: dict[tuple[int, ...], FanGeometry | None] = {}

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
        from .models.recordings.fan_finder import find_geometry  # of the extra sonar
        from .models.recordings.pictures import Pictures

        # A video's fan stays where it was found first; pictures of a folder may have a fan each.
        shape = frame.samples.shape
        if shape not in self._found or isinstance(self._recording, Pictures):
            self._found[shape] = find_geometry(frame.samples)
        return RecordedFrame(frame.samples, self._found[shape], frame.time_s, frame)


def open_recording(path: str | Path) -> OpenRecording:
    """Open the recording of a sonar, a bag, a video, or a folder of pictures.

    path: `.aris`, `.ddf`, Oculus `.raw`, bags of ROS 1 and 2 (extra `ros`), `.avi` and other
        videos, pictures; docs/recordings.md has them all.

    Frames are read when they are asked for.  Raises FactoryError, one line, for a file that is not
    there, of no known kind, or damaged.
    """
    return OpenRecording(path)
