"""The device of one image: drawn in one place, and the configuration that it means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field, dataclass, replace
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from ...common import seeds
from ...common.distribution import number
from ...dataset.fan_geometry import FEWEST_BINS, POINTS_HFOV_DEG, fan_size
from ...dataset.meaning import class_names
from ...dataset.schema import Column
from ..imaging.coherent import CoherentScene
from ..imaging.effect import EffectSettings
from ..imaging.pointwise import PointwiseScene
from ..imaging.settings import (
    GROUND_DB,
    AcousticsSettings,
    CoherentSettings,
    Formation,
    PointwiseSettings,
    ResampleSettings,
    is_coherent,
)
from ..noise.registry import EFFECTS, NoiseSettings, blocks, with_blocks
from ..sonar.array import WaterSettings
from ..sonar.settings import ImageSettings as FanSettings
from ..sonar.settings import RangeSettings, SonarSettings, TransferKind, TransferSettings
from ..sonar.window import Window
from .settings import DeviceSettings, distributions

_SOUND_SPEED_M_S = 1480.0
"""Turns a range resolution into a bandwidth; the water's own speed is within 4 % of it."""
_ANY_RANGE_M = (0.2, 30.0)
"""Limits of a fitted window."""
_LARGEST_POINTS_PX = 512
"""Beyond, an image of points has fewer echoes than pixels."""
_DARKEST = 0.8
"""Share of the median echo's grey value; a display with no darker pixel shows nothing."""
_ODD = ("spokes", "ghosts", "gains")
"""Artefacts that many recordings lack: a network that always saw them takes detail for them."""


class DrawnSettings(Protocol):
    """What of a configuration, a dataclass, a device decides; its other fields stay as they are."""

    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    @property
    def sonar(self) -> SonarSettings:
        """The device, and the size and layout of its images."""

    @property
    def acoustics(self) -> AcousticsSettings:
        """The image formation."""

    @property
    def noise(self) -> NoiseSettings:
        """The effects."""


Config = TypeVar("Config", bound=DrawnSettings)


@dataclass(frozen=True)
class DrawnDevice:
    """What was drawn for one image.

    values: by the keys of `distributions`; shares are drawn as 1 or 0.
    coins: effect -> whether a coin leaves it on, of `fewer_share` or, for odd ones, `odd_share`.
    """

    values: Mapping[str, float]
    coins: Mapping[str, bool]

    @property
    def formation(self) -> Formation:
        """Which formation makes the image."""
        return "coherent" if self.values.get("field_share", 1.0) else "pointwise"

    def row(self) -> dict[str, float]:
        """The values of `columns`."""
        return {f"device.{name}": value for name, value in self.values.items()}


def draw(settings: DeviceSettings, seed: int, *stream_names: str | int) -> DrawnDevice:
    """The device of the image of this name; the same name draws the same."""
    values = {}
    for name, distribution in distributions(settings).items():
        rng = seeds.stream(seed, "device", name, *stream_names)
        value = distribution.draw(rng)
        values[name] = float(rng.random() < value) if name.endswith("_share") else value
    # Each coin has a stream of its own, so a further effect leaves the others as they are.
    coins = {
        name: seeds.stream(seed, "device", "coin", name, *stream_names).random() < 0.5
        for name in EFFECTS
    }
    return DrawnDevice(values, coins)


def columns(settings: DeviceSettings) -> tuple[Column, ...]:
    """Columns of the sample table: what was drawn for the device of each image."""
    units = {"deg": "deg", "khz": "kHz", "px": "px", "m": "m", "db": "dB"}
    return tuple(
        Column(f"device.{name}", "f8", units.get(name.partition(".")[0].rsplit("_", 1)[-1], "1"))
        for name in distributions(settings)
    )


def configured(config: Config, device: DrawnDevice, *, any_size: bool) -> Config:
    """The configuration of one image by this device, except for what depends on its window.

    any_size: whether images may differ in size and layout; else they keep `sonar.image`.
    """
    drawn = device.values
    sonar = config.sonar
    is_pointwise = device.formation == "pointwise"
    image = _image(config.sonar.image, device, any_size=any_size)
    range_bins = sonar.range_bins
    if "bins_per_px" in drawn:
        range_bins = max(round(image.height_px * drawn["bins_per_px"]), FEWEST_BINS)
    table = sonar.beam_azimuths_deg
    if "beams" in drawn or "hfov_deg" in drawn:
        table = None
    sonar = replace(
        sonar,
        hfov_deg=drawn.get("hfov_deg", sonar.hfov_deg),
        vfov_deg=drawn.get("vfov_deg", sonar.vfov_deg),
        frequency_khz=drawn.get("frequency_khz", sonar.frequency_khz),
        beam_azimuths_deg=table,
        beams=round(drawn.get("beams", sonar.beams)),
        range_bins=range_bins,
        image=image,
        range=_range(sonar.range, device),
        transfer=_transfer(sonar.transfer, device),
    )
    acoustics = _acoustics(config.acoustics, device)
    noise = _of_formation(config.noise, device)
    is_static = is_coherent(acoustics) and acoustics.standing > 0
    if not is_static and noise.scintillation is not None:
        # Scintillation beside speckle that is new in every ping cannot be told from it.
        noise = replace(noise, scintillation=replace(noise.scintillation, enabled=False))
    changed: dict[str, Any] = {"acoustics": acoustics, "noise": noise, "devices": None}
    if is_pointwise:
        sonar = _points(sonar, any_size)
        transfer = replace(sonar.transfer, full_scale_db=None)
        # None of these reaches pointwise images.
        changed["sonar"] = replace(sonar, samples_per_bin=1, transfer=transfer)
        changed["water"] = WaterSettings()
    else:
        changed["sonar"] = sonar
        # A complex field has no points to thin.
        changed["resample"] = ResampleSettings()
    return replace(config, **changed)


