"""The root of the configuration, assembled from what every room declares."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import Field, TypeAdapter, model_validator
from pydantic.dataclasses import dataclass

from ...common.errors import FactoryError
from ...common.settings import STRICT, build
from ...common.workers.settings import SchedulerSettings, ShardSlice
from ...dataset.meaning import class_names
from ...dataset.schema import CAMERA_LAYERS
from ...dataset.settings import DatasetSettings
from ..devices.settings import DeviceSettings
from ..imaging.settings import (
    AcousticsSettings,
    CoherentSettings,
    PointwiseSettings,
    ResampleSettings,
    formation_of,
    with_materials,
)
from ..meshes.camera import HFOV_DEG
from ..noise.registry import EFFECTS, NoiseSettings, blocks
from ..render.base import CacheSettings, Mount, RenderSettings
from ..scenes import Scenes, has_labels
from ..scenes.mesh import MeshSettings
from ..scenes.moving import check_tracks
from ..scenes.seabed import RecordingSettings, SeabedSettings
from ..sonar.array import WaterSettings
from ..sonar.settings import SonarSettings

if TYPE_CHECKING:
    from omegaconf import DictConfig


@dataclass(frozen=True, config=STRICT)
class FramesSettings:
    """Keys of `frames`.

    stride: use every n-th frame of a scene.  limit: at most this many frames of each scene (after
    the stride).  total: at most this many frames in all, spread over the scenes (after both);
    a larger total keeps the frames of a smaller one.  variants: pairs made of each frame, each with
    noise of its own.  only: names (location/scene/frame) of the frames to use; null uses all.
    min_insonified: refuses a frame with echoes in less than this part of the sonar's beams, 0 to 1;
    null refuses none, and pairs below a fifth are counted.
    """

    stride: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    limit: Annotated[int, Field(ge=1)] | None = None
    total: Annotated[int, Field(ge=1)] | None = None
    variants: Annotated[int, Field(ge=1, le=10_000)] = 1
    only: tuple[str, ...] | None = None
    min_insonified: Annotated[float, Field(ge=0, le=1)] | None = None


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
    acoustics: AcousticsSettings = field(default_factory=PointwiseSettings)
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
    """A sentence for each contradiction between groups; the first one is shown."""
    yield from _conflicts_of_renderer(config)
    yield from _conflicts_of_stance(config)
    if config.devices is not None:
        yield from _conflicts_of_drawn_devices(config)
        if config.devices.field_share is None and not isinstance(
            config.acoustics, PointwiseSettings
        ):
            yield from _conflicts_of_coherent(config)
    elif isinstance(config.acoustics, PointwiseSettings):
        yield from _conflicts_of_pointwise(config)
    else:
        yield from _conflicts_of_coherent(config)
    yield from _conflicts_of_moving_objects(config)
    yield from _conflicts_of_labels(config)


def _conflicts_of_renderer(config: FactoryConfig) -> Iterator[str]:
    if config.render.kind == "analytic" and not config.sonar.mount.colocated:
        yield (
            "render.kind=analytic casts no shadows, so sonar.mount.translation_m must be "
            "[0, 0, 0]; use render=cycles or render=embree for a sonar away from the camera"
        )
    if config.render.bounces and config.render.kind in ("analytic", "cycles"):
        yield (
            f"render.bounces={config.render.bounces}: render={config.render.kind} traces no "
            "bounces; set render=embree, or render.bounces=0"
        )


def _conflicts_of_stance(config: FactoryConfig) -> Iterator[str]:
    """Contradictions of the height and tilt of the sonar."""
    sonar = config.sonar
    draws_poses = isinstance(config.scenes, SeabedSettings) or (
        isinstance(config.scenes, MeshSettings) and config.scenes.poses is None
    )
    for name in ("altitude_m", "tilt_deg"):
        if getattr(sonar, name) is not None and not draws_poses:
            yield (
                f"sonar.{name}: the poses of scenes={config.scenes.kind} are recorded ones; leave "
                "it out, or use scenes=seabed"
            )
    if sonar.altitude_m is None or sonar.mount.colocated:
        return
    if sonar.tilt_deg is None:
        yield (
            "sonar.altitude_m: the height of a sonar away from the camera depends on the tilt; "
            "give sonar.tilt_deg, too"
        )
    elif sonar.tilt_deg.kind != "number":
        yield (
            "sonar.altitude_m: the height of a sonar away from the camera depends on the tilt; "
            "give sonar.tilt_deg as a number, or set sonar.mount.translation_m=[0, 0, 0]"
        )


def _conflicts_of_moving_objects(config: FactoryConfig) -> Iterator[str]:
    moves = config.scenes.has_moving_objects
    if "tracks" in config.dataset.columns and not moves:
        yield (
            "dataset.columns: tracks are of moving objects; give scenes.moving_objects, or leave "
            "it out"
        )
    if "tracks" in config.dataset.columns and isinstance(config.scenes, RecordingSettings):
        try:
            check_tracks(tuple(config.scenes.movers.values()))
        except ValueError as error:
            yield str(error)
    if moves and not config.sonar.mount.colocated:
        yield (
            "scenes.moving_objects need the sonar at the camera; set "
            "sonar.mount.translation_m=[0, 0, 0]"
        )
    if moves and CAMERA_LAYERS.intersection(config.dataset.layers):
        yield (
            "dataset.layers: rgb and depth do not show moving objects; leave them out, or leave "
            "scenes.moving_objects out"
        )


def _conflicts_of_labels(config: FactoryConfig) -> Iterator[str]:
    if "visibility" in config.dataset.columns and "segmentation" not in config.dataset.layers:
        yield (
            "dataset.columns: visibility is of the objects in the layer segmentation; set "
            "dataset.layers=[segmentation], too, or leave it out"
        )
    if "segmentation" in config.dataset.layers and not has_labels(config.scenes):
        yield (
            "dataset.layers: segmentation needs labelled frames and "
            f"scenes={config.scenes.kind} has none; leave it out or use scenes=seabed"
        )


def _received_layers(config: FactoryConfig) -> list[str]:
    """The requested layers that need a complex field: what the receiver got, and the mean image."""
    return [name for name in ("intensity_db", "field", "mean") if name in config.dataset.layers]


def _conflicts_of_drawn_devices(config: FactoryConfig) -> Iterator[str]:
    if isinstance(config.acoustics, PointwiseSettings):
        yield (
            "acoustics=pointwise: devices draws the formation of each image, and the coherent ones "
            "need its settings; set acoustics=coherent (experiment=any_sonar), or devices=fixed"
        )
    assert config.devices is not None
    field_share = config.devices.field_share
    is_coherent = field_share is None or field_share.draws_only(1.0)
    received = _received_layers(config)
    if (received or "calibration" in config.dataset.columns) and not is_coherent:
        yield (
            f"dataset: {(received or ['calibration'])[0]} is of coherent images alone; set "
            "devices.field_share=1, or leave it out"
        )
    if config.sonar.image.layout == "polar":
        for name in ("beams", "bins_per_px"):
            if getattr(config.devices, name) is not None:
                yield (
                    f"devices.{name}: the polar images of a dataset have one size; set "
                    f"devices.{name}=null, or sonar.image.layout=fan"
                )
    for name in config.devices.reflectivity_db:
        if name not in class_names(config.scenes.own_classes()):
            yield f"devices.reflectivity_db: no class is called {name}"


def _conflicts_of_pointwise(config: FactoryConfig) -> Iterator[str]:
    for name, block in blocks(config.noise).items():
        if block.enabled and EFFECTS[name].stage != "points":
            yield (
                f"noise.{name} acts on the complex field; set acoustics=coherent, or leave it out "
                "(noise=simnfnd)"
            )
    received = _received_layers(config)
    if received or "calibration" in config.dataset.columns:
        yield (
            f"dataset: {(received or ['calibration'])[0]} is of acoustics=coherent alone; set that "
            "(experiment=physical), or leave it out"
        )
    coherent_values = {
        "water": config.water != WaterSettings(),
        "sonar.samples_per_bin": config.sonar.samples_per_bin > 1,
        "sonar.transfer.full_scale_db": config.sonar.transfer.full_scale_db is not None,
    }
    for key, is_set in coherent_values.items():
        if is_set:
            yield (
                f"{key}: has no effect on the images of acoustics=pointwise; set "
                "acoustics=coherent, or leave it out"
            )


def _conflicts_of_coherent(config: FactoryConfig) -> Iterator[str]:
    if config.resample != ResampleSettings():
        yield (
            "resample thins points, and acoustics=coherent has none; leave resample.kind and "
            "resample.rate at their defaults, or set acoustics=pointwise"
        )
    for name, block in blocks(config.noise).items():
        if block.enabled and EFFECTS[name].moves:
            yield (
                f"noise.{name} moves points, and acoustics=coherent has none; set "
                f"noise.{name}.enabled=false, or use noise=physical"
            )
    if "field" in _received_layers(config) and config.sonar.samples_per_bin > 1:
        yield (
            "dataset.layers: field is of raw samples, and sonar.samples_per_bin averages them; "
            "set sonar.samples_per_bin=1"
        )


_GONE = "was removed: the points of the grain follow what the device resolves; leave it out"
GONE_KEYS = {f"noise.{effect}.scatterer_m": _GONE for effect in ("speckle", "path_speckle")}
"""Keys of earlier versions, each with what to say of it."""


def from_mapping(values: Mapping[str, Any]) -> FactoryConfig:
    """Validate a composed configuration.

    Raises FactoryError with one line that names every bad key.
    """
    values = _with_current_names(values)
    _refuse_keys_of_the_other_formation(values["acoustics"])
    config: FactoryConfig = build(FactoryConfig, values)
    scenes = _scenes_as_the_sonar_needs(config)
    acoustics = config.acoustics
    if isinstance(acoustics, CoherentSettings):
        classes = class_names(scenes.own_classes())
        acoustics = with_materials(acoustics, classes, scenes.own())
    return replace(config, scenes=scenes, acoustics=acoustics)


def _with_current_names(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a configuration as datasets store it, with today's names of the formations."""
    current = dict(values)
    acoustics = {"formation": "pointwise", **(current.get("acoustics") or {})}
    if acoustics["formation"] == "field":
        acoustics["formation"] = "coherent"
    current["acoustics"] = acoustics
    current["noise"] = _without_gone_keys(current.get("noise") or {})
    return current


