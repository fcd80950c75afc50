"""The root of the configuration, assembled from what every room declares."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, TypeAdapter, model_validator
from pydantic.dataclasses import dataclass

from .dataset.schema import CAMERA_LAYERS
from .dataset.settings import DatasetSettings
from .errors import FactoryError
from .imaging.settings import AcousticsSettings, ResampleSettings, with_materials
from .labels import class_names
from .noise.registry import EFFECTS, NoiseSettings, blocks
from .render.base import CacheSettings, RenderSettings
from .scenes import Scenes
from .scenes.base import INTEGERS_PER_M
from .scenes.csv_list import CsvListSettings
from .scenes.mesh import MeshSettings
from .scenes.seabed import SeabedSettings
from .scenes.seabed.camera import HFOV_DEG
from .scheduler.settings import SchedulerSettings, ShardSlice
from .settings import STRICT, build
from .sonar.array import WaterSettings
from .sonar.settings import SonarSettings
from .sonar_randomization.settings import DeviceSettings

if TYPE_CHECKING:
    from omegaconf import DictConfig

# Recordings whose frames can carry labels: a pack has those that went into it.
_LABELLED = ("seabed", "mesh", "pack")


@dataclass(frozen=True, config=STRICT)
class FramesSettings:
    """Keys of `frames`.

    stride: use every n-th frame of a scene.  limit: at most so many frames a scene (after the
    stride).  total: at most so many frames in all, spread over the scenes (after stride and limit);
    a larger total keeps the frames of a smaller one.  variants: pairs made of each frame, each with
    noise of its own.  only: names (location/scene/frame) of the frames to use; null uses all.
    """

    stride: Annotated[int, Field(ge=1)] = 1
    limit: Annotated[int, Field(ge=1)] | None = None
    total: Annotated[int, Field(ge=1)] | None = None
    variants: Annotated[int, Field(ge=1)] = 1
    only: tuple[str, ...] | None = None


@dataclass(frozen=True, config=STRICT)
class SplitSettings:
    """Keys of `split`.

    test: names (or patterns) of the scenes that test; the rest trains.  test_fraction: used when no
    name is given; that part of the scenes, chosen by name and not by order.
    """

    test: tuple[str, ...] = ()
    test_fraction: Annotated[float, Field(ge=0, lt=1)] = 0.25


@dataclass(frozen=True, config=STRICT)
class FactoryConfig:
    """All keys of `simnfnd make`."""

    scenes: Scenes
    seed: Annotated[int, Field(ge=0)] = 0
    frames: FramesSettings = field(default_factory=FramesSettings)
    split: SplitSettings = field(default_factory=SplitSettings)
    render: RenderSettings = field(default_factory=RenderSettings)
    noise: NoiseSettings = field(default_factory=NoiseSettings)
    resample: ResampleSettings = field(default_factory=ResampleSettings)
    sonar: SonarSettings = field(default_factory=SonarSettings)
    water: WaterSettings = field(default_factory=WaterSettings)
    acoustics: AcousticsSettings = field(default_factory=AcousticsSettings)
    devices: DeviceSettings | None = None
    dataset: DatasetSettings = field(default_factory=DatasetSettings)
    scheduler: SchedulerSettings = field(default_factory=SchedulerSettings)
    cache: CacheSettings = field(default_factory=CacheSettings)
    shard: ShardSlice = field(default_factory=ShardSlice)
    debug: bool = False

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        for problem in _conflicts(self):
            raise ValueError(problem)
        return self


def _conflicts(config: FactoryConfig) -> Iterator[str]:
    """What contradicts each other, a line each."""
    render, sonar, scenes, dataset = config.render, config.sonar, config.scenes, config.dataset
    on_field = config.acoustics.formation == "field"
    if render.kind == "analytic" and not sonar.mount.colocated:
        yield (
            "render.kind=analytic casts no shadows, so sonar.mount.translation_m must be "
            "[0, 0, 0]; use render=cycles or render=embree for a sonar away from the camera"
        )
    if config.devices is None:  # else each picture draws its formation and has the effects of it
        enabled = [name for name, block in blocks(config.noise).items() if block.enabled]
        of_field = [name for name in enabled if EFFECTS[name].stage != "points"]
        moving = [name for name in enabled if EFFECTS[name].moves]
        if of_field and not on_field:
            yield (
                f"noise.{of_field[0]} acts on the complex field; set acoustics=field, or "
                "leave it out (noise=simnfnd)"
            )
        if on_field and config.resample != ResampleSettings():
            yield (
                "resample thins points, and acoustics.formation=field has none; leave "
                "resample.kind and resample.rate at their defaults, or set acoustics=points"
            )
        if on_field and moving:
            yield (
                f"noise.{moving[0]} moves points, and acoustics.formation=field has none; "
                f"set noise.{moving[0]}.enabled=false, or use noise=physical"
            )
    moves = scenes.kind == "seabed" and bool(scenes.moving)
    if "tracks" in dataset.columns and not moves:
        yield (
            "dataset.columns: tracks are of moving objects; give scenes.moving_objects, or leave "
            "it out"
        )
    if moves and not sonar.mount.colocated:
        yield (
            "scenes.moving_objects need the sonar at the camera; set "
            "sonar.mount.translation_m=[0, 0, 0]"
        )
    if moves and CAMERA_LAYERS.intersection(dataset.layers):
        yield (
            "dataset.layers: rgb and depth do not show moving objects; leave them out, or leave "
            "scenes.moving_objects out"
        )
    if "segmentation" in dataset.layers and scenes.kind not in _LABELLED:
        yield (
            f"dataset.layers: segmentation needs labelled frames and scenes={scenes.kind} "
            "has none; leave it out or use scenes=seabed"
        )
    received: list[str] = [name for name in ("intensity_db", "field") if name in dataset.layers]
    if config.devices is not None and (received or dataset.columns):
        yield (
            "dataset.layers: intensity_db, field and dataset.columns need one device; leave them "
            "out or set devices=fixed"
        )
    if not on_field and (received or "calibration" in dataset.columns):
        yield (
            f"dataset: {(received or ['calibration'])[0]} is of the physical profile alone; set "
            "acoustics=field (experiment=physical), or leave it out"
        )
    if "field" in received and sonar.samples_per_bin > 1:
        yield (
            "dataset.layers: field is of raw samples, and sonar.samples_per_bin averages them; "
            "set sonar.samples_per_bin=1"
        )


def from_mapping(values: Mapping[str, Any]) -> FactoryConfig:
    """Validate a composed configuration.

    Raises FactoryError with one line that names every bad key.
    """
    config: FactoryConfig = build(FactoryConfig, values)
    scenes, sonar = config.scenes, config.sonar
    if isinstance(scenes, SeabedSettings | MeshSettings):
        if scenes.hfov_deg is None and sonar.hfov_deg > HFOV_DEG:
            # A camera that sees a sonar's sector.
            scenes = replace(scenes, hfov_deg=sonar.hfov_deg, vfov_deg=sonar.vfov_deg)
        scenes = replace(scenes, boxes=scenes.boxes or "boxes" in config.dataset.columns)
    acoustics = with_materials(config.acoustics, class_names(scenes.own_classes()), scenes.own())
    return replace(config, scenes=scenes, acoustics=acoustics)


def with_cache(config: FactoryConfig, work: Path) -> FactoryConfig:
    """The configuration with a cache that workers in any folder find.

    With cache.enabled=false it is in `work`, which lasts as long as the run.
    """
    folder = config.cache.folder
    if not config.cache.enabled:
        folder = Path(os.path.abspath(work / "renders"))
    return replace(config, cache=replace(config.cache, dir=str(folder)))


def plain(config: FactoryConfig) -> dict[str, Any]:
    """The configuration as YAML-ready values; equal settings give equal values."""
    values: dict[str, Any] = TypeAdapter(FactoryConfig).dump_python(config, mode="json")
    return values


# Keys that came later, each with the value that leaves a dataset as it was, and its name.
_LATER: dict[str, Any] = {
    "frames.total": None,
    "scenes.own_objects": [],
    "scenes.frame_rate_hz": None,
    "scenes.moving_objects": [],
    "scenes.boxes": False,
    "sonar.samples_per_bin": 1,
    "sonar.range.windows_m": [],
    "sonar.image.sampling": "bilinear",
    "sonar.image.enlarged": 1.0,
    "sonar.image.jpeg_quality": None,
    "sonar.transfer.black": 0.0,
    "sonar.transfer.full_scale_db": None,
    "dataset.columns": [],
    "acoustics.standing": 0.0,
    "acoustics.lambert_exponents": {},
}
# Keys that went, each with the value that all datasets have now.
_GONE_SCENES = {
    "flsea": {"undistort": False},
    "csv_list": {"undistort": False, "distortion": []},
}
_GONE_RENDER = {"geometry": "auto", "stride": "auto", "samples": 1, "bounces": 0}
# Keys of groups that leave the samples as they are.
_NO_BYTES = {
    "dataset": ("dir", "name", "preview_pairs", "licence"),
    "acoustics": ("materials",),
}


def identity(config: FactoryConfig) -> dict[str, Any]:
    """The part of the configuration that decides the bytes of the samples.

    Left out: where things lie (the root of the recordings, the output folder), what the dataset is
    called, and how many workers do it.
    """
    values = plain(config)
    scenes = values["scenes"]
    values["render"] |= _GONE_RENDER
    scenes |= {"depth_kind": "z", "bad_depth": scenes.get("bad_depth", "reject")}
    scenes |= _GONE_SCENES.get(config.scenes.kind, {})
    for group, keys in _NO_BYTES.items():
        for key in keys:
            values[group].pop(key)
    for name, usual in _LATER.items():
        *groups, key = name.split(".")
        keyed = reduce(getitem, groups, values)
        if key in keyed and keyed[key] == usual:
            keyed.pop(key)
    for key in ("root", "file"):
        scenes.pop(key, None)
    if scenes.get("hfov_deg") is None:
        # The view that all datasets had before there was another keeps their names.
        scenes.pop("hfov_deg", None)
        scenes.pop("vfov_deg", None)
    # The user's files count by their content, and not where they lie.
    if (path := scenes.pop("path", None)) is not None:
        scenes["path"] = _file_digest(path, "scenes.path")
    if own := config.scenes.own_classes():
        values["classes"] = list(own)
    for one in scenes.get("own_objects", ()):
        one["file"] = _file_digest(one["file"], "scenes.own_objects")
        if one["moving"] is None:
            one.pop("moving")
    for item in (*scenes.get("moving_objects", ()), *scenes.get("own_objects", ())):
        moving = item.get("moving") or {}
        if moving.get("path") is not None:
            moving["path"] = _file_digest(moving["path"], "moving.path")
    if isinstance(config.scenes, MeshSettings):
        for key, file in (("file", config.scenes.file), ("poses", config.scenes.poses)):
            scenes[key] = file and _file_digest(file, f"scenes.{key}")
    if isinstance(config.scenes, CsvListSettings):
        # The value that used to be the default, and the name that goes with it; one that is given
        # divides floating-point depth, too.
        if scenes["depth_scale"] is None:
            scenes["depth_scale"] = INTEGERS_PER_M
        else:
            scenes["depth_scale_of"] = "all"
    if config.devices is None:
        values.pop("devices")
        if config.acoustics.formation == "points":
            # What never reaches the paper's pictures.
            del values["acoustics"], values["water"], values["sonar"]["array"]
    values["scheduler"] = {"shard_size": values["scheduler"]["shard_size"]}
    for key in ("cache", "shard", "debug"):
        values.pop(key)
    return values


def _file_digest(path: str, key: str) -> str:
    """16 hexadecimal digits of the content of a file.  Raises FactoryError without it."""
    try:
        content = Path(path).expanduser().read_bytes()
    except OSError as error:
        raise FactoryError(f"{key}={path}: cannot be read ({error.strerror})") from error
    return hashlib.blake2b(content, digest_size=8).hexdigest()


def composed_values(composed: DictConfig) -> dict[str, Any]:
    """The plain values of a composed configuration.  Raises FactoryError when one is missing."""
    from omegaconf import OmegaConf
    from omegaconf.errors import MissingMandatoryValue

    try:
        values = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)
    except MissingMandatoryValue as error:
        key = error.full_key
        raise FactoryError(f"{key}: a value is required; give {key}=...") from error
    assert isinstance(values, dict)
    return {str(key): value for key, value in values.items() if key != "experiment"}
