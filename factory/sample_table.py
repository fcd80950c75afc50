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
from typing import TYPE_CHECKING, NamedTuple, Protocol

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


# Start of a key's entry in the docstring of noise settings: `key: ` or `key, key: `.
_DOCUMENTED_KEYS = re.compile(r"(?<=\.) ((?:[a-z_]+, )*[a-z_]+): ")


def columns(noise: NoiseSettings, formation: Formation = "pointwise") -> tuple[Column, ...]:
    """Return the columns of the sample table.

    A parameter that was not drawn, because its effect is off, is NaN or empty in the rows.

    formation: acoustics.formation; pointwise images have one scale for clean and noisy.
    """
    target = _TARGET if formation == "coherent" else ()
    return _SAMPLE + target + tuple(map(_described, drawn.columns(noise)))


def _described(column: Column) -> Column:
    """Return the column of a noise parameter with the description of its settings key.

    Other columns, and those that have a description, are returned as they are.
    """
    kind, _, effect_and_parameter = column.name.partition(".")
    if kind != "noise" or column.description:
        return column

    effect, _, parameter = effect_and_parameter.partition(".")
    docstring = " ".join((EFFECTS[effect].settings.__doc__ or "").split())
    _, *entries = _DOCUMENTED_KEYS.split(docstring)
    for keys, meaning in zip(entries[::2], entries[1::2], strict=True):
        if parameter in keys.split(", "):
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
    """Return the row of one sample, without the columns of `dataset.columns`."""
    key_words = seeds.spawn_key(ref.location, ref.scene, ref.frame, variant)
    seed_key = "".join(f"{word:08x}" for word in key_words)
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


class ImageAxes(NamedTuple):
    """The axes of an image: along its rows from the top, along its columns from the left."""

    rows: Axis
    columns: Axis


def image_axes(sonar: SonarSettings) -> ImageAxes:
    """Return the row and column axes of the images.

    With one fixed range window they are metres (and degrees of azimuth for polar images).  With an
    automatic window, or several, every sample has its own scale: the axes count from 0 to 1 or in
    pixels, which `range_min_m`, `range_max_m`, `metres_per_pixel` of the table turn into metres.
    """
    if sonar.image.layout == "polar":
        return _polar_axes(sonar)
    return _fan_axes(sonar)


def _polar_axes(sonar: SonarSettings) -> ImageAxes:
    row_count, _ = sonar.shape()
    fraction = (np.arange(row_count) + 0.5) / sonar.range_bins
    azimuth = Axis("azimuth", "deg", np.rad2deg(sonar.beam_centres_rad()), "0 is straight ahead")
    if not sonar.range.fixed:
        return ImageAxes(
            Axis("range", "1", fraction, "0 at range_min_m, 1 at range_max_m"), azimuth
        )
    near_m = sonar.range.min_m
    far_m = sonar.range.max_m
    return ImageAxes(Axis("range", "m", near_m + fraction * (far_m - near_m)), azimuth)


def _fan_axes(sonar: SonarSettings) -> ImageAxes:
    row_count, column_count = sonar.shape()
    row_px = np.arange(row_count) + 0.5
    right_px = np.arange(column_count) + 0.5 - sonar.image.width_px / 2
    if not sonar.range.fixed:
        return ImageAxes(
            Axis("ahead", "px", row_px, "distance below range_max_m straight ahead"),
            Axis("right", "px", right_px, "distance to the right of the sonar's axis"),
        )
    far_m = sonar.range.max_m
    pixel_m = far_m * pixel_size(sonar, sonar.range.min_m / far_m)
    return ImageAxes(
        Axis("ahead", "m", far_m - row_px * pixel_m), Axis("right", "m", right_px * pixel_m)
    )


# --- columns of `dataset.columns`

