"""From the `data` group to what is learned from and what is validated on."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...factory.errors import FactoryError
from ...factory.files import sha256_of
from ...factory.storage.copies import local_folder
from ..recordings.arrays import file_of
from ..settings import (
    DataSettings,
    ModelsSettings,
    OldData,
    PairsData,
    RendersData,
)
from .images import list_images, smallest_side
from .pairs import PairSource, SampleRef, Source, hold_out, read_table, spread

_SMALLEST = 11
"""Side of the window of SSIM, pixels."""


@dataclass(frozen=True)
class Data:
    """learning, validation: images.  labels: what each validation image shows.

    facts: what decides the weights beside the settings.
    """

    learning: Source
    validation: Source
    labels: tuple[str, ...]
    facts: dict[str, Any]


def open_data(settings: ModelsSettings) -> Data:
    """Find the images that the configuration means, and hold some out.

    Raises FactoryError: nothing there, another schema, images smaller than a patch, one frame only.
    """
    data = settings.data
    if isinstance(data, PairsData | RendersData):
        return _of_dataset(data, settings)
    assert isinstance(data, OldData)
    found = list_images(data.folder)
    side, smallest = smallest_side(found)
    _check_sizes(data, side, str(smallest.path))
    learning, held = hold_out(found, data.validation, settings.seed)
    held = spread(held, data.validation_limit)
    labels = tuple(sample.frame for sample in held)
    facts: dict[str, Any] = {"images": len(found), "images.content": _digest(found)}
    from .olddata import OldDataSource
    from .renders import composed

    noise = composed(data.factory).noise
    if data.geometry != "polar":
        facts["geometry"] = sha256_of(Path(data.geometry).expanduser())[:16]
    sources = [
        OldDataSource(
            samples,
            data.geometry,
            noise,
            looks=data.looks,
            weaker=data.weaker,
            seed=settings.seed,
        )
        for samples in (learning, held)
    ]
    return Data(sources[0], sources[1], labels, facts)


def _of_dataset(data: PairsData | RendersData, settings: ModelsSettings) -> Data:
    folder = settings.dataset.dir
    if folder is None:
        raise FactoryError(
            f"dataset: data={data.kind} needs the folder that `simnfnd make` made, dataset=DIR"
        )
    folder = str(local_folder(folder))
    table = read_table(folder, "train")
    if not (isinstance(data, RendersData) and data.experiment is not None):
        least = data.least_scale if isinstance(data, RendersData) else 1.0
        height, width = (round(least * side) for side in (table.height, table.width))
        _check_sizes(data, min(height, width), folder, f"{height}x{width}")
    learning, held = hold_out(table.samples, data.validation, settings.seed)
    shown = spread(held, data.validation_limit)
    facts: dict[str, Any] = {
        "dataset.config_hash": table.config_hash,
        "dataset.pairs": len(table.samples),
        "dataset.image": [table.height, table.width],
    }
    validation = PairSource(shown, table.sonar)
    labels = tuple(f"{sample.scene} {sample.frame}" for sample in shown)
    if not isinstance(data, RendersData):
        source: Source = PairSource(learning, table.sonar, weaker=data.weaker, seed=settings.seed)
    else:
        # Only here: it brings the readers and the whole of the factory.
        from .renders import open_renders

        renders = open_renders(data, table, held, folder, settings.seed)
        facts |= renders.facts
        print(renders.said)
        source = renders.source
        if renders.validation is not None:
            return Data(source, renders.validation, renders.labels, facts)
    return Data(source, validation, labels, facts)


def _digest(samples: tuple[SampleRef, ...]) -> str:
    """Changes with the names and the content of image files, not with where they lie."""
    paths = {sample.path for sample in samples}
    hashes = {path: sha256_of(file_of(path)) for path in paths}
    found = [(sample.scene, sample.frame, hashes[sample.path]) for sample in samples]
    return hashlib.blake2b(repr(found).encode(), digest_size=8).hexdigest()


def _check_sizes(data: DataSettings, side: int, where: str, shape: str = "") -> None:
    """Raise FactoryError when an image is smaller than a patch, or than what SSIM needs."""
    patch = data.least_side
    if patch > side:
        shown = f" ({shape})" if shape else ""
        raise FactoryError(
            f"data.patch={patch} is larger than the images of {where}{shown}; choose at most "
            f"{side}, or data.batch=data.crops: each step then shows one image, a small one whole"
        )
    if side < _SMALLEST:
        raise FactoryError(f"{where}: images of {side} pixels are too small to validate on")
