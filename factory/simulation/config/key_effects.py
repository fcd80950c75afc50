"""Keys that do nothing under the settings beside them: no wish of the user is dropped silently.

A device preset describes more of a sonar than one image formation uses, so this is about keys that
a user names.  `reason_without_effect` knows every key of every group that acts only together with
others; tests change each key and look for other bytes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, NamedTuple

from ...common.distribution import Distribution
from ...common.errors import FactoryError
from ..imaging.settings import CoherentSettings
from ..noise.registry import EFFECTS, blocks
from ..scenes import has_labels
from ..scenes.mesh import MeshSettings
from ..scenes.pack import PackSettings
from ..scenes.seabed import SeabedSettings

if TYPE_CHECKING:
    from ..imaging.effect import EffectSettings
    from .root import FactoryConfig


class Rule(NamedTuple):
    """Keys that act only under a condition.

    keys: patterns of dotted keys.  acts: whether they do.  remedy: what to set so that they do.
    switch: a key that, named beside them, says that it is meant so: drawn values, given again as
        numbers, hold both.
    """

    keys: tuple[str, ...]
    acts: Callable[[FactoryConfig], bool]
    remedy: str
    switch: str = ""


def refuse_keys_without_effect(config: FactoryConfig, named: Iterable[str]) -> None:
    """Raise FactoryError, one line, for the first key that does nothing.

    named: dotted keys, and names of groups, that the user has given.
    """
    keys = list(named)
    for key in keys:
        if reason := reason_without_effect(config, key, keys):
            raise FactoryError(f"{key}: {reason}")


def reason_without_effect(
    config: FactoryConfig, key: str, named: Collection[str] = ()
) -> str | None:
    """Why a key does nothing under this configuration, and what to set instead; None if it acts.

    named: all keys that the user has given.
    """
    if key in ("sonar.range.min_m", "sonar.range.max_m"):
        return _reason_of_range(config, key, named)
    if key.startswith("noise.") and (reason := _reason_of_noise(config, key, named)):
        return reason
    for rule in _RULES:
        is_meant = any(fnmatchcase(key, pattern) for pattern in rule.keys)
        if is_meant and rule.switch not in named and not rule.acts(config):
            return f"has no effect here; {rule.remedy}, or leave it out"
    return None


def _reason_of_range(config: FactoryConfig, key: str, named: Collection[str]) -> str | None:
    """Limits of a fitted window look like a window; who knows that they are not says so."""
    limits = config.sonar.range
    if limits.windows_m:
        return "has no effect beside sonar.range.windows_m; leave one of them out"
    if limits.auto and "sonar.range.auto" not in named:
        return (
            "only limits the window, which sonar.range.auto=true fits to each frame; set "
            "sonar.range.auto=false for one window from min_m to max_m, or sonar.range.auto=true "
            "if a limit is what you mean"
        )
    return None


# Parameters that make their effect nothing where they are 0.
_AMOUNTS = {
    "range_spreading": ("alpha",),
    "multipath": ("count", "density", "strength"),
    "azimuth": ("count", "density", "strength"),
    "range_arc": ("count", "density", "strength"),
    "background": ("density", "strength"),
    "spokes": ("count",),
}
# Parameters that act from so much of another parameter on.
_LEAST_AMOUNTS = {"noise.beam_gain.dead_db": ("dead", 1), "noise.spokes.spacing": ("count", 2)}


def _reason_of_noise(config: FactoryConfig, key: str, named: Collection[str]) -> str | None:
    """A zero that the user names beside the key is meant so: see `Rule`."""
    _, effect, *parameter = key.split(".")
    block = blocks(config.noise).get(effect)
    if block is None or not parameter:
        return None
    name = parameter[0]
    if name == "enabled":
        zero = _zero_amount(effect, block)
        if block.enabled and zero:
            return f"has no effect while noise.{effect}.{zero}=0; set that, too"
        return None
    if not block.enabled:
        return f"has no effect while noise.{effect}.enabled=false; set noise.{effect}.enabled=true"
    zero = _zero_amount(effect, block)
    if zero and name != zero and f"noise.{effect}.{zero}" not in named:
        return f"has no effect while noise.{effect}.{zero}=0; set that, too"
    amount, least = _LEAST_AMOUNTS.get(key, ("", 0))
    if amount and _largest(block, amount) < least and f"noise.{effect}.{amount}" not in named:
        return f"has no effect while noise.{effect}.{amount} is below {least}; set that, too"
    if key == "noise.receiver.level_db" and _is_drawn(config, "receiver_db"):
        return "has no effect here; devices draws it: set devices.receiver_db"
    return None


def _zero_amount(effect: str, block: EffectSettings) -> str | None:
    """The parameter that makes the effect nothing, if one does."""
    for name in _AMOUNTS.get(effect, ()):
        if _largest(block, name) == 0:
            return name
    return None


def _largest(block: EffectSettings, name: str) -> float:
    """The largest value that a parameter can have, but for tails of `normal`."""
    distribution: Distribution = getattr(block, name)
    if distribution.kind == "normal":
        mean, deviation = distribution.values
        return mean + 3 * deviation
    return max(distribution.values)


# --- conditions ---


def _is_coherent(config: FactoryConfig) -> bool:
    return isinstance(config.acoustics, CoherentSettings)


def _is_drawn(config: FactoryConfig, *device_keys: str) -> bool:
    """Whether devices draws one of its keys."""
    devices = config.devices
    return devices is not None and any(getattr(devices, key) is not None for key in device_keys)


def _is_pointwise(config: FactoryConfig) -> bool:
    """Drawn devices may make pointwise images, too."""
    if config.devices is not None:
        return config.devices.field_share is not None
    return not _is_coherent(config)


def _acts(config: FactoryConfig, *effects: str) -> bool:
    """Whether one of the effects is switched on."""
    effect_settings = blocks(config.noise)
    return any(name in effect_settings and effect_settings[name].enabled for name in effects)


def _adds_points(config: FactoryConfig) -> bool:
    return any(
        block.enabled and EFFECTS[name].stage == "points"
        for name, block in blocks(config.noise).items()
    )


def _is_calibrated(config: FactoryConfig) -> bool:
    """Whether the source level reaches the samples."""
    stored = {"intensity_db", "field"}.intersection(config.dataset.layers)
    return _acts(config, "receiver") or bool(stored) or "calibration" in config.dataset.columns


def _shows_standing_speckle(config: FactoryConfig) -> bool:
    """Whether the mean of noisy images decides an image, and they have speckle."""
    is_mean_shown = (
        config.devices is not None
        or not isinstance(config.acoustics, CoherentSettings)
        or config.acoustics.target != "noise_free"
        or "mean" in config.dataset.layers
    )
    return is_mean_shown and _acts(config, "speckle", "path_speckle")


def _has_noise(config: FactoryConfig) -> bool:
    return any(block.enabled for block in blocks(config.noise).values())


def _is_labelled(config: FactoryConfig) -> bool:
    return has_labels(config.scenes)


def _is_fan(config: FactoryConfig) -> bool:
    return config.sonar.image.layout == "fan"


def _has_sidelobes(config: FactoryConfig, direction: str) -> bool:
    taper = getattr(config.sonar.array, direction)
    return taper.window in ("taylor", "chebyshev")


def _draws_poses(config: FactoryConfig) -> bool:
    return isinstance(config.scenes, MeshSettings) and config.scenes.poses is None


def _routes(config: FactoryConfig, route: str) -> bool:
    return (
        isinstance(config.scenes, MeshSettings)
        and config.scenes.poses is None
        and config.scenes.route == route
    )


def _is_timed(config: FactoryConfig) -> bool:
    """Whether frames have a time; a pack's may."""
    scenes = config.scenes
    if isinstance(scenes, SeabedSettings):
        return scenes.is_recording
    return isinstance(scenes, MeshSettings | PackSettings)


