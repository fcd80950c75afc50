"""What a training learns from, by its configuration: pairs, renders, recordings or old images."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from ...factory.common.distribution import number
from ...factory.common.errors import FactoryError
from ...factory.common.files import sha256_of
from ...factory.common.progress import RunReporter, print_warning
from ...factory.common.small_files import load_yaml
from ...factory.dataset.frame_ref import FrameRef
from ...factory.dataset.manifest import CONFIG_NAME
from ...factory.dataset.schema import config_hash
from ...factory.dataset.storage import local_folder
from ...factory.simulation.config.compose import compose_config
from ...factory.simulation.config.root import FactoryConfig, from_mapping, plain
from ...factory.simulation.config.selection import SplitWarning, choose_frames, split_frames
from ...factory.simulation.pairs.views import open_views
from ...factory.simulation.scenes import open_reader
from ..settings import DataSettings, MixedData, ModelsSettings, OldData, RenderedData, SequencesData
from .images import OldDataSource, digest_of, list_images, smallest_side
from .pairs import Data, ImageSource, SampleRef, TrainingPairs, hold_out, read_table, spread
from .radial import RadialSource
from .renders import DeviceSource, RenderSource, image_scales
from .sequences import open_sequences
from .time_stacks import MixedSource, open_stacks

_DECIDE = ("devices", "noise", "acoustics", "sonar", "water")
"""Groups of the configuration that decide the images of drawn devices."""


def open_data(settings: ModelsSettings) -> Data:
    """Find the images that the configuration means, and hold some out.

    Raises FactoryError: nothing there, another schema, images smaller than a patch, one frame only.
    """
    data = settings.data
    seed = settings.seed
    if isinstance(data, OldData):
        return _of_images(data, seed)
    folder = local_folder(_dataset_folder(settings))
    if isinstance(data, SequencesData):
        return open_sequences(folder, data, seed)
    table = read_table(folder, "train")
    if not isinstance(data, MixedData):
        least = 1.0
        if isinstance(data, RenderedData):
            least = min(scale.pixels for scale in image_scales(data))
        height, width = (round(least * side) for side in (table.height, table.width))
        _check_size(data, min(height, width), str(folder), f" ({height}x{width})")
    learning, held = hold_out(table.samples, data.validation, seed)
    facts: dict[str, Any] = {
        "dataset.config_hash": table.config_hash,
        "dataset.pairs": len(table.samples),
        "dataset.image": [table.height, table.width],
    }
    validation = TrainingPairs(spread(held, data.validation_limit), table.sonar)
    if not isinstance(data, RenderedData):
        source = TrainingPairs(learning, table.sonar, weaker=data.weaker, seed=seed)
        return Data(source, validation, facts)
    config, rendered, others = renders_of(data, folder, learning, held)
    names = "\n".join(ref.name for ref in rendered)
    facts |= {
        "renders.frames": len(rendered),
        "renders.names": hashlib.blake2b(names.encode(), digest_size=8).hexdigest(),
    }
    points = RenderSource(config, rendered, data, seed)
    if not isinstance(data, MixedData):
        return Data(points, validation, facts)
    mixed = _mixed(data, points, others, seed)
    return Data(mixed.learning, mixed.validation, facts | mixed.facts, mixed.recordings)


def _dataset_folder(settings: ModelsSettings) -> str:
    """The dataset that is named, or that `data.make` makes (or finds made already).

    Trainings with the same words share it.
    """
    data = settings.data
    if settings.dataset["dir"] is not None:
        return settings.dataset["dir"]
    if not isinstance(data, RenderedData) or not data.make:
        raise FactoryError(
            f"dataset: data={data.kind} needs the folder that `simnfnd make` made, dataset=DIR"
        )
    # Loads the scheduler, which a dataset that exists does without.
    from ...factory.production.cli.generate import run

    folder = _folder_of_renders(data)
    words = (*data.make, f"dataset.dir={folder}")
    run(compose_config(words), words, RunReporter(warning=_warn_but_of_splits))
    return folder


def _folder_of_renders(data: RenderedData) -> str:
    """Where the dataset lies that `data.make` makes."""
    digest = hashlib.blake2b("\n".join(data.make).encode(), digest_size=4).hexdigest()
    return f"outputs/renders-{digest}"


def _warn_but_of_splits(text: str) -> None:
    """Training holds out frames itself: that the dataset has no test frames is as it should be."""
    if not isinstance(text, SplitWarning):
        print_warning(text)


def _of_images(data: OldData, seed: int) -> Data:
    images = list_images(data.folder)
    side, smallest = smallest_side(images)
    _check_size(data, side, str(smallest.path))
    learning, held = hold_out(images, data.validation, seed)
    facts: dict[str, Any] = {"images": len(images), "images.content": digest_of(images)}
    if data.geometry != "polar":
        facts["geometry"] = sha256_of(Path(data.geometry).expanduser())[:16]
    noise = compose_config(("noise=simnfnd",)).noise
    sources = [
        OldDataSource(samples, data, noise, seed)
        for samples in (learning, spread(held, data.validation_limit))
    ]
    return Data(sources[0], sources[1], facts, tuple({ref.path for ref in learning}))


def renders_of(
    data: RenderedData, dataset: Path, learning: Sequence[SampleRef], held: Sequence[SampleRef]
) -> Renders:
    """Find the renders of a dataset and print their number.

    learning, held: the dataset's pairs.
    Raises FactoryError when the dataset was made by another version or its renders are not there.
    """
    config = _config(data, dataset)
    refs = open_reader(config.scenes).discover().frames
    training = split_frames(refs if data.pack else choose_frames(refs, config), config)["train"]
    scenes = {sample.scene for sample in held}
    # Where there is one scene alone, frames are held out one by one.
    alone = scenes == {sample.scene for sample in learning}
    names = {(sample.scene, sample.frame if alone else "") for sample in held}
    training = tuple(
        ref
        for ref in training
        if (f"{ref.location}/{ref.scene}", ref.frame if alone else "") not in names
    )
    views = open_views(config)
    rendered = tuple(ref for ref in training if views.holds(ref))
    if not rendered:
        remedy = "make the dataset again with this version in a fresh folder"
        if data.make and dataset == Path(_folder_of_renders(data)):
            remedy = f"delete {dataset} and give the same command again, which makes it anew"
        raise FactoryError(
            f"data={data.kind}: none of the {len(training)} training frames of {dataset} has its "
            f"render in {config.cache.folder}; the folder is of another version, or the cache "
            f"was cleared: {remedy}, or give data.pack=FILE"
        )
    missing = len(training) - len(rendered)
    print(f"renders: {len(rendered)} frames" + (f", {missing} not rendered" if missing else ""))
    learned = set(training)
    others = tuple(ref for ref in refs if ref not in learned and views.holds(ref))
    return Renders(config, rendered, others)


class Renders(NamedTuple):
    """Rendered frames of a dataset.

    config: that made it.  learning: to learn from.  others: which nothing is learned from.
    """

    config: FactoryConfig
    learning: tuple[FrameRef, ...]
    others: tuple[FrameRef, ...]


def _mixed(data: MixedData, points: RenderSource, others: tuple[FrameRef, ...], seed: int) -> Data:
    """The mixed source of renders and recordings.

    others: frames with a render that nothing is learned from.
    """
    drawn = compose_config((f"experiment={data.experiment}",))
    if not others or drawn.devices is None:
        raise FactoryError(
            f"data.experiment={data.experiment}: draws no devices, or no render is held out; use "
            "any_sonar, and give data.validation more"
        )
    device_settings = {name: getattr(drawn, name) for name in _DECIDE}
    device_settings["sonar"] = replace(drawn.sonar, mount=points.config.sonar.mount)
    config = replace(points.config, **device_settings)
    # An image without noise has 100 dB, more than all others together can gain or lose.
    noisy = replace(config, devices=replace(drawn.devices, quiet_share=number(0)))
    if data.radial and config.noise.spokes is not None:
        # Spokes are drawn into the images, where it is known how strong they are.
        spokes = replace(config.noise.spokes, enabled=False)
        config = replace(config, noise=replace(config.noise, spokes=spokes))
    stacks = open_stacks(data.recordings, data.least_side)
    refs = tuple(ref for path in data.recordings for ref in list_images(path, "data.recordings"))
    print(f"recordings: {len(stacks)} static ones")
    devices = DeviceSource(config, points.images, data, seed)
    shown = spread(others, data.validation_limit)
    validation: ImageSource = DeviceSource(noisy, shown, replace(data, weaker=0.0), seed)
    if data.radial:
        validation = RadialSource(validation, seed)
    return Data(
        MixedSource(devices, points, stacks, data, seed),
        validation,
        {
            "renders.devices": config_hash({name: plain(config)[name] for name in _DECIDE}),
            "data.recordings": digest_of(refs),
        },
        tuple({ref.path for ref in refs}),
    )


def _config(data: RenderedData, dataset: Path) -> FactoryConfig:
    """The dataset's own configuration with what `data` changes."""
    path = dataset / CONFIG_NAME
    try:
        values = load_yaml(path)
        # What stands beside the pairs is of no use here, and may need more than the renders.
        values["dataset"]["layers"] = []
        if data.pack is not None:
            values["scenes"] = {"kind": "pack", "root": data.pack}
        return from_mapping(values)
    except (OSError, ValueError, TypeError, KeyError, FactoryError) as error:
        raise FactoryError(
            f"{path}: data={data.kind} needs the whole folder that `simnfnd make` of this version "
            f"wrote ({error})"
        ) from error


def _check_size(data: DataSettings, side: int, place: str, shape: str = "") -> None:
    """Raise FactoryError when an image is smaller than a patch."""
    if data.least_side > side:
        raise FactoryError(
            f"data.patch={data.patch} is larger than the images of {place}{shape}; choose at most "
            f"{side}, or data.batch=data.crops: each step then shows one image, a small one whole"
        )