def _image(image: FanSettings, device: DrawnDevice, *, any_size: bool) -> FanSettings:
    """The image of the device; see `configured`."""
    drawn = device.values
    is_pointwise = device.formation == "pointwise"
    changed: dict[str, Any] = {}
    if any_size and "height_px" in drawn:
        changed["height_px"] = round(drawn["height_px"])
    if any_size and drawn.get("polar_share") and not is_pointwise:
        changed["layout"] = "polar"
    if "nearest_share" in drawn:
        shows_nearest = drawn["nearest_share"] and not is_pointwise
        changed["sampling"] = "nearest" if shows_nearest else "bilinear"
    if "enlarged" in drawn:
        is_enlarged = drawn.get("enlarged_share", 1.0)
        changed["enlarged"] = min(max(drawn["enlarged"], 1.0), 4.0) if is_enlarged else 1.0
    if "jpeg_quality" in drawn:
        quality = min(max(round(drawn["jpeg_quality"]), 1), 100)
        changed["jpeg_quality"] = quality if drawn.get("jpeg_share", 1.0) else None
    return replace(image, **changed)


def _range(limits: RangeSettings, device: DrawnDevice) -> RangeSettings:
    """The range window of the device, or what it is fitted within."""
    drawn = device.values
    if device.formation == "pointwise":
        return RangeSettings(auto=True, min_m=_ANY_RANGE_M[0], max_m=_ANY_RANGE_M[1])
    if drawn.get("auto_range_share"):
        return RangeSettings(auto=True, min_m=_ANY_RANGE_M[0], max_m=_ANY_RANGE_M[1])
    if "range_min_m" not in drawn and "range_max_m" not in drawn:
        return limits
    near_m = drawn.get("range_min_m", limits.min_m)
    far_m = drawn.get("range_max_m", limits.max_m)
    return RangeSettings(auto=False, min_m=near_m, max_m=far_m)


def _acoustics(acoustics: AcousticsSettings, device: DrawnDevice) -> AcousticsSettings:
    """The image formation of the device."""
    if device.formation == "pointwise":
        return PointwiseSettings()
    assert is_coherent(acoustics)  # the configuration refuses others
    drawn = device.values
    changed: dict[str, Any] = {
        name: drawn[name] for name in ("tvg_log", "lambert_exponent", "standing") if name in drawn
    }
    if not drawn.get("standing_share", 1.0):
        changed["standing"] = 0.0
    return replace(acoustics, reflectivity_db=_reflectivity_db(acoustics, device), **changed)


def _reflectivity_db(acoustics: CoherentSettings, device: DrawnDevice) -> dict[str, float]:
    """Backscatter coefficient of each class by name, dB."""
    drawn = device.values
    echo_db = dict(acoustics.reflectivity_db)
    ground_db = echo_db.get("Background", GROUND_DB)
    if shift_db := drawn.get("objects_db", 0.0):
        names = class_names(echo_db)[1:]
        echo_db |= {name: echo_db.get(name, ground_db) + shift_db for name in names}
    if "background_db" in drawn:
        echo_db["Background"] = drawn["background_db"]
    for key, level_db in drawn.items():
        group, _, name = key.partition(".")
        if group == "reflectivity_db":
            echo_db[name] = level_db
    return echo_db


def resolved(config: Config, device: DrawnDevice, window: Window, *, any_size: bool) -> Config:
    """The device with its resolution in the window, and a fan as wide as its sector."""
    if device.formation == "pointwise":
        return config
    drawn = device.values
    sonar = config.sonar
    image = config.sonar.image
    array = sonar.array
    if "resolution_bins" in drawn:
        resolution_m = window.range_span_m / sonar.range_bins * drawn["resolution_bins"]
        bandwidth_khz = float(np.clip(_SOUND_SPEED_M_S / (2000 * resolution_m), 1, 2000))
        array = replace(array, bandwidth_khz=bandwidth_khz)
    if "beamwidth_beams" in drawn:
        width_deg = sonar.hfov_deg / sonar.beams * drawn["beamwidth_beams"]
        array = replace(array, beamwidth_deg=float(np.clip(width_deg, 0.05, 60)))
    if any_size and image.layout == "fan":
        across, ahead = fan_size(sonar.hfov_deg, window.near_fraction)
        image = replace(image, width_px=int(np.ceil(image.height_px * (across / ahead))) + 1)
    return replace(config, sonar=replace(sonar, array=array, image=image))


