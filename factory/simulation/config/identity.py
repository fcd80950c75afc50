"""The identity of a dataset: the settings and inputs that decide the bytes of its samples.

Its hash names a dataset, so equal settings must keep it from version to version: keys and names
that were removed stay in it unchanged.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from functools import reduce
from operator import getitem
from pathlib import Path
from typing import Any

from ...common import extensions
from ...common.errors import FactoryError
from ...common.small_files import open_regular
from ..imaging.settings import PointwiseSettings
from ..meshes.mesh_parts import files_of
from ..render.pack import read_contents
from ..scenes.base import INTEGERS_PER_M, OwnSceneSettings
from ..scenes.csv_list import CsvListSettings
from ..scenes.mesh import MeshSettings
from ..scenes.pack import PackSettings
from ..scenes.seabed import SeabedSettings
from .renderer_choice import renderer_of
from .root import FactoryConfig, plain

# Keys added later, each with the value at which a dataset and its hash stay as they were.
_LATER: dict[str, Any] = {
    "frames.total": None,
    "scenes.own_objects": [],
    "scenes.frame_rate_hz": None,
    "scenes.moving_objects": [],
    "scenes.boxes": False,
    "scenes.camera_altitude_m": None,
    "scenes.camera_tilt_deg": None,
    "scenes.depth_gaps": True,
    "sonar.altitude_m": None,
    "sonar.sector": "seen",
    "devices.reflectivity_db": {},
    "devices.objects_db": None,
    "devices.per": "image",
    "sonar.tilt_deg": None,
    "frames.min_insonified": None,
    "scenes.up": "auto",
    "scenes.poses_frame": "optical",
    "sonar.samples_per_bin": 1,
    "sonar.range.windows_m": [],
    "sonar.image.sampling": "bilinear",
    "sonar.image.enlarged": 1.0,
    "sonar.image.jpeg_quality": None,
    "sonar.transfer.black": 0.0,
    "sonar.transfer.full_scale_db": None,
    "dataset.columns": [],
    "acoustics.standing": 0.0,
    "sonar.array.beam_groups": 1,
    "acoustics.lambert_exponents": {},
}
# Keys that were removed, each with the value that all datasets have now.
_GONE_SCENES: dict[str, dict[str, Any]] = {
    "flsea": {"undistort": False},
    "csv_list": {"undistort": False, "distortion": []},
}
_GONE_RENDER = {"geometry": "auto", "stride": "auto", "samples": 1}
# The name of acoustics=coherent when hashes began.
_COHERENT = "field"
# Keys of groups that do not change the samples.
_NO_BYTES = {
    "dataset": ("dir", "name", "preview_pairs", "licence"),
    "acoustics": ("materials",),
}


def identity(config: FactoryConfig) -> dict[str, Any]:
    """The part of the configuration that decides the bytes of the samples.

    Left out: where things lie (the root of the recordings, the output folder), what the dataset is
    called, and how many workers make it.
    """
    values = plain(config)
    values["render"] = _render_identity(config)
    values["scenes"] = _scenes_identity(config, values["scenes"])
    if own_classes := config.scenes.own_classes():
        values["classes"] = list(own_classes)
    _drop_keys_without_bytes(values)
    if config.devices is None:
        values.pop("devices")
    _drop_later_keys_at_their_defaults(values)
    if isinstance(config.acoustics, PointwiseSettings):
        # None of them reaches pointwise images.
        del values["acoustics"], values["water"], values["sonar"]["array"]
    else:
        values["acoustics"]["formation"] = _COHERENT
    values["scheduler"] = {"shard_size": values["scheduler"]["shard_size"]}
    if used := extensions_of(config):
        values["extensions"] = [extensions.provenance(*extension) for extension in used]
    return values


def extensions_of(config: FactoryConfig) -> list[tuple[extensions.Kind, str]]:
    """Kind and name of each effect and reader of another package that the pairs are made by."""
    used: list[tuple[extensions.Kind, str]] = [
        ("effect", block.effect.name) for block in config.noise.own
    ]
    if isinstance(config.scenes, OwnSceneSettings):
        used.append(("reader", config.scenes.kind))
    return used


def has_input_files(config: FactoryConfig) -> bool:
    """Whether frames are read from files whose content is no part of the identity."""
    return not isinstance(config.scenes, SeabedSettings | MeshSettings | PackSettings)


def _render_identity(config: FactoryConfig) -> dict[str, Any]:
    render = renderer_of(config).settings
    values = {
        "kind": render.kind,
        "albedo": render.albedo,
        "edge_ratio": render.edge_ratio,
        **_GONE_RENDER,
        "bounces": render.bounces,
    }
    if render.bounces:
        values["reflection_loss_db"] = render.reflection_loss_db
    return values


def _scenes_identity(config: FactoryConfig, values: Mapping[str, Any]) -> dict[str, Any]:
    """The user's files count by their content, and not by where they lie."""
    settings = config.scenes
    scenes = dict(values)
    for key, usual in (("depth_kind", "z"), ("bad_depth", "reject")):
        scenes.setdefault(key, usual)
    scenes |= _GONE_SCENES.get(settings.kind, {})
    for key in ("root", "file"):
        scenes.pop(key, None)
    if scenes.get("hfov_deg") is None:
        # Datasets of the time when there was one view keep their hash.
        scenes.pop("hfov_deg", None)
        scenes.pop("vfov_deg", None)
    if isinstance(settings, SeabedSettings) and scenes.pop("path") is not None:
        scenes["path"] = _file_digest(str(settings.path), "scenes.path")
    if isinstance(settings, SeabedSettings | MeshSettings):
        _digest_objects(scenes)
    if isinstance(settings, MeshSettings):
        scenes["file"] = _mesh_digest(settings.file, "scenes.file")
        poses = settings.poses
        scenes["poses"] = None if poses is None else _file_digest(poses, "scenes.poses")
    if isinstance(settings, PackSettings):
        scenes["digest"] = read_contents(Path(settings.root).expanduser()).digest
    if isinstance(settings, CsvListSettings):
        if settings.depth_scale is None:
            scenes["depth_scale"] = INTEGERS_PER_M
        else:
            # A scale that is given divides floating-point depth, too.
            scenes["depth_scale_of"] = "all"
    return scenes


