"""The root of the configuration, assembled from what every room declares."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import field, replace
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, TypeAdapter, model_validator
from pydantic.dataclasses import dataclass

from .dataset.settings import DatasetSettings
from .errors import FactoryError
from .imaging.settings import AcousticsSettings, ResampleSettings, with_materials
from .labels import class_names
from .noise.registry import EFFECTS, NoiseSettings, blocks
from .render.base import RenderSettings
from .render.views import CacheSettings
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
    """Everything `simnfnd make` can be told."""

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
    def _shadows(self) -> Self:
        if self.render.kind == "analytic" and not self.sonar.mount.colocated:
            raise ValueError(
                "render.kind=analytic casts no shadows, so sonar.mount.translation_m must be "
                "[0, 0, 0]; use render=cycles or render=embree for a sonar away from the camera"
            )
        return self

    @model_validator(mode="after")
    def _formation(self) -> Self:
        if self.devices is not None:
            # Each picture draws its formation, and has the effects of that one.
            return self
        enabled = [name for name, block in blocks(self.noise).items() if block.enabled]
        if self.acoustics.formation == "points":
            on_field = [name for name in enabled if EFFECTS[name].stage != "points"]
            if on_field:
                raise ValueError(
                    f"noise.{on_field[0]} acts on the complex field; set acoustics=field, or "
                    "leave it out (noise=simnfnd)"
                )
            return self
        if self.render.bounces:
            raise ValueError(
                "render.bounces adds the brightness of echoes of echoes without their delay; with "
                "acoustics.formation=field set render.bounces=0 (noise.bottom_multipath and "
                "noise.surface_multipath have the delay)"
            )
        if not self.resample.is_default:
            raise ValueError(
                "resample thins points, and acoustics.formation=field has none; leave "
                "resample.kind and resample.rate at their defaults, or set acoustics=points"
            )
        if moving := [name for name in enabled if EFFECTS[name].moves]:
            raise ValueError(
                f"noise.{moving[0]} moves points, and acoustics.formation=field has none; "
                f"set noise.{moving[0]}.enabled=false, or use noise=physical"
            )
        return self

    @model_validator(mode="after")
    def _labels(self) -> Self:
        if "segmentation" in self.dataset.layers and self.scenes.kind not in _LABELLED:
            raise ValueError(
                f"dataset.layers: segmentation needs labelled frames and scenes={self.scenes.kind} "
                "has none; leave it out or use scenes=seabed"
            )
        return self

    @model_validator(mode="after")
    def _received(self) -> Self:
        check_received(self)
        return self


_RECEIVED = ("intensity_db", "field")


def check_received(config: FactoryConfig) -> None:
    """Raise ValueError when layers or columns are asked for that the formation does not have."""
    dataset = config.dataset
    asked: list[str] = [name for name in _RECEIVED if name in dataset.layers]
    if config.devices is not None and (asked or dataset.columns):
        raise ValueError(
            "dataset.layers: intensity_db, field and dataset.columns need one device; leave them "
            "out or set devices=fixed"
        )
    if config.acoustics.formation == "points" and (asked or "calibration" in dataset.columns):
        raise ValueError(
            f"dataset: {(asked or ['calibration'])[0]} is of the physical profile alone; set "
            "acoustics=field (experiment=physical), or leave it out"
        )
    if "field" in asked and config.sonar.samples_per_bin > 1:
        raise ValueError(
            "dataset.layers: field is of raw samples, and sonar.samples_per_bin averages them; "
            "set sonar.samples_per_bin=1"
        )


def from_mapping(values: Mapping[str, Any]) -> FactoryConfig:
    """Validate a composed configuration.

    Raises FactoryError with one line that names every bad key.
    """
    config: FactoryConfig = build(FactoryConfig, values)
    scenes = config.scenes
    if isinstance(scenes, SeabedSettings | MeshSettings) and scenes.hfov_deg is None:
        sonar = config.sonar
        if sonar.hfov_deg > HFOV_DEG:  # a camera that sees a sonar's sector
            scenes = replace(scenes, hfov_deg=sonar.hfov_deg, vfov_deg=sonar.vfov_deg)
            config = replace(config, scenes=scenes)
    if isinstance(scenes, SeabedSettings | MeshSettings) and "boxes" in config.dataset.columns:
        scenes = replace(scenes, boxes=True)
        config = replace(config, scenes=scenes)
    classes = class_names(scenes.own_classes())
    return replace(config, acoustics=with_materials(config.acoustics, classes, scenes.own()))


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


def identity(config: FactoryConfig) -> dict[str, Any]:
    """The part of the configuration that decides the bytes of the samples.

    Left out: where things lie (the root of the recordings, the output folder), what the dataset is
    called, and how many workers do it.
    """
    values = plain(config)
    for key in ("root", "file"):
        values["scenes"].pop(key, None)
    if values["scenes"].get("hfov_deg") is None:
        # The view that all datasets had before there was another keeps their names.
        values["scenes"].pop("hfov_deg", None)
        values["scenes"].pop("vfov_deg", None)
    path = values["scenes"].pop("path", None)
    if path is not None:
        # Where the platform goes counts, and not where the file lies.
        values["scenes"]["path"] = file_digest(path)
    _with_content(config.scenes, values)
    for name, usual in _LATER.items():
        *groups, key = name.split(".")
        group = reduce(getitem, groups, values)
        if group[key] == usual:
            group.pop(key)
    if isinstance(config.scenes, CsvListSettings):
        # The value that used to be the default, and the name that goes with it; one that is given
        # divides floating-point depth, too.
        if values["scenes"]["depth_scale"] is None:
            values["scenes"]["depth_scale"] = INTEGERS_PER_M
        else:
            values["scenes"]["depth_scale_of"] = "all"
    for key in ("dir", "name", "preview_pairs", "licence"):
        values["dataset"].pop(key, None)
    if config.devices is None:
        values.pop("devices")
        if config.acoustics.formation == "points":
            _without_field(values)
    values["scheduler"] = {"shard_size": values["scheduler"]["shard_size"]}
    for key in ("cache", "shard", "debug"):
        values.pop(key)
    return values


def _with_content(scenes: Scenes, values: dict[str, Any]) -> None:
    """The user's meshes and materials count by their content; without any all is as it was."""
    if own := scenes.own_classes():
        values["classes"] = list(own)
    for one in values["scenes"].get("own_objects", ()):
        one["file"] = file_digest(one["file"], "scenes.own_objects")
    for key in ("own_objects", "boxes"):
        if not values["scenes"].get(key):
            values["scenes"].pop(key, None)
    if isinstance(scenes, MeshSettings):
        for key, path in (("file", scenes.file), ("poses", scenes.poses)):
            values["scenes"][key] = None if path is None else file_digest(path, f"scenes.{key}")
    values["acoustics"].pop("materials")


def file_digest(path: str, key: str = "scenes.path") -> str:
    """16 hexadecimal digits of the content of a file.  Raises FactoryError without it."""
    try:
        content = Path(path).expanduser().read_bytes()
    except OSError as error:
        raise FactoryError(f"{key}={path}: cannot be read ({error.strerror})") from error
    return hashlib.blake2b(content, digest_size=8).hexdigest()


def _without_field(values: dict[str, Any]) -> None:
    """Leave out what never reaches the paper's pictures."""
    values.pop("acoustics")
    values.pop("water")
    values["sonar"].pop("array")


def digest(values: Mapping[str, Any]) -> str:
    """Hash of a configuration: 16 hexadecimal digits of blake2b over its sorted JSON."""
    text = json.dumps(values, sort_keys=True, separators=(",", ":"))
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


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