def _share_is_above_0(name: str) -> Callable[[FactoryConfig], bool]:
    def acts(config: FactoryConfig) -> bool:
        if config.devices is None:
            return True
        share: Distribution | None = getattr(config.devices, name)
        return share is None or max(share.values) > 0

    return acts


_COHERENT_ONLY = (
    "water",
    "water.*",
    "sonar.array",
    "sonar.array.*",
    "sonar.frequency_khz",
    "sonar.samples_per_bin",
    "sonar.transfer.full_scale_db",
)
# Key of an image -> the keys of devices that replace it.
_DRAWN_BY: dict[str, tuple[str, ...]] = {
    "sonar.hfov_deg": ("hfov_deg",),
    "sonar.vfov_deg": ("vfov_deg",),
    "sonar.frequency_khz": ("frequency_khz",),
    "sonar.beams": ("beams",),
    "sonar.range_bins": ("bins_per_px",),
    "sonar.beam_azimuths_deg": ("beams", "hfov_deg"),
    "sonar.range.*": ("auto_range_share", "range_min_m", "range_max_m"),
    "sonar.transfer.kind": ("log_share", "soft_share"),
    "sonar.transfer.percentile": ("log_reference", "power_reference"),
    "sonar.transfer.reference": ("log_reference", "power_reference"),
    "sonar.transfer.exponent": ("exponent",),
    "sonar.transfer.dynamic_range_db": ("dynamic_range_db",),
    "sonar.transfer.black": ("black",),
    "sonar.transfer.full_scale_db": ("log_reference", "power_reference"),
    "sonar.image.sampling": ("nearest_share",),
    "sonar.image.enlarged": ("enlarged",),
    "sonar.image.jpeg_quality": ("jpeg_quality",),
    "sonar.array.bandwidth_khz": ("resolution_bins",),
    "sonar.array.beamwidth_deg": ("beamwidth_beams",),
    "sonar.array.source_level_db": ("receiver_db",),
    "acoustics.standing": ("standing",),
    "acoustics.tvg_log": ("tvg_log",),
    "acoustics.lambert_exponent": ("lambert_exponent",),
    "acoustics.reflectivity_db.Background": ("background_db",),
}


