"""The sample table: how a pair was made, and what `dataset.columns` and `dataset.layers` ask for.

World axes are the recording's; of `scenes=seabed` z is up.  Camera axes: x right, y down, z
forward; sonar axes: x forward, y left, z up (REP 103).  A quaternion (x, y, z, w) turns directions
in the axes of the device into those of the world.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

import numpy as np
import numpy.typing as npt

from . import seeds
from .dataset.schema import CAMERA_LAYERS, Axis, Column
from .errors import FactoryError, FrameError
from .frame import Frame, FrameRef
from .imaging.contract import Sample
from .imaging.settings import CoherentSettings, Formation
from .labels import class_names
from .moving.tracks import TRACKS, tracks_row
from .noise import draws as drawn
from .noise.draws import Draws
from .noise.registry import EFFECTS, NoiseSettings
from .render.base import Mount
from .scenes.seabed.camera import oriented
from .sonar.fan import pixel_size
from .sonar.settings import SonarSettings
from .sonar.surface import LitSurface
from .sonar.window import Window

if TYPE_CHECKING:
    from .config import FactoryConfig
    from .scenes import Reader

Row = dict[str, float | str]
Frames = tuple[FrameRef, ...]
Choose = Callable[[Frames, "FactoryConfig"], Frames]

_SAMPLE = (
    Column("location", "S96", "", "area of the recording"),
    Column("scene", "S96", "", "recording; train and test are split by it"),
    Column("frame", "S96", "", "frame within the scene"),
    Column("variant", "i4", "1", "number of the noise draw of this frame"),
    Column("seed_key", "S32", "", "blake2b spawn key of the sample's random streams, hexadecimal"),
    Column("range_min_m", "f8", "m", "range at the near edge of the picture"),
    Column("range_max_m", "f8", "m", "range at the far edge of the picture"),
    Column("azimuth_min_deg", "f8", "deg", "left edge of the sector that the camera saw"),
    Column("azimuth_max_deg", "f8", "deg", "right edge of the sector that the camera saw"),
    Column("metres_per_pixel", "f8", "m", "edge of a fan pixel, or length of a range bin"),
    Column("resample.rate", "f8", "1", "fraction of the scene points kept"),
    Column("points.scene", "i8", "1", "scene points in the pictures"),
    Column("full_scale", "f8", "1", "echo level shown as grey value 1"),
)
_TARGET = (
    Column(
        "clean_full_scale",
        "f8",
        "1",
        "level shown as grey value 1 in the clean picture, in the unit of its target: echo "
        "intensity; radiometric: backscatter",
    ),
)


def columns(noise: NoiseSettings, formation: Formation = "pointwise") -> tuple[Column, ...]:
    """Columns of the sample table: a parameter that was not drawn (effect off) is NaN or empty.

    formation: acoustics.formation; pointwise images have one scale for clean and noisy.
    """
    target = _TARGET if formation == "coherent" else ()
    return _SAMPLE + target + tuple(map(_described, drawn.columns(noise)))


def _described(column: Column) -> Column:
    """A parameter of noise says what the docstring of its settings says of the key."""
    kind, _, rest = column.name.partition(".")
    if kind != "noise" or column.description:
        return column
    effect, _, parameter = rest.partition(".")
    text = " ".join((EFFECTS[effect].settings.__doc__ or "").split())
    _, *told = re.split(r"(?<=\.) ((?:[a-z_]+, )*[a-z_]+): ", text)
    for names, meaning in zip(told[::2], told[1::2], strict=True):
        if parameter in names.split(", "):
            return replace(column, description=meaning.rstrip("."))
    return column


def record(
    ref: FrameRef,
    variant: int,
    window: Window,
    sonar: SonarSettings,
    sample: Sample,
    draws: Draws,
    formation: Formation = "pointwise",
) -> Row:
    """The row of one sample."""
    names = (ref.location, ref.scene, ref.frame, variant)
    seed_key = "".join(f"{word:08x}" for word in seeds.spawn_key(*names))
    pixel_m = window.range_span_m / sonar.range_bins
    if sonar.image.layout != "polar":
        pixel_m = window.range_max_m * pixel_size(sonar, window.near_fraction)
    row: Row = {
        "location": ref.location,
        "scene": ref.scene,
        "frame": ref.frame,
        "variant": variant,
        "seed_key": seed_key,
        "range_min_m": window.range_min_m,
        "range_max_m": window.range_max_m,
        "azimuth_min_deg": float(np.rad2deg(window.azimuth_min_rad)),
        "azimuth_max_deg": float(np.rad2deg(window.azimuth_max_rad)),
        "metres_per_pixel": pixel_m,
        "resample.rate": sample.rate,
        "points.scene": sample.points,
        "full_scale": sample.full_scale,
    }
    if formation == "coherent":
        row["clean_full_scale"] = sample.full_scale
    return row | draws.row(sample.added)


def _row(columns: Sequence[Column], *values: float | str) -> Row:
    return {column.name: value for column, value in zip(columns, values, strict=True)}


def image_axes(sonar: SonarSettings) -> tuple[Axis, Axis]:
    """Row and column axes.

    With one fixed range window they are metres (and degrees of azimuth for polar pictures).  With
    an automatic one, or several, every sample has its own scale: the axes count from 0 to 1 or in
    pixels, which `range_min_m`, `range_max_m`, `metres_per_pixel` of the table turn into metres.
    """
    rows, columns_ = (np.arange(size) + 0.5 for size in sonar.shape())
    near, far = sonar.range.min_m, sonar.range.max_m
    if sonar.image.layout == "polar":
        fraction = rows / sonar.range_bins
        down = Axis("range", "1", fraction, "0 at range_min_m, 1 at range_max_m")
        if sonar.range.fixed:
            down = Axis("range", "m", near + fraction * (far - near))
        bearings = np.rad2deg(sonar.beam_centres_rad())
        return down, Axis("azimuth", "deg", bearings, "0 is straight ahead")
    right = columns_ - sonar.image.width_px / 2
    if not sonar.range.fixed:
        return (
            Axis("ahead", "px", rows, "distance below range_max_m straight ahead"),
            Axis("right", "px", right, "distance to the right of the sonar's axis"),
        )
    pixel_m = far * pixel_size(sonar, near / far)
    return Axis("ahead", "m", far - rows * pixel_m), Axis("right", "m", right * pixel_m)


# --- what is asked for

# NaN where the recording does not say.
_POSE = (
    *(
        Column(f"{device}.{name}", "f8", unit, f"of the {device}: {what}")
        for device in ("camera", "sonar")
        for name, unit, what in (
            *((f"{axis}_m", "m", f"position along the world's {axis}") for axis in "xyz"),
            *((f"q{part}", "1", f"quaternion to world axes, {part}") for part in "xyzw"),
        )
    ),
    Column("time_s", "f8", "s", "when the frame was taken, from any beginning"),
    Column("sonar.tilt_deg", "f8", "deg", "how far the sonar looks below the horizon"),
    Column("sonar.heading_deg", "f8", "deg", "where it looks, from the world's x towards its y"),
    Column("sonar.roll_deg", "f8", "deg", "how far its left side is up"),
    Column("sonar.altitude_m", "f8", "m", "height above the ground right under the camera"),
)
# Of the picture in rgb and depth; distortion is 0 where it was taken out or is not known.
_LENS = tuple(
    Column(f"camera.{name}", "f8", unit, f"{what}, as OpenCV defines it")
    for name, unit, what in (
        ("fx_px", "px", "focal length across"),
        ("fy_px", "px", "focal length down"),
        ("cx_px", "px", "column of the principal point"),
        ("cy_px", "px", "row of the principal point"),
        ("k1", "1", "radial distortion r^2"),
        ("k2", "1", "radial distortion r^4"),
        ("p1", "1", "tangential distortion"),
        ("p2", "1", "tangential distortion"),
    )
)
# What turns grey values into sound pressure: level at the receiver = full scale of the picture, its
# transfer curve backwards, less the gain, plus the source level; layer intensity_db is the result.
_CALIBRATION = (
    Column("source_level_db", "f8", "dB re 1 uPa at 1 m", "of the device"),
    Column("sound_speed_m_s", "f8", "m/s", "of the water"),
    Column("absorption_db_per_m", "f8", "dB/m", "of the water at the frequency, one way"),
    Column("tvg_db_per_decade", "f8", "dB", "time-varying gain of the pictures, per tenfold range"),
    Column("tvg_db_per_m", "f8", "dB/m", "time-varying gain of the pictures, per metre"),
)
_MOST_BYTES = 12288
_BOXES = (
    Column(
        "boxes",
        f"S{_MOST_BYTES}",
        "",
        "JSON list of the objects in sight, most echoes first: instance, class; centre_m "
        "(ahead, left, up), size_m (length, width, height) and yaw_deg (from ahead to the left) in "
        "the sonar's axes; range_m and bearing_deg (right is positive) around its echoes, null "
        "without any; insonified and shadowed, parts of the outline that it would have alone",
    ),
)
# Ahead, left and up of the camera, from its right, down, ahead.
_LEVEL = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])


def requested(names: Sequence[str]) -> tuple[Column, ...]:
    """The columns that `dataset.columns` asks for."""
    return tuple(column for name in names for column in _REQUESTED[name][0])


def requested_row(lit: LitSurface, config: FactoryConfig) -> Row:
    """The values of `requested` for a frame as the sonar sees it."""
    rows = (_REQUESTED[name][1](lit, config) for name in config.dataset.columns)
    return {name: value for row in rows for name, value in row.items()}


def pose_row(frame: Frame, mount: Mount) -> Row:
    """The values of `pose` for a frame and the sonar mounted at its camera."""
    row: Row = dict.fromkeys((column.name for column in _POSE), float("nan"))
    if frame.time_s is not None:
        row["time_s"] = frame.time_s
    if frame.world_from_camera is None:
        return row
    camera = np.asarray(frame.world_from_camera, np.float64)
    camera_from_sonar = np.eye(4)
    camera_from_sonar[:3, :3] = mount.rotation_sonar_from_camera().T
    camera_from_sonar[:3, 3] = mount.position_camera_m()
    sonar = np.asarray(camera @ camera_from_sonar)
    numbers = [
        number
        for pose in (camera, sonar)
        for number in (*pose[:3, 3].tolist(), *_quaternion(pose[:3, :3]).tolist())
    ]
    row |= _row(_POSE[: len(numbers)], *numbers)
    forward, left = sonar[:3, 0], sonar[:3, 1]
    row["sonar.tilt_deg"] = float(np.rad2deg(np.arcsin(np.clip(-forward[2], -1, 1))))
    row["sonar.heading_deg"] = float(np.rad2deg(np.arctan2(forward[1], forward[0])))
    row["sonar.roll_deg"] = float(np.rad2deg(np.arcsin(np.clip(left[2], -1, 1))))
    if frame.altitude_m is not None:
        row["sonar.altitude_m"] = float(frame.altitude_m + sonar[2, 3] - camera[2, 3])
    return row


def _quaternion(rotation: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(4,) unit quaternion (x, y, z, w) of a rotation matrix, w not negative."""
    from scipy.spatial.transform import Rotation  # slow to import

    found = np.asarray(Rotation.from_matrix(rotation).as_quat(), np.float64)
    return -found if found[3] < 0 else found


