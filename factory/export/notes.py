"""README.md of an export: what its files are, and what the numbers in them mean."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from ..cli import markdown
from ..dataset.card import source_terms, stated_licence
from ..dataset.folder import dataset_settings
from ..dataset.meaning import grey_meaning, pixel_meaning
from ..dataset.pair_dataset import PairDataset
from ..dataset.schema import CORE
from ..dataset.schema import layers as known_layers
from .samples import flat_name


class Description(NamedTuple):
    """What a layer or a column of the sample table holds."""

    name: str
    units: str
    text: str


def describe_fields(pairs: PairDataset) -> list[Description]:
    """The descriptions of all layers, then of all columns of the sample table."""
    dtype = str(pairs.form.layers["noisy"])
    optional_layers = set(pairs.form.layers) - set(CORE)
    descriptions = [
        Description(flat_name(layer.name), layer.units, layer.description)
        for layer in known_layers(dtype, optional_layers)
    ]
    descriptions += [
        Description(column.name, column.units, column.description) for column in pairs.form.columns
    ]
    return descriptions


def write_notes(pairs: PairDataset, folder: Path, reading: str, *, front: str = "") -> None:
    """Write README.md; `reading` says in Markdown what the files are, `front` comes before all."""
    settings = dataset_settings(pairs.folder)
    counts = "".join(f"- {split}: {count} samples\n" for split, count in pairs.splits.items())
    rows, columns = pairs.shape
    text = f"""\
{front}# {settings.get("name") or "dataset"}

Pairs of simulated forward-looking-sonar images, exported from a SimNFND dataset (config hash \
`{pairs.config_hash}`). {rows} x {columns} pixels, {pairs.dtype}, {pairs.layout} layout.

{counts}
## What the files are

{reading}
## What the numbers mean

- **Grey values.** Of noisy and clean as the dataset stores them: \
{grey_meaning(pairs.form.config, str(pairs.dtype))}
- **Pixels.** {pixel_meaning(pairs.layout, columns)} These names are in the record of each sample.

{_description_table(pairs)}
## Licence

{stated_licence(settings.get("licence"), pairs.form.config) or "not stated"}. \
{source_terms(pairs.form.config)}
"""
    (folder / "README.md").write_text(text, encoding="utf-8")


def _description_table(pairs: PairDataset) -> str:
    """A Markdown table of the units and descriptions of all layers and columns."""
    rows = [
        [description.name, description.units, description.text.replace("|", "\\|")]
        for description in describe_fields(pairs)
    ]
    return markdown(["name", "unit", "what it is"], rows)
