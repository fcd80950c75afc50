"""README.md of an export: what its files are, and what the numbers in them mean."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...common.array_types import Float64s
from ...dataset.card import source_terms, stated_licence
from ...dataset.folder import dataset_settings
from ...dataset.meaning import classes_of, grey_meaning, pixel_meaning
from ...dataset.pair_dataset import PairDataset
from ...dataset.schema import CORE
from ...dataset.schema import layers as known_layers
from ..cli import markdown
from .samples import flat_name

_WINDOW_COLUMNS = ("range_min_m", "range_max_m", "metres_per_pixel")


class Description(NamedTuple):
    """What a layer or a column of the sample table holds."""

    name: str
    units: str
    text: str


def describe_fields(
    pairs: PairDataset, layers: Collection[str] | None = None, *, has_records: bool = True
) -> list[Description]:
    """The descriptions of layers, then of all columns of the sample table.

    layers: those of an export, as the schema names them; None: all of the dataset.
    has_records: whether the export holds the sample table.
    """
    dtype = str(pairs.form.layers["noisy"])
    optional_layers = set(pairs.form.layers) - set(CORE)
    descriptions = [
        Description(flat_name(layer.name), layer.units, layer.description)
        for layer in known_layers(dtype, optional_layers)
        if layers is None or layer.name in layers
    ]
    if has_records:
        descriptions += [
            Description(column.name, column.units, column.description)
            for column in pairs.form.columns
        ]
    return descriptions


def write_notes(
    pairs: PairDataset,
    folder: Path,
    reading: str,
    *,
    front: str = "",
    layers: Collection[str] | None = None,
    has_records: bool = True,
) -> None:
    """Write README.md; `reading` says in Markdown what the files are, `front` comes before all.

    layers, has_records: what the export holds, as `describe_fields` takes them.
    """
    settings = dataset_settings(pairs.folder)
    descriptions = describe_fields(pairs, layers, has_records=has_records)
    counts = "".join(f"- {split}: {count} samples\n" for split, count in pairs.splits.items())
    rows, columns = pairs.shape
    text = f"""\
{front}# {settings.get("name") or "dataset"}

Simulated forward-looking-sonar images, exported from a SimNFND dataset (config hash \
`{pairs.config_hash}`). {rows} x {columns} pixels, {pairs.layout} layout.

{counts}
## What the files are

{reading}
## What the numbers mean

- **Grey values.** {_grey_values(pairs, has_records)}
- **Pixels.** {_pixels(pairs, has_records)}
{_classes(pairs, descriptions)}
{_description_table(descriptions)}
## Licence

{stated_licence(settings.get("licence"), pairs.form.config) or "not stated"}. \
{source_terms(pairs.form.config)}
"""
    (folder / "README.md").write_text(text, encoding="utf-8")


def _grey_values(pairs: PairDataset, has_records: bool) -> str:
    place = "the record of each sample" if has_records else "/meta of the dataset, not here"
    meaning = grey_meaning(pairs.form.config, str(pairs.dtype), scale_place=place)
    return f"As the dataset stores them ({pairs.dtype}): {meaning}"


def _pixels(pairs: PairDataset, has_records: bool) -> str:
    """How pixels turn into metres, with the range window where an export has no record of it."""
    meaning = pixel_meaning(
        pairs.layout, pairs.shape[1], bearings=_describe_bearings(pairs.axes[1].values)
    )
    if has_records:
        return f"{meaning} These names are in the record of each sample."
    table = pairs.meta()
    known_names = [name for name in _WINDOW_COLUMNS if name in (table.dtype.names or ())]
    distinct_values = {name: np.unique(table[name]) for name in known_names}
    if any(len(values) != 1 for values in distinct_values.values()):
        return f"{meaning} These values differ from image to image; `--to png` has them."
    values = ", ".join(f"{name} = {values[0]:.6g}" for name, values in distinct_values.items())
    return f"{meaning} Of all images: {values}."


def _classes(pairs: PairDataset, descriptions: list[Description]) -> str:
    """A line on the values of the layer segmentation, where an export holds it."""
    if all(description.name != "segmentation" for description in descriptions):
        return ""
    return f"- **Classes.** Of segmentation: {describe_labels(pairs)}\n"


def _describe_bearings(bearings_deg: Float64s) -> str:
    """The bearings of the columns of a polar image."""
    steps_deg = np.diff(bearings_deg)
    if len(steps_deg) and np.allclose(steps_deg, steps_deg[0], atol=1e-4):
        return f"{bearings_deg[0]:.5g} + {steps_deg[0]:.5g} * column degrees"
    listed = ", ".join(f"{bearing_deg:.5g}" for bearing_deg in bearings_deg)
    return f"in degrees, column by column: {listed}"


def describe_labels(pairs: PairDataset) -> str:
    """The numbers of the classes in /segmentation and their names; empty without labels."""
    if "segmentation" not in pairs.form.layers:
        return ""
    names = classes_of(pairs.form.config)
    return ", ".join(f"{label} {name}" for label, name in enumerate(names)) + "."


def _description_table(descriptions: list[Description]) -> str:
    """A Markdown table of units and descriptions; empty without any."""
    if not descriptions:
        return ""
    rows = [
        [description.name, description.units, description.text.replace("|", "\\|")]
        for description in descriptions
    ]
    return markdown(["name", "unit", "what it is"], rows)
