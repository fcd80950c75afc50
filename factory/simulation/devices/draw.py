"""The device of one image: drawn in one place, and the configuration that it means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import Field, dataclass, replace
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from ...common import seeds
from ...common.distribution import number
from ...dataset.fan_geometry import fan_size
from ...dataset.schema import Column
from ..imaging.coherent import CoherentScene
from ..imaging.effect import EffectSettings
from ..imaging.pointwise import PointwiseScene
from ..imaging.settings import (
    AcousticsSettings,
    CoherentSettings,
    Formation,
    PointwiseSettings,
    ResampleSettings,
)
from ..noise.registry import EFFECTS, NoiseSettings, blocks, with_blocks
from ..sonar.array import WaterSettings
from ..sonar.settings import RangeSettings, SonarSettings, TransferSettings
from ..sonar.window import Window
from .settings import DeviceSettings, distributions

_SOUND_SPEED_M_S = 1480.0
"""Turns a range resolution into a bandwidth; the water's own speed is within 4 % of it."""
_FEWEST_BINS = 64
_LARGEST_POINTS_PX = 512
"""Beyond, an image of points has fewer echoes than pixels."""
_POINTS_HFOV_DEG = 30.0
_DARKEST = 0.8
"""Of the median echo's grey value: a display that is no darker anywhere shows nothing."""
_ODD = ("spokes", "ghosts", "gains")
"""Artefacts that many recordings do not have; seen always, they teach to take detail for them."""


class ImageSettings(Protocol):
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


Config = TypeVar("Config", bound=ImageSettings)


@dataclass(frozen=True)
class Device:
    """What was drawn for one image.

    values: by the keys of `DeviceSettings`; shares are drawn as 1 or 0.
    coins: effect -> whether a coin leaves it on, of `fewer_share` or, for odd ones, `odd_share`.
    """

    values: Mapping[str, float]
    coins: Mapping[str, bool]

    @property
    def formation(self) -> Formation:
        """Which formation makes the image."""
        return "coherent" if self.values["field_share"] else "pointwise"

    def row(self) -> dict[str, float]:
        """The values of `columns`."""
        return {f"device.{name}": value for name, value in self.values.items()}


def draw(settings: DeviceSettings, seed: int, *stream_names: str | int) -> Device:
    """The device of the image of this name; the same name draws the same."""
    values = {}
    for name, distribution in distributions(settings).items():
        rng = seeds.stream(seed, "device", name, *stream_names)
        value = distribution.draw(rng)
        values[name] = float(rng.random() < value) if name.endswith("_share") else value
    # Of a stream each, so that a further effect does not turn the coins of the others.
    coins = {
        name: seeds.stream(seed, "device", "coin", name, *stream_names).random() < 0.5
        for name in EFFECTS
    }
    return Device(values, coins)


def columns(settings: DeviceSettings) -> tuple[Column, ...]:
    """Columns of the sample table: what was drawn for the device of each image."""
    units = {"deg": "deg", "khz": "kHz", "px": "px", "m": "m", "db": "dB"}
    return tuple(
        Column(f"device.{name}", "f8", units.get(name.rsplit("_", 1)[-1], "1"))
        for name in distributions(settings)
    )


def configured(config: Config, device: Device, *, any_size: bool) -> Config:
    """The configuration of one image by this device, but for what depends on its window.

    any_size: whether images may differ in size and layout; else they keep `sonar.image`.
    """
    drawn = device.values
    sonar = config.sonar
    image = config.sonar.image
    points = device.formation == "pointwise"
    height = round(drawn["height_px"]) if any_size else image.height_px
    polar = any_size and drawn["polar_share"] and not points
    quality = min(max(round(drawn["jpeg_quality"]), 1), 100)
    image = replace(
        image,
        height_px=height,
        layout="polar" if polar else image.layout,
        sampling="nearest" if drawn["nearest_share"] and not points else "bilinear",
        enlarged=min(max(drawn["enlarged"], 1.0), 4.0) if drawn["enlarged_share"] else 1.0,
        jpeg_quality=quality if drawn["jpeg_share"] else None,
    )
    fixed = not points and not drawn["auto_range_share"]
    near_m, far_m = (drawn["range_min_m"], drawn["range_max_m"]) if fixed else (0.2, 30.0)
    sonar = replace(
        sonar,
        hfov_deg=drawn["hfov_deg"],
        vfov_deg=drawn["vfov_deg"],
        frequency_khz=drawn["frequency_khz"],
        beam_azimuths_deg=None,
        beams=round(drawn["beams"]),
        range_bins=max(round(height * drawn["bins_per_px"]), _FEWEST_BINS),
        image=image,
        range=RangeSettings(auto=not fixed, min_m=near_m, max_m=far_m),
        transfer=_transfer(sonar.transfer, device),
    )
    acoustics = _acoustics(config.acoustics, device)
    noise = _of_formation(config.noise, device)
    is_static = isinstance(acoustics, CoherentSettings) and acoustics.standing > 0
    if not is_static and noise.scintillation is not None:
        # Scintillation beside speckle that is new in every ping cannot be told from it.
        noise = replace(noise, scintillation=replace(noise.scintillation, enabled=False))
    changed: dict[str, Any] = {"acoustics": acoustics, "noise": noise, "devices": None}
    if points:
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


