"""The dataset format as data: names, shapes, dtypes, units and attributes of `simnfnd/1`.

What a shard holds (layers, axes, columns, root attributes) and what it is made of
(pairs and their sources).  The writer follows this file, and so do reader, validator and
docs/dataset.md.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..common.array_types import Array, Bools, Float32s, Float64s
from ..common.errors import FactoryError, FrameError
from .frame_ref import FrameRef
from .meaning import CLASSES, Formation, grey_meaning

if TYPE_CHECKING:
    from .fan_geometry import FanGeometry

SCHEMA = "simnfnd/1"
SPLITS = ("train", "test")
# What a dataset may be called.
DATASET_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}")
# Every shard says whose sample a row is; a source adds its own columns to these.
REQUIRED_COLUMNS = ("location", "scene", "frame", "variant")
VALUE_RANGES: dict[str, tuple[float, float]] = {"uint8": (0, 255), "float32": (0.0, 1.0)}
# A row per sample, a column per layer: CRC-32 of each image.
CHECKSUMS = "checksums"
# Root attributes that are made of all the rest.
SEALS = ("checksum", "text_checksum")
# An image of 4096 x 4096; the largest imaging sonars have 2048 beams.
MAX_PIXELS = 1 << 24


@dataclass(frozen=True)
class Layer:
    """One image stack of a shard: (samples, rows, columns), chunked one image at a time.

    classes: what the values 0, 1, 2, ... mean, for labels.  least, most: limits of real numbers.
    of_camera: names of the dimensions of an image that is the camera's; it has a size of its own
        and no axes.  Empty for the sonar's.
    grey: whether it holds grey values, stored as uint8 or float32 as the user chose.
    """

    name: str
    dtype: str
    description: str
    units: str = "1"
    classes: tuple[str, ...] = ()
    least: float = 0.0
    most: float = math.inf
    of_camera: tuple[str, ...] = ()
    grey: bool = False

    def attributes(self) -> dict[str, Any]:
        """Attribute name -> value of the image stack."""
        limits = {"value_range": np.asarray(VALUE_RANGES.get(self.dtype, ()), dtype=self.dtype)}
        return {
            "description": self.description,
            **(limits if self.grey else {}),
            "units": self.units,
            **({"classes": list(self.classes)} if self.classes else {}),
        }

    def size_problem(self, shape: tuple[int, ...], sonar_shape: tuple[int, ...]) -> str | None:
        """What is wrong with the shape of an image.  sonar_shape: (H, W) of the sonar's."""
        fits = shape == sonar_shape
        if self.of_camera:
            fits = len(shape) == len(self.of_camera) and shape[2:] in ((), (CHANNELS,))
        if fits and 0 < shape[0] * shape[1] <= MAX_PIXELS:
            return None
        expected = ", ".join(self.of_camera) or sonar_shape
        return f"is {shape}; expected {expected} and at most {MAX_PIXELS} pixels"

    def value_problem(self, image: Array) -> str | None:
        """What is wrong with the values of an image of the right type."""
        kind = image.dtype.kind
        if self.classes and image.max() >= len(self.classes):
            return f"has class {image.max()}; the schema knows {len(self.classes)}"
        if kind == "b" and not np.isin(image.view(np.uint8), (0, 1)).all():
            return "has values that are neither true nor false"
        if kind == "c" and not np.isfinite(image).all():
            return "has NaN or infinite values"
        if kind != "f":
            return None
        low, high = self.least, np.float32(self.most)
        known = image if self.grey else image[~np.isnan(image)]
        # Also false for NaN, which compares as neither.
        inside = not known.size or (known.min() >= low and known.max() <= high)
        if inside and np.isfinite(known).all():
            return None
        return f"has values outside {low:g}..{high:g}{', or NaN' if self.grey else ''}"


def _grey(name: str, description: str) -> Layer:
    return Layer(name, "uint8", description, most=1.0, grey=True)


def _angle(name: str, description: str) -> Layer:
    return Layer(name, "float32", description, "rad", least=-math.pi / 2, most=math.pi / 2)