def fitted(config: Config, device: DrawnDevice, scene: PointwiseScene | CoherentScene) -> Config:
    """The device for a known scene: receiver noise lies as far over its median echo as drawn."""
    receiver = config.noise.receiver
    if "receiver_db" not in device.values:
        return config
    if isinstance(scene, PointwiseScene) or receiver is None or not receiver.enabled:
        return config
    echoes = scene.expected[scene.expected > 0]
    level_db = device.values["receiver_db"]
    if len(echoes):
        level_db += 10 * float(np.log10(np.median(echoes) / scene.thermal_noise))
    block = replace(receiver, level_db=number(level_db))
    return replace(config, noise=replace(config.noise, receiver=block))


def _points(sonar: SonarSettings, any_size: bool) -> SonarSettings:
    """The paper's images: the view from above, a bin and a beam for each pixel."""
    image = sonar.image
    hfov_deg = max(sonar.hfov_deg, POINTS_HFOV_DEG)
    if any_size:
        side = min(image.height_px, _LARGEST_POINTS_PX)
        image = replace(image, layout="fan", height_px=side, width_px=side)
    sonar = replace(sonar, projection="top_view", hfov_deg=hfov_deg, image=image)
    return replace(sonar, beams=image.width_px, range_bins=image.height_px)


def _transfer(transfer: TransferSettings, device: DrawnDevice) -> TransferSettings:
    drawn = device.values
    if device.formation == "pointwise" and not drawn.get("points_log_share", 0.0):
        return replace(transfer, kind="linear", percentile=90.0, reference=1.0)
    range_db = drawn.get("dynamic_range_db", transfer.dynamic_range_db)
    if device.formation == "pointwise":
        transfer = replace(transfer, kind="log", percentile=90.0, reference=0.9)
        # Decibels of an energy: half as many as of an amplitude.
        return replace(transfer, dynamic_range_db=range_db / 2)
    kind = transfer.kind
    if "log_share" in drawn:
        kind = "log" if drawn["log_share"] else "power"
    if kind in ("log", "soft_log") and "soft_share" in drawn:
        kind = "soft_log" if drawn["soft_share"] else "log"
    if kind in ("log", "soft_log"):
        return _log_transfer(replace(transfer, dynamic_range_db=range_db), kind, drawn)
    changed: dict[str, Any] = {"kind": kind, "exponent": drawn.get("exponent", transfer.exponent)}
    if "power_reference" in drawn:
        changed |= {"percentile": 95.0, "reference": drawn["power_reference"]}
    return replace(transfer, black=0.0, **changed)


def _log_transfer(
    transfer: TransferSettings, kind: TransferKind, drawn: Mapping[str, float]
) -> TransferSettings:
    """A logarithmic display of the drawn reference and black level."""
    changed: dict[str, Any] = {"kind": kind, "black": 0.0}
    reference = drawn.get("log_reference", transfer.reference)
    if "log_reference" in drawn:
        changed |= {"percentile": 50.0, "reference": reference}
    if kind == "soft_log":
        black = drawn.get("black", transfer.black)
        changed["black"] = min(black, _DARKEST * reference)
    return replace(transfer, **changed)


def _of_formation(noise: NoiseSettings, device: DrawnDevice) -> NoiseSettings:
    """The effects of the device's formation that are on in this image."""
    changed: dict[str, EffectSettings] = {}
    for name, block in blocks(noise).items():
        is_on = block.enabled and _is_drawn(name, device)
        changed[name] = replace(block, enabled=is_on)
    return with_blocks(noise, changed)


def _is_drawn(name: str, device: DrawnDevice) -> bool:
    """Whether the device shows the effect in this image.

    Quiet images have no effect at all.  A coin decides where an image has fewer effects, and always
    for an odd artefact, which only images with odd artefacts have.
    """
    effect = EFFECTS[name]
    drawn = device.values
    is_pointwise = device.formation == "pointwise"
    has_own_noise = "field_share" in drawn
    if has_own_noise and (effect.stage == "points") != is_pointwise:
        return False
    if drawn.get("quiet_share", 0.0):
        return False
    if "odd_share" in drawn and effect.artefact in _ODD and not is_pointwise:
        return bool(drawn["odd_share"]) and device.coins[name]
    return device.coins[name] or not drawn.get("fewer_share", 0.0)
