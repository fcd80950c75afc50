"""The image stacks of a shard: which there are, and what their values mean."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

from ...errors import FactoryError
from ...labels import CLASSES

# A picture of 4096 x 4096; the largest imaging sonars have 2048 beams.
MAX_PIXELS = 1 << 24


@dataclass(frozen=True)
class Layer:
    """One image stack of a shard: (samples, rows, columns), chunked one image at a time.

    classes: what the values 0, 1, 2, ... mean, for labels.  least, most: limits of real numbers.
    of_camera: names of the dimensions of a picture that is the camera's; it has a size of its own
        and no axes.  Empty for the sonar's.
    """

    name: str
    dtype: str
    description: str
    units: str = "1"
    classes: tuple[str, ...] = ()
    least: float = 0.0
    most: float = math.inf
    of_camera: tuple[str, ...] = ()


_RIGHT_ANGLE = math.pi / 2


def _angle(name: str, description: str) -> Layer:
    return Layer(name, "float32", description, "rad", least=-_RIGHT_ANGLE, most=_RIGHT_ANGLE)


# Written where `dataset.layers` asks for them.
OPTIONAL_LAYERS = (
    Layer("range", "float32", "slant range of the strongest echo; NaN where there is none", "m"),
    _angle("elevation", "elevation of the strongest echo; NaN where there is none"),
    _angle("elevation_min", "lowest elevation of the echoes in the bin; NaN where there is none"),
    _angle("elevation_max", "highest elevation of the echoes in the bin; NaN where there is none"),
    _angle("azimuth", "azimuth of the strongest echo, right is positive; NaN where there is none"),
    Layer("valid_azimuth", "bool", "inside the sector, at a bearing that the camera saw"),
    Layer("segmentation", "uint8", "class of the object of the strongest echo", classes=CLASSES),
    Layer("instance", "uint16", "number within its scene of that object, 0 = none"),
    Layer(
        "intensity_db",
        "float32",
        "received intensity of the noisy picture before time-varying gain; NaN without data",
        "dB re 1 uPa",
        least=-math.inf,
    ),
    Layer(
        "field",
        "complex64",
        "beamformed field of the noisy picture before time-varying gain; 0 without data",
        "uPa",
    ),
    Layer(
        "rgb",
        "uint8",
        "the camera's picture of the frame that the pair was made of: red, green, blue, 0..255",
        of_camera=("camera_row", "camera_column", "channel"),
    ),
    Layer(
        "depth",
        "float32",
        "of that frame, registered to rgb: distance along the camera's optical axis (z, not slant "
        "range); NaN where none was measured",
        "m",
        of_camera=("camera_row", "camera_column"),
    ),
)
CHANNELS = 3
CAMERA_LAYERS = frozenset(layer.name for layer in OPTIONAL_LAYERS if layer.of_camera)
# Of every echo behind a pair, where `dataset.layers` asks for `echoes`: flat lists, see `echoes`.
ECHO_FOLDER = "echoes/"
_MOST_INT32 = float(1 << 30)
ECHO_FIELDS = (
    Layer(
        "bin",
        "int32",
        "range bin * beams + beam, ascending within a sample; attribute grid: range bins, beams",
        most=_MOST_INT32,
    ),
    Layer("range", "float32", "slant range", "m", most=1e6),
    Layer("azimuth", "float32", "azimuth, right is positive", "rad", least=-math.pi, most=math.pi),
    _angle("elevation", "elevation, up is positive"),
    Layer(
        "strength",
        "float32",
        "linear echo intensity after time-varying gain, relative: radiance of the render times the "
        "gain; the strongest of a bin is the one that /range and /elevation tell of",
        most=3e38,
    ),
    Layer("pixel", "int32", "row * columns + column in the camera's frame", most=_MOST_INT32),
    Layer("segmentation", "uint8", "class of the object that echoes", classes=CLASSES),
    Layer("instance", "uint16", "number within its scene of that object, 0 = none", most=65535),
)
EFFECT_FOLDER = "layers/"
_EFFECT = re.compile(rf"{EFFECT_FOLDER}[a-z][a-z0-9_]{{0,39}}")


def layers(dtype: str, optional: Iterable[str] = ()) -> tuple[Layer, ...]:
    """The image stacks of a shard whose images are stored as `dtype` (uint8 or float32).

    optional: names of further layers, in any order; they come out in that of the format.
    Raises FactoryError for one that the format does not know.
    """
    known = {layer.name: layer for layer in OPTIONAL_LAYERS}
    further = []
    place = {layer.name: number for number, layer in enumerate(OPTIONAL_LAYERS)}
    for name in sorted(optional, key=lambda name: (place.get(name, len(place)), name)):
        if _EFFECT.fullmatch(name):
            effect = name.removeprefix(EFFECT_FOLDER)
            known[name] = Layer(name, dtype, f"noisy image with {effect} as its only noise")
        if name not in known:
            raise FactoryError(f"/{name}: no layer of the format")
        further.append(known[name])
    return (
        Layer("noisy", dtype, "sonar image with noise; input of a denoiser"),
        Layer("clean", dtype, "ideal sonar image of the same points; target of a denoiser"),
        Layer("shadow", "bool", "inside the sector, where no echo arrives in the ideal image"),
        *further,
    )


def stores_grey(layer: Layer) -> bool:
    """Whether a layer holds grey values, stored as uint8 or float32 as the user chose."""
    return layer.name in ("noisy", "clean") or layer.name.startswith(EFFECT_FOLDER)