def _is_not_drawn(device_keys: tuple[str, ...]) -> Callable[[FactoryConfig], bool]:
    return lambda config: not _is_drawn(config, *device_keys)


_RULES = (
    *(
        Rule(
            (key,),
            _is_not_drawn(device_keys),
            f"devices draws it for each image: set devices.{device_keys[0]}=null or devices=fixed",
        )
        for key, device_keys in _DRAWN_BY.items()
    ),
    Rule(_COHERENT_ONLY, _is_coherent, "set acoustics=coherent (experiment=physical)"),
    Rule(("resample", "resample.*"), _is_pointwise, "set acoustics=pointwise"),
    Rule(("sonar.point_spread.*",), _is_pointwise, "set acoustics=pointwise"),
    Rule(
        ("sonar.accumulate",),
        lambda config: _is_pointwise(config) or _adds_points(config),
        "set acoustics=pointwise",
    ),
    Rule(
        ("sonar.tvg_db_per_decade",),
        lambda config: _is_pointwise(config) or _acts(config, "range_arc"),
        "set acoustics=pointwise, or acoustics.tvg_log for acoustics=coherent",
    ),
    Rule(
        ("sonar.array.source_level_db",),
        _is_calibrated,
        "set noise.receiver.enabled=true",
    ),
    *(
        Rule(
            (f"sonar.array.{direction}.sidelobe_db",),
            lambda config, direction=direction: _has_sidelobes(config, direction),  # type: ignore[misc]
            f"set sonar.array.{direction}.window=taylor or chebyshev",
        )
        for direction in ("horizontal", "vertical", "pulse")
    ),
    Rule(
        ("sonar.transfer.percentile", "sonar.transfer.reference"),
        lambda config: config.sonar.transfer.full_scale_db is None,
        "set sonar.transfer.full_scale_db=null",
    ),
    Rule(
        ("sonar.transfer.exponent",),
        lambda config: config.sonar.transfer.kind == "power",
        "set sonar.transfer.kind=power",
    ),
    Rule(
        ("sonar.transfer.dynamic_range_db",),
        lambda config: config.sonar.transfer.kind in ("log", "soft_log"),
        "set sonar.transfer.kind=log",
    ),
    Rule(
        ("sonar.image.width_px", "sonar.image.height_px"),
        _is_fan,
        "a polar image has a pixel a bin: set sonar.beams and sonar.range_bins",
    ),
    Rule(("sonar.image.sampling", "sonar.image.enlarged"), _is_fan, "set sonar.image.layout=fan"),
    Rule(("acoustics.target",), _has_noise, "switch on noise"),
    Rule(
        ("acoustics.standing",),
        _shows_standing_speckle,
        "set noise.speckle.enabled=true and acoustics.target=mean_log, or dataset.layers=[mean]",
    ),
    Rule(
        ("sonar.array.beam_groups",),
        lambda config: config.scenes.has_moving_objects,
        "nothing moves within a ping: give scenes.moving_objects, or leave it out",
    ),
    Rule(
        ("noise.drifting_volume.correlation_s", "noise.drifting_volume.drift_m_s"),
        _is_timed,
        "frames have no time: set scenes.frame_rate_hz",
    ),
    Rule(
        ("acoustics.reflectivity_db.[!B]*", "acoustics.reflectivity_db.B[!a]*"),
        _is_labelled,
        "frames without labels are Background: use labelled scenes",
    ),
    Rule(
        ("acoustics.lambert_exponents", "acoustics.lambert_exponents.*", "acoustics.materials"),
        _is_labelled,
        "frames without labels are Background: use labelled scenes",
    ),
    Rule(
        ("render.albedo", "render.edge_ratio", "render.bounces", "render.reflection_loss_db"),
        lambda config: config.scenes.kind != "pack",
        "the pack holds finished renders: use other scenes",
    ),
    Rule(
        ("render.reflection_loss_db",),
        lambda config: config.render.bounces > 0,
        "nothing is mirrored: set render.bounces=1",
    ),
    Rule(
        ("scenes.frames_per_location",),
        lambda config: not isinstance(config.scenes, SeabedSettings) or config.scenes.path is None,
        "the lines of scenes.path are the frames: set scenes.path=null",
    ),
    Rule(
        ("scenes.kinds",),
        lambda config: not isinstance(config.scenes, SeabedSettings) or config.scenes.objects > 0,
        "set scenes.objects above 0",
    ),
    Rule(
        ("scenes.route", "scenes.paths", "scenes.views_per_path", "scenes.height_m"),
        _draws_poses,
        "scenes.poses has the poses: set scenes.poses=null",
    ),
    Rule(
        ("scenes.height_m",),
        lambda config: config.sonar.altitude_m is None,
        "sonar.altitude_m has the height: set sonar.altitude_m=null",
    ),
    Rule(
        ("scenes.tilt_deg",),
        lambda config: config.sonar.tilt_deg is None,
        "sonar.tilt_deg has the tilt: set sonar.tilt_deg=null",
    ),
    Rule(("scenes.speed_m_s",), _draws_poses, "scenes.poses has the poses: set scenes.poses=null"),
    Rule(
        ("scenes.distance_m",),
        lambda config: _routes(config, "orbit"),
        "set scenes.route=orbit and scenes.poses=null",
    ),
    Rule(
        ("scenes.tilt_deg",),
        lambda config: _routes(config, "transect"),
        "set scenes.route=transect and scenes.poses=null",
    ),
    Rule(
        ("frames.stride", "frames.limit", "frames.total"),
        lambda config: config.frames.only is None,
        "frames.only names the frames: set frames.only=null",
    ),
    Rule(
        ("split.test_fraction",),
        lambda config: not config.split.test,
        "split.test names the scenes: set split.test=[]",
    ),
    Rule(
        ("dataset.compression_level",),
        lambda config: config.dataset.compression == "gzip",
        "set dataset.compression=gzip",
    ),
    *(
        Rule(
            (f"devices.{name}",),
            _share_is_above_0(share),
            f"set devices.{share} above 0",
            switch=f"devices.{share}",
        )
        for name, share in (
            ("standing", "standing_share"),
            ("black", "soft_share"),
            ("jpeg_quality", "jpeg_share"),
            ("enlarged", "enlarged_share"),
        )
    ),
)