# NaN where the recording does not say.
_POSE = (
    *(
        Column(f"{device}.{name}", "f8", unit, f"of the {device}: {description}")
        for device in ("camera", "sonar")
        for name, unit, description in (
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
# Of the image in rgb and depth; distortion is 0 where it was taken out or is not known.
_LENS = tuple(
    Column(f"camera.{name}", "f8", unit, f"{description}, as OpenCV defines it")
    for name, unit, description in (
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
# What turns grey values into sound pressure: level at the receiver = full scale of the image, its
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
    """Return the columns that `dataset.columns` asks for."""
    return tuple(column for name in names for column in _REQUESTABLE[name].columns)


def requested_row(lit: LitSurface, config: FactoryConfig) -> Row:
    """Return the values of `requested` for a frame as the sonar sees it."""
    row: Row = {}
    for name in config.dataset.columns:
        row |= _REQUESTABLE[name].row(lit, config)
    return row


def pose_row(frame: Frame, mount: Mount) -> Row:
    """Return the values of `pose` for a frame and the sonar mounted at its camera.

    NaN where the recording has no time, pose or altitude.
    """
    row: Row = dict.fromkeys((column.name for column in _POSE), float("nan"))
    if frame.time_s is not None:
        row["time_s"] = frame.time_s
    if frame.world_from_camera is None:
        return row

    world_from_camera = np.asarray(frame.world_from_camera, np.float64)
    camera_from_sonar = np.eye(4)
    camera_from_sonar[:3, :3] = mount.rotation_sonar_from_camera().T
    camera_from_sonar[:3, 3] = mount.position_camera_m()
    world_from_sonar = np.asarray(world_from_camera @ camera_from_sonar)
    pose_values = [*_position_and_quaternion(world_from_camera)]
    pose_values += _position_and_quaternion(world_from_sonar)
    row |= _row(_POSE[: len(pose_values)], *pose_values)

    forward = world_from_sonar[:3, 0]
    left = world_from_sonar[:3, 1]
    row["sonar.tilt_deg"] = float(np.rad2deg(np.arcsin(np.clip(-forward[2], -1, 1))))
    row["sonar.heading_deg"] = float(np.rad2deg(np.arctan2(forward[1], forward[0])))
    row["sonar.roll_deg"] = float(np.rad2deg(np.arcsin(np.clip(left[2], -1, 1))))
    if frame.altitude_m is not None:
        sonar_up_m = world_from_sonar[2, 3]
        camera_up_m = world_from_camera[2, 3]
        row["sonar.altitude_m"] = float(frame.altitude_m + sonar_up_m - camera_up_m)
    return row


def _position_and_quaternion(pose: npt.NDArray[np.float64]) -> list[float]:
    """Return x, y, z (metres) and the unit quaternion x, y, z, w of a (4, 4) pose, w >= 0."""
    from scipy.spatial.transform import Rotation  # slow to import

    quaternion = np.asarray(Rotation.from_matrix(pose[:3, :3]).as_quat(), np.float64)
    if quaternion[3] < 0:
        quaternion = -quaternion
    return [*pose[:3, 3].tolist(), *quaternion.tolist()]


def _lens_row(frame: Frame) -> Row:
    lens = frame.intrinsics
    no_distortion = (0.0, 0.0, 0.0, 0.0)
    values = (lens.fx, lens.fy, lens.cx, lens.cy, *lens.distortion, *no_distortion)
    return _row(_LENS, *map(float, values[: len(_LENS)]))


def _calibration_row(config: FactoryConfig) -> Row:
    sonar = config.sonar
    water = config.water
    acoustics = config.acoustics
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
    """Return the value of `boxes`: the frame's objects as JSON, those with most echoes first.

    Objects with the fewest echoes are left out where the text would exceed the column.
    Raises FrameError for a frame without boxes.
    """
    frame = lit.frame
    if frame.boxes is None or frame.instance is None:
        raise FrameError(f"{frame.ref.name}: has no boxes; leave boxes out of dataset.columns")

    instance_of_pixel = frame.instance.ravel()
    echoes, pixel, _ = lit.insonified
    has_echo = echoes.strength > 0
    instance_of_echo = instance_of_pixel[pixel[has_echo]]
    range_m = echoes.range_m[has_echo]
    bearing_deg = np.rad2deg(echoes.azimuth_rad[has_echo])
    is_shadowed = lit.rendered.surface & (lit.rendered.radiance <= 0)
    instance_of_shadow = instance_of_pixel[is_shadowed.ravel()]

    echo_counts: list[int] = []
    entries: list[dict[str, object]] = []
    for instance, label, *box, alone_px, hidden_px in frame.boxes.tolist():
        is_own = instance_of_echo == instance
        echo_count = int(is_own.sum())
        shadow_px = hidden_px + np.count_nonzero(instance_of_shadow == instance)
        outline_px = max(alone_px, 1)
        echo_counts.append(echo_count)
        entries.append(
            {
                "instance": int(instance),
                "class": classes[int(label)],
                **_box_in_sonar_axes(np.array(box), lit),
                "range_m": _limits(range_m[is_own]),
                "bearing_deg": _limits(bearing_deg[is_own]),
                "insonified": round(min(echo_count / outline_px, 1.0), 3),
                "shadowed": round(min(shadow_px / outline_px, 1.0), 3),
            }
        )

    most_echoes_first = sorted(range(len(entries)), key=lambda index: -echo_counts[index])
    entries = [entries[index] for index in most_echoes_first]
    while len(text := json.dumps(entries, separators=(",", ":"))) > _MOST_BYTES:
        entries.pop()
    return {"boxes": text}


def _limits(values: npt.NDArray[np.float32]) -> list[float] | None:
    """Return the smallest and largest value to 3 decimals, None for no values."""
    if not len(values):
        return None
    return [round(float(limit), 3) for limit in (values.min(), values.max())]


def _box_in_sonar_axes(box: npt.NDArray[np.float64], lit: LitSurface) -> dict[str, object]:
    """Return centre, size and yaw, in the sonar's axes, of a box in the camera's.

    box: (7,) centre, size (metres) and yaw (radians); see `Frame.boxes`.
    """
    cosine = np.cos(box[6])
    sine = np.sin(box[6])
    yaw_rotation = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])
    corner_signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners_level_m = box[:3] + (corner_signs * box[3:6] / 2) @ yaw_rotation.T

    corners_sonar_m = lit.sonar.mount.in_sonar_axes(corners_level_m @ _LEVEL)
    *centre_and_size_m, yaw_rad = oriented(corners_sonar_m)
    rounded_m = [round(float(length_m), 3) for length_m in centre_and_size_m]
    return {
        "centre_m": rounded_m[:3],
        "size_m": rounded_m[3:],
        "yaw_deg": round(float(np.rad2deg(yaw_rad)), 1),
    }


class Requestable(NamedTuple):
    """Columns that `dataset.columns` can ask for, and their values for a frame."""

    columns: tuple[Column, ...]
    row: Callable[[LitSurface, FactoryConfig], Row]


_REQUESTABLE: dict[str, Requestable] = {
    "pose": Requestable(_POSE, lambda lit, config: pose_row(lit.frame, config.sonar.mount)),
    "intrinsics": Requestable(_LENS, lambda lit, _: _lens_row(lit.frame)),
    "calibration": Requestable(_CALIBRATION, lambda _, config: _calibration_row(config)),
    "boxes": Requestable(
        _BOXES,
        lambda lit, config: _boxes_row(lit, class_names(config.scenes.own_classes())),
    ),
    "tracks": Requestable(TRACKS, lambda lit, config: tracks_row(lit, config.sonar.frequency_khz)),
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

    A render has lost the colour and rounds the depth, so frames whose images are asked for are
    read, or made, once more.
    """

    def __init__(self, config: FactoryConfig, chosen: Choose) -> None:
        """Reads nothing where `dataset.layers` asks for none.  chosen: frames of those found."""
        self._config = config
        self._chosen = chosen
        self._requested = CAMERA_LAYERS.intersection(config.dataset.layers)

    def layers(self, ref: FrameRef) -> Mapping[str, npt.NDArray[np.generic]]:
        """The requested of rgb (H, W, 3) uint8 and depth (H, W) float32, m, NaN where unknown.

        Raises FrameError when the frame is bad, or of another size than the first frame of the
        dataset: its images have one size.
        """
        if not self._requested:
            return {}
        frame = self._reader.load(ref)
        # Procedural frames all have the size of the settings, and take long to make.
        if self._config.scenes.kind != "seabed":
            self._check_size(ref, frame.depth_m.shape)
        return camera_images(frame, self._requested)

    def _check_size(self, ref: FrameRef, size: tuple[int, ...]) -> None:
        """Raise FrameError unless the frame is as large, (H, W), as the dataset's first."""
        first_ref, first_size = self._first
        if size == first_size:
            return

        size_text = "x".join(map(str, reversed(size)))
        first_size_text = "x".join(map(str, reversed(first_size)))
        raise FrameError(
            f"{ref.name}: its image is {size_text}, that of {first_ref.name} {first_size_text}; "
            "make one dataset of each size (scenes, frames.only), or leave "
            f"{', '.join(sorted(self._requested))} out of dataset.layers"
        )

    @cached_property
    def _reader(self) -> Reader:
        from .scenes import open_reader

        return open_reader(self._config.scenes)

    @cached_property
    def _first(self) -> tuple[FrameRef, tuple[int, ...]]:
        """The first readable frame and its (H, W), the same in all processes."""
        for ref in self._chosen(self._reader.discover().frames, self._config):
            with suppress(FrameError):
                return ref, self._reader.load(ref).depth_m.shape
        raise FactoryError("dataset.layers: no frame of the recordings can be read")
