"""No key is ignored silently: each changes bytes, is refused, or is known to change no image."""

from __future__ import annotations

import copy
import json
from collections.abc import Iterator, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from simnfnd.factory.common.errors import FactoryError, FrameError
from simnfnd.factory.common.small_files import load_yaml
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.production.scheduler.plan import plan_shards
from simnfnd.factory.simulation.config.compose import compose_config
from simnfnd.factory.simulation.config.key_effects import reason_without_effect
from simnfnd.factory.simulation.config.named_keys import named_keys
from simnfnd.factory.simulation.config.root import FactoryConfig, from_mapping, plain
from simnfnd.factory.simulation.config.selection import choose_frames, split_frames
from simnfnd.factory.simulation.pairs.pair_maker import PairMaker
from simnfnd.factory.simulation.pairs.views import Views
from simnfnd.factory.simulation.render import open_renderer
from simnfnd.factory.simulation.render.view import View, view_of
from simnfnd.factory.simulation.scenes import open_reader
from tests.project_files import ROOT

SMALL = (
    *("scenes.locations=3", "scenes.frames_per_location=2", "scenes.width=96", "scenes.height=61"),
    *("scenes.objects=3", "sonar.beams=32", "sonar.range_bins=40"),
    *("sonar.image.width_px=48", "sonar.image.height_px=48", "dataset.dtype=float32"),
)
PHYSICAL = ("experiment=physical", *SMALL, "noise.beam_gain.dead=2", "noise.spokes.count=2")
BASES: dict[str, tuple[str, ...]] = {
    "pointwise": (*SMALL, "noise.range_arc.count=1"),
    "top view, polar": (
        *SMALL[:-3], "sonar.projection=top_view", "sonar.image.layout=polar",
        "noise.range_arc.count=1",
    ),
    "coherent": PHYSICAL,
    "coherent, level": (
        *PHYSICAL, "noise=moving",
        "acoustics.standing=0.3", "acoustics.target=mean_log", "sonar.range.auto=false",
        "sonar.range.max_m=4", "water.depth_m=1", "dataset.layers=[intensity_db,segmentation]",
        "sonar.array.horizontal.window=taylor",
    ),
    "recording": (*PHYSICAL[:-2], "noise=recording", "scenes.frame_rate_hz=0.5"),
    "drawn devices": (
        "experiment=any_sonar", *SMALL[:5], "sonar.image.width_px=72", "sonar.image.height_px=72",
        "noise.range_arc.count=1", "noise.spokes.count=2", "noise.beam_gain.dead=2",
        "noise.sector_edges.enabled=true", "noise.ring_down.level_db=0", "devices.beams=32",
        "noise.saturation.level_db=1", "devices.range_min_m=0.2",
        "devices.field_share=0.6", "devices.quiet_share=0.05", "devices.odd_share=0.95",
        *(f"devices.{name}_share=0.5" for name in ("log", "soft", "points_log", "jpeg")),
        *(f"devices.{name}_share=0.5" for name in ("enlarged", "auto_range", "standing")),
    ),
}  # fmt: skip
RECORDED: dict[str, tuple[str, ...]] = {
    "orbit": ("scenes=mesh", "scenes.file=bed.obj"),
    "transect": ("scenes=mesh", "scenes.file=bed.obj", "scenes.route=transect"),
    "list": ("scenes=csv_list", "scenes.file=frames.csv", "scenes.intrinsics=[96,96,48,32]"),
    "flsea": ("scenes=flsea", "scenes.root=flsea"),
}
"""Scenes of files; they are looked at with `SEEN`, and their keys of `scenes` alone are changed."""
SEEN = (
    *("noise=none", "resample.rate=1", "sonar.beams=24", "sonar.range_bins=24"),
    *("sonar.image.width_px=32", "sonar.image.height_px=32", "dataset.layers=[rgb,depth]"),
)
SMALL_VIEWS = (
    *("scenes.width=96", "scenes.height=64", "scenes.paths=1", "scenes.views_per_path=2"),
    "dataset.layers=[rgb,depth,segmentation]",
)
PAIRS = {"drawn devices": (1, 14)}
"""Frames, and variants of each, that are looked at; of the others (2, 1)."""
KEYS_OF_BASE = {"recording": "noise.drifting_volume.*"}
"""Of these bases, only these keys are changed."""
SCENE_GROUPS = ("scenes", "frames", "split", "render", "dataset")
"""Groups that need to be changed in one base alone."""