def _lens_row(frame: Frame) -> Row:
    lens = frame.intrinsics
    numbers = (lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion, 0.0, 0.0, 0.0, 0.0)
    return _row(_LENS, *map(float, numbers[: len(_LENS)]))


def _calibration_row(config: FactoryConfig) -> Row:
    sonar, water, acoustics = config.sonar, config.water, config.acoustics
    assert isinstance(acoustics, CoherentSettings)  # the configuration refuses others
    absorption = water.absorption_db_per_m(sonar.frequency_khz)
    return _row(
        _CALIBRATION,
        sonar.array.source_level_db,
        water.sound_speed_m_s(),
        absorption,
        acoustics.tvg_log,
        2 * absorption if acoustics.tvg_absorption else 0.0,
    )


def _boxes_row(lit: LitSurface, classes: Sequence[str]) -> Row:
    """Raises FrameError for a frame without boxes."""
    frame = lit.frame
    if frame.boxes is None or frame.instance is None:
        raise FrameError(f"{frame.ref.name}: has no boxes; leave boxes out of dataset.columns")
    echoes, pixel, _ = lit.insonified
    heard = echoes.strength > 0
    number = frame.instance.ravel()
    of, range_m = number[pixel[heard]], echoes.range_m[heard]
    bearing_deg = np.rad2deg(echoes.azimuth_rad[heard])
    dark = number[(lit.rendered.surface & (lit.rendered.radiance <= 0)).ravel()]
    found: list[tuple[int, dict[str, object]]] = []
    for instance, label, *box, alone_px, hidden_px in frame.boxes.tolist():
        own = of == instance
        heard_px, dark_px = int(own.sum()), hidden_px + np.count_nonzero(dark == instance)
        entry = {
            "instance": int(instance),
            "class": classes[int(label)],
            **_of_sonar(np.array(box), lit),
            "range_m": _limits(range_m[own]),
            "bearing_deg": _limits(bearing_deg[own]),
            "insonified": round(min(heard_px / max(alone_px, 1), 1.0), 3),
            "shadowed": round(min(dark_px / max(alone_px, 1), 1.0), 3),
        }
        found.append((-heard_px, entry))
    kept = [entry for _, entry in sorted(found, key=lambda one: one[0])]
    while len(text := json.dumps(kept, separators=(",", ":"))) > _MOST_BYTES:
        kept.pop()
    return {"boxes": text}


