"""preview.png: a contact sheet of a dataset, read back from its shards."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from simnfnd.factory.dataset.describe import palette
from simnfnd.factory.dataset.format.axes import image_axes
from simnfnd.factory.dataset.format.manifest import MANIFEST_NAME, load_manifest
from simnfnd.factory.dataset.format.schema import VALUE_RANGES
from simnfnd.factory.dataset.read.image_stack import ImageStack
from simnfnd.factory.dataset.read.overview import SampleName, read_overview
from simnfnd.factory.dataset.read.reader import check_in_isolation, listed_shards, reading
from simnfnd.factory.dataset.read.source import read_image
from simnfnd.factory.dataset.write.folder import PREVIEW_NAME
from simnfnd.factory.errors import FactoryError
from simnfnd.factory.files import write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PANELS = ("noisy", "clean", "shadow")
_PANEL_INCHES, _DPI = 2.35, 150


@dataclass(frozen=True, eq=False)
class _Shown:
    """One sample with what its panels need: images, and (label, extent) of both axes."""

    name: SampleName
    images: Mapping[str, npt.NDArray[np.generic]]
    full_scale: float
    labels: tuple[str, str]
    extent: tuple[float, float, float, float]
    same_units: bool


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
    chosen = spread(read_overview(directory, manifest).samples, pairs)
    title = f"{manifest.samples('train')} train and {manifest.samples('test')} test pairs"
    figure = _draw([_load(directory, sample) for sample in chosen], title, manifest.config_hash)
    buffer = io.BytesIO()
    # Without the library's version in it, equal pictures are equal files.
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": None})
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


def _load(directory: Path, name: SampleName) -> _Shown:
    with reading(directory / name.path) as file:
        images = {panel: read_image(ImageStack(file[panel]), panel, name.row) for panel in _PANELS}
        record = file["meta"][name.row]
        axes = [
            _metric(axis.name, axis.units, axis.values, record)
            for axis in image_axes(file["noisy"])
        ]
    (rows, row_label, row_units), (columns, column_label, column_units) = axes
    top, bottom = _edges(rows)
    left, right = _edges(columns)
    return _Shown(
        name,
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


def _draw(shown: Sequence[_Shown], title: str, config_hash: str) -> Figure:
    # A second to import, and only needed here.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    wide = 2 if len(shown) > 1 else 1
    tall = -(-len(shown) // wide)
    aspect = shown[0].images["noisy"].shape[0] / shown[0].images["noisy"].shape[1]
    panel_height = _PANEL_INCHES * min(max(aspect, 0.5), 1.6) if shown[0].same_units else 2.35
    size = (wide * 3 * _PANEL_INCHES + 0.9 * wide + 0.2, tall * (panel_height + 0.72) + 0.75)
    figure = Figure(figsize=size, facecolor=palette.BACKGROUND)
    FigureCanvasAgg(figure)
    inch_x, inch_y = 1 / size[0], 1 / size[1]
    figure.text(
        0.3 * inch_x,
        1 - 0.34 * inch_y,
        title,
        color=palette.TEXT,
        fontsize=13,
        weight="bold",
        va="center",
    )
    figure.text(
        1 - 0.3 * inch_x, 1 - 0.34 * inch_y, f"config {config_hash[:8]}", color=palette.FAINT,
        fontsize=9, ha="right", va="center", family="monospace",
    )  # fmt: skip
    for number, sample in enumerate(shown):
        row, column = divmod(number, wide)
        left = (0.75 + column * (3 * _PANEL_INCHES + 0.9)) * inch_x
        bottom = 1 - (0.75 + (row + 1) * (panel_height + 0.72) - 0.5) * inch_y
        for panel, name in enumerate(_PANELS):
            place = (
                left + panel * _PANEL_INCHES * inch_x,
                bottom,
                (_PANEL_INCHES - 0.08) * inch_x,
                panel_height * inch_y,
            )
            _draw_panel(figure.add_axes(place), sample, name, first=panel == 0)
        heading = " / ".join(
            part for part in (sample.name.location, sample.name.scene, sample.name.frame) if part
        )
        figure.text(
            left, bottom + (panel_height + 0.2) * inch_y,
            f"{sample.name.split}   {heading}   variant {sample.name.variant}",
            color=palette.TEXT, fontsize=9, va="bottom",
        )  # fmt: skip
    return figure


def _draw_panel(axes: Axes, sample: _Shown, name: str, *, first: bool) -> None:
    colours = palette.SHADOW if name == "shadow" else palette.ECHO
    style: dict[str, Any] = {"color": palette.FAINT, "fontsize": 7.5}
    axes.imshow(
        sample.images[name],
        cmap=palette.colour_map(colours),
        vmin=0,
        vmax=1 if name == "shadow" else sample.full_scale,
        extent=sample.extent,
        aspect="equal" if sample.same_units else "auto",
        interpolation="antialiased",
    )
    axes.set_facecolor("black")
    axes.set_title(name, color=palette.FAINT, fontsize=8, pad=2.5, loc="left")
    axes.tick_params(colors=palette.FAINT, labelsize=6.5, length=2, width=0.5, pad=1.5)
    axes.set_xlabel(sample.labels[1], labelpad=1, **style)
    if first:
        axes.set_ylabel(sample.labels[0], labelpad=2, **style)
    else:
        axes.tick_params(labelleft=False, left=False)
    for spine in axes.spines.values():
        spine.set(color=palette.LINE, linewidth=0.5)