NO_IMAGES = (
    *("scheduler.*", "cache.*", "shard.*", "debug", "sonar.name"),
    *("dataset.dir", "dataset.name", "dataset.licence", "dataset.preview_pairs"),
    *("dataset.compression", "dataset.compression_level", "dataset.columns"),
    # Of training alone: a dataset's images have one size.
    *("devices.height_px", "devices.polar_share"),
    # Renderers agree; the column boxes reads it; it counts where depths are invalid.
    *("render.kind", "scenes.boxes", "scenes.bad_depth"),
    # It refuses frames; tests of stances do.
    "frames.min_insonified",
    # These cameras see the whole sector; tests of varied devices look beyond it.
    "sonar.sector",
    # Files, which tests of own worlds change.
    *("scenes.own_objects", "acoustics.materials"),
)
"""Keys that change no image."""
CHOICES = ("scenes.kind", "acoustics.formation", "resample.kind", "devices")
"""What chooses a group, whose keys are then others."""
CONF_GROUPS = (
    *("scenes", "render", "noise", "resample", "sonar", "water", "acoustics", "devices"),
    *("dataset", "cache", "scheduler"),
)

OTHER: dict[str, Any] = {
    "scenes.hfov_deg": 60.0,
    "scenes.vfov_deg": 30.0,
    "scenes.kinds": ["Tire"],
    "scenes.places": ["pier"],
    "scenes.path": str(ROOT / "examples/platform.csv"),
    "scenes.camera_altitude_m": 1.2,
    "scenes.camera_tilt_deg": 20.0,
    "scenes.frame_rate_hz": 0.2,
    "scenes.moving_objects": [{"object": "Fish"}],
    "frames.limit": 1,
    "frames.total": 1,
    "frames.only": ["seabed/seabed-0001/0000"],
    "split.test": ["seabed-000[12]"],
    "split.test_fraction": 0.7,
    "render.albedo": "constant",
    "sonar.altitude_m": 1.2,
    "sonar.tilt_deg": 20.0,
    "sonar.projection": ("slant_range", "top_view"),
    "sonar.accumulate": "max",
    "sonar.image.layout": ("fan", "polar"),
    "sonar.image.sampling": "nearest",
    "sonar.image.jpeg_quality": 40,
    "sonar.image.enlarged": 1.5,
    "sonar.beam_azimuths_deg": np.linspace(-10, 10, 32).tolist(),
    "sonar.range.windows_m": [[0.5, 3.0]],
    "sonar.transfer.kind": "power",
    "sonar.transfer.black": 0.1,
    "sonar.transfer.full_scale_db": -60.0,
    "sonar.mount.translation_m": [0.0, 0.1, 0.1],
    "dataset.dtype": ("float32", "uint8"),
    "dataset.layers": ["range"],
    "dataset.max_train": 1,
    "dataset.max_test": 1,
    "acoustics.target": "restored",
    "devices.objects_db": 10.0,
    "devices.per": "place",
    "acoustics.reflectivity_db": {"Background": -25.0, "Wall": 0.0, "Boulder": 0.0},
    "acoustics.lambert_exponents": {"Wall": 5.0, "Boulder": 5.0, "Background": 4.0},
}
_OF_MESHES: dict[str, Any] = {
    "scenes.file": "tall.obj",
    "scenes.up": "y",
    "scenes.poses_frame": "flu",
    "scenes.scale": 1.1,
    "scenes.classes": [{"class": "Target", "parts": "*"}],
    "scenes.poses": "poses.txt",
    "scenes.route": "orbit",
    "scenes.paths": 2,
    "scenes.views_per_path": 3,
    "scenes.height_m": [0.6, 0.8],
    "scenes.distance_m": [1.2, 1.4],
    "scenes.tilt_deg": [50.0, 55.0],
    "scenes.speed_m_s": 0.8,
}
OTHER_OF_RECORDED: dict[str, dict[str, Any]] = {
    "orbit": {**_OF_MESHES, "scenes.route": "transect"},
    "transect": _OF_MESHES,
    "list": {
        "scenes.file": "fewer.csv",
        "scenes.intrinsics": [80.0, 80.0, 48.0, 32.0],
        "scenes.depth_scale": 900.0,
        "scenes.depth_kind": "ray",
        "scenes.invalid_below_m": 2.5,
        "scenes.invalid_above_m": 3.5,
    },
    "flsea": {"scenes.root": "flsea/canyons", "scenes.scenes": ["u_canyon"]},
}
ROUNDED = ("*.looks", "*.count", "*.dead", "*.spacing_beams", "devices.beams", "devices.*_px")
WORDS = (
    *(("uniform", "hann", "hamming", "taylor"), ("radial", "paper"), ("sample", "beam")),
    ("random", "regular"),
)