def _limits(values: npt.NDArray[np.float32]) -> list[float] | None:
    return [round(float(v), 3) for v in (values.min(), values.max())] if len(values) else None


def _of_sonar(box: npt.NDArray[np.float64], lit: LitSurface) -> dict[str, object]:
    """Centre, size and yaw of a box in the camera's axes, see `Frame.boxes`, in the sonar's."""
    mount, (c, s) = lit.sonar.mount, (np.cos(box[6]), np.sin(box[6]))
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    corners = box[:3] + (signs * box[3:6] / 2) @ turn.T
    seen = (corners @ _LEVEL - mount.position_camera_m()) @ mount.rotation_sonar_from_camera().T
    *numbers, yaw = oriented(seen)
    centre, size = ([round(float(v), 3) for v in numbers[k : k + 3]] for k in (0, 3))
    return {"centre_m": centre, "size_m": size, "yaw_deg": round(float(np.rad2deg(yaw)), 1)}


# What `dataset.columns` can ask for: columns, and their values for a frame as the sonar sees it.
_REQUESTED: dict[str, tuple[tuple[Column, ...], Callable[[LitSurface, FactoryConfig], Row]]] = {
    "pose": (_POSE, lambda lit, config: pose_row(lit.frame, config.sonar.mount)),
    "intrinsics": (_LENS, lambda lit, _: _lens_row(lit.frame)),
    "calibration": (_CALIBRATION, lambda _, config: _calibration_row(config)),
    "boxes": (
        _BOXES,
        lambda lit, config: _boxes_row(lit, class_names(config.scenes.own_classes())),
    ),
    "tracks": (TRACKS, lambda lit, config: tracks_row(lit, config.sonar.frequency_khz)),
}


