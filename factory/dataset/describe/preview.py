"""preview.png: a contact sheet of a dataset, read back from its shards."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt

from ...errors import FactoryError
from ...files import write_atomically
from ..format.axes import image_axes
from ..format.manifest import MANIFEST_NAME, load_manifest
from ..format.schema import VALUE_RANGES
from ..read.image_stack import ImageStack
from ..read.reader import check_in_isolation, listed_shards, reading
from ..read.source import SampleName, manifest_source, read_image
from ..write.folder import PREVIEW_NAME
from .contact_sheet import Shown, draw

_PANELS = ("noisy", "clean", "shadow")


def preview(
    dataset_dir: Path | str,
    out: Path | str | None = None,
    pairs: int = 8,
    *,
    trusted: bool = False,
) -> Path:
    """Draw `pairs` samples, spread over the scenes, as noisy | clean | shadow; returns the path.

    out: the PNG to write; None is preview.png in the dataset's folder.
    trusted: leave out the check of the shards in another process; for datasets just made.
    Raises FactoryError when the folder holds no dataset, or one without samples.
    """
    directory = Path(dataset_dir)
    manifest = load_manifest(directory)
    if manifest is None:
        raise FactoryError(f"{directory}: no {MANIFEST_NAME}; give the folder of a dataset")
    if pairs < 1:
        raise FactoryError(f"pairs must be at least 1, got {pairs}")
    if manifest.shards and not trusted:
        check_in_isolation(listed_shards(directory, "all", manifest))
    chosen = spread(list(manifest_source(directory, manifest).names()), pairs)
    title = f"{manifest.samples('train')} train and {manifest.samples('test')} test pairs"
    shown = [_load(sample) for sample in chosen]
    buffer = io.BytesIO()
    draw(shown, title, f"config {manifest.config_hash[:8]}").save(buffer, "PNG", compress_level=1)
    path = directory / PREVIEW_NAME if out is None else Path(out)
    # Whoever asks for a preview alone has no key dataset.dir to change.
    write_atomically(path, buffer.getvalue(), key="dataset.dir" if trusted else "--out")
    return path


def spread(samples: Sequence[SampleName], count: int) -> list[SampleName]:
    """`count` samples (or all), as evenly over splits and scenes as they allow, in their order."""
    scenes: dict[tuple[str, str, str], list[int]] = {}
    for number, sample in enumerate(samples):
        scenes.setdefault((sample.split, sample.location, sample.scene), []).append(number)
    groups = list(scenes.values())
    if len(groups) > count:
        groups = [groups[(2 * k + 1) * len(groups) // (2 * count)] for k in range(count)]
    shares = [0] * len(groups)
    for _ in range(min(count, sum(map(len, groups)))):
        open_groups = [g for g, group in enumerate(groups) if shares[g] < len(group)]
        shares[min(open_groups, key=lambda g: shares[g])] += 1
    numbers = [
        group[(2 * k + 1) * len(group) // (2 * share)]
        for group, share in zip(groups, shares, strict=True)
        for k in range(share)
    ]
    return [samples[number] for number in sorted(numbers)]


def _load(name: SampleName) -> Shown:
    with reading(name.path) as file:
        images = {panel: read_image(ImageStack(file[panel]), panel, name.row) for panel in _PANELS}
        record = file["meta"][name.row]
        axes = [
            _metric(axis.name, axis.units, axis.values, record)
            for axis in image_axes(file["noisy"])
        ]
    (rows, row_label, row_units), (columns, column_label, column_units) = axes
    top, bottom = _edges(rows)
    left, right = _edges(columns)
    variant = f"variant {name.variant}"
    place = " / ".join(part for part in (name.location, name.scene, name.frame) if part)
    return Shown(
        f"{name.split}   {place}   {variant}",
        images,
        VALUE_RANGES[str(images["noisy"].dtype)][1],
        (f"{row_label} [{row_units}]", f"{column_label} [{column_units}]"),
        (left, right, bottom, top),
        row_units == column_units,
    )


def _metric(
    label: str, units: str, values: npt.NDArray[np.float64], record: np.void
) -> tuple[npt.NDArray[np.float64], str, str]:
    """An axis in metres where the sample's own scale is on record: (values, label, units)."""
    names = record.dtype.names or ()
    if units == "px" and {"metres_per_pixel", "range_max_m"} <= set(names):
        metres = values * float(record["metres_per_pixel"])
        return (float(record["range_max_m"]) - metres if label == "ahead" else metres), label, "m"
    if units == "1" and label == "range" and {"range_min_m", "range_max_m"} <= set(names):
        near, far = float(record["range_min_m"]), float(record["range_max_m"])
        return near + values * (far - near), label, "m"
    return values, label, units


def _edges(values: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Outer edges of the first and last pixel of an axis of pixel centres."""
    if len(values) < 2:
        return float(values[0]) - 0.5, float(values[0]) + 0.5
    first, last = values[1] - values[0], values[-1] - values[-2]
    return float(values[0] - first / 2), float(values[-1] + last / 2)
