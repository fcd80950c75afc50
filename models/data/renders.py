"""`data=renders` and `data=mixed`: fresh noise, or drawn devices, on clean renders at every visit.

The renders are those of a dataset, in the cache or in a pack; pairs are made of them by the same
code as the dataset's own, so a network never sees the same noise twice.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...factory.config import FactoryConfig, from_mapping, plain
from ...factory.dataset.manifest import CONFIG_NAME
from ...factory.dataset.pair_dataset import in_unit_range
from ...factory.dataset.schema import config_hash
from ...factory.distribution import Distribution, number
from ...factory.errors import FactoryError, FrameError
from ...factory.frame import FrameRef
from ...factory.noise.draws import StreamNames, draw
from ...factory.noise.registry import NoiseSettings
from ...factory.pairs import PairMaker, observe_by
from ...factory.scenes import open_reader
from ...factory.seeds import stream
from ...factory.selection import choose_frames, split_frames
from ...factory.sonar.fan import rasterised
from ...factory.sonar.geometry import FanGeometry
from ...factory.sonar.settings import SonarSettings
from ...factory.sonar_randomization import draw as devices
from ...factory.views import Views, open_views
from ..networks import DEFAULT
from ..settings import MixedData, RendersData
from .images import digest_of, list_images
from .pairs import Data, PairTable, Sample, SampleRef, Source, spread, weakened

_DECIDE = ("devices", "noise", "acoustics", "sonar", "water")
"""Groups of the configuration that decide the pictures of drawn devices."""
_ATTEMPTS = 40
_LEAST_ECHOES = 0.02
"""Part of the bins that must hold surface: a picture of nothing teaches nothing."""
_BLACK = 0.02
"""Shadow counts as such where the target is darker; under haze there is none to see."""
_AMOUNTS = ("alpha", "density", "strength")
"""Parameters that are 0 where an effect is absent: these a weaker noise scales."""


class RenderSource:
    """Pairs made on the fly; a `simnfnd.models.data.pairs.Source`."""

    def __init__(
        self,
        config: FactoryConfig,
        frames: tuple[FrameRef, ...],
        *,
        weaker: float,
        fewer: float,
        seed: int,
        scales: tuple[float, ...],
    ) -> None:
        """config: how pairs are made.  frames: whose renders are at hand.  See `RendersData`.

        Raises FactoryError as `resized` does.
        """
        self.config, self.frames = replace(config, seed=seed), frames
        self.weaker, self.fewer, self.seed, self.scales = weaker, fewer, seed, scales
        self._sonars = {scale: resized(config.sonar, scale) for scale in (1.0, *scales)}
        self._makers: dict[float, PairMaker] = {}

    def __len__(self) -> int:
        return len(self.frames)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_makers": {}}

    def sample(self, index: int, visit: int | None) -> Sample:
        """See `Source`."""
        scale: float = 1.0 if visit is None else self.scale_of(index, visit)
        if scale not in self._makers:
            config = replace(self.config, sonar=self._sonars[scale])
            self._makers[scale] = PairMaker(config, open_views(config))
        ref = self.frames[index]
        number = 0 if visit is None else visit
        noise = None if visit is None else self.noise_of(index, visit)
        try:
            (pair,) = self._makers[scale].pairs(ref, (number,), noise)
        except FrameError as error:
            raise FactoryError(f"data=renders: {error}; leave the frame out") from error
        return Sample(
            in_unit_range(pair.noisy),
            in_unit_range(pair.clean),
            pair.shadow.astype(np.float32),
            FanGeometry.from_record(self._sonars[scale], pair.record),
        )

    def scale_of(self, index: int, visit: int) -> float:
        """Size of the picture of a visit, as multiples of the dataset's: any of `scales`."""
        return self.scales[stream(self.seed, "scale", index, visit).integers(len(self.scales))]

    def noise_of(self, index: int, visit: int) -> NoiseSettings:
        """The noise of a visit: as configured, or with less of all effects, or some effects off.

        An effect that has no amount to make less of is left out in as many visits instead.
        """
        chosen = self.config.noise
        factor = weakened(self.weaker, self.seed, index, visit)
        rng = stream(self.seed, "fewer", index, visit)
        fewer = rng.random() < self.fewer
        blocks = {}
        for item in fields(chosen):
            block, coins = getattr(chosen, item.name), rng.random(2)
            if block is None:
                continue
            weaker = scaled(block, factor) if factor < 1 else block
            off = (fewer and coins[0] < 0.5) or factor == 0
            off |= factor < 1 and weaker == block and coins[1] >= factor
            blocks[item.name] = replace(weaker, enabled=block.enabled and not off)
        return replace(chosen, **blocks)


