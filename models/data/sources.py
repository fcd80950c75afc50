"""What a training learns from, by its configuration: pairs, renders, recordings or old images."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ...factory.errors import FactoryError
from ...factory.files import sha256_of
from ...factory.storage.copies import local_folder
from ..settings import DataSettings, ModelsSettings, OldData, RendersData
from .images import OldDataSource, digest_of, list_images, smallest_side
from .pairs import Data, PairSource, hold_out, read_table, spread
from .renders import composed, open_renders

_SMALLEST = 11
"""Side of the window of SSIM, pixels."""


def open_data(settings: ModelsSettings) -> Data:
    """Find the images that the configuration means, and hold some out.

    Raises FactoryError: nothing there, another schema, images smaller than a patch, one frame only.
    """
    data = settings.data
    return _of_images(data, settings) if isinstance(data, OldData) else _of_dataset(data, settings)


def _of_images(data: OldData, settings: ModelsSettings) -> Data:

    found = list_images(data.folder)
    side, smallest = smallest_side(found)
    _check_sizes(data, side, str(smallest.path))
    learning, held = hold_out(found, data.validation, settings.seed)
    facts: dict[str, Any] = {"images": len(found), "images.content": digest_of(found)}
    if data.geometry != "polar":
        facts["geometry"] = sha256_of(Path(data.geometry).expanduser())[:16]
    noise = composed(("noise=simnfnd",)).noise
    sources = [
        OldDataSource(samples, data.geometry, noise, weaker=data.weaker, seed=settings.seed)
        for samples in (learning, spread(held, data.validation_limit))
    ]
    return Data(sources[0], sources[1], facts)


def _of_dataset(data: DataSettings, settings: ModelsSettings) -> Data:
    folder = settings.dataset.dir
    if folder is None:
        raise FactoryError(
            f"dataset: data={data.kind} needs the folder that `simnfnd make` made, dataset=DIR"
        )
    folder = str(local_folder(folder))
    table = read_table(folder, "train")
    if not (isinstance(data, RendersData) and data.experiment is not None):
        least = min(data.scales) if isinstance(data, RendersData) else 1.0
        height, width = (round(least * side) for side in (table.height, table.width))
        _check_sizes(data, min(height, width), folder, f" ({height}x{width})")
    learning, held = hold_out(table.samples, data.validation, settings.seed)
    facts: dict[str, Any] = {
        "dataset.config_hash": table.config_hash,
        "dataset.pairs": len(table.samples),
        "dataset.image": [table.height, table.width],
    }
    validation = PairSource(spread(held, data.validation_limit), table.sonar)
    if not isinstance(data, RendersData):
        source = PairSource(learning, table.sonar, weaker=data.weaker, seed=settings.seed)
        return Data(source, validation, facts)
    # Only here: it brings the readers and the whole of the factory.

    renders = open_renders(data, table, held, validation, folder, settings.seed)
    return Data(renders.learning, renders.validation, facts | renders.facts)


def _check_sizes(data: DataSettings, side: int, where: str, shape: str = "") -> None:
    """Raise FactoryError when an image is smaller than a patch, or than what SSIM needs."""
    if data.least_side > side:
        raise FactoryError(
            f"data.patch={data.patch} is larger than the images of {where}{shape}; choose at most "
            f"{side}, or data.batch=data.crops: each step then shows one image, a small one whole"
        )
    if side < _SMALLEST:
        raise FactoryError(f"{where}: images of {side} pixels are too small to validate on")