_CORE_LAYERS = (
    _grey("noisy", "sonar image with noise; input of a denoiser"),
    _grey("clean", "noise-free sonar image of the same scene; target of a denoiser"),
    Layer("shadow", "bool", "inside the sector, where no echo arrives in the clean image"),
)
# Layers of every shard.
CORE = tuple(layer.name for layer in _CORE_LAYERS)
# Written where `dataset.layers` asks for them.
OPTIONAL_LAYERS = (
    _grey("static", "the clean image of the scene without moving objects"),
    _grey("mean", "what the mean of noisy images of the scene shows; acoustics=coherent alone"),
    Layer("range", "float32", "slant range of the strongest echo; NaN where there is none", "m"),
    _angle("elevation", "elevation of the strongest echo; NaN where there is none"),
    _angle("elevation_min", "lowest elevation of the echoes in the bin; NaN where there is none"),
    _angle("elevation_max", "highest elevation of the echoes in the bin; NaN where there is none"),
    _angle("azimuth", "azimuth of the strongest echo, right is positive; NaN where there is none"),
    Layer("valid_azimuth", "bool", "inside the sector, at a bearing that the camera saw"),
    Layer(
        "segmentation",
        "uint8",
        "class of the object, or ground, with most power in the bin",
        classes=CLASSES,
    ),
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
EFFECT_FOLDER = "layers/"
_EFFECT = re.compile(rf"{EFFECT_FOLDER}[a-z][a-z0-9_]{{0,39}}")


def layers(
    dtype: str, optional: Iterable[str] = (), classes: tuple[str, ...] = CLASSES
) -> tuple[Layer, ...]:
    """The image stacks of a shard whose images are stored as `dtype` (uint8 or float32).

    optional: names of further layers, in any order; they come out in that of the format.
    classes: of the dataset, see `simnfnd.factory.dataset.meaning.classes_of`.
    Raises FactoryError for one that the format does not know.
    """
    wanted = sorted(optional)
    effects = (
        _grey(name, f"noisy image with {name.removeprefix(EFFECT_FOLDER)} as its only noise")
        for name in filter(_EFFECT.fullmatch, wanted)
    )
    known = {layer.name: layer for layer in (*_CORE_LAYERS, *OPTIONAL_LAYERS, *effects)}
    if unknown := [name for name in wanted if name not in known]:
        raise FactoryError(f"/{unknown[0]}: no layer of the format")
    chosen = [layer for name, layer in known.items() if name in (*CORE, *wanted)]
    typed = [replace(layer, dtype=dtype) if layer.grey else layer for layer in chosen]
    return tuple(replace(layer, classes=classes) if layer.classes else layer for layer in typed)


@dataclass(frozen=True, eq=False)
class Axis:
    """One image axis: the coordinate of every row or column centre, for example range in metres."""

    name: str
    units: str
    values: Float64s
    description: str = ""


@dataclass(frozen=True)
class Column:
    """One column of the per-sample table: `dtype` is a numpy type string such as f4, i8 or S64."""

    name: str
    dtype: str
    units: str = ""
    description: str = ""


@dataclass(frozen=True, eq=False)
class Pair:
    """One sample.

    noisy, clean: (H, W) uint8, or float32 in [0, 1].
    shadow: (H, W) bool, True inside the sonar's sector where no echo arrives in the ideal image.
    record: column name -> value, everything needed to make this very sample again.
    layers: name -> (H, W) optional image (rgb: (H, W, 3)), as `OPTIONAL_LAYERS` describes them.
    formation: how the device formed the image, by which `denoise` chooses its weights; "" where
        that is not known or was drawn.
    geometry: where range and bearing are in noisy and clean, or None where that is not known.
    """

    noisy: Array
    clean: Array
    shadow: Bools
    record: Mapping[str, float | int | str] = field(default_factory=dict)
    layers: Mapping[str, Array] = field(default_factory=dict)
    formation: Formation = ""
    geometry: FanGeometry | None = None

    def image(self, layer: str) -> Array:
        """The image that goes to a layer: (H, W), of rgb (H, W, 3)."""
        return np.asarray(getattr(self, layer)) if layer in CORE else self.layers[layer]


@dataclass(frozen=True)
class Prepared:
    """What became of one frame.

    hit: it was ready already.  bytes: added to the cache.  key: what a `PairSource` finds it by
    without reading all files of the frame again; empty: nothing.
    """

    hit: bool
    bytes: int
    key: str = ""


class PairSource(Protocol):
    """Makes the pairs of a frame; each worker process builds its own from the configuration."""

    def axes(self) -> tuple[Axis, Axis]:
        """The row and column axes of the images."""

    def columns(self) -> tuple[Column, ...]:
        """The columns that every pair's record has, in order."""

    def pairs(self, ref: FrameRef, variants: tuple[int, ...]) -> list[Pair]:
        """All asked variants of one frame.

        Raises FrameError when the frame is bad, NotRendered when a `Preparer` must see it first.
        """

    def set_cache_keys(self, keys: Mapping[str, str]) -> None:
        """Take the keys of prepared frames, by their names; those before are forgotten."""


class Preparer(Protocol):
    """Does what is slow and the same for all noise; its workers are few and heavy."""

    def prepare(self, ref: FrameRef) -> Prepared:
        """Make a frame ready for `PairSource.pairs`.  Raises FrameError when it is bad."""


@dataclass(frozen=True)
class Provenance:
    """Where a dataset comes from, stated in every shard.

    config: plain values only (what JSON can hold), without anything that leaves the bytes alone,
        such as the number of workers or the name of the folder.
    """

    config: Mapping[str, Any] = field(hash=False)
    config_hash: str
    generator: str


def plain_values(value: Any) -> Any:
    """`value` as JSON and YAML give it back: mappings are dicts with text keys, sequences lists."""
    if isinstance(value, Mapping):
        return {str(key): plain_values(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_values(item) for item in value]
    return value


def config_text(config: Mapping[str, Any]) -> str:
    """Settings as the JSON of the root attribute `config`."""
    return json.dumps(plain_values(config), sort_keys=True, separators=(",", ":"))


def config_hash(config: Mapping[str, Any]) -> str:
    """Hash of settings: 16 hexadecimal digits of BLAKE2b over their JSON.

    `extends`, the list of the datasets that an extended one began as, is left out.
    """
    text = config_text({key: value for key, value in config.items() if key != "extends"})
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def root_attributes(provenance: Provenance, split: str, dtype: str) -> dict[str, Any]:
    """Root attribute name -> value, without the checksums."""
    return {
        "schema": SCHEMA,
        "generator": provenance.generator,
        "config": config_text(provenance.config),
        "config_hash": provenance.config_hash,
        "split": split,
        "value_range": np.asarray(VALUE_RANGES[dtype], dtype=dtype),
        "value_meaning": grey_meaning(provenance.config, dtype),
    }


ROOT_ATTRIBUTES = (*root_attributes(Provenance({}, "", ""), "", "uint8"), *SEALS)


def check_pair(
    pair: Pair, axes: tuple[Axis, Axis], columns: Sequence[Column], name: str
) -> tuple[Any, ...]:
    """The pair's row of /meta.

    Raises FrameError when a pair does not fit the axes or columns, or holds what none may hold;
    `name` (of the frame) opens the message.
    """
    if odd := sorted(set(pair.record) ^ {column.name for column in columns}):
        raise FrameError(f"{name}: record and columns disagree about {', '.join(odd)}")
    row = tuple(_stored_value(column, pair.record[column.name], name) for column in columns)
    height, width = (len(axis.values) for axis in axes)
    for layer in layers(str(pair.noisy.dtype), pair.layers):
        image = pair.image(layer.name)
        kinds = tuple(VALUE_RANGES) if layer.grey else (layer.dtype,)
        problem = layer.size_problem(image.shape, (height, width))
        if problem is None and str(image.dtype) not in kinds:
            problem = f"is {image.dtype}, expected {' or '.join(kinds)}"
        if problem is None and layer.grey:
            problem = layer.value_problem(image)
        if problem:
            raise FrameError(f"{name}: {layer.name} {problem}")
    return row


@np.errstate(over="ignore", invalid="ignore")
def _stored_value(column: Column, value: Any, name: str) -> Any:
    """A value as /meta keeps it.  Raises FrameError when anything would be lost."""
    dtype = np.dtype(column.dtype)
    try:
        if dtype.kind == "S":
            stored = value.encode()
            is_lossless = len(stored) <= dtype.itemsize and b"\0" not in stored
        else:
            stored = np.asarray(value).astype(dtype)[()]
            is_lossless = stored == value or (
                dtype.kind == "f" and np.isfinite(stored) == np.isfinite(value)
            )
    except (AttributeError, OverflowError, TypeError, ValueError):
        is_lossless = False
    if not is_lossless:
        text = f"text of at most {dtype.itemsize} bytes" if dtype.kind == "S" else f"{dtype}"
        raise FrameError(f"{name}: column {column.name} is {text} and cannot hold {value!r}")
    return stored


def stored_image(image: Array, dtype: str) -> Array:
    """(H, W) uint8 or float32 in [0, 1] -> the stored dtype; full scale stays full scale."""
    if image.dtype == np.dtype(dtype):
        return image
    values: Float32s = image.astype(np.float32)
    if dtype == "uint8":
        return np.asarray(np.rint(values * np.float32(255)).astype(np.uint8))
    return np.asarray(values / np.float32(255))