class DeviceSource:
    """Pairs of drawn devices; a `Source`.

    Device, formation, display, size and rasterisation of the picture are drawn at each visit.  The
    target is the same picture without the artefacts of `networks.DEFAULT`, under the same random
    streams.
    """

    def __init__(
        self,
        config: FactoryConfig,
        frames: tuple[FrameRef, ...],
        *,
        patch: int,
        weaker: float,
        seed: int,
    ) -> None:
        """config: with `devices`.  frames: whose renders are at hand.  patch: least side, pixels.

        weaker: part of the visits whose noise is blended towards the target.
        """
        self.config, self.frames, self.patch = replace(config, seed=seed), frames, patch
        self.weaker, self.seed = weaker, seed
        self._views: Views | None = None

    def __len__(self) -> int:
        return len(self.frames)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_views": None}

    def sample(self, index: int, visit: int | None) -> Sample:
        """See `Source`."""
        names = (index, "validation" if visit is None else visit)
        for attempt in range(_ATTEMPTS):
            # A frame that shows nothing to this device gives way to the next one.
            ref = self.frames[(index + attempt // 4) % len(self.frames)]
            try:
                found = self._sample(ref, *names, attempt)
            except FrameError:
                continue
            if found is not None:
                return found
        raise FactoryError(
            f"data=renders: no device sees enough of {self.frames[index].name} and of the frames "
            "after it; make renders of other places"
        )

    def _sample(self, ref: FrameRef, *names: int | str) -> Sample | None:
        assert self.config.devices is not None
        if self._views is None:
            self._views = open_views(self.config)
        device = devices.draw(self.config.devices, self.seed, ref.name, *names)
        view = self._views.view(ref)
        observed, config = observe_by(
            device, view.frame(ref), view.rendered(), self.config, any_size=True
        )
        if observed.scene.filled.mean() < _LEAST_ECHOES or min(config.sonar.shape()) < self.patch:
            return None
        draws = draw(config.noise, self.seed, StreamNames.single(ref.name, *names))
        # Points are thinned by a variant's stream: any number that no other picture has.
        variant = int(stream(self.seed, "variant", *names).integers(2**31))
        sample = observed.scene.sample(variant, draws.effects)
        noisy, clean = (
            rasterised(grey, observed.window, config.sonar, noisy=noisy)
            for grey, noisy in (
                (sample.noisy(draws.names), True),
                (sample.without(DEFAULT), False),
            )
        )
        strength = np.float32(weakened(self.weaker, self.seed, *names))
        return Sample(
            clean + strength * (noisy - clean),
            clean,
            (observed.shadow & (clean <= _BLACK)).astype(np.float32),
            FanGeometry.from_sonar(
                config.sonar,
                observed.window.range_min_m,
                observed.window.range_max_m,
                observed.window.azimuth_min_rad,
                observed.window.azimuth_max_rad,
            ),
        )


def scaled(block: Any, factor: float) -> Any:
    """An effect's settings with `alpha`, `density` and `strength` times `factor`."""
    changes = {}
    for item in fields(block):
        value = getattr(block, item.name)
        if item.name in _AMOUNTS and isinstance(value, Distribution):
            values = tuple(number * factor for number in value.values)
            changes[item.name] = replace(value, values=values)
    return replace(block, **changes)


def resized(sonar: SonarSettings, scale: float) -> SonarSettings:
    """The same device with `scale` times as many beams, range bins and pixels.

    Its point spread stays as many bins and beams wide, so with more of them it resolves more.
    Raises FactoryError when that is too many, and where there is a table of beams, which says
    nothing of beams between.
    """
    if scale == 1:
        return sonar
    image = sonar.image
    beams, range_bins, width_px, height_px = (
        round(scale * size)
        for size in (sonar.beams, sonar.range_bins, image.width_px, image.height_px)
    )
    try:
        image = replace(image, width_px=width_px, height_px=height_px)
        return replace(sonar, beams=beams, range_bins=range_bins, image=image)
    except ValueError as error:
        raise FactoryError(
            f"data.scales: {scale:g} makes {beams} beams, {range_bins} range bins and "
            f"{width_px}x{height_px} pixels; 2 to 8192 of each are possible, and of a sonar with a "
            "table of beams only its own"
        ) from error


def open_renders(
    data: RendersData,
    table: PairTable,
    held: tuple[SampleRef, ...],
    validation: Source,
    dataset: str,
    seed: int,
) -> Data:
    """The renders of a dataset as training data; says how many there are.

    table: the dataset's train split.  held: its pairs that are held out.  validation: these as
    images, which are measured on but for drawn devices.
    Raises FactoryError when the dataset was made by another version or its renders are not there.
    """
    config = _config(data, dataset)
    found = open_reader(config.scenes).discover().frames
    if data.pack is None:
        found = choose_frames(found, config)
    training = split_frames(found, config)["train"]
    scenes = {sample.scene for sample in held}
    # Of one scene alone frames are held out one by one.
    alone = {sample.scene for sample in table.samples} == scenes
    names = {(sample.scene, sample.frame if alone else "") for sample in held}
    training = tuple(
        ref
        for ref in training
        if (f"{ref.location}/{ref.scene}", ref.frame if alone else "") not in names
    )
    views = open_views(config)
    ready = tuple(ref for ref in training if views.holds(ref))
    if not ready:
        raise FactoryError(
            f"data=renders: none of the {len(training)} training frames of {dataset} has its "
            f"render in {config.cache.folder}; make the dataset again with this version (its "
            "command keeps the renders), or give data.pack=FILE"
        )
    missing = len(training) - len(ready)
    print(f"renders: {len(ready)} frames" + (f", {missing} not rendered" if missing else ""))
    names_ = "\n".join(ref.name for ref in ready)
    facts: dict[str, Any] = {
        "renders.frames": len(ready),
        "renders.names": hashlib.blake2b(names_.encode(), digest_size=8).hexdigest(),
    }
    points = RenderSource(
        config, ready, weaker=data.weaker, fewer=data.fewer, scales=data.scales, seed=seed
    )
    if data.experiment is None:
        return Data(points, validation, facts)
    learned = set(training)
    shown = tuple(ref for ref in found if ref not in learned and views.holds(ref))
    drawn = _by_any_device(data, config, ready, shown, facts, seed)
    return _mixed(data, drawn, points, seed) if isinstance(data, MixedData) else drawn


def _mixed(data: MixedData, drawn: Data, points: Source, seed: int) -> Data:
    from .time_stacks import MixedSource, open_stacks

    stacks = open_stacks(data.recordings, data.least_side)
    refs = tuple(ref for path in data.recordings for ref in list_images(path, "data.recordings"))
    source = MixedSource(
        drawn.learning,
        points,
        stacks,
        points_share=data.points_share,
        recordings_share=data.recordings_share,
        several=data.several,
        seed=seed,
    )
    still = sum(one.is_still for one in stacks)
    print(f"recordings: {len(stacks)}, of which {still} stand still")
    return Data(source, drawn.validation, {**drawn.facts, "data.recordings": digest_of(refs)})


def _by_any_device(
    data: RendersData,
    config: FactoryConfig,
    ready: tuple[FrameRef, ...],
    held: tuple[FrameRef, ...],
    facts: dict[str, Any],
    seed: int,
) -> Data:
    drawn = composed((f"experiment={data.experiment}",))
    if not held or drawn.devices is None:
        raise FactoryError(
            f"data.experiment={data.experiment}: draws no devices, or no render is held out; use "
            "any_sonar, and give data.validation more"
        )
    config = replace(
        config,
        devices=drawn.devices,
        noise=drawn.noise,
        acoustics=drawn.acoustics,
        sonar=replace(drawn.sonar, mount=config.sonar.mount),
        water=drawn.water,
    )
    drawn_as = config_hash({name: plain(config)[name] for name in _DECIDE})
    shown = spread(held, data.validation_limit)
    # A picture without noise has 100 dB, more than all others together can gain or lose.
    noisy = replace(config, devices=replace(drawn.devices, quiet_share=number(0)))
    common: dict[str, Any] = {"patch": data.least_side, "seed": seed}
    return Data(
        DeviceSource(config, ready, weaker=data.weaker, **common),
        DeviceSource(noisy, shown, weaker=0.0, **common),
        {**facts, "renders.devices": drawn_as},
    )


def composed(words: Sequence[str]) -> FactoryConfig:
    """The configuration of `simnfnd make` with these words.  Raises FactoryError for a bad one."""
    from hydra.core.global_hydra import GlobalHydra

    from ...factory.cli.compose import compose_config

    # Hydra composes one configuration at a time, and that of this training is the one at present.
    state = GlobalHydra.get_state()
    GlobalHydra.instance().clear()
    try:
        return compose_config(words)
    finally:
        GlobalHydra.set_state(state)


def _config(data: RendersData, dataset: str) -> FactoryConfig:
    """The dataset's own configuration with what `data` changes."""
    path = Path(dataset) / CONFIG_NAME
    try:
        values = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise FactoryError(
            f"{path}: cannot be read; data=renders needs the whole folder that `simnfnd make` wrote"
        ) from error
    # What stands beside the pairs is of no use here, and may need more than the renders.
    if isinstance(values, dict) and isinstance(values.get("dataset"), dict):
        values["dataset"]["layers"] = []
    if data.pack is not None:
        values["scenes"] = {"kind": "pack", "root": data.pack}
    try:
        return from_mapping(values)
    except FactoryError as error:
        raise FactoryError(
            f"dataset={dataset}: data=renders needs a dataset of this version: {error}"
        ) from error