class CameraLayers(Protocol):
    """Gives the images of the camera that `dataset.layers` asks for."""

    def layers(self, ref: FrameRef) -> Mapping[str, npt.NDArray[np.generic]]:
        """The requested of rgb (H, W, 3) uint8 and depth (H, W) float32, m, NaN where unknown."""


def camera_images(frame: Frame, names: Collection[str]) -> Mapping[str, npt.NDArray[np.generic]]:
    """Those of rgb and depth that are among `names`; see `CameraLayers`."""
    depth_m = np.where(frame.valid, frame.depth_m, np.float32(np.nan))
    images = {"rgb": frame.rgb, "depth": depth_m}
    return {name: image for name, image in images.items() if name in names}


class FrameCamera:
    """The camera's images of one frame in memory."""

    def __init__(self, frame: Frame, names: Collection[str]) -> None:
        self._frame = frame
        self._names = names

    def layers(self, ref: FrameRef) -> Mapping[str, npt.NDArray[np.generic]]:
        """See `CameraLayers`."""
        return camera_images(self._frame, self._names)


class Camera:
    """The layers rgb and depth of frames.

    A render has lost the colour and rounds the depth, so frames whose pictures are asked for are
    read, or made, once more.
    """

    def __init__(self, config: FactoryConfig, chosen: Choose) -> None:
        """Reads nothing where `dataset.layers` asks for none.  chosen: frames of those found."""
        self._config, self._chosen = config, chosen
        self._requested = CAMERA_LAYERS.intersection(config.dataset.layers)

    def layers(self, ref: FrameRef) -> Mapping[str, npt.NDArray[np.generic]]:
        """The requested of rgb (H, W, 3) uint8 and depth (H, W) float32, m, NaN where unknown.

        Raises FrameError when the frame is bad, or of another size than the first frame of the
        dataset: its pictures have one size.
        """
        if not self._requested:
            return {}
        frame = self._reader.load(ref)
        size = frame.depth_m.shape
        # Procedural frames are as large as the settings say, and take long to make.
        first = self._first if self._config.scenes.kind != "seabed" else (ref, size)
        if size != first[1]:
            own, other = ("x".join(map(str, reversed(one))) for one in (size, first[1]))
            raise FrameError(
                f"{ref.name}: its picture is {own}, that of {first[0].name} {other}; "
                "make one dataset of each size (scenes, frames.only), or leave "
                f"{', '.join(sorted(self._requested))} out of dataset.layers"
            )
        return camera_images(frame, self._requested)

    @cached_property
    def _reader(self) -> Reader:
        from .scenes import open_reader

        return open_reader(self._config.scenes)

    @cached_property
    def _first(self) -> tuple[FrameRef, tuple[int, ...]]:
        """The first frame that can be read, and its (H, W); of all processes the same."""
        for ref in self._chosen(self._reader.discover().frames, self._config):
            with suppress(FrameError):
                return ref, self._reader.load(ref).depth_m.shape
        raise FactoryError("dataset.layers: no frame of the recordings can be read")  # one was