def leaves(values: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in values.items():
        key = f"{prefix}{name}"
        is_leaf = not isinstance(value, dict) or set(value) & {"uniform", "choice", "normal"}
        if is_leaf or key in OTHER:
            yield key, value
        else:
            yield from leaves(value, f"{key}.")


def another(key: str, value: Any) -> Any:
    """A valid value that differs."""
    if key in OTHER:
        other = OTHER[key]
        return next(one for one in other if one != value) if isinstance(other, tuple) else other
    if isinstance(value, dict):
        ((form, numbers),) = value.items()
        return max(numbers) if form == "choice" else 0.9 * numbers[1] + 0.1 * numbers[0]
    if isinstance(value, bool):
        return not value
    if isinstance(value, str):
        return next(word for words in WORDS for word in words if value in words and word != value)
    if key.startswith("devices.") and key.endswith("_share"):
        return 1.0 if value < 0.5 else 0.0
    if any(fnmatchcase(key, pattern) for pattern in ROUNDED):
        return value + 2
    return value + 1 if isinstance(value, int) else 0.8 * value + 0.05


def replaced(values: Mapping[str, Any], key: str, value: Any) -> dict[str, Any]:
    changed = copy.deepcopy(dict(values))
    *groups, last = key.split(".")
    node = changed
    for group in groups:
        node = node[group]
    node[last] = value
    return changed


_rendered: dict[str, View] = {}


class SmallViews(Views):
    """Renders made when first asked for, by the closed form or, for offset mounts, by Embree."""

    def __init__(self, config: FactoryConfig) -> None:
        super().__init__({})
        self._config = config
        values = plain(config)
        given = values["scenes"], values["render"], values["sonar"]["mount"]
        self._key = json.dumps(given, sort_keys=True)

    def view(self, ref: FrameRef) -> View:
        key = f"{self._key} {ref.name}"
        if key not in _rendered:
            render = self._config.render
            mount = self._config.sonar.mount
            needs_rays = render.bounces or not mount.colocated
            settings = replace(render, kind="embree" if needs_rays else "analytic")
            frame = reader(json.dumps(plain(self._config)["scenes"])).load(ref)
            _rendered[key] = view_of(frame, open_renderer(settings).render(frame, mount), mount)
        return _rendered[key]


@cache
def reader(scenes: str) -> Any:
    return open_reader(from_mapping({"scenes": json.loads(scenes)}).scenes)


def parts_of(config: FactoryConfig, frames: int = 2, variants: int = 1) -> Iterator[Any]:
    """What makes up a dataset: its plan, then some pairs of it."""
    found = open_reader(config.scenes).discover().frames
    splits = split_frames(choose_frames(found, config), config)
    tasks = plan_shards(
        splits, config.frames.variants, config.scheduler.shard_size, config.dataset.limits
    )
    yield [(task.path, task.digest) for task in tasks]
    maker = PairMaker(config, SmallViews(config))
    refs = [ref for task in tasks for ref, _ in task.items][:frames]
    for ref in refs:
        for variant in range(variants):
            try:
                (pair,) = maker.pairs(ref, (variant,))
            except FrameError as error:
                yield str(error)
                continue
            images = (pair.noisy, pair.clean, pair.shadow, *pair.layers.values())
            yield [(image.dtype.str, image.shape, image.tobytes()) for image in images]


def keys_of_base(name: str) -> list[tuple[str, Any]]:
    values = plain(compose_config(BASES[name]))
    passed_over = [*CHOICES, *NO_IMAGES]
    if name != "pointwise":
        passed_over += [f"{group}.*" for group in SCENE_GROUPS]
    return [
        (key, value)
        for key, value in leaves(values)
        if not any(fnmatchcase(key, pattern) for pattern in passed_over)
        and fnmatchcase(key, KEYS_OF_BASE.get(name, "*"))
    ]


@pytest.mark.slow
@pytest.mark.parametrize("name", BASES)
def test_every_key_changes_bytes_or_is_refused(name: str) -> None:
    base = compose_config(BASES[name])
    counts = PAIRS.get(name, (2, 1))
    expected = list(parts_of(base, *counts))
    values = plain(base)
    ignored: list[str] = []
    refusals: list[str] = []
    for key, value in keys_of_base(name):
        other = another(key, value)
        try:
            config = from_mapping(replaced(values, key, other))
        except FactoryError as error:
            refusals.append(str(error))
            continue
        if reason_without_effect(config, key, [key]):
            continue
        pairs = zip(parts_of(config, *counts), expected, strict=False)
        if all(found == part for found, part in pairs):
            ignored.append(f"{key}={other}")
    assert not ignored
    # A value out of its limits would say nothing of the key.
    assert not [refusal for refusal in refusals if "given: " in refusal]


@pytest.fixture
def recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The files that `RECORDED` and `OTHER_OF_RECORDED` name, in the working folder."""
    monkeypatch.chdir(tmp_path)
    x, y = np.meshgrid(np.linspace(-6, 6, 20), np.linspace(-6, 6, 20))
    for name, height in (("bed", 0.3), ("tall", 0.6)):
        z = height * np.sin(3 * x) * np.cos(2 * y)
        vertices = [
            f"v {a:.4f} {b:.4f} {c:.4f}" for a, b, c in zip(x.flat, y.flat, z.flat, strict=True)
        ]
        corners = [20 * row + column + 1 for row in range(19) for column in range(19)]
        faces = [f"f {i} {i + 1} {i + 21} {i + 20}" for i in corners]
        Path(f"{name}.obj").write_text("\n".join((*vertices, *faces)))
    Path("poses.txt").write_text("0 -4 0 1.5 -0.5 0.5 -0.5 0.5\n")

    rng = np.random.default_rng(5)
    rows, columns = np.mgrid[0:64, 0:96]
    lines = []
    for number, folder in enumerate(("canyons/u_canyon", "red_sea/sub_pier")):
        rgb = rng.integers(0, 255, (64, 96, 3), np.uint8)
        depth_m = (4.2 - rows / 30 + 0.05 * np.sin(columns / 5 + number)).astype(np.float32)
        places = [Path("flsea") / folder / kind for kind in ("imgs", "depth")]
        for place in places:
            place.mkdir(parents=True)
        tifffile.imwrite(places[0] / "16233.tiff", rgb)
        tifffile.imwrite(places[1] / "16233_SeaErra_abs_depth.tif", depth_m)
        tifffile.imwrite(f"{number}.tiff", rgb)
        np.save(f"{number}.npy", np.rint(depth_m * 1000).astype(np.uint16))
        lines.append(f"{number}.tiff,{number}.npy,scene-{number}")
    Path("frames.csv").write_text("\n".join(lines))
    Path("fewer.csv").write_text(lines[0])


@pytest.mark.parametrize("name", RECORDED)
def test_every_key_of_recorded_scenes_changes_bytes_or_is_refused(
    name: str, recordings: None
) -> None:
    views = SMALL_VIEWS if "scenes=mesh" in RECORDED[name] else ()
    base = compose_config((*RECORDED[name], *SEEN, *views))
    expected = list(parts_of(base))
    assert any(isinstance(part, list) and len(part) > 3 for part in expected[1:])
    values = plain(base)
    ignored: list[str] = []
    for key, value in leaves(values["scenes"], "scenes."):
        if key in (*CHOICES, *NO_IMAGES):
            continue
        other = OTHER_OF_RECORDED[name].get(key, OTHER.get(key))
        if other is None:
            other = another(key, value)
        try:
            config = from_mapping(replaced(values, key, other))
        except FactoryError:
            continue
        if reason_without_effect(config, key, [key]):
            continue
        if list(parts_of(config)) == expected:
            ignored.append(f"{key}={other}")
    assert not ignored


@pytest.mark.slow
def test_no_key_of_a_group_is_left_out() -> None:
    """Of all keys that files of `conf` list, each is changed above or in a short list."""
    changed = {key for name in BASES for key, _ in keys_of_base(name)}
    changed.update(key for keys in OTHER_OF_RECORDED.values() for key in keys)
    listed: dict[str, str] = {}
    root = load_yaml(ROOT / "conf/factory.yaml")
    files = [
        path for group in CONF_GROUPS for path in sorted((ROOT / "conf" / group).glob("*.yaml"))
    ]
    for path in files:
        values = load_yaml(path)
        is_global = path.read_text().startswith("# @package _global_")
        for key, _ in leaves(values, "" if is_global else f"{path.parent.name}."):
            listed[key] = path.name
    for key, _ in leaves({name: root[name] for name in root if name not in ("defaults", "hydra")}):
        listed[key] = "factory.yaml"
    assert len(listed) > 150
    left_out = [
        f"{name}: {key}"
        for key, name in listed.items()
        if key not in changed
        and not key.endswith(".defaults")
        and not any(fnmatchcase(key, pattern) for pattern in (*CHOICES, *NO_IMAGES))
    ]
    assert not left_out


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (("noise.range_arc.density=0.1",), "noise.range_arc.density"),
        (("noise=none", "noise.background.strength=0.4"), "noise.background.strength"),
        (("noise.azimuth.enabled=false", "noise.azimuth.count=3"), "noise.azimuth.count"),
        (("sonar.range.max_m=10",), "sonar.range.max_m"),
        (("water=fresh",), "water"),
        (("sonar.frequency_khz=600",), "sonar.frequency_khz"),
        (("sonar=didson_hf", "sonar.array.beamwidth_deg=1"), "sonar.array.beamwidth_deg"),
        (("acoustics.tvg_log=20",), "acoustics.tvg_log"),
        (("experiment=physical", "sonar.point_spread.beams=1"), "sonar.point_spread.beams"),
        (("experiment=any_sonar", "sonar.beams=64"), "sonar.beams"),
        (("experiment=any_sonar", "acoustics=pointwise"), "acoustics"),
        (
            ("experiment=physical", "noise=recording", "noise.drifting_volume.correlation_s=2"),
            "noise.drifting_volume.correlation_s",
        ),
        (("split.test=[seabed-0000]", "split.test_fraction=0.5"), "split.test_fraction"),
    ],
)
def test_a_key_without_effect_is_refused_by_name(words: tuple[str, ...], key: str) -> None:
    with pytest.raises(FactoryError) as caught:
        compose_config(words)
    assert str(caught.value).startswith(f"{key}")


@pytest.mark.parametrize(
    "words",
    [
        ("sonar.range.auto=true", "sonar.range.max_m=2"),
        ("sonar.range={auto: false, max_m: 10}",),
        ("sonar=didson_hf",),
        ("noise.range_arc.count=2", "noise.range_arc.density=0.1"),
        ("noise.background.density={uniform: [0, 0.1]}", "noise.background.strength=0.2"),
    ],
)
def test_keys_that_act_are_taken(words: tuple[str, ...]) -> None:
    compose_config(words)


def test_a_mapping_names_each_of_its_keys_and_a_distribution_none() -> None:
    words = ["sonar.range={auto:false,max_m:9}", "-m", "resample.rate={uniform:[0.1,0.2]}"]
    words += ["~frames.total", "water=sea", "+scenes/objects=example"]
    assert named_keys(words) == ["sonar.range.auto", "sonar.range.max_m", "resample.rate", "water"]