def _drop_keys_without_bytes(values: dict[str, Any]) -> None:
    for key in ("cache", "shard", "debug"):
        values.pop(key)
    for group, keys in _NO_BYTES.items():
        for key in keys:
            values[group].pop(key, None)


def _digest_objects(scenes: Mapping[str, Any]) -> None:
    """The files of own and moving objects by their content; keys at their first values left out."""
    for own_object in scenes["own_objects"]:
        own_object["file"] = _mesh_digest(own_object["file"], "scenes.own_objects")
        if own_object["up"] == "auto":
            own_object.pop("up")
        if own_object["moving"] is None:
            own_object.pop("moving")
    for item in (*scenes["moving_objects"], *scenes["own_objects"]):
        moving = item.get("moving") or {}
        if moving.get("path") is not None:
            moving["path"] = _file_digest(moving["path"], "moving.path")


def _drop_later_keys_at_their_defaults(values: dict[str, Any]) -> None:
    for name, default in _LATER.items():
        *groups, key = name.split(".")
        if groups[0] not in values:
            continue
        group = reduce(getitem, groups, values)
        if key in group and group[key] == default:
            group.pop(key)


def _mesh_digest(path: str, key: str) -> str:
    """Digest of a mesh and all files that it refers to.  Raises FactoryError without one."""
    mesh = Path(path).expanduser()
    _file_digest(path, key)  # says best that the file itself is not there
    files = files_of(mesh, key)
    if len(files) == 1:
        return _file_digest(path, key)
    parts = [(os.path.relpath(file, mesh.parent), _file_digest(file, key)) for file in files]
    return hashlib.blake2b(json.dumps(parts).encode(), digest_size=8).hexdigest()


def _file_digest(path: str, key: str) -> str:
    """16 hexadecimal digits of the content of a file.  Raises FactoryError without it."""
    try:
        with open_regular(Path(path).expanduser()) as file:
            content = file.read()
    except OSError as error:
        raise FactoryError(f"{key}={path}: cannot be read ({error.strerror})") from error
    return hashlib.blake2b(content, digest_size=8).hexdigest()