def _acoustics(acoustics: AcousticsSettings, device: Device) -> AcousticsSettings:
    """The image formation of the device."""
    if device.formation == "pointwise":
        return PointwiseSettings()
    assert isinstance(acoustics, CoherentSettings)  # the configuration refuses others
    drawn = device.values
    return replace(
        acoustics,
        standing=drawn["standing"] if drawn["standing_share"] else 0.0,
        reflectivity_db=acoustics.reflectivity_db | {"Background": drawn["background_db"]},
        tvg_log=drawn["tvg_log"],
        lambert_exponent=drawn["lambert_exponent"],
    )


def resolved(config: Config, device: Device, window: Window, *, any_size: bool) -> Config:
    """The same, with what the device resolves in its window, and a fan as wide as its sector."""
    if device.formation == "pointwise":
        return config
    drawn = device.values
    sonar = config.sonar
    image = config.sonar.image
    resolution_m = window.range_span_m / sonar.range_bins * drawn["resolution_bins"]
    bandwidth_khz = float(np.clip(_SOUND_SPEED_M_S / (2000 * resolution_m), 1, 2000))
    width_deg = sonar.hfov_deg / sonar.beams * drawn["beamwidth_beams"]
    beamwidth_deg = float(np.clip(width_deg, 0.05, 60))
    array = replace(sonar.array, bandwidth_khz=bandwidth_khz, beamwidth_deg=beamwidth_deg)
    if any_size and image.layout == "fan":
        across, ahead = fan_size(sonar.hfov_deg, window.near_fraction)
        image = replace(image, width_px=int(np.ceil(image.height_px * (across / ahead))) + 1)
    return replace(config, sonar=replace(sonar, array=array, image=image))


def fitted(config: Config, device: Device, scene: PointwiseScene | CoherentScene) -> Config:
    """The same once the scene is known: the receiver's noise lies so far over its median echo."""
    receiver = config.noise.receiver
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
    hfov_deg = max(sonar.hfov_deg, _POINTS_HFOV_DEG)
    if any_size:
        side = min(image.height_px, _LARGEST_POINTS_PX)
        image = replace(image, layout="fan", height_px=side, width_px=side)
    sonar = replace(sonar, projection="top_view", hfov_deg=hfov_deg, image=image)
    return replace(sonar, beams=image.width_px, range_bins=image.height_px)


def _transfer(transfer: TransferSettings, device: Device) -> TransferSettings:
    drawn = device.values
    if device.formation == "pointwise" and not drawn["points_log_share"]:
        return replace(transfer, kind="linear", percentile=90.0, reference=1.0)
    range_db = drawn["dynamic_range_db"]
    if device.formation == "pointwise":
        transfer = replace(transfer, kind="log", percentile=90.0, reference=0.9)
        # Decibels of an energy: half as many as of an amplitude.
        return replace(transfer, dynamic_range_db=range_db / 2)
    if drawn["log_share"]:
        soft = bool(drawn["soft_share"])
        reference = drawn["log_reference"]
        black = min(drawn["black"], _DARKEST * reference) if soft else 0.0
        transfer = replace(transfer, kind="soft_log" if soft else "log", black=black)
        return replace(transfer, percentile=50.0, reference=reference, dynamic_range_db=range_db)
    transfer = replace(transfer, kind="power", exponent=drawn["exponent"])
    return replace(transfer, percentile=95.0, reference=drawn["power_reference"])


def _of_formation(noise: NoiseSettings, device: Device) -> NoiseSettings:
    """The effects of the device's formation that are on in this image."""
    points = device.formation == "pointwise"
    drawn = device.values
    changed: dict[str, EffectSettings] = {}
    for name, block in blocks(noise).items():
        effect = EFFECTS[name]
        odd = effect.artefact in _ODD and not points
        on = block.enabled and (effect.stage == "points") == points and not drawn["quiet_share"]
        on &= device.coins[name] or not (drawn["fewer_share"] or odd)
        on &= bool(drawn["odd_share"]) or not odd
        changed[name] = replace(block, enabled=on)
    return with_blocks(noise, changed)