def _without_gone_keys(noise: Mapping[str, Any]) -> dict[str, Any]:
    """The group without keys of earlier versions that have their default, 0.

    Raises FactoryError for one that has another value.
    """
    current = dict(noise)
    for key, remark in GONE_KEYS.items():
        _, effect, name = key.split(".")
        block = current.get(effect)
        if isinstance(block, Mapping) and name in block:
            if block[name] != 0:
                raise FactoryError(f"{key}: {remark}")
            current[effect] = {other: block[other] for other in block if other != name}
    return current


def _refuse_keys_of_the_other_formation(acoustics: Mapping[str, Any]) -> None:
    """Raises FactoryError that names the key."""
    chosen = acoustics["formation"]
    for key in acoustics:
        formation = formation_of(f"acoustics.{key}")
        if formation not in (None, chosen):
            raise FactoryError(
                f"acoustics.{key}: is a setting of acoustics={formation}, and acoustics={chosen} "
                f"has no use for it; set acoustics={formation}, or leave it out"
            )


def _scenes_as_the_sonar_needs(config: FactoryConfig) -> Scenes:
    """The settings of the scenes with a camera that sees the sonar's sector."""
    scenes = config.scenes
    sonar = config.sonar
    if not isinstance(scenes, SeabedSettings | MeshSettings):
        return scenes
    if scenes.hfov_deg is None and sonar.hfov_deg > HFOV_DEG:
        scenes = replace(scenes, hfov_deg=sonar.hfov_deg, vfov_deg=sonar.vfov_deg)
    scenes = replace(scenes, boxes=scenes.boxes or "boxes" in config.dataset.columns)
    if sonar.altitude_m is None and sonar.tilt_deg is None:
        return scenes
    altitude_m = scenes.camera_altitude_m
    tilt_deg = scenes.camera_tilt_deg
    if sonar.tilt_deg is not None:
        tilt_deg = sonar.tilt_deg.mapped(partial(_camera_tilt_deg, sonar.mount))
    if sonar.altitude_m is not None:
        altitude_m = sonar.altitude_m
        if not sonar.mount.colocated:
            camera_tilt_deg = 0.0 if tilt_deg is None else tilt_deg.values[0]
            sonar_above_m = sonar.mount.height_above_camera_m(camera_tilt_deg)
            altitude_m = altitude_m.mapped(lambda sonar_m: sonar_m - sonar_above_m)
    return replace(scenes, camera_altitude_m=altitude_m, camera_tilt_deg=tilt_deg)


def _camera_tilt_deg(mount: Mount, sonar_tilt_deg: float) -> float:
    """Tilt of a camera whose sonar has this one.  Raises FactoryError where no tilt gives it."""
    tilt_deg = mount.camera_tilt_deg(sonar_tilt_deg)
    if tilt_deg is None:
        raise FactoryError(
            f"sonar.tilt_deg={sonar_tilt_deg:g}: no camera has it with sonar.mount.yaw_deg="
            f"{mount.yaw_deg:g}; give a smaller yaw or tilt"
        )
    return tilt_deg


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
